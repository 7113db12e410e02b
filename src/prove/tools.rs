//! Yosys, ABC and z3: run at low priority, each for a limited time.

use crate::child::Supervised;
use crate::cosim::build::current;
use anyhow::{Context, Result, anyhow, bail, ensure};
use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// A tool, the Debian package that it comes from, and, if it says its version, how it is asked and the oldest that will do.
type Wanted = (
    &'static str,
    &'static str,
    Option<(&'static str, &'static str)>,
);

const WANTED: [Wanted; 4] = [
    ("yosys", "yosys", Some(("-V", "0.23"))),
    ("yosys-abc", "yosys", None),
    ("yosys-smtbmc", "yosys", None),
    ("z3", "z3", Some(("--version", "4.8"))),
];

/// How a tool ended.
pub enum Ended {
    /// What it printed, and whether it was content.
    With { text: String, success: bool },
    /// It was still running after its time.
    OutOfTime,
}

/// Whether every tool is there.
///
/// # Errors
/// One line that names the tool that is missing or too old and what to install.
pub fn check() -> Result<()> {
    static FOUND: OnceLock<()> = OnceLock::new();
    if FOUND.get().is_some() {
        return Ok(());
    }
    for (tool, package, version) in WANTED {
        let output = Command::new(tool)
            .arg(version.map_or("-h", |(ask, _)| ask))
            .supervised_output()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => {
                    anyhow!("{tool} is not installed: apt-get install {package}")
                }
                _ => anyhow!("cannot run {tool}: {error}"),
            })?;
        if let Some((_, oldest)) = version {
            let printed = String::from_utf8_lossy(&output.stdout);
            let install = format!("apt-get install {package}");
            current(tool, &printed, oldest, &install)?;
        }
    }
    FOUND.get_or_init(|| ());
    Ok(())
}

/// Runs a tool in a folder. Ends it, and what it has started, when its time is over.
///
/// # Errors
/// It cannot be started.
pub fn run(folder: &Path, limit: Duration, tool: &str, args: &[&str]) -> Result<Ended> {
    let log = folder.join("tool.log");
    let output = File::create(&log).with_context(|| format!("{}", log.display()))?;
    // `timeout` ends the whole group that it starts: a solver that smtbmc has started ends with it.
    let seconds = limit.as_secs().max(1).to_string();
    let started = Instant::now();
    let status = Command::new("nice")
        .args(["-n", "10", "timeout", "--kill-after=5", &seconds, tool])
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
    ensure!(status.code().is_some(), "{tool} was ended by a signal");
    let bytes = std::fs::read(&log).with_context(|| format!("{}", log.display()))?;
    Ok(Ended::With {
        text: String::from_utf8_lossy(&bytes).into_owned(),
        success: status.success(),
    })
}

/// Runs a Yosys script.
///
/// # Errors
/// What Yosys says, in one line.
pub fn yosys(folder: &Path, script: &str) -> Result<()> {
    const LIMIT: Duration = Duration::from_secs(300);
    match run(folder, LIMIT, "yosys", &["-q", "-p", script])? {
        Ended::With { success: true, .. } => Ok(()),
        Ended::With { text, .. } => {
            let line = text.lines().find(|line| line.contains("ERROR"));
            bail!(
                "Yosys: {}",
                line.or(text.lines().last())
                    .unwrap_or("fails without a word")
            )
        }
        Ended::OutOfTime => bail!("Yosys takes more than {} s", LIMIT.as_secs()),
    }
}
