//! The output registers of ECP5 block RAMs and multipliers. Yosys does not use them, and puts a register that follows a block into
//! slices. The block's own register has no wire in front of it, and its output is valid earlier (Lattice FPGA-TN-02204, *ECP5 and
//! ECP5-5G Memory User Guide*: REGMODE; FPGA-TN-02205, *ECP5 and ECP5-5G sysDSP Usage Guide*: REG_OUTPUT_CLK).

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value, json};
use std::collections::HashMap;

/// Outputs of a block with optional registers, as Yosys leaves them and as they are with the registers.
struct Outputs {
    /// Prefixes of the ports' names; numbers follow.
    ports: &'static [&'static str],
    /// The clock of the registers. It is connected if the block has none yet.
    clock: &'static str,
    /// Ports and parameters of outputs without registers that always show the last word read.
    tied: &'static [(&'static str, &'static str)],
    unset: &'static [(&'static str, &'static str)],
    /// Ports and parameters with the registers.
    ties: &'static [(&'static str, &'static str)],
    sets: &'static [(&'static str, &'static str)],
}

const PORT_A: Outputs = Outputs {
    ports: &["DOA"],
    clock: "CLKA",
    tied: &[("CEA", "1"), ("OCEA", "1"), ("RSTA", "0")],
    unset: &[("REGMODE_A", "NOREG")],
    ties: &[],
    sets: &[("REGMODE_A", "OUTREG")],
};

const PORT_B: Outputs = Outputs {
    ports: &["DOB"],
    clock: "CLKB",
    tied: &[("CEB", "1"), ("OCEB", "1"), ("RSTB", "0")],
    unset: &[("REGMODE_B", "NOREG")],
    ties: &[],
    sets: &[("REGMODE_B", "OUTREG")],
};

/// Words of 36 bits use both halves and belong to port B, as in Lattice's PDPW16KD.
const WIDE: Outputs = Outputs {
    ports: &["DOA", "DOB"],
    clock: "CLKB",
    tied: &[("CEB", "1"), ("OCEB", "1"), ("RSTB", "0")],
    unset: &[("REGMODE_A", "NOREG"), ("REGMODE_B", "NOREG")],
    ties: &[("OCEA", "1")],
    sets: &[("REGMODE_A", "OUTREG"), ("REGMODE_B", "OUTREG")],
};

/// A product. Yosys connects neither a clock nor any register of a multiplier.
const PRODUCT: Outputs = Outputs {
    ports: &["P"],
    clock: "CLK0",
    tied: &[],
    unset: &[],
    ties: &[("CE0", "1"), ("RST0", "0")],
    sets: &[
        ("REG_OUTPUT_CLK", "CLK0"),
        ("REG_OUTPUT_CE", "CE0"),
        ("REG_OUTPUT_RST", "RST0"),
    ],
};

/// Clock target in MHz at and above which a product's register is moved too. The multiplier's register has a longer clock-to-output
/// delay than a slice's, so the change pays only if little logic follows in the same cycle.
const PRODUCTS_FROM: u32 = 120;

/// The blocks whose output registers are used.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Blocks {
    Rams,
    RamsAndMultipliers,
}

impl Blocks {
    /// The selection for a clock target in MHz.
    pub fn at(clock_mhz: u32) -> Blocks {
        match clock_mhz < PRODUCTS_FROM {
            true => Blocks::Rams,
            false => Blocks::RamsAndMultipliers,
        }
    }

    /// The selection as a part of the keys of results.
    pub fn key(self) -> &'static str {
        match self {
            Blocks::Rams => "output registers of block RAMs, 2",
            Blocks::RamsAndMultipliers => "output registers of block RAMs and multipliers, 1",
        }
    }
}

/// The cell name of a flip-flop.
pub(super) const FLIP_FLOP: &str = "TRELLIS_FF";

fn outputs(cell: &Value, blocks: Blocks) -> &'static [Outputs] {
    let width = |port: &str| {
        let bits = cell["parameters"][port].as_str()?;
        u32::from_str_radix(bits, 2).ok()
    };
    match (kind(cell), width("DATA_WIDTH_A"), width("DATA_WIDTH_B")) {
        ("DP16KD", Some(_), Some(36)) => &[WIDE],
        ("DP16KD", Some(36), Some(_)) => &[PORT_B],
        ("DP16KD", Some(_), Some(_)) => &[PORT_A, PORT_B],
        ("MULT18X18D", ..) if blocks == Blocks::RamsAndMultipliers && unregistered(cell) => {
            &[PRODUCT]
        }
        _ => &[],
    }
}

/// Whether a multiplier has no clock and no registers.
fn unregistered(multiplier: &Value) -> bool {
    let has = |what: &str, prefix: &str| {
        let named = multiplier[what].as_object();
        named.is_some_and(|all| all.keys().any(|name| name.starts_with(prefix)))
    };
    !has("connections", "CLK") && !has("parameters", "REG_")
}

/// The readers of a net.
enum Reader {
    /// One cell's input.
    One { cell: String, port: String },
    /// Several inputs, or a pin.
    Many,
}

/// Moves registers that follow `blocks` into them, if every bit of a word or product is followed directly by a plain register of
/// the same clock. Returns the number of flip-flops saved. Registers of cells whose names start with `stay` are not moved.
///
/// # Errors
/// If `netlist` is not Yosys' output for one flattened module `top`.
pub(super) fn absorb(netlist: &mut Value, top: &str, stay: &str, blocks: Blocks) -> Result<u64> {
    let module = netlist
        .pointer_mut(&format!("/modules/{top}"))
        .with_context(|| format!("the netlist has no module {top}"))?;
    let pins: Vec<Value> = module["ports"]
        .as_object()
        .into_iter()
        .flat_map(|ports| ports.values())
        .flat_map(|port| port["bits"].as_array().cloned().unwrap_or_default())
        .collect();
    let Some(cells) = module["cells"].as_object_mut() else {
        bail!("the netlist's module {top} has no cells");
    };
    let readers = readers(cells, &pins);
    let mut moves = vec![];
    for (name, cell) in cells.iter() {
        for outputs in outputs(cell, blocks) {
            let Some(registers) = registers_behind(cells, cell, outputs, &readers) else {
                continue;
            };
            if !registers.iter().any(|(_, name)| name.starts_with(stay)) {
                moves.push((name.clone(), outputs, registers));
            }
        }
    }
    let mut saved = 0;
    for (block, outputs, registers) in moves {
        let mut clock = Value::Null;
        for (output, register) in registers {
            let flip_flop = cells.remove(&register).context("a register is met twice")?;
            cells[&block]["connections"][&output] = flip_flop["connections"]["Q"].clone();
            clock = flip_flop["connections"]["CLK"].clone();
            saved += 1;
        }
        let ties = outputs.ties.iter().map(|(port, bit)| (*port, json!([bit])));
        for (port, bits) in ties.chain([(outputs.clock, clock)]) {
            cells[&block]["connections"][port] = bits;
            cells[&block]["port_directions"][port] = "input".into();
        }
        for (parameter, value) in outputs.sets {
            cells[&block]["parameters"][*parameter] = (*value).into();
        }
    }
    Ok(saved)
}

fn kind(cell: &Value) -> &str {
    cell["type"].as_str().unwrap_or_default()
}

/// The net at a one-bit port, unless it is a constant.
fn net<'v>(cell: &'v Value, port: &str) -> Option<&'v Value> {
    Some(&cell["connections"][port][0]).filter(|bit| bit.is_u64())
}

fn is_constant(cell: &Value, port: &str, bit: &str) -> bool {
    cell["connections"][port][0] == *bit
}

/// The readers of each net.
fn readers(cells: &Map<String, Value>, pins: &[Value]) -> HashMap<u64, Reader> {
    let mut readers: HashMap<u64, Reader> = HashMap::new();
    for pin in pins.iter().filter_map(Value::as_u64) {
        readers.insert(pin, Reader::Many);
    }
    for (name, cell) in cells {
        let directions = &cell["port_directions"];
        let connections = cell["connections"].as_object().into_iter().flatten();
        for (port, bits) in connections.filter(|(port, _)| directions[port.as_str()] != "output") {
            for bit in bits.as_array().into_iter().flatten() {
                let Some(bit) = bit.as_u64() else { continue };
                let one = || Reader::One {
                    cell: name.clone(),
                    port: port.clone(),
                };
                readers
                    .entry(bit)
                    .and_modify(|reader| *reader = Reader::Many)
                    .or_insert_with(one);
            }
        }
    }
    readers
}

/// The registers behind all used outputs of a block, each with its output, if they can be moved into the block.
fn registers_behind(
    cells: &Map<String, Value>,
    block: &Value,
    outputs: &Outputs,
    readers: &HashMap<u64, Reader>,
) -> Option<Vec<(String, String)>> {
    let has = |(parameter, value): &(&str, &str)| block["parameters"][*parameter] == *value;
    let plain = outputs.unset.iter().all(has)
        && (outputs.tied.iter()).all(|(port, bit)| is_constant(block, port, bit));
    if !plain {
        return None;
    }
    let mut clock = net(block, outputs.clock);
    let mut registers = vec![];
    for output in block["connections"].as_object()?.keys() {
        let is_output = outputs.ports.iter().any(|prefix| {
            let number = output.strip_prefix(prefix);
            number.is_some_and(|number| number.parse::<u32>().is_ok())
        });
        if !is_output {
            continue;
        }
        match net(block, output).and_then(|bit| readers.get(&bit.as_u64()?)) {
            None => {}
            Some(Reader::One { cell, port }) if port == "DI" => {
                let register = &cells[cell];
                let clock = *clock.get_or_insert(net(register, "CLK")?);
                is_plain_register(register, clock).then_some(())?;
                registers.push((output.clone(), cell.clone()));
            }
            Some(_) => return None,
        }
    }
    Some(registers).filter(|registers| !registers.is_empty())
}

/// A flip-flop of a clock's rising edge, without enable or reset, with the initial value 0.
fn is_plain_register(cell: &Value, clock: &Value) -> bool {
    let parameter = |name: &str| cell["parameters"][name].as_str().map(str::trim);
    kind(cell) == FLIP_FLOP
        && net(cell, "CLK") == Some(clock)
        && net(cell, "LSR").is_none()
        && !is_constant(cell, "LSR", "1")
        && net(cell, "CE").is_none()
        && parameter("CEMUX") == Some("1")
        && parameter("CLKMUX") == Some("CLK")
        && parameter("REGSET") == Some("RESET")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Two bits of a block RAM with a register each, after a change by a test.
    fn netlist(change: impl Fn(&mut Value)) -> Value {
        let register = |d: u32, q: u32| {
            json!({
                "type": "TRELLIS_FF",
                "parameters": {"CEMUX": "1 ", "CLKMUX": "CLK", "GSR": "DISABLED", "LSRMUX": "LSR", "REGSET": "RESET"},
                "port_directions": {"CLK": "input", "DI": "input", "LSR": "input", "Q": "output"},
                "connections": {"CLK": [2], "DI": [d], "LSR": ["0"], "Q": [q]},
            })
        };
        let mut netlist = json!({"modules": {"top": {
            "ports": {
                "clk": {"direction": "input", "bits": [2]},
                "q": {"direction": "output", "bits": [20, 21]},
            },
            "cells": {
                "ram": {
                    "type": "DP16KD",
                    "parameters": {"REGMODE_A": "NOREG", "REGMODE_B": "NOREG", "DATA_WIDTH_A": "10010", "DATA_WIDTH_B": "10010"},
                    "port_directions": {"CLKB": "input", "CEB": "input", "OCEB": "input", "RSTB": "input",
                        "DOB0": "output", "DOB1": "output", "DOB2": "output"},
                    "connections": {"CLKB": [2], "CEB": ["1"], "OCEB": ["1"], "RSTB": ["0"],
                        "DOB0": [10], "DOB1": [11], "DOB2": [12]},
                },
                "first": register(10, 20),
                "second": register(11, 21),
            },
        }}});
        change(&mut netlist["modules"]["top"]);
        netlist
    }

    fn moved(netlist: &mut Value, stay: &str) -> Result<u64> {
        absorb(netlist, "top", stay, Blocks::RamsAndMultipliers)
    }

    #[test]
    fn registers_move_into_their_ram() {
        let mut netlist = netlist(|_| ());
        assert_eq!(moved(&mut netlist, "captured").unwrap(), 2);
        let cells = &netlist["modules"]["top"]["cells"];
        assert_eq!(cells.as_object().unwrap().len(), 1);
        let ram = &cells["ram"];
        assert_eq!(ram["connections"]["DOB0"], json!([20]));
        assert_eq!(ram["connections"]["DOB1"], json!([21]));
        assert_eq!(ram["connections"]["DOB2"], json!([12]));
        assert_eq!(ram["parameters"]["REGMODE_B"], "OUTREG");
        assert_eq!(ram["parameters"]["REGMODE_A"], "NOREG");
    }

    #[test]
    fn what_is_more_than_a_plain_register_stays() {
        let changes: [(&str, &str, Value); 10] = [
            (
                "a register with an enable",
                "/cells/second/connections/CE",
                json!([30]),
            ),
            (
                "by its parameter",
                "/cells/second/parameters/CEMUX",
                json!("CE"),
            ),
            ("with a reset", "/cells/second/connections/LSR", json!([30])),
            (
                "of the falling edge",
                "/cells/second/parameters/CLKMUX",
                json!("INV"),
            ),
            (
                "of another clock",
                "/cells/second/connections/CLK",
                json!([30]),
            ),
            (
                "that begins as 1",
                "/cells/second/parameters/REGSET",
                json!("SET"),
            ),
            ("no register", "/cells/second/type", json!("LUT4")),
            ("a pin beside it", "/ports/q/bits", json!([20, 11])),
            (
                "a bit that is read twice",
                "/cells/first/connections/DI",
                json!([11]),
            ),
            (
                "a RAM that pauses",
                "/cells/ram/connections/CEB",
                json!([30]),
            ),
        ];
        for (what, place, value) in changes {
            let mut netlist = netlist(|top| {
                let (cell, key) = place.rsplit_once('/').unwrap();
                top.pointer_mut(cell).unwrap()[key] = value.clone();
            });
            let before = netlist.clone();
            assert_eq!(moved(&mut netlist, "captured").unwrap(), 0, "{what}");
            assert_eq!(netlist, before, "{what}");
        }
    }

    #[test]
    fn a_wide_word_has_the_registers_of_both_halves() {
        let wide = |top: &mut Value, bit: u32| {
            let ram = &mut top["cells"]["ram"];
            ram["parameters"]["DATA_WIDTH_B"] = "100100".into();
            ram["port_directions"]["DOA0"] = "output".into();
            ram["connections"]["DOA0"] = json!([bit]);
            ram["connections"]["OCEA"] = json!(["0"]);
        };
        let mut both = netlist(|top| {
            wide(top, 11);
            top["cells"]["ram"]["connections"]["DOB1"] = json!([13]);
        });
        assert_eq!(moved(&mut both, "captured").unwrap(), 2);
        let ram = &both["modules"]["top"]["cells"]["ram"];
        assert_eq!(ram["connections"]["DOA0"], json!([21]));
        assert_eq!(ram["connections"]["OCEA"], json!(["1"]));
        assert_eq!(ram["parameters"]["REGMODE_A"], "OUTREG");
        assert_eq!(ram["parameters"]["REGMODE_B"], "OUTREG");

        // If another cell reads a bit of one half, the registers of the other half are not moved.
        let mut one = netlist(|top| {
            wide(top, 14);
            top["ports"]["q"]["bits"] = json!([20, 21, 14]);
        });
        assert_eq!(moved(&mut one, "captured").unwrap(), 0);
    }

    /// Replaces the RAM by a multiplier, in Yosys' form.
    fn multiplier(top: &mut Value) {
        top["cells"]["ram"] = json!({
            "type": "MULT18X18D",
            "parameters": {},
            "port_directions": {"A0": "input", "P0": "output", "P1": "output", "P2": "output"},
            "connections": {"A0": [5], "P0": [10], "P1": [11], "P2": [12]},
        });
    }

    #[test]
    fn a_products_registers_move_into_the_multiplier() {
        let mut netlist = netlist(multiplier);
        let before = netlist.clone();
        assert_eq!(
            absorb(&mut netlist, "top", "captured", Blocks::Rams).unwrap(),
            0
        );
        assert_eq!(netlist, before);
        assert_eq!(moved(&mut netlist, "captured").unwrap(), 2);
        let cells = &netlist["modules"]["top"]["cells"];
        assert_eq!(cells.as_object().unwrap().len(), 1);
        let multiplier = &cells["ram"];
        for (port, bits) in [
            ("P0", json!([20])),
            ("P1", json!([21])),
            ("CLK0", json!([2])),
            ("CE0", json!(["1"])),
            ("RST0", json!(["0"])),
        ] {
            assert_eq!(multiplier["connections"][port], bits, "{port}");
        }
        assert_eq!(multiplier["port_directions"]["CLK0"], "input");
        assert_eq!(multiplier["parameters"]["REG_OUTPUT_CLK"], "CLK0");
    }

    #[test]
    fn a_product_of_two_clocks_or_with_registers_already_stays() {
        let mut two_clocks = netlist(|top| {
            multiplier(top);
            top["cells"]["second"]["connections"]["CLK"] = json!([30]);
        });
        assert_eq!(moved(&mut two_clocks, "captured").unwrap(), 0);
        let mut registered = netlist(|top| {
            multiplier(top);
            top["cells"]["ram"]["parameters"]["REG_INPUTA_CLK"] = "CLK0".into();
        });
        assert_eq!(moved(&mut registered, "captured").unwrap(), 0);
    }

    #[test]
    fn registers_of_the_wrapper_stay() {
        let mut netlist = netlist(|_| ());
        assert_eq!(moved(&mut netlist, "sec").unwrap(), 0);
    }

    #[test]
    fn a_netlist_of_another_shape_is_named() {
        let error = absorb(&mut json!({"modules": {}}), "top", "captured", Blocks::Rams);
        let error = error.unwrap_err();
        assert!(error.to_string().contains("no module top"), "{error}");
    }
}
