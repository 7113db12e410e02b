//! An interrupted run leaves no files behind.

use super::{contents, dynrt, folder, prints};
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Time limit for an expected event.
const PATIENCE: Duration = Duration::from_secs(120);

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let started = Instant::now();
    while !holds() {
        assert!(started.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
    names.collect()
}

/// The temporary folder of a run in `folder`, as soon as it has contents.
fn temporary(folder: &Path) -> Option<String> {
    let entries = fs::read_dir(folder).unwrap().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut temporary = names.filter(|name| name.starts_with(".dynrt-"));
    temporary.find(|name| fs::read_dir(folder.join(name)).is_ok_and(|entries| entries.count() > 0))
}

fn start(command: &mut Command) -> Child {
    command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn send(child: &Child, signal: Signal) {
    let process = Pid::from_raw(child.id() as i32).unwrap();
    kill_process(process, signal).unwrap();
}

/// The command as `env` starts it with an option for signals. A process inherits which signals are ignored: the tests themselves may
/// run under `nohup`.
fn with(option: &str, arguments: &str, folder: &Path) -> Command {
    let own = dynrt(arguments, folder);
    let mut command = Command::new("env");
    command
        .arg(option)
        .arg(own.get_program())
        .args(own.get_args())
        .current_dir(folder)
        .stdin(Stdio::null());
    command
}

const HEEDED: &str = "--default-signal=HUP,INT,TERM";

/// Starts a command that writes for some time, and sends it a signal while it writes.
fn signalled(command: &mut Command, folder: &Path, signal: Signal) -> Child {
    let child = start(command);
    wait_until("the command writes", || temporary(folder).is_some());
    send(&child, signal);
    child
}

/// Starts a command that writes for some time, and interrupts it.
fn ended(arguments: &str, folder: &Path, signal: Signal) -> Output {
    let child = signalled(&mut with(HEEDED, arguments, folder), folder, signal);
    child.wait_with_output().unwrap()
}

const LONG: &str = "vectors builtin:interior --size 256x192 --out v";

#[test]
fn an_interrupted_run_leaves_nothing_and_ends_by_the_signal() {
    for (signal, number) in [(Signal::INT, 2), (Signal::TERM, 15), (Signal::HUP, 1)] {
        let folder = folder();
        fs::write(folder.path().join("mine"), "stays").unwrap();
        let output = ended(LONG, folder.path(), signal);
        assert_eq!(output.status.signal(), Some(number));
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        assert_eq!(String::from_utf8_lossy(&output.stdout), "");
        assert_eq!(names(folder.path()), ["mine"]);
    }
}

/// As under `nohup`.
#[test]
fn a_run_that_ignores_a_hangup_goes_on() {
    let folder = folder();
    let command = "vectors builtin:interior --size 64x48 --out v";
    let mut command = with("--ignore-signal=HUP", command, folder.path());
    let child = signalled(&mut command, folder.path(), Signal::HUP);
    // The signal was sent before the end.
    assert!(!folder.path().join("v").exists());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert_eq!(names(folder.path()), ["v"]);
}

#[test]
fn what_a_killed_run_leaves_the_next_one_removes() {
    let folder = folder();
    let output = ended(LONG, folder.path(), Signal::KILL);
    assert_eq!(output.status.signal(), Some(9));
    assert!(
        temporary(folder.path()).is_some(),
        "{:?}",
        names(folder.path())
    );
    prints(
        "vectors builtin:sphere?level=0 --config tiny --size 8x8 --limit 1 --out v",
        folder.path(),
    );
    assert_eq!(names(folder.path()), ["v"]);
    // The same for a command that writes a single file.
    ended(
        &LONG.replace("--out v", "--out w"),
        folder.path(),
        Signal::KILL,
    );
    assert!(temporary(folder.path()).is_some());
    prints(
        "stats builtin:cornell --size 8x8 --json a.json",
        folder.path(),
    );
    let mut left = names(folder.path());
    left.sort();
    assert_eq!(left, ["a.json", "v"]);
}

#[test]
fn an_earlier_result_outlives_an_interrupted_one() {
    let folder = folder();
    prints(
        "vectors builtin:sphere?level=0 --config tiny --size 8x8 --limit 1 --out v",
        folder.path(),
    );
    let before = contents(folder.path());
    ended(LONG, folder.path(), Signal::TERM);
    assert!(contents(folder.path()) == before);
}

/// The processes with a working directory in a folder or below.
fn running_in(folder: &Path) -> Vec<String> {
    let folder = folder.canonicalize().unwrap();
    let processes = fs::read_dir("/proc").unwrap().flatten();
    processes
        .filter(|process| {
            let place = fs::read_link(process.path().join("cwd"));
            place.is_ok_and(|place| place.starts_with(&folder))
        })
        .map(|process| fs::read_to_string(process.path().join("comm")).unwrap_or_default())
        .collect()
}

#[cfg(target_os = "linux")]
#[test]
fn tools_end_with_the_run_that_has_started_them() {
    let (folder, cache) = (folder(), tempfile::tempdir().unwrap());
    let command =
        "cosim builtin:cornell --size 8x8 --config tiny --json a.json --trace w.fst --cycles 5";
    let child = start(with(HEEDED, command, folder.path()).env("DYNRT_CACHE", cache.path()));
    wait_until("a tool runs", || !running_in(cache.path()).is_empty());
    send(&child, Signal::TERM);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.signal(), Some(15));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    // The kernel may not have removed the last one yet.
    wait_until("tools end", || running_in(cache.path()).is_empty());
    let left = names(cache.path());
    assert!(
        left.iter().all(|name| !name.starts_with("building-")),
        "{left:?}"
    );
    assert_eq!(
        contents(folder.path()).len(),
        0,
        "{:?}",
        names(folder.path())
    );
}
