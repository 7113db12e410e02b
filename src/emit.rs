//! Generates the files of a machine besides its Verilog: file list, FuseSoC core, bench, manifest. Writes folders of
//! generated files atomically.

pub mod bench;

use crate::bkd::layout::Record;
use crate::chip::export;
use crate::config::{Config, KEYS};
use crate::hdl::{Design, Direction, GENERATED, Module, Port, Prefix};
use crate::hw::{self, Machine, Plan};
use crate::temporary::{self, Parents};
use crate::{interrupt, text};
use anyhow::{Context, Result, anyhow, bail};
use bench::Bench;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::fs;
use std::path::{Component, Path};

/// The name of the manifest in a folder of generated files.
pub const MANIFEST: &str = "manifest.json";
/// The manifest's key of the bench and its files.
const SIMULATION: &str = "simulation";
/// The manifest's key of the properties for provers, and the name of the folder with their files.
pub const FORMAL: &str = "formal";

/// The folder of expected hits beside a memory image.
pub const HITS: &str = "hits";

/// The top module of a design.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Top {
    /// All units, each with its own memory ports.
    #[default]
    Core,
    /// The core with its memory system behind two buses.
    Chip,
}

/// Options for additional generated files.
#[derive(Clone, Debug, Default)]
pub struct Extras {
    /// Whether modules check their properties if the macro `DYNRT_CHECKS` is defined.
    pub checks: bool,
    /// Files of properties for provers, in [`FORMAL`], and their description in the manifest; its key `files` lists them.
    pub formal: Option<(Vec<(String, String)>, Value)>,
}

/// All files of a machine by name: its modules, children first, then file list, core file, bench and manifest. The same
/// configuration gives the same bytes.
///
/// # Errors
/// See [`Bench::new`].
pub fn files(machine: &Machine, extras: Extras) -> Result<Vec<(String, String)>> {
    if extras.checks && !machine.design.is_checked() {
        let checked = Machine {
            config: machine.config.clone(),
            trace: machine.trace,
            design: machine.design.clone().with_checks(),
        };
        return files(&checked, extras);
    }
    let design = &machine.design;
    let bench = Bench::new(machine)?;
    let top = design.emitted(design.top().name());
    let mut files = design.files();
    let origin = origin(&machine.config);
    for (_, text) in &mut files {
        *text = text.replacen(GENERATED, &origin, 1);
    }
    files.push((format!("{top}.f"), file_list(design)));
    files.push((format!("{top}.core"), core_file(machine, &bench)));
    files.extend(bench.files().cloned());
    let mut manifest = manifest(machine);
    if design.top().name() == hw::chip::NAME {
        let [header, rdl] = export::names(design.prefix().as_str());
        let origin = format!("{origin}. Do not edit.");
        manifest[export::KEY] = json!({"header": header, "systemrdl": rdl, "files": [header, rdl]});
        files.push((header, export::header(&machine.config, &origin)));
        files.push((rdl, export::rdl(&machine.config, &top, &origin)));
    }
    manifest[SIMULATION] = bench.describe();
    if let Some((formal, described)) = extras.formal {
        files.extend(formal);
        manifest[FORMAL] = described;
    }
    files.push((MANIFEST.into(), format!("{manifest:#}\n")));
    Ok(files)
}

/// The first words of a generated file: the program and the configuration.
pub fn origin(config: &Config) -> String {
    let name = plain_name(&config.name);
    format!(
        "{GENERATED} {}, configuration {name}",
        env!("CARGO_PKG_VERSION")
    )
}

/// The list of Verilog files, one per line, children first, in the format of the option `-f` of most tools.
fn file_list(design: &Design) -> String {
    let mut list = String::new();
    for module in design.emitted_modules() {
        let _ = writeln!(list, "{}.v", design.module_name(module));
    }
    list
}

/// The FuseSoC core file: the Verilog, and targets for lint, simulation and synthesis.
fn core_file(machine: &Machine, bench: &Bench) -> String {
    let design = &machine.design;
    let top = design.emitted(design.top().name());
    let config = plain_name(&machine.config.name);
    let mut core = format!(
        "CAPI=2:\n\
         name: dynrt:machine:{}:{}\n\
         description: DynRT core, configuration {config}\n\
         \n\
         filesets:\n  rtl:\n    files:\n",
        design.emitted(&config),
        env!("CARGO_PKG_VERSION")
    );
    for module in design.emitted_modules() {
        let _ = writeln!(core, "      - {}.v", design.module_name(module));
    }
    core += "    file_type: verilogSource-2001\n\
             \x20 # Test bench of the ray casting unit and golden vectors: see docs/vectors.md of DynRT.\n\
             \x20 sim:\n    files:\n";
    for (name, _) in &bench.sources {
        let _ = writeln!(core, "      - {name}");
    }
    for (name, _) in &bench.headers {
        let _ = writeln!(core, "      - {name}: {{is_include_file: true}}");
    }
    core += "    file_type: verilogSource-2001\n\
             \x20 # The test bench reads these files from its working directory.\n\
             \x20 vectors:\n    files:\n";
    for (name, _) in &bench.data {
        let file = name.rsplit('/').next().unwrap_or(name);
        let _ = writeln!(core, "      - {name}: {{copyto: {file}}}");
    }
    let _ = write!(
        core,
        "    file_type: user\n\
         \n\
         targets:\n\
         \x20 default: &default\n\
         \x20   filesets: [rtl]\n\
         \x20   toplevel: {top}\n\
         \x20 lint:\n\
         \x20   <<: *default\n\
         \x20   description: lint with all warnings of Verilator\n\
         \x20   flow: lint\n\
         \x20   flow_options:\n\
         \x20     tool: verilator\n\
         \x20     verilator_options: [-Wall]\n\
         \x20 sim:\n\
         \x20   description: golden vectors of the ray casting unit in Icarus Verilog; fails unless all agree\n\
         \x20   flow: sim\n\
         \x20   flow_options:\n\
         \x20     tool: icarus\n\
         \x20     iverilog_options: [-g2001]\n\
         \x20     # A mismatch ends the simulation with $stop; this option makes it a failure.\n\
         \x20     vvp_options: [-N]\n\
         \x20   filesets: [rtl, sim, vectors]\n\
         \x20   toplevel: {bench}\n\
         \x20 sim_verilator:\n\
         \x20   description: the same in Verilator, 5 or later\n\
         \x20   flow: sim\n\
         \x20   flow_options:\n\
         \x20     tool: verilator\n\
         \x20     mode: binary\n\
         \x20     verilator_options: [--timing, -Wno-lint, -Wno-fatal]\n\
         \x20   filesets: [sim, rtl, vectors]\n\
         \x20   toplevel: {bench}\n\
         \x20 synth:\n\
         \x20   <<: *default\n\
         \x20   description: a netlist for an ECP5, by Yosys\n\
         \x20   flow: generic\n\
         \x20   flow_options:\n\
         \x20     tool: yosys\n\
         \x20     arch: ecp5\n\
         \x20     output_format: json\n",
        bench = bench.top,
    );
    core
}

/// A name with only letters, digits, `_` and `-`, as required for a core.
fn plain_name(name: &str) -> String {
    let plain = |c: char| match c.is_ascii_alphanumeric() || matches!(c, '_' | '-') {
        true => c,
        false => '_',
    };
    name.chars().map(plain).collect()
}

/// The information that a program needs to connect a machine and to fill its memories: configuration, top
/// module, modules with ports and latencies, layouts of the records in memory, counters.
pub fn manifest(machine: &Machine) -> Value {
    let Machine {
        config,
        trace,
        design,
    } = machine;
    let format = config.format();
    let top = design.top();
    let latencies: Map<String, Value> = design
        .modules()
        .iter()
        .filter_map(|module| Some((design.module_name(module), json!(module.latency()?))))
        .collect();
    let counters: Vec<Value> = (top.ports().iter())
        .filter(|port| port.direction == Direction::Output)
        .filter(|port| port.name.contains("count_") || port.name.starts_with("stack_"))
        .map(|port| json!({"port": port.name, "width": port.width}))
        .collect();
    let file_names: Vec<String> = (design.emitted_modules().into_iter())
        .map(|module| design.module_name(module) + ".v")
        .collect();
    json!({
        "generator": concat!("dynrt ", env!("CARGO_PKG_VERSION")),
        "configuration": configuration(config),
        "number": {
            "width": format.width(),
            "exponent_bits": format.exponent_bits(),
            "fraction_bits": format.fraction_bits(),
            "bias": format.bias(),
        },
        "prefix": design.prefix().as_str(),
        "trace_ports": trace,
        "top": design.emitted(top.name()),
        "files": file_names,
        "ports": ports(top),
        "counters": counters,
        "modules": design.modules().iter().map(|m| describe(design, m)).collect::<Vec<_>>(),
        "latencies": latencies,
        "layouts": {
            "node": layout(&Record::node(format)),
            "link_word": layout(&Record::link_word()),
            "triangle": layout(&Record::triangle()),
            "instance": layout(&Record::instance()),
            "vertex": layout(&Record::vertex(format)),
            "box": layout(&Record::bounding_box(format)),
            "influence_row": layout(&Record::influence_row(format)),
        },
    })
}

/// The configuration's name, and every key by section.
pub fn configuration(config: &Config) -> Value {
    let mut sections = Map::new();
    sections.insert("name".into(), json!(config.name));
    for key in KEYS {
        let section = sections.entry(key.section).or_insert_with(|| json!({}));
        // Numbers and quoted names have the same syntax in TOML and JSON.
        let value = serde_json::from_str(&key.value(config)).expect("a number or a quoted name");
        section[key.name] = value;
    }
    Value::Object(sections)
}

fn describe(design: &Design, module: &Module) -> Value {
    let instances = module.children().iter();
    let instances: Vec<String> = instances.map(|m| design.module_name(m)).collect();
    json!({
        "name": design.module_name(module),
        "unit": module.name(),
        "file": design.module_name(module) + ".v",
        "parameters": parameters(module),
        "latency": module.latency(),
        "instances": instances,
        "ports": ports(module),
    })
}

/// The values of a module's Verilog parameters where it is instantiated; empty for a module without parameters.
pub(crate) fn parameters(module: &Module) -> Map<String, Value> {
    let parameters = module.parameters().into_iter();
    parameters
        .map(|(name, value)| (name.to_string(), json!(value)))
        .collect()
}

fn ports(module: &Module) -> Vec<Value> {
    let describe = |port: &Port| {
        json!({
            "name": port.name,
            "direction": match port.direction {
                Direction::Input => "input",
                Direction::Output => "output",
            },
            "width": port.width,
            "group": port.group,
            "stage": port.stage,
        })
    };
    module.ports().iter().map(describe).collect()
}

fn layout(record: &Record) -> Value {
    let mut value = serde_json::to_value(record).expect("a layout is plain data");
    value["hex_digits"] = json!(record.hex_digits());
    value["words"] = json!(record.words());
    value
}

/// Describes a machine whose module names start with `prefix`.
///
/// # Errors
/// See [`hw::core::emit`].
pub fn machine_with(plan: &Plan, prefix: Prefix, top: Top) -> Result<Machine> {
    let name = &plan.config.name;
    let machine = match top {
        Top::Core => hw::core::emit(plan),
        Top::Chip => hw::chip::emit(plan),
    };
    let machine = machine.with_context(|| format!("configuration {name}"))?;
    Ok(Machine {
        design: machine.design.with_prefix(prefix),
        ..machine
    })
}

/// Describes the machine of a configuration, without trace ports, with the prefix [`hw::core::PREFIX`].
///
/// # Errors
/// See [`hw::core::emit`].
pub fn machine(config: &Config) -> Result<Machine> {
    machine_with(&Plan::new(config)?, hw::core::default_prefix(), Top::Core)
}

/// Describes the same machine and generates all its files, whose names start with the prefix; see [`files`].
///
/// # Errors
/// See [`hw::core::emit`].
pub fn generate(config: &Config) -> Result<(Machine, Vec<(String, String)>)> {
    let plan = Plan::new(config)?;
    let prefix = hw::core::default_prefix();
    generate_with(&plan, prefix, Top::Core, Extras::default())
}

/// As [`generate`], with options for trace ports, prefix and additional files.
///
/// # Errors
/// See [`hw::core::emit`].
pub fn generate_with(
    plan: &Plan,
    prefix: Prefix,
    top: Top,
    extras: Extras,
) -> Result<(Machine, Vec<(String, String)>)> {
    let machine = machine_with(plan, prefix, top)?;
    let name = &plan.config.name;
    let files = files(&machine, extras).with_context(|| format!("configuration {name}"))?;
    Ok((machine, files))
}

/// Writes files into `folder`.
///
/// A new folder is filled under a temporary name next to its place and then renamed, so it is never incomplete. In an
/// existing folder, every file is first written to a temporary folder inside it. Then each file is renamed to its place,
/// files that the old manifest lists and that no longer exist are removed, and the new manifest is written last. An error
/// before the first rename leaves the folder unchanged; a crash between renames leaves the old manifest with some new
/// files. Other files are not touched.
///
/// # Errors
/// One line that names the folder and the reason why it cannot be written.
pub fn write_folder<T: AsRef<[u8]>>(folder: &Path, files: &[(String, T)]) -> Result<()> {
    let fault = |error: std::io::Error| {
        anyhow!(
            "{}: cannot be written: {}; give a folder that can be",
            text::path(folder),
            error.kind()
        )
    };
    if folder.exists() && !folder.is_dir() {
        bail!(
            "{}: cannot be written: it is a file; give a folder",
            text::path(folder)
        );
    }
    for (name, _) in files {
        let path = folder.join(name);
        if path.is_dir() {
            bail!(
                "{}: cannot be written: it is a folder; move it elsewhere",
                text::path(&path)
            );
        }
        let within = path.parent().unwrap_or(folder);
        // A dangling link is an obstacle as well.
        if fs::symlink_metadata(within).is_ok() && !within.is_dir() {
            bail!(
                "{}: cannot be made a folder: it is a file; move it elsewhere",
                text::path(within)
            );
        }
    }
    let is_new = !folder.exists();
    let within = match folder.parent() {
        _ if !is_new => folder,
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let parents = Parents::make(within).map_err(fault)?;
    let temporary = temporary::Folder::for_result(within).map_err(fault)?;
    for (name, text) in files {
        let path = temporary.path().join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder)).map_err(fault)?;
        fs::write(path, text.as_ref()).map_err(fault)?;
    }
    let _whole = interrupt::hold();
    if is_new {
        fs::rename(temporary.path(), folder).map_err(fault)?;
        // The temporary folder has become the result, so there is nothing to remove.
        temporary.keep();
        parents.keep();
        return Ok(());
    }
    let stale = listed_files(folder);
    let publish = |name: &str| {
        let place = folder.join(name);
        fs::create_dir_all(place.parent().unwrap_or(folder))
            .and_then(|()| fs::rename(temporary.path().join(name), &place))
            .map_err(fault)
    };
    let (manifest, others): (Vec<_>, Vec<_>) = files
        .iter()
        .map(|(name, _)| name)
        .partition(|name| *name == MANIFEST);
    others.into_iter().try_for_each(|name| publish(name))?;
    for name in stale.iter().filter(|n| files.iter().all(|(f, _)| f != *n)) {
        let path = folder.join(name);
        match fs::remove_file(&path) {
            // An earlier run did not write a folder with this name.
            Err(error) if error.kind() != std::io::ErrorKind::NotFound && !path.is_dir() => {
                return Err(fault(error));
            }
            _ => {}
        }
        if let Some(within) = path.parent().filter(|within| *within != folder) {
            // The folder stays if it contains other files.
            let _ = fs::remove_dir(within);
        }
    }
    manifest.into_iter().try_for_each(|name| publish(name))
}

/// The files that an earlier run wrote, according to the folder's manifest if this program wrote it.
fn listed_files(folder: &Path) -> Vec<String> {
    let manifest: Option<Value> = fs::read_to_string(folder.join(MANIFEST))
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok());
    let Some(manifest) = manifest else {
        return Vec::new();
    };
    let is_ours = (manifest["generator"].as_str()).is_some_and(|g| g.starts_with("dynrt "));
    if !is_ours {
        return Vec::new();
    }
    let lists = [
        &manifest["files"],
        &manifest[SIMULATION]["files"],
        &manifest[FORMAL]["files"],
        &manifest[export::KEY]["files"],
    ];
    let names = lists.into_iter().filter_map(Value::as_array).flatten();
    let names = names.filter_map(Value::as_str).map(str::to_string);
    // These files are named after the top module, and therefore include the prefix.
    let top = manifest["top"].as_str();
    let of_top = top.map(|top| [format!("{top}.f"), format!("{top}.core")]);
    // Only files in the folder itself, or in one of our folders inside it.
    let is_plain = |name: &String| {
        let name = Path::new(name);
        let within = [bench::FOLDER, FORMAL, HITS].map(|folder| name.strip_prefix(folder));
        let within = within.into_iter().find_map(Result::ok);
        let mut parts = within.unwrap_or(name).components();
        matches!(parts.next(), Some(Component::Normal(_))) && parts.next().is_none()
    };
    names
        .chain(of_top.into_iter().flatten())
        .filter(is_plain)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, text: &str) -> (String, String) {
        (name.to_string(), text.to_string())
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn manifest_of(files: &[&str]) -> (String, String) {
        let manifest = json!({"generator": "dynrt 0", "files": files});
        file(MANIFEST, &manifest.to_string())
    }

    #[test]
    fn a_folder_is_made_and_replaced_without_harm_to_others_files() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("a/b");
        write_folder(
            &folder,
            &[
                file("a.v", "1"),
                file("old.v", "1"),
                manifest_of(&["a.v", "old.v", "../x"]),
            ],
        )
        .unwrap();
        assert_eq!(names(&folder), ["a.v", "manifest.json", "old.v"]);
        assert_eq!(names(&parent.path().join("a")), ["b"]);
        fs::write(parent.path().join("a/x"), "not ours").unwrap();
        fs::write(folder.join("mine.v"), "not ours").unwrap();
        write_folder(&folder, &[file("a.v", "2"), manifest_of(&["a.v"])]).unwrap();
        assert_eq!(names(&folder), ["a.v", "manifest.json", "mine.v"]);
        assert_eq!(names(&parent.path().join("a")), ["b", "x"]);
        assert_eq!(fs::read_to_string(folder.join("a.v")).unwrap(), "2");
    }

    #[test]
    fn the_bench_s_folder_is_made_and_goes_with_its_files() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("a");
        let manifest = |files: &[&str]| {
            let manifest =
                json!({"generator": "dynrt 0", "files": [], SIMULATION: {"files": files}});
            file(MANIFEST, &manifest.to_string())
        };
        let listed = ["sim/a.hex", "sim/b.hex", "sim/../../x", "other/y"];
        write_folder(
            &folder,
            &[
                file("sim/a.hex", "1"),
                file("sim/b.hex", "1"),
                manifest(&listed),
            ],
        )
        .unwrap();
        fs::write(parent.path().join("x"), "not ours").unwrap();
        fs::create_dir(folder.join("other")).unwrap();
        fs::write(folder.join("other/y"), "not ours").unwrap();
        write_folder(&folder, &[file("sim/a.hex", "2"), manifest(&["sim/a.hex"])]).unwrap();
        assert_eq!(names(&folder.join("sim")), ["a.hex"]);
        assert_eq!(fs::read_to_string(folder.join("sim/a.hex")).unwrap(), "2");
        write_folder(&folder, &[manifest(&[])]).unwrap();
        assert_eq!(names(&folder), ["manifest.json", "other"]);
        assert_eq!(names(&folder.join("other")), ["y"]);
        assert_eq!(names(parent.path()), ["a", "x"]);
        // There is a file in place of the folder.
        fs::write(folder.join("sim"), "not ours").unwrap();
        let error = write_folder(&folder, &[file("sim/a.hex", "3"), manifest(&["sim/a.hex"])]);
        let place = folder.join("sim");
        assert_eq!(
            format!("{:#}", error.unwrap_err()),
            format!(
                "{}: cannot be made a folder: it is a file; move it elsewhere",
                place.display()
            )
        );
        assert_eq!(names(&folder), ["manifest.json", "other", "sim"]);
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let parent = tempfile::tempdir().unwrap();
        let taken = parent.path().join("taken");
        fs::write(&taken, "").unwrap();
        let fault = |folder: &Path| {
            let error = write_folder(folder, &[file("a.v", "")]).unwrap_err();
            format!("{error:#}")
        };
        assert_eq!(
            fault(&taken),
            format!(
                "{}: cannot be written: it is a file; give a folder",
                taken.display()
            )
        );
        let below = taken.join("below");
        assert!(fault(&below).starts_with(&format!("{}: cannot be written: ", below.display())));
        assert_eq!(names(parent.path()), ["taken"]);
    }

    #[test]
    fn a_core_s_name_is_plain() {
        assert_eq!(plain_name("virtex4-lx160"), "virtex4-lx160");
        assert_eq!(plain_name("my machine: ö"), "my_machine___");
    }
}
