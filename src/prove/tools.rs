//! Yosys, ABC and z3.

use crate::tools::{Ended, Tool, Wanted};
use anyhow::{Result, bail};
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

const fn of(name: &'static [&'static str], install: &'static str) -> Wanted {
    Wanted {
        names: name,
        version: None,
        install,
    }
}

const YOSYS: Wanted = Wanted {
    version: Some(("-V", "0.23")),
    ..of(&["yosys"], "apt-get install yosys")
};
const ABC: Wanted = of(&["yosys-abc"], "apt-get install yosys");
const SMTBMC: Wanted = of(&["yosys-smtbmc"], "apt-get install yosys");
const Z3: Wanted = Wanted {
    version: Some(("--version", "4.8")),
    ..of(&["z3"], "apt-get install z3")
};

/// The tools for proofs.
pub struct Tools {
    pub yosys: Tool,
    pub abc: Tool,
    pub smtbmc: Tool,
}

/// The tools, located once per process.
///
/// # Errors
/// One line that names the tool that is missing or too old, and how to install it.
pub fn tools() -> Result<&'static Tools> {
    static FOUND: OnceLock<Tools> = OnceLock::new();
    if let Some(tools) = FOUND.get() {
        return Ok(tools);
    }
    Z3.find()?;
    let tools = Tools {
        yosys: YOSYS.find()?,
        abc: ABC.find()?,
        smtbmc: SMTBMC.find()?,
    };
    Ok(FOUND.get_or_init(|| tools))
}

/// Runs a Yosys script.
///
/// # Errors
/// The message of Yosys, in one line.
pub fn yosys(folder: &Path, script: &str) -> Result<()> {
    const LIMIT: Duration = Duration::from_secs(300);
    match tools()?
        .yosys
        .run_for(folder, LIMIT, &["-q", "-p", script])?
    {
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
