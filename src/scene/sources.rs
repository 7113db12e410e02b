//! The names of scenes, and the files that are read for them.

use super::ANIMATED_NAMES;
use crate::text;
use serde_json::Value;
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// A scene as named by the user: `builtin:NAME`, or the path of a file or a folder. Paths are bytes and need not be UTF-8.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneSpec(OsString);

impl SceneSpec {
    /// A scene with this name.
    pub fn new(spec: impl AsRef<OsStr>) -> SceneSpec {
        SceneSpec(spec.as_ref().to_os_string())
    }

    /// The part after `builtin:`, if the scene is a built-in one.
    pub fn builtin(&self) -> Option<String> {
        let name = self.0.to_string_lossy();
        name.strip_prefix("builtin:").map(str::to_string)
    }

    /// The path of the scene's file or folder, if the scene is not a built-in one.
    pub fn path(&self) -> Option<&Path> {
        match self.builtin() {
            Some(_) => None,
            None => Some(Path::new(&self.0)),
        }
    }

    /// Whether the path is a folder of frames, or names a glTF file.
    pub fn is_folder_or_gltf(&self) -> bool {
        self.path()
            .is_some_and(|path| path.is_dir() || is_named(path, &GLTF))
    }
}

impl SceneSpec {
    /// Whether a scene of this name moves: a folder of frames, a glTF file, or an animated built-in scene.
    pub fn is_animated(&self) -> bool {
        let builtin = self.builtin();
        let name = builtin.as_deref().and_then(|name| name.split('?').next());
        name.is_some_and(|name| ANIMATED_NAMES.contains(&name)) || self.is_folder_or_gltf()
    }
}

impl AsRef<OsStr> for SceneSpec {
    fn as_ref(&self) -> &OsStr {
        &self.0
    }
}

impl From<OsString> for SceneSpec {
    fn from(spec: OsString) -> SceneSpec {
        SceneSpec(spec)
    }
}

/// The form for messages.
impl fmt::Display for SceneSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text::path(Path::new(&self.0)))
    }
}

/// A file or folder that is read for a scene, or that the scene's file names.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Source {
    /// Its role for the scene. In a sorted list, the file named by the user comes first.
    pub role: Role,
    /// Its path.
    pub path: PathBuf,
}

/// The role of a [`Source`] for its scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// The file, or the folder, that the user named.
    Scene,
    /// An OBJ file of a sequence.
    Frame,
    /// A file with vertices or other data that a glTF file names.
    Buffer,
    /// A picture that a glTF file names.
    Image,
    /// A material file that an OBJ file names.
    Material,
}

impl Role {
    /// The name of the role in messages.
    pub fn name(self) -> &'static str {
        match self {
            Role::Scene => "the input scene",
            Role::Frame => "a frame of the input scene",
            Role::Buffer => "a buffer of the input scene",
            Role::Image => "an image of the input scene",
            Role::Material => "a material file of the input scene",
        }
    }
}

pub(super) const OBJ: [&str; 1] = ["obj"];
pub(super) const GLTF: [&str; 2] = ["glb", "gltf"];

/// Whether a file's name ends in one of `extensions`, ignoring case.
pub(super) fn is_named(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().unwrap_or_default();
    extensions
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

/// The files and folders that are read for a scene, and those that its files name, each once; empty for a built-in scene.
///
/// Callers use the list to avoid overwriting these files. The loaders report faults of the files; a file that cannot be read
/// names no other files here.
pub fn sources(spec: &SceneSpec) -> Vec<Source> {
    let Some(path) = spec.path() else {
        return vec![];
    };
    let mut found = BTreeSet::new();
    let mut add = |path: PathBuf, role| found.insert(Source { path, role });
    add(path.to_path_buf(), Role::Scene);
    if path.is_dir() {
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        for file in entries.map(|entry| entry.path()) {
            if is_named(&file, &OBJ) {
                let materials = material_files(&file);
                add(file, Role::Frame);
                materials.into_iter().for_each(|path| {
                    add(path, Role::Material);
                });
            }
        }
    } else if is_named(path, &OBJ) {
        material_files(path).into_iter().for_each(|path| {
            add(path, Role::Material);
        });
    } else if is_named(path, &GLTF) {
        let document = gltf_json(path).unwrap_or_default();
        for (list, role) in [("buffers", Role::Buffer), ("images", Role::Image)] {
            for uri in uris(&document[list]) {
                for place in places_of(path, uri) {
                    add(place, role);
                }
            }
        }
    }
    found.into_iter().collect()
}

/// At most `limit` bytes of a regular file. Opening a pipe could wait forever, and reading a device could never end.
fn bytes_of(path: &Path, limit: u64) -> Option<Vec<u8>> {
    let mut bytes = vec![];
    let file = open_regular(path).ok()?;
    file.take(limit).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// The contents of a regular file.
///
/// # Errors
/// If the file is not regular, or cannot be read.
pub(super) fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = vec![];
    open_regular(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn open_regular(path: &Path) -> io::Result<File> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    File::open(path)
}

/// The file that a URI in a glTF file names: percent-encoded bytes, which need not be UTF-8.
pub(super) fn place_of_uri(folder: &Path, uri: &str) -> Option<PathBuf> {
    let name: Vec<u8> = percent_encoding::percent_decode_str(uri).collect();
    Some(folder.join(os_string(&name)?))
}

/// The material files that an OBJ file names. A name may contain blanks, and a statement may have several names, so all possible
/// readings of a statement are listed.
fn material_files(obj: &Path) -> Vec<PathBuf> {
    const STATEMENT: &[u8] = b"mtllib";
    let bytes = bytes_of(obj, u64::MAX).unwrap_or_default();
    let bytes = utf8_of_utf16(&bytes).unwrap_or(bytes);
    let folder = obj.parent().unwrap_or(Path::new(""));
    let mut files = vec![];
    for line in bytes.split(|byte| matches!(byte, b'\n' | b'\r')) {
        let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
        let Some(names) = line.trim_ascii_start().strip_prefix(STATEMENT) else {
            continue;
        };
        if !names.first().is_some_and(u8::is_ascii_whitespace) {
            continue;
        }
        let names = names.trim_ascii();
        let uncommented = names.split(|byte| *byte == b'#').next();
        let uncommented = uncommented.unwrap_or_default().trim_ascii();
        let words = names.split(u8::is_ascii_whitespace);
        for name in words.chain([names, uncommented]) {
            if let (false, Some(name)) = (name.is_empty(), os_string(name)) {
                files.push(folder.join(name));
            }
        }
    }
    files
}

/// Text in UTF-16 with its byte order mark, as UTF-8.
fn utf8_of_utf16(bytes: &[u8]) -> Option<Vec<u8>> {
    let unit: fn([u8; 2]) -> u16 = match bytes {
        [0xff, 0xfe, ..] => u16::from_le_bytes,
        [0xfe, 0xff, ..] => u16::from_be_bytes,
        _ => return None,
    };
    let units: Vec<u16> = bytes[2..]
        .chunks_exact(2)
        .map(|pair| unit([pair[0], pair[1]]))
        .collect();
    Some(String::from_utf16_lossy(&units).into_bytes())
}

/// The JSON of a glTF file, or of the first chunk of a binary one. Data after the value is ignored.
fn gltf_json(path: &Path) -> Option<Value> {
    const HEAD: u64 = 20;
    let head = bytes_of(path, HEAD)?;
    let bytes = match head.starts_with(b"glTF") {
        false => bytes_of(path, u64::MAX)?,
        true => {
            let length = u32::from_le_bytes(head.get(12..16)?.try_into().ok()?);
            let bytes = bytes_of(path, HEAD + u64::from(length))?;
            bytes.get(HEAD as usize..)?.to_vec()
        }
    };
    let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    serde_json::Deserializer::from_slice(json)
        .into_iter()
        .next()?
        .ok()
}

/// The URIs in a list of buffers or images that name files.
fn uris(list: &Value) -> impl Iterator<Item = &str> {
    let entries = list.as_array().into_iter().flatten();
    entries
        .filter_map(|entry| entry.get("uri")?.as_str())
        .filter(|uri| {
            let scheme = uri.get(..5).unwrap_or_default();
            !scheme.eq_ignore_ascii_case("data:")
        })
}

/// The files that a URI in a glTF file may name: after percent-decoding, or unchanged.
fn places_of(gltf: &Path, uri: &str) -> Vec<PathBuf> {
    let folder = gltf.parent().unwrap_or(Path::new(""));
    let places = [place_of_uri(folder, uri), Some(folder.join(uri))];
    places.into_iter().flatten().collect()
}

/// Bytes as a file name.
fn os_string(bytes: &[u8]) -> Option<OsString> {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStringExt;
        Some(OsString::from_vec(bytes.to_vec()))
    }
    #[cfg(not(unix))]
    {
        String::from_utf8(bytes.to_vec()).ok().map(OsString::from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// Role and file name of each source, without the folder.
    fn listed(spec: &Path, within: &Path) -> Vec<(Role, String)> {
        let mut list: Vec<_> = sources(&SceneSpec::new(spec))
            .into_iter()
            .map(|source| {
                let name = source.path.strip_prefix(within).unwrap();
                (source.role, name.to_string_lossy().into_owned())
            })
            .collect();
        list.sort();
        list
    }

    fn of(role: Role, names: &[&str]) -> Vec<(Role, String)> {
        names.iter().map(|name| (role, name.to_string())).collect()
    }

    #[test]
    fn a_built_in_scene_reads_no_file() {
        assert_eq!(sources(&SceneSpec::new("builtin:teapot?level=2")), []);
        let spec = SceneSpec::new("builtin:teapot?level=2");
        assert_eq!(spec.builtin().as_deref(), Some("teapot?level=2"));
        assert_eq!(spec.path(), None);
    }

    #[test]
    fn an_obj_file_names_its_material_files() {
        let folder = tempfile::tempdir().unwrap();
        let text =
            "# mtllib no.mtl\nmtllib a b.mtl\r\n\tmtllib sub/c.mtl # c\nmtllibx d.mtl\nv 0 0 0\n";
        let expected = [
            of(Role::Scene, &["m.obj"]),
            of(
                Role::Material,
                &[
                    "#",
                    "a",
                    "a b.mtl",
                    "b.mtl",
                    "c",
                    "sub/c.mtl",
                    "sub/c.mtl # c",
                ],
            ),
        ]
        .concat();
        let path = folder.path().join("m.obj");
        fs::write(&path, text).unwrap();
        assert_eq!(listed(&path, folder.path()), expected);
        let wide: Vec<u8> = "\u{feff}"
            .chars()
            .chain(text.chars())
            .flat_map(|c| (c as u16).to_le_bytes())
            .collect();
        fs::write(&path, wide).unwrap();
        assert_eq!(listed(&path, folder.path()), expected);
    }

    #[test]
    fn a_folder_is_read_with_all_its_obj_files() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("film");
        fs::create_dir(&place).unwrap();
        for (name, text) in [
            ("f1.obj", "mtllib f.mtl\n"),
            ("F2.OBJ", ""),
            ("notes.txt", ""),
        ] {
            fs::write(place.join(name), text).unwrap();
        }
        let expected = [
            of(Role::Scene, &["film"]),
            of(Role::Frame, &["film/F2.OBJ", "film/f1.obj"]),
            of(Role::Material, &["film/f.mtl"]),
        ];
        assert_eq!(listed(&place, folder.path()), expected.concat());
    }

    #[test]
    fn a_gltf_file_names_buffers_and_images_whatever_else_is_wrong_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let json = r#"{"buffers": [{"uri": "a%20b.bin"}, {}, {"uri": "DATA:,x"}, 7],
            "images": [{"uri": "sub/p.png"}], "nodes": "none"}"#;
        let expected = [
            of(Role::Scene, &["s"]),
            of(Role::Buffer, &["a b.bin", "a%20b.bin"]),
            of(Role::Image, &["sub/p.png"]),
        ]
        .concat();
        let shown = |name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            fs::write(&path, bytes).unwrap();
            let mut list = listed(&path, folder.path());
            list[0].1 = list[0].1.replace(name, "s");
            list
        };
        assert_eq!(shown("s.gltf", json.as_bytes()), expected);
        let padded = format!("\u{feff}{json}\0\0");
        assert_eq!(shown("s.gltf", padded.as_bytes()), expected);
        let mut binary = b"glTF\x02\0\0\0".to_vec();
        binary.extend((json.len() as u32 + 20).to_le_bytes());
        binary.extend((json.len() as u32).to_le_bytes());
        binary.extend(b"JSON");
        binary.extend(json.as_bytes());
        assert_eq!(shown("s.glb", &binary), expected);
        for cut in [0, 3, 13, 30] {
            assert_eq!(shown("s.glb", &binary[..cut]), of(Role::Scene, &["s"]));
        }
    }
}
