//! `dynrt config`: maintenance of configuration files.

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

/// Update a configuration file
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
A configuration must set every key, and a file for an earlier version may lack some. Each missing key is added at the end of its
section, with the value of the reference machine and a comment with meaning, range and unit. Existing values, comments and order
are kept. A file with an error is not changed.

Examples:
  dynrt config upgrade machine.toml
  dynrt config upgrade machine.toml && dynrt generate --config machine.toml --out build/rtl";

/// Add the missing keys to a configuration file, with default values and comments
#[derive(clap::Args)]
#[command(after_help = UPGRADE_HELP)]
struct UpgradeArgs {
    /// The TOML file
    #[arg(value_name = "FILE")]
    file: ConfigFile,
}

/// The file of a configuration; it is read and written.
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
