//! Wavefront OBJ files.
//!
//! The file is divided into statements (see [`lexer`]) and reduced to its vertices and the position indices of its
//! faces. Every statement is checked, so errors can name the line. The result is read by
//! `tobj` as one object: groups, objects and materials merge in file order, and vertices stay shared. A missing
//! material file or a bad texture coordinate causes no error. Faces of more than three
//! corners become fans around their first corner, including concave ones.
//!
//! | after `v` | meaning |
//! |---|---|
//! | 3 numbers | x y z |
//! | 4 numbers | x y z and a weight, by which they are divided |
//! | 6 or 7 numbers | x y z and a colour, with or without alpha, which is ignored |
//! | 5, or 8 and more | x y z; the rest has an unknown meaning and is left out with a warning |
//!
//! Lines, points, free-form curves and surfaces, references to other files and unknown statements are left out with a
//! warning (see [`left_out`]).

mod left_out;
mod lexer;

pub use left_out::LeftOut;

use super::sources::{GLTF, OBJ, is_named};
use super::{BUILTIN_NAMES, Mesh, Scene};
use crate::text;
use anyhow::{Context, Result, bail, ensure};
use lexer::{Kind, Statement};
use std::fmt::Write;
use std::path::Path;

/// Reads a file as a scene, with one warning per kind of content that is not in the picture.
pub fn load(path: &Path) -> Result<Scene> {
    let (mesh, left_out) = read(path)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Scene {
        name: text::escaped(&name).into_owned(),
        mesh,
        warnings: left_out.warnings(&text::path(path), None),
    })
}

/// Reads a file's mesh, and counts the parts that are left out.
pub fn read(path: &Path) -> Result<(Mesh, LeftOut)> {
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
        "{shown}: is a folder, not a mesh; {THEY_READ} a folder of OBJ files as a sequence; give this command an OBJ file or builtin:NAME"
    );
    // Reading a pipe could wait forever.
    ensure!(
        metadata.is_file(),
        "{shown}: is not a regular file; give an OBJ file or builtin:NAME"
    );
    ensure!(
        !is_named(path, &GLTF),
        "{shown}: is a glTF file; {THEY_READ} it; give this command an OBJ file or builtin:NAME"
    );
    ensure!(
        is_named(path, &OBJ),
        "{shown}: is not a mesh that can be read; give an OBJ file, whose name ends in .obj, or builtin:NAME"
    );
    let bytes = std::fs::read(path).with_context(|| format!("{shown}: cannot be read"))?;
    parse(&bytes).map_err(|error| anyhow::anyhow!("{shown}{error}"))
}

/// The commands that read animated scenes.
const THEY_READ: &str = "`dynrt animate`, `dynrt vectors` and `dynrt cosim --unit skinning` read";

/// Parses a file. Errors do not include the file's name.
fn parse(bytes: &[u8]) -> Result<(Mesh, LeftOut)> {
    let text = lexer::decode(bytes)
        .context(": is a binary file, not an OBJ mesh; export the mesh as OBJ")?;
    let (reduced, left_out) = reduce(&text)?;
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_lines: true,
        ignore_points: true,
        single_index: false,
    };
    let (models, _) = tobj::load_obj_buf(&mut reduced.as_bytes(), &options, |_| {
        Err(tobj::LoadError::OpenFileFailed)
    })
    .map_err(|error| anyhow::anyhow!(": is not an OBJ mesh: {error}; export it again"))?;
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
        ": is an empty mesh, it has no triangles{}; export it with its faces",
        left_out.instead_of_triangles()
    );
    Ok((mesh, left_out))
}

/// `tobj` reads single or double precision, depending on a feature of the crate.
fn widen(x: impl Into<f64>) -> f64 {
    x.into()
}

/// The `v` and `f` statements of a text, with only positions in `f`, and the counts of all other statements. Checks every
/// statement.
fn reduce(text: &str) -> Result<(String, LeftOut)> {
    let mut reduction = Reduction {
        text: String::with_capacity(text.len()),
        ..Reduction::default()
    };
    let mut left_out = LeftOut::default();
    let mut first_unknown = None;
    for statement in lexer::statements(text) {
        let Statement { line, word, .. } = statement;
        match statement.kind {
            Kind::Vertex => reduction.vertex(&statement, &mut left_out)?,
            Kind::Face => reduction.face(&statement, &mut left_out)?,
            Kind::NotPolygon => left_out.not_polygons.add(word, line),
            Kind::OtherFile => left_out.other_files.add(word, line),
            Kind::Unknown => {
                first_unknown = first_unknown.or(Some((line, word)));
                left_out.unknown.add(word, line);
            }
            Kind::Name | Kind::Attribute | Kind::Parameters => {}
        }
    }
    if reduction.vertices == 0 && reduction.faces == 0 {
        match first_unknown {
            None => bail!(
                ": is an empty file, not an OBJ mesh: it has neither vertices (`v`) nor faces (`f`); export the mesh again"
            ),
            Some((line, word)) => bail!(
                ", line {line}: `{}` is not an OBJ statement, and the file, which has neither vertices (`v`) nor faces (`f`), is not an OBJ mesh; give an OBJ mesh",
                text::word(word)
            ),
        }
    }
    reduction.check_furthest()?;
    Ok((reduction.text, left_out))
}

/// The state of the reduction.
#[derive(Default)]
struct Reduction {
    text: String,
    vertices: i64,
    faces: usize,
    /// The greatest index of a vertex that a face names, that face and its line. Faces may name vertices that follow
    /// them, so they are checked at the end.
    furthest: (i64, usize, usize),
}

impl Reduction {
    fn vertex(&mut self, statement: &Statement, left_out: &mut LeftOut) -> Result<()> {
        self.vertices += 1;
        let line = statement.line;
        let words: Vec<&str> = statement.argument.split_whitespace().collect();
        let (position, is_odd) = position(&words).map_err(|fault| {
            anyhow::anyhow!(
                ", line {line}: vertex {} {fault}; correct or remove it",
                self.vertices
            )
        })?;
        if is_odd {
            left_out.odd_vertices.add(statement.word, line);
        }
        self.text.push('v');
        for word in position {
            self.text.push(' ');
            self.text.push_str(word);
        }
        self.text.push('\n');
        Ok(())
    }

    fn face(&mut self, statement: &Statement, left_out: &mut LeftOut) -> Result<()> {
        self.faces += 1;
        let (line, faces, vertices) = (statement.line, self.faces, self.vertices);
        self.text.push('f');
        let mut corners = 0;
        for corner in statement.argument.split_whitespace() {
            corners += 1;
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
            if absolute > self.furthest.0 {
                self.furthest = (absolute, faces, line);
            }
            let _ = write!(self.text, " {absolute}");
        }
        self.text.push('\n');
        ensure!(
            corners > 0,
            ", line {line}: face {faces} has no corners; give it at least three, or remove it"
        );
        if corners < 3 {
            left_out.small_faces.add(statement.word, line);
        }
        Ok(())
    }

    /// Checks that the vertices that faces name exist.
    fn check_furthest(&self) -> Result<()> {
        let (index, face, line) = self.furthest;
        ensure!(
            index <= self.vertices,
            ", line {line}: face {face} names vertex {index}, which is out of range (there are {}); correct or remove it",
            self.vertices
        );
        Ok(())
    }
}

/// The words of a vertex's position (three, or four with a weight), and whether further words follow that are not a
/// colour. The error describes the fault if it is not a position.
fn position<'a, 'b>(words: &'b [&'a str]) -> Result<(&'b [&'a str], bool), String> {
    let kept = match words.len() {
        1 => return Err("has 1 number where 3 belong".into()),
        count @ (0 | 2) => return Err(format!("has {count} numbers where 3 belong")),
        4 => 4,
        _ => 3,
    };
    let (position, more) = words.split_at(kept);
    let is_number = |word: &&str| word.parse::<f64>().is_ok();
    let is_odd = !matches!(more.len(), 0 | 3 | 4) || !more.iter().all(is_number);
    let mut numbers = [0.0, 0.0, 0.0, 1.0f64];
    for (number, word) in numbers.iter_mut().zip(position) {
        *number = word
            .parse()
            .map_err(|_| format!("has `{}` where a number belongs", text::word(word)))?;
    }
    let [.., weight] = numbers;
    if weight == 0.0 {
        return Err("has the weight 0".into());
    }
    // Most readers of OBJ files, including `tobj` by default, use single precision.
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
    Ok((position, is_odd))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(text: &str) -> Mesh {
        let (mesh, left_out) = parse(text.as_bytes()).expect("a good mesh");
        assert_eq!(left_out, LeftOut::default(), "for {text:?}");
        mesh
    }

    /// A mesh, and the warnings for the file m.obj.
    fn warned(text: &str) -> (Mesh, Vec<String>) {
        let (mesh, left_out) = parse(text.as_bytes()).expect("a good mesh");
        (mesh, left_out.warnings("m.obj", None))
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
    fn what_is_not_in_the_mesh_is_warned_of_once() {
        let more = |lines: &str| warned(&format!("{SQUARE}{lines}f 1 2 3\n"));
        let many: String = (1..=12).map(|i| format!("x{i} 0\nx{i}\n")).collect();
        for (lines, expected) in [
            (
                "t crease 2/1/0 0 1 2.0\nvw 0 0 1.0\n",
                &["2 lines of unknown statements `t`, `vw` left out, first in line 5"][..],
            ),
            (
                "\u{1a}\n",
                &["1 line of the unknown statement `\\u{1a}` left out, first in line 5"],
            ),
            (
                &many,
                &[
                    "24 lines of unknown statements `x1`, `x2`, `x3`, `x4`, `x5`, `x6`, `x7`, `x8`, `x9` and others left out, first in line 5",
                ],
            ),
            (
                "p 1 2\nl 1 2 \\\n3\nl 1 2\nsurf 0 1 0 1 1 2 3 4\nparm u 0 1\nend\n",
                &[
                    "1 `p`, 2 `l`, 1 `surf` left out, first in line 5; only faces are drawn: export lines, points, curves and surfaces as polygons",
                ],
            ),
            (
                "call more.obj\ncsh ls\n",
                &[
                    "1 `call`, 1 `csh` left out, first in line 5; other files are not read: put what they hold into this one",
                ],
            ),
            (
                "f 1 2\nf 3\n",
                &["2 faces of fewer than three corners left out, first in line 5"],
            ),
            (
                "f 1\n",
                &["1 face of fewer than three corners left out, first in line 5"],
            ),
            (
                "v 0 0 0 1 1\nv 0 0 0 1 1 1 1 9\nv 0 0 0 1 1 red\n",
                &[
                    "3 vertices have something after x y z that is neither a weight nor a colour, first in line 5; it is left out",
                ],
            ),
            (
                "l 1 2\nf 1 2\nx\n",
                &[
                    "1 line of the unknown statement `x` left out, first in line 7",
                    "1 `l` left out, first in line 5; only faces are drawn: export lines, points, curves and surfaces as polygons",
                    "1 face of fewer than three corners left out, first in line 6",
                ],
            ),
            // There are no warnings about statements that only describe the appearance.
            (
                "vt 0 0\nvn 0 0 1\nvp 0\no a\ng b c\ns off\nmg 1 2\nmtllib x.mtl\nusemtl y\nlod 3\nv 0 0 0 1 0 0\n",
                &[],
            ),
        ] {
            let (mesh, warnings) = more(lines);
            assert_eq!(mesh.triangles, [[0, 1, 2]], "for {lines:?}");
            let expected: Vec<String> = expected.iter().map(|w| format!("m.obj: {w}")).collect();
            assert_eq!(warnings, expected, "for {lines:?}");
        }
    }

    #[test]
    fn a_file_without_triangles_says_what_it_has_instead() {
        for (lines, expected) in [
            ("", ""),
            ("t 1\n", ""),
            (
                "l 1 2\np 3\nf 1 2\n",
                ", only 1 `l`, 1 `p`, 1 face of fewer than three corners",
            ),
            ("f 1\nf 2\n", ", only 2 faces of fewer than three corners"),
            ("curv 0 1 1 2\ncurv 0 1 1 2\n", ", only 2 `curv`"),
        ] {
            assert_eq!(
                fault(&format!("{SQUARE}{lines}")),
                format!(
                    ": is an empty mesh, it has no triangles{expected}; export it with its faces"
                )
            );
        }
    }

    #[test]
    fn four_numbers_are_a_weighted_vertex_and_more_are_a_colour() {
        for (vertex, expected, is_odd) in [
            ("2 4 6", [2.0, 4.0, 6.0], false),
            ("2 4 6 2", [1.0, 2.0, 3.0], false),
            ("2 4 6 2 # weight", [1.0, 2.0, 3.0], false),
            ("2 4 6 # x y z", [2.0, 4.0, 6.0], false),
            ("2 4 6#1", [2.0, 4.0, 6.0], false),
            ("2 4 6 0.5 0.25 0", [2.0, 4.0, 6.0], false),
            ("2 4 6 0.25 0.5 0.5 1", [2.0, 4.0, 6.0], false),
            ("2 4 6 0 0 0 0", [2.0, 4.0, 6.0], false),
            ("2 4 6 255 128 0 # tan", [2.0, 4.0, 6.0], false),
            ("2 4 6 2 2", [2.0, 4.0, 6.0], true),
            ("2 4 6 1 1 1 1 1", [2.0, 4.0, 6.0], true),
            ("2 4 6 1 1 1 0 0 1", [2.0, 4.0, 6.0], true),
            ("2 4 6 1 1 x", [2.0, 4.0, 6.0], true),
            ("+2. .4e1 \\ \n 6", [2.0, 4.0, 6.0], false),
        ] {
            let (mesh, warnings) = warned(&format!("v {vertex}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"));
            assert_eq!(mesh.positions[0], expected, "for {vertex}");
            assert_eq!(warnings.len(), usize::from(is_odd), "{warnings:?}");
        }
    }

    #[test]
    fn however_a_file_is_written_down_it_is_the_same_mesh() {
        let plain = mesh("v 1 2 3\nv 4 5 6\nv 7 8 9\nv 0 1 0\nf 1 2 3\nf -1 -2 -3\n");
        for text in [
            "v 1 2 3\rv 4 5 6\rv 7 8 9\rv 0 1 0\rf 1 2 3\rf -1 -2 -3\r",
            "v 1 2 3\r\nv 4 5 6\r\nv 7 8 9\r\nv 0 1 0\r\nf 1 \\\r\n2 3\r\nf -1 -2 -3",
            "# C:\\model\\\nv 1 2 3 # a\nv 4 5 6\nmtllib C:\\tex\\\nv 7 8 9\ng \\\nv 0 1 0\nf 1 2 3 # b\n f -1 -2 -3\n",
            "v 1 2 3 \\\nv 4 5 6\nvt 0 0 \\\nv 7 8 9\nv 0 1 0\nf 1 2 \\ \t\n3\nf -1 \\\n-2 \\\n-3",
        ] {
            assert_eq!(mesh(text), plain, "for {text:?}");
            let little = text.encode_utf16().flat_map(u16::to_le_bytes);
            let big = text.encode_utf16().flat_map(u16::to_be_bytes);
            for bytes in [
                [&b"\xef\xbb\xbf"[..], text.as_bytes()].concat(),
                b"\xff\xfe".iter().copied().chain(little.clone()).collect(),
                b"\xfe\xff".iter().copied().chain(big.clone()).collect(),
                little.collect(),
                big.collect(),
            ] {
                assert_eq!(parse(&bytes).unwrap().0, plain, "for {bytes:?}");
            }
        }
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
                "v 1 2 3 x\n",
                ", line 1: vertex 1 has `x` where a number belongs; correct or remove it",
            ),
            (
                "v 1 # 2 3\n",
                ", line 1: vertex 1 has 1 number where 3 belong; correct or remove it",
            ),
            (
                "v 0 0 0\r# a\\\rf 1 \\\r1 1\rf # 1 1\r",
                ", line 5: face 2 has no corners; give it at least three, or remove it",
            ),
            (
                "v 0 \\\r\n0 \\\r\n0\r\nf\r\n",
                ", line 4: face 1 has no corners; give it at least three, or remove it",
            ),
            (
                "# a\nonce upon a time\n",
                ", line 2: `once` is not an OBJ statement, and the file, which has neither vertices (`v`) nor faces (`f`), is not an OBJ mesh; give an OBJ mesh",
            ),
            (
                "# a\nmtllib b\n",
                ": is an empty file, not an OBJ mesh: it has neither vertices (`v`) nor faces (`f`); export the mesh again",
            ),
            (
                "a\0b",
                ": is a binary file, not an OBJ mesh; export the mesh as OBJ",
            ),
            (
                "",
                ": is an empty file, not an OBJ mesh: it has neither vertices (`v`) nor faces (`f`); export the mesh again",
            ),
        ] {
            assert_eq!(fault(text), expected, "for {text:?}");
        }
    }
}
