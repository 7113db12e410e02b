//! Builds a model from Verilog with Verilator, keeps it in the cache, and runs lint.
//!
//! The usual entry points, [`build()`] and [`lint`], are re-exported by [`model`](super::model), which documents the
//! cache. The rest are helpers for programs that run other hardware tools in the same way.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::io::ErrorKind;
use std::num::NonZero;
use std::path::{Component, Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::Instant;

use crate::cache::{self, key};
use crate::temporary;
use crate::tools::{Tool, Wanted, complaint};
use anyhow::{Context, Result, anyhow, bail, ensure};
use dynrt_hdl::{Design, Direction};

/// A port of a module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// The name in the Verilog.
    pub name: String,
    /// The width in bits, at least 1.
    pub width: u32,
    /// Whether the port is an input; otherwise it is an output.
    pub input: bool,
}

/// A module in Verilog, from which a model is built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sources {
    /// The name of the top module.
    pub top: String,
    /// The name and the contents of every file. Files that end in `.v` are compiled in this order;
    /// others (included files, data for `$readmemh`) are put beside them.
    pub files: Vec<(String, String)>,
    /// All ports of the top module, in any order.
    pub ports: Vec<Port>,
}

/// Options for building a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildOptions {
    /// Whether the model can write FST traces. Such a model is slower even while it writes none.
    pub traced: bool,
    /// The options of the C++ compiler for the code that runs in every cycle, separated by spaces.
    pub opt: String,
    /// The cache directory; `None` for the default (see [`model`](super::model)).
    pub cache: Option<PathBuf>,
    /// The directory of this model, in the file system of the cache; `None` for the cache itself. For models that are not
    /// to be kept: all else that a build needs is kept in the cache.
    pub models: Option<PathBuf>,
}

impl Default for BuildOptions {
    /// Returns options for a model without traces, compiled with `-O1`, in the default cache.
    fn default() -> Self {
        BuildOptions {
            traced: false,
            opt: "-O1".into(),
            cache: None,
            models: None,
        }
    }
}

/// A model in the cache.
#[derive(Clone, Debug)]
pub struct Built {
    /// The path of the shared library.
    pub library: PathBuf,
    /// The time that [`build`] took in seconds; close to 0 if `reused`.
    pub build_seconds: f64,
    /// Whether the model was in the cache already.
    pub reused: bool,
}

/// The C interface between this module and Verilator's class.
const SHIM: &str = include_str!("shim.cpp");

/// Verilator's options. Its output is split into small files; [`compile`] joins them into one unit per core.
const VERILATE: &[&str] = &[
    "--cc",
    "-O3",
    "--x-assign",
    "fast",
    "--x-initial",
    "fast",
    "--noassert",
    "--output-split",
    "5000",
    "--output-split-cfuncs",
    "1000",
    "--output-split-ctrace",
    "1000",
    "--prefix",
    "Vmodel",
];

/// Options of every compilation. Only the shim's functions are exported, so models loaded at the same time share no
/// symbols. No symbol is unique to the process, so a library can be unloaded.
const COMPILE: &[&str] = &[
    "-std=gnu++17",
    "-fPIC",
    "-fvisibility=hidden",
    "-fno-gnu-unique",
    "-faligned-new",
    "-fcf-protection=none",
    "-w",
    "-DVM_COVERAGE=0",
    "-DVM_SC=0",
    "-DVM_TRACE_VCD=0",
];

/// Options for code that does not run in every cycle: Verilator's runtime library, and constructors.
const RUNTIME_OPT: &str = "-Os";
const SLOW_OPT: &str = "-O0";

/// Text of C++ that is worth a compiler process of its own, in bytes. Each process reads the headers of the model again.
const UNIT_BYTES: u64 = 300_000;

/// The same without optimisation, where the source takes less time than the headers.
const PLAIN_UNIT_BYTES: u64 = 1_500_000;

/// Builds a model of `sources`, or finds it in the cache. `progress` receives one line at a time
/// that describes what is being done.
///
/// Within a process, only one model is built at a time; a build uses all cores.
///
/// # Errors
/// A tool is missing or too old (the message says how to install it), the cache cannot be written,
/// the sources are inconsistent, Verilator rejects them, or the ports are not those of the Verilog.
/// Every message is one line; if a tool fails, it holds the first error of the tool and the path of
/// the complete log.
pub fn build(sources: &Sources, options: &BuildOptions, progress: &dyn Fn(&str)) -> Result<Built> {
    let start = Instant::now();
    sources.check()?;
    let tools = Tools::find()?;
    let cache = cache::folder(options.cache.clone())?;
    let key = model_key(sources, options, tools);
    let models = match &options.models {
        Some(folder) => std::path::absolute(folder)
            .with_context(|| format!("the folder of models {}", folder.display()))?,
        None => cache.join("models"),
    };
    fs::create_dir_all(&models).with_context(|| format!("cannot create {}", models.display()))?;
    let folder = models.join(format!("{}-{key}", sources.top));
    let library = folder.join("model.so");
    let done = |reused| Built {
        library: library.clone(),
        build_seconds: start.elapsed().as_secs_f64(),
        reused,
    };
    if library.is_file() {
        return Ok(done(true));
    }

    // One build at a time per process, because each uses all cores. A caller that waits for the same model then finds it in the cache.
    static BUILDING: Mutex<()> = Mutex::new(());
    let _building = BUILDING.lock().unwrap_or_else(PoisonError::into_inner);
    if library.is_file() {
        return Ok(done(true));
    }
    let workshop = Workshop::open(&cache, &format!("{}-{key}", sources.top))?;
    let runtime = runtime(&cache, options.traced, tools, progress)?;
    let headers = [options.opt.as_str(), SLOW_OPT]
        .into_iter()
        .map(|opt| Ok((opt.to_owned(), header(&cache, options.traced, opt, tools)?)))
        .collect::<Result<_>>()?;
    let compiler = Compiler {
        tools,
        traced: options.traced,
        headers,
    };
    build_model(sources, options, &compiler, &workshop, &runtime, progress)?;
    workshop.publish(&folder)?;
    progress(&format!(
        "built the model of {} in {:.1} s",
        sources.top,
        start.elapsed().as_secs_f64()
    ));
    Ok(done(false))
}

impl Sources {
    /// Returns the emitted files and the ports of a design.
    pub fn of(design: &Design) -> Sources {
        let top = design.top();
        let port = |port: &dynrt_hdl::Port| Port {
            name: port.name.clone(),
            width: port.width,
            input: port.direction == Direction::Input,
        };
        Sources {
            top: design.emitted(top.name()),
            files: design.files(),
            ports: top.ports().iter().map(port).collect(),
        }
    }

    /// Checks for mistakes that the tools report unclearly or not at all.
    fn check(&self) -> Result<()> {
        let identifier = |s: &str| {
            s.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && s.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        ensure!(
            identifier(&self.top),
            "top module `{}` is not a plain Verilog name",
            self.top
        );
        ensure!(
            self.files.iter().any(|(name, _)| name.ends_with(".v")),
            "module {}: there is no .v file to build it from",
            self.top
        );
        let mut names = BTreeSet::new();
        for (name, _) in &self.files {
            // A leading dash would be taken for an option.
            let plain = !name.starts_with('-')
                && Path::new(name)
                    .components()
                    .all(|c| matches!(c, Component::Normal(_)));
            ensure!(
                plain && !name.is_empty(),
                "source file name `{name}` must be relative, without `..` or a leading dash"
            );
            ensure!(names.insert(name), "source file `{name}` is given twice");
        }
        let mut names = BTreeSet::new();
        for Port { name, width, .. } in &self.ports {
            ensure!(
                identifier(name),
                "module {}: port `{name}` is not a plain Verilog name",
                self.top
            );
            ensure!(
                *width >= 1,
                "module {}: port `{name}` is 0 bits wide",
                self.top
            );
            ensure!(
                names.insert(name),
                "module {}: port `{name}` is given twice",
                self.top
            );
        }
        Ok(())
    }

    fn write_to(&self, folder: &Path) -> Result<()> {
        for (name, text) in &self.files {
            let path = folder.join(name);
            let parent = path.parent().unwrap_or(folder);
            fs::create_dir_all(parent)
                .and_then(|()| fs::write(&path, text))
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    fn verilog_files(&self) -> impl Iterator<Item = &str> {
        self.files
            .iter()
            .map(|(name, _)| name.as_str())
            .filter(|name| name.ends_with(".v"))
    }
}

const VERILATOR: Wanted = Wanted {
    names: &["verilator"],
    version: Some(("--version", "5.006")),
    install: "apt-get install verilator g++, of Debian 12 or later",
};

const COMPILER: Wanted = Wanted {
    names: &["g++"],
    version: None,
    install: "apt-get install g++ zlib1g-dev",
};

/// Debian's Yosys is sufficient for lint and for synthesis for a Virtex-4.
const YOSYS: Wanted = Wanted {
    names: &["yosys"],
    version: Some(("-V", "0.23")),
    install: "apt-get install yosys",
};

const ICARUS: Wanted = Wanted {
    names: &["iverilog"],
    version: None,
    install: "apt-get install iverilog",
};

/// The tools of a build, located once per process.
struct Tools {
    verilator: Tool,
    verilator_root: PathBuf,
    compiler: Tool,
    compiler_version: String,
}

impl Tools {
    fn find() -> Result<&'static Tools> {
        static FOUND: OnceLock<Tools> = OnceLock::new();
        if let Some(tools) = FOUND.get() {
            return Ok(tools);
        }
        let (verilator, compiler) = (VERILATOR.find()?, COMPILER.find()?);
        let tools = Tools {
            verilator_root: verilator.says(&["--getenv", "VERILATOR_ROOT"])?.into(),
            compiler_version: compiler.says(&["--version"])?,
            verilator,
            compiler,
        };
        Ok(FOUND.get_or_init(|| tools))
    }

    fn include(&self) -> PathBuf {
        self.verilator_root.join("include")
    }
}

fn model_key(sources: &Sources, options: &BuildOptions, tools: &Tools) -> String {
    let traced = options.traced.to_string();
    let interface = interface(&sources.ports);
    let mut parts = vec![
        sources.top.as_str(),
        &interface,
        SHIM,
        &traced,
        &options.opt,
        SLOW_OPT,
        RUNTIME_OPT,
        &tools.verilator.version,
        &tools.compiler_version,
    ];
    parts.extend(VERILATE);
    parts.extend(COMPILE);
    parts.extend(
        sources
            .files
            .iter()
            .flat_map(|(name, text)| [name.as_str(), text]),
    );
    key(&parts)
}

/// A directory in the cache for one build. It is removed when dropped.
pub struct Workshop {
    folder: temporary::Folder,
    /// The path of the log if the build fails.
    failure_log: PathBuf,
    log: Mutex<String>,
}

impl Workshop {
    /// The prefix of the directories' names.
    pub const PREFIX: &str = "building-";

    fn open(cache: &Path, name: &str) -> Result<Workshop> {
        let folder = temporary::Folder::named(cache, Self::PREFIX).map_err(|error| {
            anyhow!(
                "cannot write to the model cache {}: {error}; set DYNRT_CACHE to a folder that can be written",
                cache.display()
            )
        })?;
        for part in ["rtl", "obj", "product"] {
            let path = folder.path().join(part);
            fs::create_dir(&path).with_context(|| format!("cannot create {}", path.display()))?;
        }
        let failure_log = cache.join("failed").join(format!("{name}.log"));
        Ok(Workshop {
            folder,
            failure_log,
            log: Mutex::default(),
        })
    }

    fn rtl(&self) -> PathBuf {
        self.folder.path().join("rtl")
    }

    fn obj(&self) -> PathBuf {
        self.folder.path().join("obj")
    }

    /// The directory that is moved into the cache.
    fn product(&self) -> PathBuf {
        self.folder.path().join("product")
    }

    /// Runs a tool and logs its output; if it fails, keeps the log and returns the first error line.
    fn run(&self, tool: &Tool, command: &mut Command) -> Result<()> {
        let output = tool.output(command)?;
        let tool = tool.name;
        let printed =
            String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = writeln!(log, "{command:?}\n{printed}{}", output.status);
        if output.status.success() {
            return Ok(());
        }
        let why = complaint(&printed).unwrap_or_else(|| output.status.to_string());
        let kept = fs::create_dir_all(self.failure_log.parent().unwrap_or(Path::new(".")))
            .and_then(|()| fs::write(&self.failure_log, log.as_bytes()));
        match kept {
            Ok(()) => bail!(
                "{tool}: {why} (complete log: {})",
                self.failure_log.display()
            ),
            Err(error) => bail!(
                "{tool}: {why} (no log kept, {}: {error})",
                self.failure_log.display()
            ),
        }
    }

    /// Moves the product to its place. It is no error if another process has put the same product there in the meantime.
    fn publish(&self, place: &Path) -> Result<()> {
        match fs::rename(self.product(), place) {
            Ok(()) => Ok(()),
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists
                ) =>
            {
                Ok(())
            }
            Err(error) => bail!(
                "cannot put a model into the cache as {}: {error}",
                place.display()
            ),
        }
    }
}

/// Compiles Verilator's runtime library, once for all models; returns the folder of the object files.
fn runtime(cache: &Path, traced: bool, tools: &Tools, progress: &dyn Fn(&str)) -> Result<PathBuf> {
    let mut parts = vec![
        tools.verilator.version.as_str(),
        &tools.compiler_version,
        RUNTIME_OPT,
    ];
    parts.extend(COMPILE);
    if traced {
        parts.push("traced");
    }
    let name = format!("runtime-{}", key(&parts));
    let folder = cache.join(&name);
    if folder.is_dir() {
        return Ok(folder);
    }
    progress("compiling Verilator's runtime library, once for all models");
    let workshop = Workshop::open(cache, &name)?;
    let mut names = vec!["verilated", "verilated_threads"];
    if traced {
        names.push("verilated_fst_c");
    }
    let units: Vec<Unit> = names
        .iter()
        .map(|name| Unit {
            source: tools.include().join(name).with_extension("cpp"),
            object: workshop.product().join(name).with_extension("o"),
            opt: RUNTIME_OPT.into(),
        })
        .collect();
    let compiler = Compiler {
        tools,
        traced,
        headers: vec![],
    };
    compiler.compile(&units, &workshop, &|_| ())?;
    workshop.publish(&folder)?;
    Ok(folder)
}

/// Verilator's headers, precompiled once for each optimisation level: the path to include. Reading them as text takes a second for
/// each unit, more than most units take beside it.
fn header(cache: &Path, traced: bool, opt: &str, tools: &Tools) -> Result<PathBuf> {
    let mut text = String::from("#include \"verilated.h\"\n");
    if traced {
        text += "#include \"verilated_fst_c.h\"\n";
    }
    let mut parts = vec![
        tools.verilator.version.as_str(),
        &tools.compiler_version,
        opt,
        &text,
    ];
    parts.extend(COMPILE);
    let name = format!("header-{}", key(&parts));
    let folder = cache.join(&name);
    let place = folder.join("verilated_all.h");
    if folder.is_dir() {
        return Ok(place);
    }
    let workshop = Workshop::open(cache, &name)?;
    let source = workshop.product().join("verilated_all.h");
    write(&source, &text)?;
    let compiler = Compiler {
        tools,
        traced,
        headers: vec![],
    };
    let mut command = compiler.command(&workshop, opt);
    command.args(["-x", "c++-header"]).arg(&source).arg("-o");
    command.arg(source.with_extension("h.gch"));
    workshop.run(&tools.compiler, &mut command)?;
    workshop.publish(&folder)?;
    Ok(place)
}

fn build_model(
    sources: &Sources,
    options: &BuildOptions,
    compiler: &Compiler,
    workshop: &Workshop,
    runtime: &Path,
    progress: &dyn Fn(&str),
) -> Result<()> {
    let tools = compiler.tools;
    sources.write_to(&workshop.rtl())?;
    progress(&format!(
        "verilating {} ({} files)",
        sources.top,
        sources.files.len()
    ));
    let mut verilator = tools.verilator.command();
    // The tools run in the folder of the sources, so that messages contain the user's file names.
    verilator.current_dir(workshop.rtl()).args(VERILATE).args([
        "--Mdir",
        "../obj",
        "--top-module",
        &sources.top,
    ]);
    if options.traced {
        verilator.arg("--trace-fst");
    }
    workshop.run(&tools.verilator, verilator.args(sources.verilog_files()))?;

    let obj = workshop.obj();
    let header = read(&obj.join("Vmodel.h"))?;
    write(
        &obj.join("ports.h"),
        &port_table(&sources.ports, &verilated_ports(&header), &sources.top)?,
    )?;
    write(&obj.join("shim.cpp"), SHIM)?;
    let units = join_units(&obj, &options.opt)?;
    compiler.compile(&units, workshop, &|done| {
        progress(&format!(
            "compiling {}: {done} of {} units",
            sources.top,
            units.len()
        ))
    })?;

    let mut link = tools.compiler.command();
    link.current_dir(&obj)
        .args(["-shared", "-Wl,-Bsymbolic", "-o"])
        .arg(workshop.product().join("model.so"));
    link.args(units.iter().map(|unit| &unit.object))
        .args(files_with_extension(runtime, "o")?)
        .arg("-pthread");
    if options.traced {
        link.arg("-lz");
    }
    workshop.run(&tools.compiler, &mut link)
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn files_with_extension(folder: &Path, extension: &str) -> Result<Vec<PathBuf>> {
    let list = || -> std::io::Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|e| e == extension) {
                files.push(path);
            }
        }
        files.sort();
        Ok(files)
    };
    list().with_context(|| format!("cannot list {}", folder.display()))
}

/// Reads the ports that Verilator found from the header that it wrote, with lines such as `VL_IN8(&clk,0,0);`.
fn verilated_ports(header: &str) -> Vec<Port> {
    let parse = |line: &str| -> Option<Port> {
        let (kind, rest) = line.trim().strip_prefix("VL_")?.split_once("(&")?;
        let input = kind.starts_with("IN") && !kind.starts_with("INOUT");
        if !input && !kind.starts_with("OUT") {
            return None;
        }
        let mut fields = rest.strip_suffix(");")?.split(',');
        let name = fields.next()?.replace("___05F", "__");
        let msb: u32 = fields.next()?.parse().ok()?;
        let lsb: u32 = fields.next()?.parse().ok()?;
        Some(Port {
            name,
            width: msb - lsb + 1,
            input,
        })
    };
    header.lines().filter_map(parse).collect()
}

/// A string that describes a list of ports completely; a library contains that of the ports it was built for.
pub(super) fn interface(ports: &[Port]) -> String {
    ports
        .iter()
        .fold(String::new(), |mut text, Port { name, width, input }| {
            let _ = write!(
                text,
                "{name}:{width}:{};",
                if *input { "in" } else { "out" }
            );
            text
        })
}

/// The text of `ports.h` (see the shim). Fails if the claimed ports are not those of the module.
fn port_table(claimed: &[Port], actual: &[Port], top: &str) -> Result<String> {
    let show = |port: &Port| {
        format!(
            "{} of {} bits",
            if port.input { "an input" } else { "an output" },
            port.width
        )
    };
    for port in claimed {
        match actual.iter().find(|other| other.name == port.name) {
            Some(other) if other == port => (),
            Some(other) => bail!(
                "module {top}: port `{}` was described as {}, but the Verilog has {}",
                port.name,
                show(port),
                show(other)
            ),
            None => bail!(
                "module {top}: port `{}` was described, but the Verilog has no such port",
                port.name
            ),
        }
    }
    if let Some(port) = actual.iter().find(|port| !claimed.contains(port)) {
        bail!(
            "module {top}: port `{}`, {}, was not described",
            port.name,
            show(port)
        );
    }
    let has_clk = claimed.iter().any(|port| port.name == "clk" && port.input);
    let mut text = format!(
        "#define MODEL_INTERFACE \"{}\"\n#define MODEL_HAS_CLK {}\n\
         static void* port_address(Vmodel& model, unsigned index) {{\n    switch (index) {{\n",
        interface(claimed),
        u32::from(has_clk)
    );
    for (index, port) in claimed.iter().enumerate() {
        // Verilator reserves double underscores and escapes those in names.
        let name = port.name.replace("__", "___05F");
        let address = if port.width > 64 {
            format!("model.{name}.data()")
        } else {
            format!("&model.{name}")
        };
        let _ = writeln!(text, "        case {index}: return {address};");
    }
    text += "        default: return nullptr;\n    }\n}\n";
    Ok(text)
}

/// One run of the C++ compiler.
struct Unit {
    source: PathBuf,
    object: PathBuf,
    opt: String,
}

/// Joins Verilator's files and the shim into few units that keep all cores busy, the largest first.
fn join_units(obj: &Path, opt: &str) -> Result<Vec<Unit>> {
    let mut slow = Vec::new();
    let mut fast = Vec::new();
    for path in files_with_extension(obj, "cpp")? {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let bytes = fs::metadata(&path)
            .with_context(|| format!("cannot read {}", path.display()))?
            .len();
        // Code that runs once: constructors, initial values, tables of names.
        let is_slow = name.ends_with("__Slow.cpp") || name.ends_with("__Syms.cpp");
        if is_slow { &mut slow } else { &mut fast }.push((bytes, name));
    }
    let mut units = Vec::new();
    for (kind, opt, mut pieces) in [("fast", opt, fast), ("slow", SLOW_OPT, slow)] {
        let bytes: u64 = pieces.iter().map(|(bytes, _)| bytes).sum();
        // A few units per core at most, so that larger models have larger units.
        let unit = if opt == "-O0" {
            PLAIN_UNIT_BYTES
        } else {
            UNIT_BYTES
        };
        let count = (bytes.div_ceil(unit) as usize).clamp(1, 2 * jobs());
        // Largest first; each file goes to the unit that is smallest so far.
        pieces.sort_by(|a, b| b.cmp(a));
        let mut bins = vec![(0, String::new()); count];
        for (bytes, name) in pieces {
            if let Some(bin) = bins.iter_mut().min_by_key(|bin| bin.0) {
                bin.0 += bytes;
                let _ = writeln!(bin.1, "#include \"{name}\"");
            }
        }
        for (index, (bytes, text)) in bins.into_iter().enumerate().filter(|(_, bin)| bin.0 > 0) {
            let source = obj.join(format!("unit_{kind}_{index}.cc"));
            write(&source, &text)?;
            units.push((
                bytes,
                Unit {
                    object: source.with_extension("o"),
                    source,
                    opt: opt.to_owned(),
                },
            ));
        }
    }
    units.sort_by_key(|(bytes, _)| std::cmp::Reverse(*bytes));
    Ok(units.into_iter().map(|(_, unit)| unit).collect())
}

fn jobs() -> usize {
    thread::available_parallelism().map_or(2, NonZero::get)
}

/// The C++ compiler with what all its runs for a model share.
struct Compiler<'a> {
    tools: &'a Tools,
    traced: bool,
    /// The precompiled headers by optimisation options.
    headers: Vec<(String, PathBuf)>,
}

impl Compiler<'_> {
    /// A run of the compiler among the model's sources, without its input and output.
    fn command(&self, workshop: &Workshop, opt: &str) -> Command {
        let trace = u32::from(self.traced);
        let mut command = self.tools.compiler.command();
        command
            .current_dir(workshop.obj())
            .args(COMPILE)
            .args(opt.split_whitespace());
        command.args([
            format!("-DVM_TRACE={trace}"),
            format!("-DVM_TRACE_FST={trace}"),
            "-I.".into(),
            "-I".into(),
        ]);
        command
            .arg(self.tools.include())
            .arg("-I")
            .arg(self.tools.include().join("vltstd"));
        command
    }

    /// Compiles units on all cores; `progress` receives the number of finished units.
    fn compile(&self, units: &[Unit], workshop: &Workshop, progress: &dyn Fn(usize)) -> Result<()> {
        let one = |unit: &Unit| {
            let mut command = self.command(workshop, &unit.opt);
            if let Some((_, header)) = self.headers.iter().find(|(opt, _)| *opt == unit.opt) {
                command.arg("-include").arg(header);
            }
            command
                .arg("-c")
                .arg("-o")
                .arg(&unit.object)
                .arg(&unit.source);
            workshop.run(&self.tools.compiler, &mut command)
        };
        let next = AtomicUsize::new(0);
        let (sender, results) = std::sync::mpsc::channel();
        thread::scope(|scope| {
            for _ in 0..jobs().min(units.len()) {
                let (sender, next, one) = (sender.clone(), &next, &one);
                scope.spawn(move || {
                    while let Some(unit) = units.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let result = one(unit);
                        if result.is_err() {
                            next.store(units.len(), Ordering::Relaxed);
                        }
                        let _ = sender.send(result);
                    }
                });
            }
            drop(sender);
            for (done, result) in results.iter().enumerate() {
                result?;
                progress(done + 1);
            }
            Ok(())
        })
    }
}

/// Checks the sources with Verilator's lint with all warnings (`-Wall`), with Icarus Verilog as
/// Verilog-2001, and with Yosys (hierarchy and netlist checks). Any output of a tool counts as a
/// failure.
///
/// # Errors
/// One line: the missing tool, or the first message of the first tool that fails.
pub fn lint(sources: &Sources) -> Result<()> {
    sources.check()?;
    let folder = temporary::Folder::new().context("cannot create a temporary folder to lint in")?;
    sources.write_to(folder.path())?;
    let top = sources.top.as_str();
    let files: Vec<&str> = sources.verilog_files().collect();
    // Names are quoted, because Yosys splits the script at blanks.
    let quoted: String = files.iter().map(|file| format!(" \"{file}\"")).collect();
    let script = format!("read_verilog{quoted}; hierarchy -check -top {top}; proc; check -assert");

    let gate = |tool: &Wanted, args: &[&str], files: &[&str]| -> Result<()> {
        let tool = tool.find()?;
        let mut command = tool.command();
        let output = tool.output(command.current_dir(folder.path()).args(args).args(files))?;
        let printed =
            String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        if output.status.success() && printed.trim().is_empty() {
            return Ok(());
        }
        let why = complaint(&printed).unwrap_or_else(|| output.status.to_string());
        bail!("module {top} fails lint: {}: {why}", tool.name)
    };
    let verilator = ["--lint-only", "-Wall", "--top-module", top];
    gate(&VERILATOR, &verilator, &files)?;
    let icarus = ["-g2001", "-t", "null", "-s", top];
    gate(&ICARUS, &icarus, &files)?;
    gate(&YOSYS, &["-q", "-p", &script], &[])
}
