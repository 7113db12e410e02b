//! The devices: capacity, mapping of modules, and the area of each cell.

use super::cells::Cells;
use anyhow::{Result, bail};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::str::FromStr;

/// A device that modules are synthesised for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Xilinx Virtex-4 XC4VLX160, the device of the original. Yosys counts its cells; no open tool places and routes it.
    Virtex4Lx160,
    /// Lattice ECP5 LFE5U-85F, speed grade 6 (the slowest): the most similar device with LUT4 and 18×18 multipliers that nextpnr supports.
    Ecp5_85f,
}

/// The area of a module, or the capacity of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Area {
    /// 4-input look-up tables, including those of distributed RAM and carry chains.
    pub lut4: u64,
    /// Flip-flops.
    pub ff: u64,
    /// DSP48, or 18×18 multipliers.
    pub dsp: u64,
    /// Block RAMs of 18 Kbit.
    pub ram: u64,
}

/// The file to which the script of [`Target::yosys_script`] writes the counts of cells.
pub(super) const CELLS: &str = "cells.json";

impl Target {
    pub const ALL: [Target; 2] = [Target::Virtex4Lx160, Target::Ecp5_85f];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Target::Virtex4Lx160 => "virtex4-lx160",
            Target::Ecp5_85f => "ecp5-85f",
        }
    }

    /// The capacity of the device.
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

    /// Whether an open tool places and routes for it.
    pub fn is_routable(self) -> bool {
        self == Target::Ecp5_85f
    }

    /// The definition of the columns, in one sentence.
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

    /// The Yosys script: reads `files`, maps `top`, writes its cells to [`CELLS`] and, if the device is routable, the netlist.
    pub(super) fn yosys_script(self, files: &[&str], top: &str, netlist: &str) -> String {
        let mut script = "read_verilog".to_string();
        for file in files {
            let _ = write!(script, " {file}");
        }
        let _ = match self {
            // Without wide multiplexers, because they make counts unstable; without pins, because modules are inside a device.
            Target::Virtex4Lx160 => write!(
                script,
                "; synth_xilinx -family xc4v -ise -flatten -nowidelut -noiopad -noclkbuf -top {top}"
            ),
            Target::Ecp5_85f => write!(script, "; synth_ecp5 -top {top} -json {netlist}"),
        };
        let _ = write!(script, "; tee -q -o {CELLS} stat -json");
        script
    }

    /// The area of all cells; see [`Target::counting`].
    ///
    /// # Errors
    /// If there is a kind of cell with unknown area.
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

    /// Number of LUTs, flip-flops, multipliers and block RAMs of a cell.
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
            // A cell that only stores the position of a flattened module.
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

/// The options of nextpnr that determine its result. A missed clock target is a result, not an error.
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
