//! `dynrt run`: the lists of several frames on the chip in Verilog.

use crate::support::command::dynrt;
use serde_json::Value;

/// Frames of a still scene: each is a list of its own, and the figures of all are sums of theirs.
#[test]
fn the_command_runs_a_list_for_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let arguments = "run builtin:cornell --config tiny --size 24x18 --frames 2 --out film --gif film.gif --json film.json";
    let output = dynrt(arguments, folder).output().unwrap();
    let (stdout, stderr) = (output.stdout, String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success() && stderr.is_empty(), "{stderr}");
    let text = String::from_utf8(stdout).unwrap();
    for line in [
        "frame 0: ",
        "frame 1: ",
        "frames: film",
        "animated picture: film.gif",
    ] {
        assert!(text.lines().any(|l| l.starts_with(line)), "{line}: {text}");
    }
    let picture = |name: &str| image::open(folder.join(name)).unwrap().into_rgb8();
    let pictures = [0, 1].map(|number| picture(&format!("film/frame_000{number}.png")));
    assert_eq!(pictures[0].dimensions(), (24, 18));
    assert_eq!(pictures[0], pictures[1]);
    let json: Value =
        serde_json::from_slice(&std::fs::read(folder.join("film.json")).unwrap()).unwrap();
    let frames = json["per_frame"].as_array().unwrap();
    assert_eq!((frames.len(), &json["frames"]), (2, &Value::from(2)));
    for key in [
        "cycles",
        "rays",
        "hits",
        "bytes_read",
        "bytes_written",
        "cast_cycles",
    ] {
        let sum: u64 = frames
            .iter()
            .map(|frame| frame[key].as_u64().unwrap())
            .sum();
        assert_eq!(json[key].as_u64(), Some(sum), "{key}");
        assert!(sum > 0, "{key}");
    }
    for key in [
        "skinning_cycles",
        "update_cycles",
        "influences",
        "triangles_updated",
    ] {
        assert_eq!(json[key], 0, "{key}: nothing moves");
    }
    for key in [
        "update_triangles_per_clock",
        "skinning_influences_per_clock",
    ] {
        assert!(json[key].is_null(), "{key}");
    }
    let rate = json["rays"].as_f64().unwrap() / json["cast_cycles"].as_f64().unwrap();
    assert_eq!(json["rays_per_clock"].as_f64(), Some(rate));
    assert_eq!(json["rays"], 2 * 24 * 18);
    assert!(json["checked"].as_u64() > json["rays"].as_u64());
    // One frame is a picture, which a still scene has without --frames as well.
    for (frames, name) in [("", "still.png"), (" --view outside --frames 1", "one.png")] {
        let view = if frames.is_empty() {
            " --view outside"
        } else {
            ""
        };
        let arguments =
            format!("run builtin:cornell --config tiny --size 24x18{view}{frames} --out {name}");
        let output = dynrt(&arguments, folder).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    assert_eq!(picture("still.png"), picture("one.png"));
}
