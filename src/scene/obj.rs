//! Wavefront OBJ files.
//!
//! The file is first reduced to what geometry needs, its vertices and its faces' position indices, every
//! line of it checked, so that an error can say where it is. What is left goes through `tobj`, as one
//! object: groups, objects and materials merge in file order, vertices stay shared across them, and neither
//! a missing material file nor a bad texture coordinate stands in a ray's way. Faces of more than three
//! corners become fans around their first corner, concave ones too. Lines, points and free-form surfaces are
//! no triangles and are left out.

use super::{BUILTIN_NAMES, Mesh, Scene};
use crate::text;
use anyhow::{Context, Result, bail, ensure};
use std::fmt::Write;
use std::path::Path;

/// Statements of the format that say nothing about polygons.
const OTHER_STATEMENTS: [&str; 44] = [
    "vt",
    "vn",
    "vp",
    "p",
    "l",
    "o",
    "g",
    "s",
    "mg",
    "usemtl",
    "mtllib",
    "usemap",
    "maplib",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "shadow_obj",
    "trace_obj",
    "ctech",
    "stech",
    "cstype",
    "deg",
    "bmat",
    "step",
    "curv",
    "curv2",
    "surf",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "call",
    "csh",
    "bsp",
    "bzp",
    "cdc",
    "cdp",
    "res",
    "vc",
    "newmtl",
];

pub fn load(path: &Path) -> Result<Scene> {
    let shown = text::path(path);
    let metadata = match std::fs::metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let name = path.to_string_lossy();
            match BUILTIN_NAMES.contains(&name.as_ref()) {
                true => bail!("{shown}: no such file; for the built-in scene, give builtin:{name}"),
                false => bail!("{shown}: no such file; give an OBJ file or builtin:NAME"),
            }
        }
        Err(error) => bail!("{shown}: cannot be read: {error}"),
    };
    ensure!(
        !metadata.is_dir(),
        "{shown}: is a folder, not a mesh; give an OBJ file or builtin:NAME"
    );
    // To read a pipe could wait for ever.
    ensure!(
        metadata.is_file(),
        "{shown}: is no regular file; give an OBJ file or builtin:NAME"
    );
    let is_obj = path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("obj"));
    ensure!(
        is_obj,
        "{shown}: is no mesh that can be read here; give an OBJ file, whose name ends in .obj, or builtin:NAME"
    );
    let bytes = std::fs::read(path).with_context(|| format!("{shown}: cannot be read"))?;
    let mesh = parse(&bytes).map_err(|error| anyhow::anyhow!("{shown}{error}"))?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Scene {
        name: text::escaped(&name).into_owned(),
        mesh,
    })
}

/// Errors begin with what follows the file's name.
fn parse(bytes: &[u8]) -> Result<Mesh> {
    /// Some editors begin a UTF-8 file with it.
    const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    ensure!(
        !bytes.contains(&0),
        ": is a binary file, not an OBJ mesh; export the mesh as OBJ"
    );
    // Comments and names may be in any encoding; numbers are ASCII.
    let reduced = reduce(&String::from_utf8_lossy(bytes))?;
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_lines: true,
        ignore_points: true,
        single_index: false,
    };
    let (models, _) = tobj::load_obj_buf(&mut reduced.as_bytes(), &options, |_| {
        Err(tobj::LoadError::OpenFileFailed)
    })
    .map_err(|error| anyhow::anyhow!(": is no OBJ mesh: {error}; export it anew"))?;
    let mut mesh = Mesh::default();
    for model in models {
        let base = u32::try_from(mesh.positions.len()).context(": has more than 2^32 vertices")?;
        let positions = model.mesh.positions.chunks_exact(3);
        mesh.positions
            .extend(positions.map(|p| [widen(p[0]), widen(p[1]), widen(p[2])]));
        let triangles = model.mesh.indices.chunks_exact(3);
        mesh.triangles
            .extend(triangles.map(|t| [base + t[0], base + t[1], base + t[2]]));
    }
    ensure!(
        !mesh.triangles.is_empty(),
        ": is an empty mesh, it has no triangles; export it with its faces"
    );
    Ok(mesh)
}

/// `tobj` reads single or double precision, by a feature of the crate.
fn widen(x: impl Into<f64>) -> f64 {
    x.into()
}

/// The text's `v` and `f` statements alone, with `f` naming positions only. Checks every statement.
fn reduce(text: &str) -> Result<String> {
    let mut reduced = String::with_capacity(text.len());
    let (mut vertices, mut faces) = (0i64, 0usize);
    // Faces may name vertices that follow them; they are checked at the end.
    let mut furthest = (0i64, 0usize, 0usize);
    for (line, statement) in statements(text) {
        let mut words = statement.split_whitespace();
        match words.next() {
            None => {}
            Some(word) if word.starts_with('#') => {}
            Some("v") => {
                vertices += 1;
                let words: Vec<&str> = words.collect();
                let position = position(&words).map_err(|fault| {
                    anyhow::anyhow!(
                        ", line {line}: vertex {vertices} {fault}; correct or remove it"
                    )
                })?;
                reduced.push('v');
                for word in position {
                    reduced.push(' ');
                    reduced.push_str(word);
                }
                reduced.push('\n');
            }
            // `fo` is the format's former name of `f`.
            Some("f" | "fo") => {
                faces += 1;
                reduced.push('f');
                for corner in words {
                    let position = corner.split('/').next().unwrap_or_default();
                    let Ok(index) = position.parse::<i64>() else {
                        bail!(
                            ", line {line}: face {faces} has `{}` where a vertex's number belongs; correct or remove it",
                            text::word(corner)
                        );
                    };
                    let absolute = if index < 0 {
                        vertices.saturating_add(index).saturating_add(1)
                    } else {
                        index
                    };
                    ensure!(
                        absolute >= 1,
                        ", line {line}: face {faces} names vertex {index}, which is out of range (there are {vertices} before it, counted from 1); correct or remove it"
                    );
                    if absolute > furthest.0 {
                        furthest = (absolute, faces, line);
                    }
                    let _ = write!(reduced, " {absolute}");
                }
                reduced.push('\n');
            }
            Some(word) => ensure!(
                OTHER_STATEMENTS.contains(&word),
                ", line {line}: `{}` is no OBJ statement; give an OBJ mesh, or remove the line",
                text::word(word)
            ),
        }
    }
    let (index, face, line) = furthest;
    ensure!(
        index <= vertices,
        ", line {line}: face {face} names vertex {index}, which is out of range (there are {vertices}); correct or remove it"
    );
    Ok(reduced)
}

/// The words of a vertex that are its position: three, or four with a weight. What is wrong, if not.
fn position<'a, 'b>(words: &'b [&'a str]) -> Result<&'b [&'a str], String> {
    // Six or seven words: a colour follows.
    let kept = match words.len() {
        3 | 6 => 3,
        4 | 7 => 4,
        count => return Err(format!("has {count} numbers where 3 belong")),
    };
    let mut numbers = [0.0, 0.0, 0.0, 1.0f64];
    for (number, word) in numbers.iter_mut().zip(&words[..kept]) {
        *number = word
            .parse()
            .map_err(|_| format!("has `{}` where a number belongs", text::word(word)))?;
    }
    let [.., weight] = numbers;
    if weight == 0.0 {
        return Err("has the weight 0".into());
    }
    // Nearly every reader of OBJ files, `tobj` by default too, keeps single precision.
    for (number, axis) in numbers.iter().zip(["x", "y", "z"]) {
        let value = number / weight;
        if !value.is_finite() {
            return Err(format!("is not finite: its {axis} is {value}"));
        }
        if !(value as f32).is_finite() {
            return Err(format!(
                "is beyond the range of single precision: its {axis} is {value:e}"
            ));
        }
    }
    Ok(&words[..kept])
}

/// Lines with their numbers from 1; a line that ends in a backslash goes on in the next.
fn statements(text: &str) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        let (index, line) = lines.next()?;
        let Some(head) = line.strip_suffix('\\') else {
            return Some((index + 1, line.into()));
        };
        let mut joined = head.to_string();
        for (_, line) in lines.by_ref() {
            joined.push(' ');
            joined.push_str(line.strip_suffix('\\').unwrap_or(line));
            if !line.ends_with('\\') {
                break;
            }
        }
        Some((index + 1, joined.into()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(text: &str) -> Mesh {
        parse(text.as_bytes()).expect("a good mesh")
    }

    fn fault(text: &str) -> String {
        parse(text.as_bytes()).expect_err("a bad mesh").to_string()
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

    #[test]
    fn polygons_become_fans() {
        let square = mesh(&format!("{SQUARE}f 1 2 3 4\n"));
        assert_eq!(square.triangles, [[0, 1, 2], [0, 2, 3]]);
        let pentagon = mesh(&format!("{SQUARE}v -1 0.5 0\nf 1 2 3 4 5\n"));
        assert_eq!(pentagon.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    }

    #[test]
    fn a_concave_polygon_is_a_fan_around_its_first_corner() {
        let arrow = mesh("v 0 0 0\nv 2 1 0\nv 0 2 0\nv 1 1 0\nf 1 2 3 4\n");
        assert_eq!(arrow.triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn negative_indices_count_back_from_the_face() {
        let first = mesh(&format!("{SQUARE}f -4 -3 -2\nv 5 5 5\nf -1 1 2\n"));
        assert_eq!(first.triangles, [[0, 1, 2], [3, 0, 1]]);
        assert_eq!(first.positions[3], [5.0; 3]);
    }

    #[test]
    fn groups_objects_and_materials_merge_and_share_vertices() {
        let merged = mesh(&format!(
            "mtllib missing.mtl\n{SQUARE}o a\nusemtl x\nf 1 2 3\ng b c\nusemtl\ns off\nf 1 3 4\n"
        ));
        assert_eq!(merged.positions.len(), 4);
        assert_eq!(merged.triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn corners_with_other_texture_coordinates_share_their_position() {
        let seam = mesh(&format!("{SQUARE}vt 0 0\nf 1/1 2/1 3/9\nf 1//7 3/2/1 4\n"));
        assert_eq!(seam.positions.len(), 4);
    }

    #[test]
    fn lines_and_points_are_no_triangles() {
        let text = format!("{SQUARE}l 1 2 3\np 1\nf 1 2\nf 3\nf 1 2 3\n");
        assert_eq!(mesh(&text).triangles.len(), 1);
        let only_lines = fault(&format!("{SQUARE}l 1 2\np 3\nf 1 2\n"));
        assert_eq!(
            only_lines,
            ": is an empty mesh, it has no triangles; export it with its faces"
        );
    }

    #[test]
    fn weights_divide_colours_are_ignored_and_lines_go_on() {
        let text = "v 2 4 6 2\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nf 1 \\\n 2 \\\n 3\nv 0 0 0";
        let all = mesh(text);
        assert_eq!(all.positions[0], [1.0, 2.0, 3.0]);
        assert_eq!(all.triangles, [[0, 1, 2]]);
    }

    #[test]
    fn faces_may_name_later_vertices() {
        let text = format!("f 1 2 3\n{SQUARE}");
        assert_eq!(mesh(&text).positions[2], [1.0, 1.0, 0.0]);
    }

    #[test]
    fn faults_say_where_they_are() {
        for (text, expected) in [
            (
                "v 0 nan 0\n",
                ", line 1: vertex 1 is not finite: its y is NaN; correct or remove it",
            ),
            (
                "#\nv 0 0 0\nv 0 0 -inf\n",
                ", line 3: vertex 2 is not finite: its z is -inf; correct or remove it",
            ),
            (
                "v 1e39 0 0\n",
                ", line 1: vertex 1 is beyond the range of single precision: its x is 1e39; correct or remove it",
            ),
            (
                "v 1 0 0 0\n",
                ", line 1: vertex 1 has the weight 0; correct or remove it",
            ),
            (
                "v 1 2\n",
                ", line 1: vertex 1 has 2 numbers where 3 belong; correct or remove it",
            ),
            (
                "v 1 2 x\n",
                ", line 1: vertex 1 has `x` where a number belongs; correct or remove it",
            ),
            (
                "v 0 0 0\nf 1 1 2\n",
                ", line 2: face 1 names vertex 2, which is out of range (there are 1); correct or remove it",
            ),
            (
                "v 0 0 0\nf 0 1 1\n",
                ", line 2: face 1 names vertex 0, which is out of range (there are 1 before it, counted from 1); correct or remove it",
            ),
            (
                "v 0 0 0\nf 1 1 1\nf -2 1 1\n",
                ", line 3: face 2 names vertex -2, which is out of range (there are 1 before it, counted from 1); correct or remove it",
            ),
            (
                "f a/1 2 3\n",
                ", line 1: face 1 has `a/1` where a vertex's number belongs; correct or remove it",
            ),
            (
                "f -9223372036854775808 2 3\n",
                ", line 1: face 1 names vertex -9223372036854775808, which is out of range (there are 0 before it, counted from 1); correct or remove it",
            ),
            (
                "once upon a time\n",
                ", line 1: `once` is no OBJ statement; give an OBJ mesh, or remove the line",
            ),
            (
                "a\0b",
                ": is a binary file, not an OBJ mesh; export the mesh as OBJ",
            ),
            (
                "",
                ": is an empty mesh, it has no triangles; export it with its faces",
            ),
        ] {
            assert_eq!(fault(text), expected, "for {text:?}");
        }
    }
}
