//! The command line: one file a subcommand, and what they share.

mod animate;
mod baseline;
mod compare;
mod configuration;
mod constraints;
mod cosim;
mod files;
mod frame;
mod fuzz;
mod generate;
mod manual;
mod mutate;
mod program;
mod prove;
mod render;
mod stats;
mod synth;
mod vectors;

use anyhow::Result;
use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use dynrt::config::{Config, KEYS, NAMED};
use dynrt::cosim::mismatch::Mismatch;
use dynrt::{emit, interrupt, text};
use serde_json::{Map, Value};
use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

const EXAMPLES: &str = "\
Examples:
  dynrt generate --out build/rtl                     Verilog of the reference machine
  dynrt cosim builtin:teapot --out teapot.png        every ray of a picture through that Verilog
  dynrt animate builtin:water --gif water.gif        every stage of every frame of a scene that moves
  dynrt render model.obj --view inside --out a.png   the same picture from the golden model, at once
  dynrt stats model.obj                              what trees of the mesh cost
  dynrt compare model.obj                            build, refit, rays a second and hits beside Embree 3
  dynrt program model.obj                            the program that updates that tree when vertices move
  dynrt prove --quick                                proofs about that Verilog by open tools
  dynrt fuzz                                         random machines, generated, linted, co-simulated
  dynrt synth                                        what the machine takes of a Virtex-4, unit by unit
  dynrt constraints --out build/constraints          from Verilog to a bitstream that tests itself
  dynrt mutate --mutants 100 --seed 1                whether co-simulation would notice a bug
  dynrt baseline                                     whether any of that has become worse than what is checked in
  dynrt vectors builtin:cornell --out vectors        stimulus and expected results for other simulators
  dynrt config upgrade machine.toml                  an older configuration with the keys that it lacks
  dynrt COMMAND --help                               all options, with examples

SCENE is an OBJ file or builtin:NAME, NAME one of teapot, cornell, interior, sphere, knot; some take
parameters: 'builtin:teapot?tessellation=20', 'builtin:sphere?level=6', 'builtin:knot?segments=800&sides=24'.

An output never replaces a file that is read, and never has the name of another type of file. All outputs of a
command appear when all are written. With - for an output, as in --json -, it goes to the standard output and all
text to the standard error. An interrupted run leaves nothing behind.

Exit status: 0 if all went well, 1 with one line on stderr if not, 2 for a command that makes no sense.";

/// A hardware ray tracer: Verilog from Rust, proved bit for bit against a golden model.
#[derive(Parser)]
#[command(name = "dynrt", version, after_help = EXAMPLES, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// The commands, each in one group.
#[derive(Subcommand)]
enum Command {
    #[command(flatten)]
    Use(Use),
    #[command(flatten)]
    Verify(Verify),
    #[command(flatten)]
    Maintain(Maintain),
}

/// What people do with the machine.
#[derive(Subcommand)]
enum Use {
    Generate(generate::Args),
    Constraints(constraints::Args),
    Cosim(cosim::Args),
    Animate(animate::Args),
    Render(render::Args),
    Stats(stats::Args),
    Program(program::Args),
    Vectors(vectors::Args),
}

/// What shows that it is right.
#[derive(Subcommand)]
enum Verify {
    Prove(prove::Args),
    Fuzz(fuzz::Args),
    Mutate(mutate::Args),
    Compare(compare::Args),
}

/// What keeps it so.
#[derive(Subcommand)]
enum Maintain {
    Synth(synth::Args),
    Baseline(baseline::Args),
    Numbers(baseline::NumbersArgs),
    Config(configuration::Args),
    Completions(manual::CompletionsArgs),
    Man(manual::ManArgs),
}

impl Use {
    fn run(&self) -> Result<()> {
        match self {
            Use::Generate(args) => generate::run(args),
            Use::Constraints(args) => constraints::run(args),
            Use::Cosim(args) => cosim::run(args),
            Use::Animate(args) => animate::run(args),
            Use::Render(args) => render::run(args),
            Use::Stats(args) => stats::run(args),
            Use::Program(args) => program::run(args),
            Use::Vectors(args) => vectors::run(args),
        }
    }
}

impl Verify {
    fn run(&self) -> Result<()> {
        match self {
            Verify::Prove(args) => prove::run(args),
            Verify::Fuzz(args) => fuzz::run_fuzz(args),
            Verify::Mutate(args) => mutate::run(args),
            Verify::Compare(args) => compare::run(args),
        }
    }
}

impl Maintain {
    fn run(&self) -> Result<()> {
        match self {
            Maintain::Synth(args) => synth::run(args),
            Maintain::Baseline(args) => baseline::run(args),
            Maintain::Numbers(args) => baseline::numbers(args),
            Maintain::Config(args) => configuration::run(args),
            Maintain::Completions(args) => manual::completions(args),
            Maintain::Man(args) => manual::run(args),
        }
    }
}

/// The groups' headings, and the commands in each.
fn groups() -> [(&'static str, clap::Command); 3] {
    let none = || clap::Command::new("");
    [
        ("Use the machine:", Use::augment_subcommands(none())),
        ("Verify it:", Verify::augment_subcommands(none())),
        ("Maintain it:", Maintain::augment_subcommands(none())),
    ]
}

/// The whole command line. Help lists the commands by group.
fn command() -> clap::Command {
    let groups = groups();
    let of_all = || groups.iter().flat_map(|(_, group)| group.get_subcommands());
    let width = of_all().map(|command| command.get_name().len()).max();
    let width = width.unwrap_or(0);
    let styles = clap::builder::Styles::styled();
    let (heading, literal) = (styles.get_header(), styles.get_literal());
    let mut template = String::from("{about-with-newline}\n{usage-heading} {usage}\n\n");
    for (name, group) in &groups {
        let _ = writeln!(template, "{heading}{name}{heading:#}");
        for command in group.get_subcommands() {
            let about = command.get_about().map(ToString::to_string);
            let _ = writeln!(
                template,
                "  {literal}{:width$}{literal:#}  {}",
                command.get_name(),
                about.unwrap_or_default()
            );
        }
        template.push('\n');
    }
    let _ = writeln!(template, "{heading}Options:{heading:#}");
    template += "{options}{after-help}";
    let styled = clap::builder::StyledStr::from(template);
    Cli::command().help_template(styled)
}

/// The command line that the process was given, and its parts by name. What makes no sense ends the process with status 2.
fn parse() -> (Cli, ArgMatches) {
    let matches = match command().try_get_matches() {
        Ok(matches) => matches,
        Err(error) if error.kind() == clap::error::ErrorKind::InvalidUtf8 => {
            // clap does not say which argument that is.
            let word = std::env::args_os().find(|word| word.to_str().is_none());
            let word = word.unwrap_or_default();
            tell(&format!(
                "error: argument {} is not UTF-8, which only paths and names of scenes and configurations need not be",
                quoted(word)
            ));
            std::process::exit(2);
        }
        Err(error) => error.exit(),
    };
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    (cli, matches)
}

/// How much of a setting messages show.
const LONGEST_SETTING: usize = 80;

/// The heading of [`ConfigArgs`].
const MACHINE: &str = "Machine";

/// A configuration's name, or the path of its file.
#[derive(Clone)]
struct ConfigName(OsString);

impl From<OsString> for ConfigName {
    fn from(name: OsString) -> ConfigName {
        ConfigName(name)
    }
}

impl ConfigName {
    /// The file, where it is not the name of a configuration that is built in.
    fn file(&self) -> Option<&Path> {
        let is_named = NAMED.iter().any(|(name, _)| self.0 == *name);
        (!is_named).then(|| Path::new(&self.0))
    }
}

/// Which machine.
#[derive(clap::Args)]
struct ConfigArgs {
    /// A configuration's name (virtex4-lx160, dynrt-2006, ecp5-85f, tiny) or a TOML file that sets every key
    #[arg(long, value_name = "C", default_value = NAMED[0].0, help_heading = MACHINE)]
    config: ConfigName,
    /// Sets one key of the configuration, such as packets.rays=8 or memory.latency=20; may be repeated
    #[arg(long, value_name = "SECTION.KEY=VALUE", help_heading = MACHINE)]
    set: Vec<String>,
}

impl ConfigArgs {
    /// The machine. One that `--set` has changed is no longer the one of that name, and gets a name of its own.
    fn load(&self) -> Result<Config> {
        let mut config = Config::load(&self.config.0)?;
        let named = config.clone();
        for setting in &self.set {
            let Some((path, value)) = setting.split_once('=') else {
                anyhow::bail!(
                    "--set {}: has no value; write SECTION.KEY=VALUE, such as packets.rays=8",
                    text::cut(setting, LONGEST_SETTING)
                );
            };
            config.set(path.trim(), value.trim()).map_err(|error| {
                error.context(format!("--set {}", text::cut(setting, LONGEST_SETTING)))
            })?;
        }
        if config != named {
            config.name += "-custom";
        }
        Ok(config)
    }

    /// The keys that `--set` names, with their values in `config`.
    fn overrides(&self, config: &Config) -> Value {
        let mut overrides = Map::new();
        for setting in &self.set {
            let path = setting.split('=').next().unwrap_or_default().trim();
            if let Some(key) = KEYS.iter().find(|key| key.path() == path) {
                let value = emit::configuration(config)[key.section][key.name].clone();
                overrides.insert(path.into(), value);
            }
        }
        Value::Object(overrides)
    }

    /// What follows the configuration's name in a line: the settings.
    fn settings(&self) -> String {
        let settings =
            (self.set.iter()).map(|setting| format!(", {}", text::cut(setting, LONGEST_SETTING)));
        settings.collect()
    }

    /// The options that choose this machine again.
    fn replay(&self) -> String {
        let mut text = String::new();
        if self.config.0 != NAMED[0].0 {
            text += &format!(" --config {}", quoted(&self.config.0));
        }
        for setting in &self.set {
            text += &format!(" --set {}", quoted(setting));
        }
        text
    }
}

/// Runs the command that the process was given.
pub fn main() -> ExitCode {
    if let Err(error) = interrupt::listen() {
        tell(&format!(
            "warning: an interrupt will leave temporary files behind: {error}"
        ));
    }
    let (cli, matches) = parse();
    let result = files::check(&matches).and_then(|()| match &cli.command {
        Command::Use(command) => command.run(),
        Command::Verify(command) => command.run(),
        Command::Maintain(command) => command.run(),
    });
    // What an interrupt has broken is no news.
    interrupt::stop_if_ending();
    let Err(error) = result else {
        return ExitCode::SUCCESS;
    };
    // A mismatch's report has a line for each field; every other error is one line.
    let text = match error.is::<Mismatch>() || error.is::<cosim::UnitMismatch>() {
        true => error.to_string(),
        false => one_line(&error),
    };
    tell(&format!("error: {text}"));
    ExitCode::FAILURE
}

/// An error with its causes, in one line.
fn one_line(error: &anyhow::Error) -> String {
    let lines = format!("{error:#}");
    lines
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

/// Text of several lines, with what cannot be printed in it escaped.
fn escaped_lines(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for part in text.split_inclusive(['\n', '\t']) {
        let end = part.trim_end_matches(['\n', '\t']).len();
        shown += &text::escaped(&part[..end]);
        shown += &part[end..];
    }
    shown
}

/// Lines to the person in front of the program. That nobody reads them is no error.
fn tell(lines: &str) {
    let _ = writeln!(std::io::stderr(), "{}", escaped_lines(lines));
}

/// Whether the standard output belongs to a result.
static STDOUT_IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// From now on what is [`print`]ed goes to the standard error: the standard output belongs to a result, such as JSON.
fn results_go_to_stdout() {
    STDOUT_IS_TAKEN.store(true, Ordering::Relaxed);
}

/// Writes text for a person to stdout. A reader that has left, such as `head`, is no error.
fn print(text: &str) -> Result<()> {
    print_as_it_is(&escaped_lines(text))
}

/// As [`print`], text that holds nothing from outside.
fn print_as_it_is(text: &str) -> Result<()> {
    if STDOUT_IS_TAKEN.load(Ordering::Relaxed) {
        let _ = std::io::stderr().write_all(text.as_bytes());
        return Ok(());
    }
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow::anyhow!("stdout: cannot be written: {error}"))
        }
        _ => Ok(()),
    }
}

/// A word so that a shell reads the same bytes. What cannot be printed, or is not UTF-8, is written in octal.
fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=+".contains(c);
    let octal = |text: &mut String, bytes: &[u8]| {
        for byte in bytes {
            let _ = write!(text, "\\{byte:03o}");
        }
    };
    match word.to_str() {
        Some(text) if !text.is_empty() && text.chars().all(is_plain) => return text.to_string(),
        Some(text) if text::escaped(text) == text => {
            return format!("'{}'", text.replace('\'', r"'\''"));
        }
        _ => {}
    }
    let mut shown = String::from("$'");
    for chunk in word.as_encoded_bytes().utf8_chunks() {
        for c in chunk.valid().chars() {
            let mut buffer = [0; 4];
            let text: &str = c.encode_utf8(&mut buffer);
            match c {
                '\'' | '\\' => shown.extend(['\\', c]),
                _ if text::escaped(text) != text => octal(&mut shown, text.as_bytes()),
                _ => shown.push(c),
            }
        }
        octal(&mut shown, chunk.invalid());
    }
    shown + "'"
}

/// A count with its digits in groups of three.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A count of things, `thing` being the name of one.
fn counted(count: u64, thing: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{} {thing}{plural}", grouped(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn help_lists_each_command_once_in_one_group() {
        let names = |command: &clap::Command| -> Vec<String> {
            let commands = command.get_subcommands();
            commands
                .map(|command| command.get_name().to_string())
                .collect()
        };
        let mut grouped: Vec<String> = groups()
            .iter()
            .flat_map(|(_, group)| names(group))
            .collect();
        let mut all = names(&Cli::command());
        grouped.sort();
        all.sort();
        assert_eq!(grouped, all);
        let help = command().render_help().to_string();
        for name in all {
            let lines = help.lines().filter(|line| {
                (line.strip_prefix("  ")).is_some_and(|line| line.split(' ').next() == Some(&name))
            });
            assert_eq!(lines.count(), 1, "{name} in {help}");
        }
        for (heading, _) in groups() {
            assert!(
                help.contains(&format!("\n{heading}\n")),
                "{heading} in {help}"
            );
        }
        assert!(
            help.lines().all(|line| line.chars().count() <= 110),
            "{help}"
        );
    }

    /// Every argument of a command and of those below it.
    fn arguments(command: &clap::Command) -> Vec<(String, clap::Arg)> {
        let own = (command.get_arguments())
            .map(|argument| (command.get_name().to_string(), argument.clone()));
        let below = command.get_subcommands().flat_map(arguments);
        own.chain(below).collect()
    }

    #[test]
    fn whatever_is_a_path_is_checked_as_an_input_or_an_output() {
        use std::any::TypeId;
        let mut outputs = 0;
        for (command, argument) in arguments(&Cli::command()) {
            let name = argument.get_id().to_string();
            let value = argument.get_value_parser().type_id();
            assert!(
                value != TypeId::of::<std::path::PathBuf>() && value != TypeId::of::<OsString>(),
                "dynrt {command}, {name}: a bare path"
            );
            let is_output = value == TypeId::of::<files::Output>();
            outputs += usize::from(is_output);
            let has_name = ["json", "out", "gif", "heatmap", "trace"].contains(&name.as_str());
            assert_eq!(is_output, has_name, "dynrt {command}, {name}");
        }
        assert!(outputs >= 20, "{outputs}");
    }

    #[test]
    fn help_names_every_configuration_and_scene() {
        let help = command().render_help().to_string();
        for scene in dynrt::scene::BUILTIN_NAMES {
            assert!(help.contains(scene), "{scene}");
        }
        let mut command = command();
        let generate = command.find_subcommand_mut("generate").unwrap();
        let help = generate.render_long_help().to_string();
        for (name, _) in NAMED {
            assert!(help.contains(name), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_shell_reads_quoted_words_as_they_were() {
        use std::os::unix::ffi::OsStrExt;
        for word in [
            &b"plain.obj"[..],
            b"it's",
            b"",
            b"a b$HOME`x`\\\"!",
            b"na\xffme\xc3\xa9.obj",
            b"line\nfeed\x1b[1m\x07'7\\",
            "turn\u{202e}ed".as_bytes(),
        ] {
            let script = format!("printf %s {}", quoted(OsStr::from_bytes(word)));
            let shell = std::process::Command::new("bash")
                .args(["-c", &script])
                .output();
            assert_eq!(shell.unwrap().stdout, word, "{script}");
            assert!(text::escaped(&script) == script, "{script}");
        }
    }

    #[test]
    fn counts_and_words_read_well() {
        let texts = [0, 999, 1000, 196_608, 1_234_567].map(grouped);
        assert_eq!(texts, ["0", "999", "1,000", "196,608", "1,234,567"]);
        let counts = [0, 1, 2000].map(|count| counted(count, "primary ray"));
        assert_eq!(
            counts,
            ["0 primary rays", "1 primary ray", "2,000 primary rays"]
        );
        assert_eq!(quoted("builtin:teapot"), "builtin:teapot");
        assert_eq!(quoted("it's"), r"'it'\''s'");
        assert_eq!(quoted("builtin:sphere?level=2"), "'builtin:sphere?level=2'");
        assert_eq!(quoted("a\x1b[1m\n'\\é.obj"), r"$'a\033[1m\012\'\\é.obj'");
    }
}
