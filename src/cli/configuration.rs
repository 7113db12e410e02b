//! `dynrt config`: care of configuration files.

use super::print;
use anyhow::Result;
use clap::Subcommand;
use dynrt::config::Upgrade;
use dynrt::text;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

const HELP: &str = "\
Examples:
  dynrt config upgrade machine.toml";

/// Bring a configuration file up to date
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Upgrade(UpgradeArgs),
}

const UPGRADE_HELP: &str = "\
A configuration sets every key, so a file for an earlier version may lack some. Each that is missing is added below the others of its
section, with the reference machine's value and a comment that gives meaning, range and unit. Values, comments and order of
what is there stay. A file with a fault is left as it is.

Examples:
  dynrt config upgrade machine.toml
  dynrt config upgrade machine.toml && dynrt generate --config machine.toml --out build/rtl";

/// Add the keys that a configuration file lacks, with their defaults and comments
#[derive(clap::Args)]
#[command(after_help = UPGRADE_HELP)]
struct UpgradeArgs {
    /// The TOML file
    #[arg(value_name = "FILE")]
    file: ConfigFile,
}

/// A configuration's file, which is read and written.
#[derive(Clone)]
struct ConfigFile(PathBuf);

impl From<OsString> for ConfigFile {
    fn from(path: OsString) -> ConfigFile {
        ConfigFile(path.into())
    }
}

pub fn run(args: &Args) -> Result<()> {
    match &args.command {
        Command::Upgrade(args) => upgrade(&args.file.0),
    }
}

fn upgrade(file: &Path) -> Result<()> {
    let shown = text::path(file);
    let upgrade = Upgrade::of_file(file)?;
    if upgrade.added.is_empty() {
        return print(&format!("{shown}: has every key; nothing to add\n"));
    }
    upgrade.write(file)?;
    print(&format!("{shown}: added {}\n", upgrade.added.join(", ")))
}
