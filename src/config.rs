//! The configuration keys of a machine, with the range, unit and meaning of each.
//!
//! A configuration is one TOML file that sets every key of [`KEYS`]. The files, their validation, the emitted
//! manifest and random configurations all derive from that table.

use crate::float::Format;
use crate::{report, text};
use anyhow::{Context, Result, anyhow, bail};
use std::ffi::OsStr;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;

/// The test of a ray against a triangle; see `docs/arithmetic.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TriangleTest {
    MollerTrumbore,
    Watertight,
}

/// The memory behind the chip's bus; see `docs/chip.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MemoryModel {
    Ideal,
    DdrVirtex4,
    SdrUlx3s,
}

impl MemoryModel {
    /// The names, in the order of the variants.
    pub const NAMES: &[&str] = &["ideal", "ddr-virtex4", "sdr-ulx3s"];

    const ALL: [MemoryModel; 3] = [
        MemoryModel::Ideal,
        MemoryModel::DdrVirtex4,
        MemoryModel::SdrUlx3s,
    ];

    pub fn name(self) -> &'static str {
        MemoryModel::NAMES[self as usize]
    }
}

/// The parameters of a machine and of the model of its memory.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Config {
    /// The file's stem. It names generated folders and reports, and does not affect the hardware.
    pub name: String,
    pub exponent_bits: u32,
    pub fraction_bits: u32,
    pub clock_mhz: u32,
    pub rays_per_packet: u32,
    pub packets_in_flight: u32,
    pub tag_bits: u32,
    pub axes_per_node: u32,
    pub stack_depth: u32,
    pub address_bits: u32,
    pub triangle_test: TriangleTest,
    pub update_vertex_registers: u32,
    pub update_box_registers: u32,
    pub update_program_rows: u32,
    pub update_instructions_ahead: u32,
    pub update_vertices_ahead: u32,
    pub update_nodes_waiting: u32,
    pub skinning_joints: u32,
    pub skinning_rows_ahead: u32,
    pub skinning_vertices_ahead: u32,
    pub skinning_vertices_waiting: u32,
    pub bus_data_bits: u32,
    pub bus_reads: u32,
    pub bus_writes: u32,
    pub bus_write_lines: u32,
    pub bus_rays_ahead: u32,
    pub bus_rows_ahead: u32,
    pub cache_line_bytes: u32,
    pub cache_ways: u32,
    pub cache_misses: u32,
    pub cache_nodes_kib: u32,
    pub cache_records_kib: u32,
    pub cache_vertices_kib: u32,
    pub cache_update_kib: u32,
    pub memory_model: MemoryModel,
    pub memory_latency: u32,
    pub memory_jitter: u32,
    pub memory_in_order: bool,
    pub memory_ready_percent: u32,
}

/// Maximum length of an unknown name in an error message, in characters.
const LONGEST_NAME: usize = 60;

/// The values that a key may have.
#[derive(Clone, Debug)]
pub enum Values {
    Range(RangeInclusive<u32>),
    OneOf(&'static [u32]),
    /// Named choices; the value is the index of the name.
    Names(&'static [&'static str]),
}

/// One configuration key.
pub struct Key {
    pub section: &'static str,
    pub name: &'static str,
    pub unit: &'static str,
    pub meaning: &'static str,
    pub values: Values,
    /// Whether the key belongs to the model of the memory in simulation and not to the machine.
    pub environment: bool,
    get: fn(&Config) -> u32,
    set: fn(&mut Config, u32),
}

macro_rules! key {
    ($section:literal, $name:literal, $unit:literal, $values:expr, $field:ident, $environment:literal, $meaning:literal) => {
        Key {
            section: $section,
            name: $name,
            unit: $unit,
            meaning: $meaning,
            values: $values,
            environment: $environment,
            get: |c| c.$field,
            set: |c, v| c.$field = v,
        }
    };
}

/// All keys, in the order of the files.
pub static KEYS: &[Key] = &[
    key!(
        "float",
        "exponent_bits",
        "bits",
        Values::Range(3..=10),
        exponent_bits,
        false,
        "exponent bits of a number; the bias is 2^(bits - 1) - 1"
    ),
    key!(
        "float",
        "fraction_bits",
        "bits",
        Values::Range(2..=23),
        fraction_bits,
        false,
        "fraction bits of a number; with 16, one DSP48 multiplies two significands"
    ),
    key!(
        "clock",
        "target_mhz",
        "MHz",
        Values::Range(25..=200),
        clock_mhz,
        false,
        "target clock; it determines the depth of every pipeline"
    ),
    key!(
        "packets",
        "rays",
        "rays",
        Values::OneOf(&[1, 2, 4, 8]),
        rays_per_packet,
        false,
        "rays per packet; the traversal unit has one slice per ray"
    ),
    key!(
        "packets",
        "in_flight",
        "packets",
        Values::Range(4..=64),
        packets_in_flight,
        false,
        "packets in flight; more packets hide more latency"
    ),
    key!(
        "packets",
        "tag_bits",
        "bits",
        Values::Range(7..=32),
        tag_bits,
        false,
        "tag of a packet; the hits return the tag of their rays"
    ),
    key!(
        "tree",
        "axes_per_node",
        "axes",
        Values::Range(1..=2),
        axes_per_node,
        false,
        "1: both children are bounded on one common axis, as in the original; 2: each child has its own axis"
    ),
    key!(
        "tree",
        "stack_depth",
        "entries",
        Values::Range(8..=64),
        stack_depth,
        false,
        "stack entries per packet; also the maximum depth of a tree, in inner nodes"
    ),
    key!(
        "tree",
        "address_bits",
        "bits",
        Values::Range(8..=26),
        address_bits,
        false,
        "index of a node, a triangle record or a vertex"
    ),
    Key {
        section: "geometry",
        name: "triangle_test",
        unit: "",
        meaning: "moller-trumbore, as in the original, or watertight: no ray passes between two adjacent triangles",
        values: Values::Names(&["moller-trumbore", "watertight"]),
        environment: false,
        get: |c| c.triangle_test as u32,
        set: |c, v| {
            c.triangle_test = [TriangleTest::MollerTrumbore, TriangleTest::Watertight][v as usize]
        },
    },
    key!(
        "update",
        "vertex_registers",
        "registers",
        Values::Range(8..=64),
        update_vertex_registers,
        false,
        "vertex registers of the update processor; with more registers, fewer vertices are loaded twice"
    ),
    key!(
        "update",
        "box_registers",
        "registers",
        Values::Range(8..=64),
        update_box_registers,
        false,
        "box registers of the update processor; an object of n triangles needs at most 2 log2(n)"
    ),
    key!(
        "update",
        "program_rows",
        "rows",
        Values::Range(2..=32),
        update_program_rows,
        false,
        "rows (16 bytes) of the update program that are fetched ahead"
    ),
    key!(
        "update",
        "instructions_ahead",
        "instructions",
        Values::Range(4..=128),
        update_instructions_ahead,
        false,
        "decoded update instructions that wait for their vertices; use about the latency of the memory"
    ),
    key!(
        "update",
        "vertices_ahead",
        "vertices",
        Values::Range(2..=64),
        update_vertices_ahead,
        false,
        "vertices that the update processor fetches ahead"
    ),
    key!(
        "update",
        "nodes_waiting",
        "nodes",
        Values::Range(2..=32),
        update_nodes_waiting,
        false,
        "merged nodes of the update processor that wait to be written"
    ),
    key!(
        "skinning",
        "joints",
        "joints",
        Values::OneOf(&[16, 32, 64, 128, 256]),
        skinning_joints,
        false,
        "matrices in the palette"
    ),
    key!(
        "skinning",
        "rows_ahead",
        "rows",
        Values::Range(2..=32),
        skinning_rows_ahead,
        false,
        "rows of four influences that the skinning processor fetches ahead"
    ),
    key!(
        "skinning",
        "vertices_ahead",
        "vertices",
        Values::Range(2..=64),
        skinning_vertices_ahead,
        false,
        "vertices at rest that the skinning processor fetches ahead; use about the latency of the memory"
    ),
    key!(
        "skinning",
        "vertices_waiting",
        "vertices",
        Values::Range(4..=128),
        skinning_vertices_waiting,
        false,
        "vertices in the arithmetic or waiting to be written; with one influence per vertex, use the depth of the arithmetic"
    ),
    key!(
        "bus",
        "data_bits",
        "bits",
        Values::OneOf(&[32, 64, 128, 256]),
        bus_data_bits,
        false,
        "width of the data of the chip's memory bus"
    ),
    key!(
        "bus",
        "reads",
        "bursts",
        Values::Range(1..=64),
        bus_reads,
        false,
        "read bursts that the chip may have outstanding"
    ),
    key!(
        "bus",
        "writes",
        "bursts",
        Values::Range(1..=16),
        bus_writes,
        false,
        "write bursts that the chip may have outstanding"
    ),
    key!(
        "bus",
        "write_lines",
        "lines",
        Values::OneOf(&[4, 8, 16]),
        bus_write_lines,
        false,
        "open lines of 64 bytes in the write combiner"
    ),
    key!(
        "bus",
        "rays_ahead",
        "words",
        Values::OneOf(&[16, 32, 64, 128]),
        bus_rays_ahead,
        false,
        "words of 16 bytes that the chip reads ahead of the rays of a cast"
    ),
    key!(
        "bus",
        "rows_ahead",
        "words",
        Values::OneOf(&[16, 32, 64, 128]),
        bus_rows_ahead,
        false,
        "words of 16 bytes that the chip reads ahead of an update program or of rows of influences"
    ),
    key!(
        "cache",
        "line_bytes",
        "bytes",
        Values::OneOf(&[32, 64, 128]),
        cache_line_bytes,
        false,
        "line of a cache, one burst"
    ),
    key!(
        "cache",
        "ways",
        "lines",
        Values::OneOf(&[1, 2, 4]),
        cache_ways,
        false,
        "lines per set of a cache"
    ),
    key!(
        "cache",
        "misses",
        "lines",
        Values::Range(1..=16),
        cache_misses,
        false,
        "lines that each cache may have in flight"
    ),
    key!(
        "cache",
        "nodes_kib",
        "KiB",
        Values::OneOf(&[1, 2, 4, 8, 16, 32, 64]),
        cache_nodes_kib,
        false,
        "size of the cache of nodes"
    ),
    key!(
        "cache",
        "records_kib",
        "KiB",
        Values::OneOf(&[1, 2, 4, 8, 16, 32, 64]),
        cache_records_kib,
        false,
        "size of the cache of triangle records"
    ),
    key!(
        "cache",
        "vertices_kib",
        "KiB",
        Values::OneOf(&[1, 2, 4, 8, 16, 32, 64]),
        cache_vertices_kib,
        false,
        "size of the cache of vertices"
    ),
    key!(
        "cache",
        "update_kib",
        "KiB",
        Values::OneOf(&[1, 2, 4, 8, 16, 32, 64]),
        cache_update_kib,
        false,
        "size of the cache of the vertices that the update processor reads"
    ),
    Key {
        section: "memory",
        name: "model",
        unit: "",
        meaning: "the memory behind the chip's bus: ideal has the latency below, the others are DRAM",
        values: Values::Names(MemoryModel::NAMES),
        environment: true,
        get: |c| c.memory_model as u32,
        set: |c, v| c.memory_model = MemoryModel::ALL[v as usize],
    },
    key!(
        "memory",
        "latency",
        "cycles",
        Values::Range(1..=100),
        memory_latency,
        true,
        "from a request to its response, on every read port"
    ),
    key!(
        "memory",
        "jitter",
        "cycles",
        Values::Range(0..=100),
        memory_jitter,
        true,
        "maximum random addition to the latency"
    ),
    Key {
        section: "memory",
        name: "order",
        unit: "",
        meaning: "whether responses arrive in the order of their requests",
        values: Values::Names(&["out-of-order", "in-order"]),
        environment: true,
        get: |c| u32::from(c.memory_in_order),
        set: |c, v| c.memory_in_order = v == 1,
    },
    key!(
        "memory",
        "ready_percent",
        "%",
        Values::Range(5..=100),
        memory_ready_percent,
        true,
        "share of the cycles in which a read port accepts a request"
    ),
];

impl Key {
    /// `section.name`.
    pub fn path(&self) -> String {
        format!("{}.{}", self.section, self.name)
    }

    /// The allowed values, as text for messages.
    pub fn range(&self) -> String {
        let list = |values: &[String]| values.join(", ");
        match &self.values {
            Values::Range(r) => format!("{} to {}", r.start(), r.end()),
            Values::OneOf(values) => list(&values.iter().map(u32::to_string).collect::<Vec<_>>()),
            Values::Names(names) => {
                list(&names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>())
            }
        }
    }

    /// The unit with a leading blank; empty if there is no unit.
    fn unit_after_blank(&self) -> String {
        match self.unit {
            "" => String::new(),
            unit => format!(" {unit}"),
        }
    }

    /// The comment above the key in a file: meaning, range and unit.
    fn comment(&self) -> String {
        let unit = self.unit_after_blank();
        format!("# {} ({}{unit})", self.meaning, self.range())
    }

    /// The key's value in TOML syntax.
    pub fn value(&self, config: &Config) -> String {
        let value = (self.get)(config);
        match &self.values {
            Values::Names(names) => format!("\"{}\"", names[value as usize]),
            _ => value.to_string(),
        }
    }

    /// Copies the key's value from `other`.
    #[cfg(test)]
    fn set_value(&self, config: &mut Config, other: &Config) {
        (self.set)(config, (self.get)(other));
    }

    /// Sets the key from a TOML value.
    fn parse(&self, config: &mut Config, value: &toml::Value) -> Result<()> {
        let parsed = match (&self.values, value) {
            (Values::Range(r), toml::Value::Integer(i)) => {
                u32::try_from(*i).ok().filter(|v| r.contains(v))
            }
            (Values::OneOf(values), toml::Value::Integer(i)) => {
                u32::try_from(*i).ok().filter(|v| values.contains(v))
            }
            (Values::Names(names), toml::Value::String(s)) => {
                names.iter().position(|n| n == s).map(|i| i as u32)
            }
            _ => None,
        };
        // A number of more than 64 bits arrives as a string.
        let is_whole = match value {
            toml::Value::Integer(_) => true,
            toml::Value::String(s) => {
                let digits = s.strip_prefix('-').unwrap_or(s);
                s.parse::<i64>().is_err()
                    && !digits.is_empty()
                    && digits.bytes().all(|b| b.is_ascii_digit())
            }
            _ => false,
        };
        if !is_whole && !matches!(self.values, Values::Names(_)) {
            bail!(
                "{} = {} is not a whole number: use {}",
                self.path(),
                text::word(&value.to_string()),
                self.range()
            );
        }
        let Some(parsed) = parsed else {
            bail!(
                "{} = {} is out of range: use {}",
                self.path(),
                text::word(&value.to_string()),
                self.range()
            );
        };
        (self.set)(config, parsed);
        Ok(())
    }

    /// A random value within the key's range.
    pub fn randomise(&self, config: &mut Config, rng: &mut fastrand::Rng) {
        let value = match &self.values {
            Values::Range(r) => rng.u32(r.clone()),
            Values::OneOf(values) => values[rng.usize(..values.len())],
            Values::Names(names) => rng.u32(..names.len() as u32),
        };
        (self.set)(config, value);
    }
}

/// The configurations of `configs/`, compiled in, so the command needs no files.
pub const NAMED: &[(&str, &str)] = &[
    (
        "virtex4-lx160",
        include_str!("../configs/virtex4-lx160.toml"),
    ),
    ("dynrt-2006", include_str!("../configs/dynrt-2006.toml")),
    ("ecp5-85f", include_str!("../configs/ecp5-85f.toml")),
    ("tiny", include_str!("../configs/tiny.toml")),
];

impl Config {
    /// The reference machine, `virtex4-lx160`.
    pub fn reference() -> Config {
        Config::load(NAMED[0].0).expect("the reference configuration is valid")
    }

    /// Loads a configuration by its name in `configs/`, or from a TOML file.
    ///
    /// # Errors
    /// One line that names the file, the line, the key and what to write instead.
    pub fn load(name_or_file: impl AsRef<OsStr>) -> Result<Config> {
        let path = Path::new(&name_or_file);
        if let Some((name, text)) = NAMED.iter().find(|(name, _)| path.as_os_str() == *name) {
            return Config::parse(name, &format!("configs/{name}.toml"), text);
        }
        let file = read_file(path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        Config::parse(&text::escaped(&name), &text::path(path), &file)
    }

    /// Parses a configuration; `file` names it in errors.
    ///
    /// # Errors
    /// See [`Config::load`].
    pub fn parse(name: &str, file: &str, text: &str) -> Result<Config> {
        let (config, missing) = Config::parse_some(name, file, text)?;
        let Some(key) = missing.first() else {
            return Ok(config);
        };
        let all = match missing.len() {
            1 => String::new(),
            count => format!(", which adds all {count} that are missing"),
        };
        bail!(
            "{file}: key {} is missing ({}; {}{}): add the line `{} = {}` below [{}], or run dynrt config upgrade {file}{all}",
            key.path(),
            key.meaning,
            key.range(),
            key.unit_after_blank(),
            key.name,
            key.value(&Config::reference()),
            key.section
        )
    }

    /// Parses a configuration that may lack keys, and returns the missing ones. Their values in the configuration are meaningless.
    fn parse_some(name: &str, file: &str, text: &str) -> Result<(Config, Vec<&'static Key>)> {
        let table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
            let line = e.span().map_or(1, |s| line_of(text, s.start));
            anyhow!(
                "{file}:{line}: is not TOML: {}; correct the line, or give a configuration file",
                e.message().replace('\n', " ")
            )
        })?;
        let mut config = Config::blank(name);
        for (section, keys) in &table {
            let Some(keys) = keys.as_table() else {
                let header = format!("[[{section}]]");
                if let Some(line) = text
                    .lines()
                    .position(|line| line.trim().starts_with(&header))
                {
                    let section = text::cut(section, LONGEST_NAME);
                    bail!(
                        "{file}:{}: [[{section}]] makes a list: write [{section}]",
                        line + 1
                    );
                }
                bail!(
                    "{file}:{}: key {} is outside a section: write it under one of {}",
                    find_line(text, None, section),
                    text::cut(section, LONGEST_NAME),
                    sections().join(", ")
                );
            };
            if !sections().contains(&section.as_str()) {
                bail!(
                    "{file}:{}: unknown section [{}]: there are {}",
                    find_line(text, Some(section), ""),
                    text::cut(section, LONGEST_NAME),
                    sections().join(", ")
                );
            }
            for (name, value) in keys {
                let at = || format!("{file}:{}", find_line(text, Some(section), name));
                let Some(key) = KEYS.iter().find(|k| k.section == section && k.name == name) else {
                    let known: Vec<_> = KEYS
                        .iter()
                        .filter(|k| k.section == section)
                        .map(|k| k.name)
                        .collect();
                    bail!(
                        "{}: unknown key {section}.{}: [{section}] has {}",
                        at(),
                        text::cut(name, LONGEST_NAME),
                        known.join(", ")
                    );
                };
                key.parse(&mut config, value)
                    .map_err(|e| anyhow!("{}: {e}", at()))?;
            }
        }
        let is_missing = |key: &&Key| {
            let section = table.get(key.section);
            section.and_then(|keys| keys.get(key.name)).is_none()
        };
        Ok((config, KEYS.iter().filter(is_missing).collect()))
    }

    /// Sets one key, given as `section.name`, from text. The value is checked as in a file; quotes around a named
    /// choice are optional.
    ///
    /// # Errors
    /// One line that names the key and what to write instead. The configuration is then unchanged.
    pub fn set(&mut self, path: &str, value: &str) -> Result<()> {
        let Some(key) = KEYS.iter().find(|key| key.path() == path) else {
            bail!(
                "unknown key {}: there are {}",
                text::cut(path, LONGEST_NAME),
                KEYS.iter().map(Key::path).collect::<Vec<_>>().join(", ")
            );
        };
        let value = match value.parse() {
            Ok(number) => toml::Value::Integer(number),
            Err(_) => toml::Value::String(value.trim_matches('"').to_string()),
        };
        key.parse(self, &value)
    }

    fn blank(name: &str) -> Config {
        Config {
            name: name.to_string(),
            exponent_bits: 0,
            fraction_bits: 0,
            clock_mhz: 0,
            rays_per_packet: 0,
            packets_in_flight: 0,
            tag_bits: 0,
            axes_per_node: 0,
            stack_depth: 0,
            address_bits: 0,
            triangle_test: TriangleTest::Watertight,
            update_vertex_registers: 0,
            update_box_registers: 0,
            update_program_rows: 0,
            update_instructions_ahead: 0,
            update_vertices_ahead: 0,
            update_nodes_waiting: 0,
            skinning_joints: 0,
            skinning_rows_ahead: 0,
            skinning_vertices_ahead: 0,
            skinning_vertices_waiting: 0,
            bus_data_bits: 0,
            bus_reads: 0,
            bus_writes: 0,
            bus_write_lines: 0,
            bus_rays_ahead: 0,
            bus_rows_ahead: 0,
            cache_line_bytes: 0,
            cache_ways: 0,
            cache_misses: 0,
            cache_nodes_kib: 0,
            cache_records_kib: 0,
            cache_vertices_kib: 0,
            cache_update_kib: 0,
            memory_model: MemoryModel::Ideal,
            memory_latency: 0,
            memory_jitter: 0,
            memory_in_order: true,
            memory_ready_percent: 0,
        }
    }

    /// A machine with a random value for every key, the same for the same seed.
    pub fn random(seed: u64) -> Config {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut config = Config::blank(&format!("random-{seed}"));
        for key in KEYS {
            key.randomise(&mut config, &mut rng);
        }
        config
    }

    /// The configuration as a TOML file, every key with its unit, range and meaning.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        let mut section = "";
        for key in KEYS {
            if key.section != section {
                let gap = if section.is_empty() { "" } else { "\n" };
                let _ = writeln!(text, "{gap}[{}]", key.section);
                section = key.section;
            }
            let _ = writeln!(
                text,
                "{}\n{} = {}",
                key.comment(),
                key.name,
                key.value(self)
            );
        }
        text
    }

    pub fn format(&self) -> Format {
        Format::new(self.exponent_bits, self.fraction_bits)
            .expect("a configuration's format is within range")
    }
}

/// The text of a configuration's file.
fn read_file(path: &Path) -> Result<String> {
    let shown = text::path(path);
    if !path.exists() {
        let names: Vec<_> = NAMED.iter().map(|(name, _)| *name).collect();
        bail!(
            "{shown}: no such configuration: name one of {} or a TOML file",
            names.join(", ")
        );
    }
    if !path.is_file() {
        bail!("{shown}: is not a regular file; give a configuration's name or a TOML file");
    }
    let bytes = std::fs::read(path);
    let bytes = bytes.with_context(|| format!("{shown}: cannot read the configuration"))?;
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = before.iter().filter(|&&byte| byte == b'\n').count() + 1;
        anyhow!("{shown}:{line}: is not UTF-8; save the file as UTF-8")
    })
}

/// A configuration file with its missing keys added.
#[derive(Debug)]
pub struct Upgrade {
    /// The text of the whole file.
    pub text: String,
    /// The paths of the added keys; empty if the file had all keys.
    pub added: Vec<String>,
}

impl Upgrade {
    /// Adds the missing keys of a file to its text; the file itself is not changed.
    ///
    /// # Errors
    /// See [`Config::load`]; missing keys are not an error here.
    pub fn of_file(path: &Path) -> Result<Upgrade> {
        let shown = text::path(path);
        if !path.exists() {
            bail!("{shown}: no such file; give a configuration's TOML file");
        }
        Upgrade::new(&shown, &read_file(path)?)
    }

    /// Adds the missing keys to a file's text; `file` names it in errors. Each key is appended to its section, with the reference
    /// machine's value and a comment. Existing values, comments and their order do not change.
    ///
    /// # Errors
    /// As [`Upgrade::of_file`].
    pub fn new(file: &str, text: &str) -> Result<Upgrade> {
        let (_, missing) = Config::parse_some("upgraded", file, text)?;
        let mut upgrade = Upgrade {
            text: text.to_string(),
            added: missing.iter().map(|key| key.path()).collect(),
        };
        if missing.is_empty() {
            return Ok(upgrade);
        }
        // The parser emits line feeds; keep the file's own line ends.
        let line_end = if text.contains("\r\n") { "\r\n" } else { "\n" };
        let mark = if text.starts_with('\u{feff}') {
            "\u{feff}"
        } else {
            ""
        };
        let plain = text.trim_start_matches('\u{feff}').replace("\r\n", "\n");
        let mut document: toml_edit::DocumentMut = (plain.parse())
            .map_err(|error: toml_edit::TomlError| anyhow!("{file}: {}", error.message()))?;
        for key in missing {
            add(&mut document, key)?;
        }
        upgrade.text = mark.to_string() + &document.to_string().replace('\n', line_end);
        // If the text parsed before and does not parse now, this function has a bug.
        Config::parse("upgraded", file, &upgrade.text)?;
        Ok(upgrade)
    }

    /// Writes the text to the file atomically and keeps the file's permissions.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let permissions = std::fs::metadata(path).map(|data| data.permissions());
        let staged = report::Staged::text(path, &self.text)?;
        if let Ok(permissions) = permissions {
            std::fs::set_permissions(staged.temporary(), permissions)
                .with_context(|| format!("{}: cannot be written", text::path(path)))?;
        }
        staged.publish()
    }
}

/// Adds a key with its comment to its section, and adds the section if it is missing.
fn add(document: &mut toml_edit::DocumentMut, key: &Key) -> Result<()> {
    use toml_edit::{Item, Table, Value};
    let mut value: Value = key
        .value(&Config::reference())
        .parse()
        .map_err(|error| anyhow!("{}: {error}", key.path()))?;
    if !document.contains_key(key.section) {
        // Comments at the end of the file stay at their place, which is then above the new section.
        let mut above = document.trailing().as_str().unwrap_or_default().to_string();
        document.set_trailing("");
        if !(document.is_empty() && above.is_empty()) {
            above.push('\n');
        }
        let mut table = Table::new();
        table.decor_mut().set_prefix(above);
        document.insert(key.section, Item::Table(table));
    }
    match &mut document[key.section] {
        Item::Table(table) => {
            table.insert(key.name, Item::Value(value));
            // There is no place for a comment in a line `section.key = value` or in an inline table.
            if let (false, Some(mut name)) = (table.is_dotted(), table.key_mut(key.name)) {
                let comment = format!("{}\n", key.comment());
                name.leaf_decor_mut().set_prefix(comment);
            }
        }
        Item::Value(Value::InlineTable(table)) => {
            // Keep the blank before the brace.
            if let Some((_, last)) = table.iter_mut().last() {
                let decor = last.decor_mut();
                let blank = decor.suffix().and_then(|suffix| suffix.as_str());
                let blank = blank.unwrap_or_default().to_string();
                decor.set_suffix("");
                value = value.decorated(" ", blank);
            }
            table.insert(key.name, value);
        }
        _ => bail!("key {} is outside a section", key.section),
    }
    Ok(())
}

fn sections() -> Vec<&'static str> {
    let mut sections: Vec<_> = KEYS.iter().map(|k| k.section).collect();
    sections.dedup();
    sections
}

fn line_of(text: &str, offset: usize) -> usize {
    text[..offset.min(text.len())].matches('\n').count() + 1
}

/// The line that sets a section (with an empty key) or a key of it; 1 if it is written in a form that is not recognised.
fn find_line(text: &str, section: Option<&str>, key: &str) -> usize {
    let mut within = section.is_none();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(header) = line.strip_prefix('[') {
            within = Some(header.trim_end_matches(']').trim()) == section;
            if within && key.is_empty() {
                return number + 1;
            }
        } else if within && line.split('=').next().map(str::trim) == Some(key) {
            return number + 1;
        }
    }
    1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(edit: impl Fn(String) -> String) -> String {
        let text = edit(Config::reference().to_toml());
        Config::parse("x", "x.toml", &text).unwrap_err().to_string()
    }

    #[test]
    fn named_configurations_are_what_the_table_writes() {
        for (name, text) in NAMED {
            let config = Config::load(name).unwrap();
            assert!(
                text.ends_with(&config.to_toml()),
                "configs/{name}.toml differs from what the key table writes:\n{}",
                config.to_toml()
            );
        }
    }

    #[test]
    fn errors_name_the_file_the_line_the_key_and_the_remedy() {
        assert_eq!(
            error(|t| t.replace("rays = 4", "rays = 3")),
            "x.toml:13: packets.rays = 3 is out of range: use 1, 2, 4, 8"
        );
        assert_eq!(
            error(|t| t.replace("in_flight = 48", "in_fligth = 48")),
            "x.toml:15: unknown key packets.in_fligth: [packets] has rays, in_flight, tag_bits"
        );
        assert_eq!(
            error(|t| t.replace("[packets]", "[[packets]]")),
            "x.toml:11: [[packets]] makes a list: write [packets]"
        );
        assert_eq!(
            error(|t| t.replace("[packets]", "[packets")),
            "x.toml:11: is not TOML: unclosed table, expected `]`; correct the line, or give a configuration file"
        );
        assert!(
            error(|t| t.replace("[float]", "[flaot]"))
                .starts_with("x.toml:1: unknown section [flaot]")
        );
        assert!(
            error(|t| t.replace("rays = 4\n", ""))
                .starts_with("x.toml: key packets.rays is missing")
        );
        assert!(error(|t| t.replace("rays = 4", "rays = ")).starts_with("x.toml:13: "));
        assert_eq!(
            Config::load("nonesuch").unwrap_err().to_string(),
            "nonesuch: no such configuration: name one of virtex4-lx160, dynrt-2006, ecp5-85f, tiny or a TOML file"
        );
    }

    #[test]
    fn an_error_for_a_missing_key_prints_the_line_to_add() {
        assert_eq!(
            error(|t| t.replace("rays = 4\n", "")),
            "x.toml: key packets.rays is missing (rays per packet; the traversal unit has one slice per ray; \
             1, 2, 4, 8 rays): add the line `rays = 4` below [packets], or run dynrt config upgrade x.toml"
        );
        let line = error(|t| t.replace("triangle_test", "# ").replace("latency = ", "# "));
        assert!(
            line.ends_with(
                ": add the line `triangle_test = \"watertight\"` below [geometry], \
                 or run dynrt config upgrade x.toml, which adds all 2 that are missing"
            ),
            "{line}"
        );
    }

    /// Asserts that every line of `before` is in `after`, in the same order.
    fn keeps_lines(before: &str, after: &str) {
        let mut after_lines = after.lines();
        for line in before.lines() {
            assert!(
                after_lines.any(|other| other == line),
                "`{line}` is lost or moved:\n{before}\nbecame\n{after}"
            );
        }
    }

    fn upgraded(text: &str) -> Upgrade {
        let upgrade = Upgrade::new("x.toml", text).unwrap();
        keeps_lines(text, &upgrade.text);
        Config::parse("x", "x.toml", &upgrade.text).unwrap();
        let again = Upgrade::new("x.toml", &upgrade.text).unwrap();
        assert_eq!((again.text, again.added.len()), (upgrade.text.clone(), 0));
        upgrade
    }

    #[test]
    fn each_missing_key_is_added_in_its_section_with_the_reference_s_value() {
        let reference = Config::reference();
        for (number, key) in KEYS.iter().enumerate() {
            let config = Config::random(number as u64);
            let line = format!("{} = {}\n", key.name, key.value(&config));
            let section = format!("[{}]\n", key.section);
            let (head, rest) = config.to_toml().split_once(&section).map(own).unwrap();
            let text = head + &section + &rest.replacen(&line, "# mine\n", 1);
            let upgrade = upgraded(&text);
            assert_eq!(upgrade.added, [key.path()]);
            let mut expected = config;
            key.set_value(&mut expected, &reference);
            expected.name = "x".into();
            assert_eq!(Config::parse("x", "f", &upgrade.text).unwrap(), expected);
            let added = format!(
                "{}\n{} = {}\n",
                key.comment(),
                key.name,
                key.value(&reference)
            );
            assert!(upgrade.text.contains(&added), "{}", upgrade.text);
        }
    }

    fn own((a, b): (&str, &str)) -> (String, String) {
        (a.to_string(), b.to_string())
    }

    #[test]
    fn files_of_every_form_are_upgraded() {
        let reference = Config::reference();
        let all = |text: &str| {
            let config = Config::parse("virtex4-lx160", "f", &upgraded(text).text).unwrap();
            assert_eq!(config, reference, "{text}");
        };
        assert_eq!(upgraded("").text, reference.to_toml());
        all("# a comment, and nothing else\n");
        assert!(
            upgraded("# mine\n")
                .text
                .starts_with("# mine\n\n[float]\n# ")
        );
        all("[packets]\nrays = 4 # the original's\n# below\n\n[clock]\n\ttarget_mhz = 100");
        all("packets.rays = 4\nmemory.order = \"in-order\"\n");
        all("[\"packets\"]\n'rays' = 0x4\n");
        // An inline table is extended on its line.
        let line = "packets = { rays = 4 }\nclock = {}\n[float]\n";
        let text = Upgrade::new("f", line).unwrap().text;
        let start =
            "packets = { rays = 4, in_flight = 48, tag_bits = 16 }\nclock = { target_mhz = ";
        assert!(text.starts_with(start), "{text}");
        let config = Config::parse("virtex4-lx160", "f", &text).unwrap();
        assert_eq!(config, reference);
        let dos = "\u{feff}[packets]\r\nrays = 4\r\n# mine\r\n";
        all(dos);
        let upgrade = upgraded(dos);
        assert!(
            upgrade
                .text
                .starts_with("\u{feff}[packets]\r\nrays = 4\r\n")
        );
        assert!(!upgrade.text.replace("\r\n", "").contains('\n'));
        let whole = "# mine\n".to_string() + &reference.to_toml().replace("rays = 4", "rays=4#x");
        let upgrade = upgraded(&whole);
        assert_eq!((upgrade.text, upgrade.added.len()), (whole, 0));
    }

    #[test]
    fn a_faulty_file_is_not_upgraded() {
        let fault = |text: &str| Upgrade::new("x.toml", text).unwrap_err().to_string();
        assert_eq!(
            fault("[packets]\nrays = 3\n"),
            "x.toml:2: packets.rays = 3 is out of range: use 1, 2, 4, 8"
        );
        assert!(fault("[packets]\n\nrais = 3\n").starts_with("x.toml:3: unknown key packets.rais"));
        assert!(fault("[packets]\nrays = \n").starts_with("x.toml:2: "));
        let long = fault(&format!("[packets]\nrays = {:?}\n", 1e300));
        assert!(
            long.len() < 120 && long.contains("packets.rays = 1"),
            "{long}"
        );
    }

    #[test]
    fn single_keys_are_set_and_checked_as_in_a_file() {
        let mut config = Config::reference();
        config.set("packets.rays", "8").unwrap();
        config
            .set("geometry.triangle_test", "moller-trumbore")
            .unwrap();
        config.set("memory.order", "\"out-of-order\"").unwrap();
        assert_eq!(config.rays_per_packet, 8);
        assert_eq!(config.triangle_test, TriangleTest::MollerTrumbore);
        assert!(!config.memory_in_order);
        let before = config.clone();
        let mut fault = |path, value| config.set(path, value).unwrap_err().to_string();
        assert_eq!(
            fault("packets.rays", "3"),
            "packets.rays = 3 is out of range: use 1, 2, 4, 8"
        );
        assert_eq!(
            fault("packets.rays", "four"),
            "packets.rays = \"four\" is not a whole number: use 1, 2, 4, 8"
        );
        assert!(fault("packets.ray", "4").starts_with(
            "unknown key packets.ray: there are float.exponent_bits, float.fraction_bits, "
        ));
        assert_eq!(config, before);
    }

    #[test]
    fn random_configurations_are_valid_and_replay() {
        for seed in 0..100 {
            let config = Config::random(seed);
            assert_eq!(config, Config::random(seed));
            let name = config.name.clone();
            assert_eq!(
                Config::parse(&name, "f", &config.to_toml()).unwrap(),
                config
            );
        }
    }
}
