//! The devices: what they hold, how modules are mapped to them, what a cell counts for.

use super::cells::Cells;
use anyhow::{Result, bail};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::str::FromStr;

/// A device that modules are synthesised for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Xilinx Virtex-4 XC4VLX160, the original's device: counted by Yosys, routed by no open tool.
    Virtex4Lx160,
    /// Lattice ECP5 LFE5U-85F, speed grade 6, the slowest: the open LUT4 and 18×18 device nearest to it, placed and routed by nextpnr.
    Ecp5_85f,
}

/// What a module takes, or a device holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Area {
    /// 4-input look-up tables, those of distributed RAM and carry chains included.
    pub lut4: u64,
    /// Flip-flops.
    pub ff: u64,
    /// DSP48, or 18×18 multipliers.
    pub dsp: u64,
    /// Block RAMs of 18 Kbit.
    pub ram: u64,
}

/// The file to which the script of [`Target::yosys_script`] writes the cells.
pub(super) const CELLS: &str = "cells.json";

impl Target {
    pub const ALL: [Target; 2] = [Target::Virtex4Lx160, Target::Ecp5_85f];

    /// The name by which it is chosen.
    pub fn name(self) -> &'static str {
        match self {
            Target::Virtex4Lx160 => "virtex4-lx160",
            Target::Ecp5_85f => "ecp5-85f",
        }
    }

    /// What the device holds.
    pub fn holds(self) -> Area {
        match self {
            Target::Virtex4Lx160 => Area {
                lut4: 135_168,
                ff: 135_168,
                dsp: 96,
                ram: 288,
            },
            Target::Ecp5_85f => Area {
                lut4: 83_640,
                ff: 83_640,
                dsp: 156,
                ram: 208,
            },
        }
    }

    /// Whether an open tool places and routes it.
    pub fn is_routable(self) -> bool {
        self == Target::Ecp5_85f
    }

    /// How the columns are counted, in a sentence.
    pub fn counting(self) -> &'static str {
        match self {
            Target::Virtex4Lx160 => {
                "lut4: LUT1 to LUT4, and of distributed RAM the LUTs that it takes: RAM16X1S 1, RAM16X1D, RAM32X1S 2, RAM64X1S 4; \
                 inverters are free, carry chains lie in counted LUTs; ff: FD*; dsp: DSP48; ram: RAMB16"
            }
            Target::Ecp5_85f => {
                "lut4: LUT4, 2 for a CCU2C, 6 for a TRELLIS_DPR16X4 (4 of memory, 2 that its write port blocks); ff: TRELLIS_FF; \
                 dsp: MULT18X18D; ram: DP16KD, with the registers right behind it; without the shift registers around the module"
            }
        }
    }

    /// What Yosys is to do: read `files`, map `top`, write its cells to [`CELLS`] and, where it can be routed, the netlist.
    pub(super) fn yosys_script(self, files: &[&str], top: &str, netlist: &str) -> String {
        let mut script = "read_verilog".to_string();
        for file in files {
            let _ = write!(script, " {file}");
        }
        let _ = match self {
            // Without wide multiplexers, or counts wander; without pins, since modules are inside a device.
            Target::Virtex4Lx160 => write!(
                script,
                "; synth_xilinx -family xc4v -ise -flatten -nowidelut -noiopad -noclkbuf -top {top}"
            ),
            Target::Ecp5_85f => write!(script, "; synth_ecp5 -top {top} -json {netlist}"),
        };
        let _ = write!(script, "; tee -q -o {CELLS} stat -json");
        script
    }

    /// What cells add up to; see [`Target::counting`].
    ///
    /// # Errors
    /// There is a kind of cell that it is not known what to count for.
    pub fn area(self, cells: &Cells) -> Result<Area> {
        let mut area = Area::default();
        for (kind, &count) in cells {
            let Some((lut4, ff, dsp, ram)) = self.weight(kind) else {
                bail!(
                    "Yosys made {count} cells {kind}, and what they take of a {} is not known here; use the version of Yosys that \
                     docs/synthesis.md names",
                    self.name()
                );
            };
            area.lut4 += lut4 * count;
            area.ff += ff * count;
            area.dsp += dsp * count;
            area.ram += ram * count;
        }
        Ok(area)
    }

    /// LUTs, flip-flops, multipliers and block RAMs of a cell.
    fn weight(self, kind: &str) -> Option<(u64, u64, u64, u64)> {
        let weight = match (self, kind) {
            (Target::Virtex4Lx160, "LUT1" | "LUT2" | "LUT3" | "LUT4" | "RAM16X1S") => (1, 0, 0, 0),
            (Target::Virtex4Lx160, "RAM16X1D" | "RAM32X1S") => (2, 0, 0, 0),
            (Target::Virtex4Lx160, "RAM64X1S") => (4, 0, 0, 0),
            (
                Target::Virtex4Lx160,
                "FDRE" | "FDSE" | "FDCE" | "FDPE" | "FDRE_1" | "FDSE_1" | "FDCE_1" | "FDPE_1",
            ) => (0, 1, 0, 0),
            (Target::Virtex4Lx160, "DSP48") => (0, 0, 1, 0),
            (Target::Virtex4Lx160, "RAMB16") => (0, 0, 0, 1),
            (
                Target::Virtex4Lx160,
                "INV" | "MUXCY" | "XORCY" | "MUXF5" | "MUXF6" | "MUXF7" | "MUXF8",
            ) => (0, 0, 0, 0),
            (Target::Ecp5_85f, "LUT4") => (1, 0, 0, 0),
            (Target::Ecp5_85f, "CCU2C") => (2, 0, 0, 0),
            (Target::Ecp5_85f, "TRELLIS_DPR16X4") => (6, 0, 0, 0),
            (Target::Ecp5_85f, "TRELLIS_FF") => (0, 1, 0, 0),
            (Target::Ecp5_85f, "MULT18X18D") => (0, 0, 1, 0),
            (Target::Ecp5_85f, "DP16KD" | "PDPW16KD") => (0, 0, 0, 1),
            (Target::Ecp5_85f, "PFUMX" | "L6MUX21") => (0, 0, 0, 0),
            // Remembers where a flattened module was.
            (_, "$scopeinfo") => (0, 0, 0, 0),
            _ => return None,
        };
        Some(weight)
    }
}

impl FromStr for Target {
    type Err = anyhow::Error;

    fn from_str(name: &str) -> Result<Target> {
        let Some(target) = Target::ALL.into_iter().find(|t| t.name() == name) else {
            let known = Target::ALL.map(Target::name).join(" or ");
            bail!("there is no target {name}; choose {known}");
        };
        Ok(target)
    }
}

/// The options of nextpnr that decide its result. A clock missed is a result too, not an error.
pub(super) fn nextpnr_options(clock_mhz: u32, seed: u32) -> Vec<String> {
    let clock = clock_mhz.to_string();
    let seed = seed.to_string();
    [
        "-q",
        "--85k",
        "--package",
        "CABGA756",
        "--speed",
        "6",
        "--freq",
        &clock,
        "--timing-allow-fail",
        "--seed",
        &seed,
    ]
    .map(str::to_string)
    .to_vec()
}
