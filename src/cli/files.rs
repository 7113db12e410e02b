//! The files that commands read and write: the types of their arguments, and the checks that apply to all of them.
//!
//! Every file that a command reads or writes is an argument of a type of this module, [`SceneSpec`] or [`ConfigName`]. [`check`]
//! finds these arguments by their types, so no command can omit a check.

use super::ConfigName;
use anyhow::{Context, Result, bail, ensure};
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Arg, ArgMatches};
use dynrt::report::{self, Identity, Staged};
use dynrt::scene::{SceneSpec, sources};
use dynrt::temporary::Parents;
use dynrt::{emit, text};
use image::RgbImage;
use serde_json::Value;
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The kind of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A JSON file.
    Json,
    /// A picture.
    Png,
    /// An animated picture.
    Gif,
    /// A waveform.
    Fst,
    /// A picture, or a folder of the pictures of several frames.
    Pictures,
    /// A folder that is replaced as a whole.
    Folder,
    /// A folder in which files are replaced, and others stay.
    Files,
}

impl Kind {
    /// The extension and the format name of a file; `None` for folders.
    fn extension(self) -> Option<(&'static str, &'static str)> {
        match self {
            Kind::Json => Some(("json", "JSON")),
            Kind::Png | Kind::Pictures => Some(("png", "PNG")),
            Kind::Gif => Some(("gif", "GIF")),
            Kind::Fst => Some(("fst", "FST")),
            Kind::Folder | Kind::Files => None,
        }
    }
}

/// Extensions of known file types. An output of another type must not have such a name.
const KNOWN_EXTENSIONS: [&str; 47] = [
    "3ds", "bin", "blend", "bmp", "core", "csv", "dae", "exr", "f", "fbx", "fst", "gif", "glb",
    "gltf", "h", "hdr", "hex", "html", "jpeg", "jpg", "json", "lpf", "mtl", "obj", "pdf", "ply",
    "png", "ppm", "rdl", "rs", "stl", "sv", "svg", "svh", "tga", "tif", "tiff", "toml", "ucf",
    "usd", "v", "vcd", "vh", "webp", "yaml", "yml", "zip",
];

/// The name of the standard output. A file of that name is `./-`.
const STANDARD_OUTPUT: &str = "-";

/// A file or a folder that a command writes.
#[derive(Clone, Debug)]
pub struct Output {
    path: PathBuf,
    kind: Kind,
}

impl TypedValueParser for Kind {
    type Value = Output;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<Output, clap::Error> {
        let path = PathBufValueParser::new().parse_ref(command, argument, value)?;
        Ok(Output { path, kind: *self })
    }
}

/// The name in messages.
impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.is_standard_output() {
            true => f.write_str("the standard output"),
            false => f.write_str(&text::path(&self.path)),
        }
    }
}

impl Output {
    fn is_standard_output(&self) -> bool {
        self.path.as_os_str() == STANDARD_OUTPUT || report::is_stdout(&self.path)
    }

    fn is_folder(&self) -> bool {
        match self.kind {
            Kind::Pictures => self.path.is_dir(),
            kind => kind.extension().is_none(),
        }
    }

    /// Checks that the name is a folder's, because there are several pictures.
    pub fn check_folder(&self, pictures: usize) -> Result<()> {
        let name = self.path.extension().unwrap_or_default();
        ensure!(
            !self.is_standard_output() && !name.eq_ignore_ascii_case("png"),
            "{self}: holds one picture, but there are {pictures}; give --out a folder's name"
        );
        Ok(())
    }

    /// The path to write to.
    pub fn path(&self) -> &Path {
        match self.is_standard_output() {
            // `report` uses this name on every system.
            true => Path::new("/dev/stdout"),
            false => &self.path,
        }
    }

    /// Writes a value as JSON.
    pub fn json(&self, value: &Value) -> Result<Staged> {
        Staged::json(self.path(), value)
    }

    /// Writes a picture.
    pub fn png(&self, picture: &RgbImage) -> Result<Staged> {
        Staged::png(self.path(), picture)
    }

    /// Writes the pictures of an animation.
    pub fn gif(&self, pictures: &[RgbImage], frames_per_second: f64) -> Result<Staged> {
        Staged::gif(self.path(), pictures, frames_per_second)
    }

    /// Writes files, by their names, into the folder; see [`emit::write_folder`].
    pub fn files(&self, files: &[(String, String)]) -> Result<()> {
        for (name, _) in files {
            check_apart(&self.path.join(name))?;
        }
        emit::write_folder(&self.path, files)
    }

    /// Writes texts, by their names, into the folder, and touches nothing else in it.
    pub fn texts(&self, files: &[(String, String)]) -> Result<()> {
        let parents = Parents::make(&self.path)
            .with_context(|| format!("{self}: cannot be created; give --out another place"))?;
        let staged = files.iter().map(|(name, content)| {
            let path = self.path.join(name);
            check_apart(&path)?;
            Staged::text(&path, content)
        });
        report::publish_all(staged.collect::<Result<Vec<_>>>()?)?;
        parents.keep();
        Ok(())
    }

    /// Checks that the name does not belong to another type of file.
    fn check_name(&self) -> Result<()> {
        if self.is_standard_output() {
            ensure!(
                !self.is_folder() && self.kind != Kind::Fst,
                "-: is the standard output, which cannot hold this output; give a file name (./- for a file named -)"
            );
            return Ok(());
        }
        let extension = self.path.extension().unwrap_or_default();
        let extension = extension.to_string_lossy().to_ascii_lowercase();
        if !KNOWN_EXTENSIONS.contains(&extension.as_str()) {
            return Ok(());
        }
        match self.kind.extension() {
            Some((right, _)) if right == extension => Ok(()),
            Some((right, format)) => bail!(
                "{self}: the output is {format}; give it a name that ends in .{right}, not in .{extension}"
            ),
            None if self.path.is_dir() => Ok(()),
            None => bail!(
                "{self}: the output is a folder; give it a name that does not end in .{extension}"
            ),
        }
    }

    /// Checks that it does not collide with another output.
    fn check_beside(&self, other: &Output) -> Result<()> {
        ensure!(
            !(self.is_standard_output() && other.is_standard_output()),
            "-: is the standard output, which can hold only one output; give the other one a file name"
        );
        let is_same = self.path == other.path || report::is_same_file(self.path(), other.path());
        ensure!(
            !is_same || report::is_stream(self.path()),
            "{self}: is the same file as {other}; give each output its own"
        );
        for (inner, outer) in [(self, other), (other, self)] {
            ensure!(
                outer.kind != Kind::Folder || !is_within(&inner.path, &outer.path),
                "{inner}: is in {outer}, which is replaced as a whole; give it another place"
            );
        }
        Ok(())
    }

    /// Checks that it replaces no input.
    fn check_apart(&self) -> Result<()> {
        if self.is_standard_output() || report::is_stream(&self.path) {
            return Ok(());
        }
        check_apart(&self.path)?;
        if self.kind == Kind::Folder {
            for input in read_files() {
                ensure!(
                    !is_within(&input.path, &self.path),
                    "{self}: holds {}, {}; name another folder",
                    text::path(&input.path),
                    input.role
                );
            }
        }
        Ok(())
    }

    /// Checks that the file can be written at the end.
    fn check_writable(&self) -> Result<()> {
        if self.is_folder() {
            return Ok(());
        }
        report::check_writable(self.path())?;
        match self.kind {
            Kind::Fst => report::check_regular(self.path()),
            _ => Ok(()),
        }
    }
}

/// Whether an existing file or folder, or the folder of one to be, lies somewhere below an existing folder.
fn is_within(path: &Path, folder: &Path) -> bool {
    let Some(folder) = Identity::of(folder) else {
        return false;
    };
    let parent = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let parent = match path.canonicalize() {
        Ok(found) => found.parent().map(Path::to_path_buf),
        Err(_) => parent.canonicalize().ok(),
    };
    parent.is_some_and(|parent| {
        parent
            .ancestors()
            .any(|above| Identity::of(above).as_ref() == Some(&folder))
    })
}

/// A file that a command reads in addition to scenes and configurations: the figures of a baseline.
#[derive(Clone, Debug)]
pub struct Figures(PathBuf);

impl From<std::ffi::OsString> for Figures {
    fn from(path: std::ffi::OsString) -> Figures {
        Figures(path.into())
    }
}

impl Figures {
    /// Its path.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

/// An input file.
struct Input {
    path: PathBuf,
    /// Its description in messages.
    role: &'static str,
}

/// The arguments that name input files.
#[derive(Default)]
struct Inputs {
    scenes: Vec<SceneSpec>,
    others: Vec<Input>,
}

/// The input files of this process.
static INPUTS: OnceLock<Inputs> = OnceLock::new();

/// The input files. Scenes are searched for the names of further files once, on first use.
fn read_files() -> &'static [Input] {
    static FILES: OnceLock<Vec<Input>> = OnceLock::new();
    FILES.get_or_init(|| {
        let Some(Inputs { scenes, others }) = INPUTS.get() else {
            return vec![];
        };
        let of_scenes = scenes.iter().flat_map(sources).map(|source| Input {
            path: source.path,
            role: source.role.name(),
        });
        let others = others.iter().map(|input| Input {
            path: input.path.clone(),
            role: input.role,
        });
        of_scenes.chain(others).collect()
    })
}

/// Checks that writing to `path` replaces no input file, under any of its names.
fn check_apart(path: &Path) -> Result<()> {
    // A path that does not exist is not an input.
    let Some(identity) = Identity::of(path) else {
        return Ok(());
    };
    let same = |input: &&Input| Identity::of(&input.path).as_ref() == Some(&identity);
    let Some(input) = read_files().iter().find(same) else {
        return Ok(());
    };
    let shown = text::path(path);
    let named = match input.path == path {
        true => String::new(),
        false => format!("{}, ", text::path(&input.path)),
    };
    bail!(
        "{shown}: is {named}{}; give the output another name",
        input.role
    )
}

/// The values of one type among the given and default arguments.
fn arguments<T: Clone + Send + Sync + 'static>(matches: &ArgMatches) -> Vec<T> {
    let values =
        (matches.ids()).filter_map(|id| matches.try_get_many::<T>(id.as_str()).ok().flatten());
    values.flatten().cloned().collect()
}

/// Checks the inputs and outputs of a command before any work: outputs have suitable names, replace neither each other nor an
/// input, and can be written.
pub fn check(matches: &ArgMatches) -> Result<()> {
    let mut matches = matches;
    while let Some((_, below)) = matches.subcommand() {
        matches = below;
    }
    let outputs: Vec<Output> = arguments(matches);
    let configs = arguments::<ConfigName>(matches);
    let configs = configs
        .iter()
        .filter_map(|name| name.file())
        .map(|file| Input {
            path: file.to_path_buf(),
            role: "the input configuration",
        });
    let figures = arguments::<Figures>(matches).into_iter().map(|file| Input {
        path: file.0,
        role: "the input file of figures",
    });
    let inputs = Inputs {
        scenes: arguments(matches),
        others: configs.chain(figures).collect(),
    };
    // A process runs one command, so this is set only once.
    let _ = INPUTS.set(inputs);
    if outputs.iter().any(Output::is_standard_output) {
        super::results_go_to_stdout();
    }
    outputs.iter().try_for_each(Output::check_apart)?;
    outputs.iter().try_for_each(Output::check_name)?;
    for (number, output) in outputs.iter().enumerate() {
        (outputs[..number].iter()).try_for_each(|other| output.check_beside(other))?;
    }
    outputs.iter().try_for_each(Output::check_writable)
}
