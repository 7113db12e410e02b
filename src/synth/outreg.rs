//! The output registers of ECP5 block RAMs. Yosys leaves them unused and puts a register that follows a block RAM into slices; the
//! RAM's own has no wire before it, and its bits come sooner after the clock (Lattice FPGA-TN-02204, *ECP5 and ECP5-5G Memory
//! User Guide*: REGMODE).

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value};
use std::collections::HashMap;

/// A read port of a block RAM: outputs, the parameters of its registers, and the ports that these listen to.
struct ReadPort {
    outputs: &'static [&'static str],
    modes: &'static [&'static str],
    clock: &'static str,
    clock_enable: &'static str,
    /// The first is what Yosys ties, 1 where words are read.
    register_enables: &'static [&'static str],
    reset: &'static str,
}

const PORT_A: ReadPort = ReadPort {
    outputs: &["DOA"],
    modes: &["REGMODE_A"],
    clock: "CLKA",
    clock_enable: "CEA",
    register_enables: &["OCEA"],
    reset: "RSTA",
};

const PORT_B: ReadPort = ReadPort {
    outputs: &["DOB"],
    modes: &["REGMODE_B"],
    clock: "CLKB",
    clock_enable: "CEB",
    register_enables: &["OCEB"],
    reset: "RSTB",
};

/// Words of 36 bits come out of both halves and belong to port B, as they do for Lattice's PDPW16KD.
const WIDE: ReadPort = ReadPort {
    outputs: &["DOA", "DOB"],
    modes: &["REGMODE_A", "REGMODE_B"],
    clock: "CLKB",
    clock_enable: "CEB",
    register_enables: &["OCEB", "OCEA"],
    reset: "RSTB",
};

/// What is done here, for keys of results.
pub(super) const WHAT: &str = "output registers of block RAMs, 2";

/// The kind of a flip-flop's cell.
pub(super) const FLIP_FLOP: &str = "TRELLIS_FF";

fn read_ports(cell: &Value) -> &'static [ReadPort] {
    let width = |port: &str| {
        let bits = cell["parameters"][port].as_str()?;
        u32::from_str_radix(bits, 2).ok()
    };
    match (kind(cell), width("DATA_WIDTH_A"), width("DATA_WIDTH_B")) {
        ("DP16KD", Some(_), Some(36)) => &[WIDE],
        ("DP16KD", Some(36), Some(_)) => &[PORT_B],
        ("DP16KD", Some(_), Some(_)) => &[PORT_A, PORT_B],
        _ => &[],
    }
}

/// Who reads a net.
enum Reader {
    /// One cell's input.
    One { cell: String, port: String },
    /// More than one, or a pin.
    Many,
}

/// Moves into block RAMs the registers that follow them, where all bits of a read port have one, each a plain one of the same clock
/// that nothing else comes between; and says how many flip-flops that saves. Registers whose cells' names begin with `stay` stay.
///
/// # Errors
/// `netlist` is not what Yosys writes for one flattened module `top`.
pub(super) fn absorb(netlist: &mut Value, top: &str, stay: &str) -> Result<u64> {
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
        for port in read_ports(cell) {
            let Some(registers) = registers_behind(cells, cell, port, &readers) else {
                continue;
            };
            if !registers.iter().any(|(_, name)| name.starts_with(stay)) {
                moves.push((name.clone(), port, registers));
            }
        }
    }
    let mut saved = 0;
    for (ram, port, registers) in moves {
        for (output, register) in registers {
            let flip_flop = cells.remove(&register).context("a register is met twice")?;
            cells[&ram]["connections"][&output] = flip_flop["connections"]["Q"].clone();
            saved += 1;
        }
        for mode in port.modes {
            cells[&ram]["parameters"][*mode] = "OUTREG".into();
        }
        for enable in port.register_enables {
            cells[&ram]["connections"][*enable] = Value::from(vec!["1"]);
        }
    }
    Ok(saved)
}

fn kind(cell: &Value) -> &str {
    cell["type"].as_str().unwrap_or_default()
}

/// The net at a port of one bit, if it is no constant.
fn net<'v>(cell: &'v Value, port: &str) -> Option<&'v Value> {
    Some(&cell["connections"][port][0]).filter(|bit| bit.is_u64())
}

fn is_constant(cell: &Value, port: &str, bit: &str) -> bool {
    cell["connections"][port][0] == *bit
}

/// Who reads each net.
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

/// The registers behind all outputs of a read port that anyone reads, each with its output, if they can move into the RAM.
fn registers_behind(
    cells: &Map<String, Value>,
    ram: &Value,
    port: &ReadPort,
    readers: &HashMap<u64, Reader>,
) -> Option<Vec<(String, String)>> {
    let plain = port
        .modes
        .iter()
        .all(|mode| ram["parameters"][*mode] == "NOREG")
        && is_constant(ram, port.clock_enable, "1")
        && is_constant(ram, port.register_enables[0], "1")
        && is_constant(ram, port.reset, "0");
    if !plain {
        return None;
    }
    let clock = net(ram, port.clock)?;
    let mut registers = vec![];
    for output in ram["connections"].as_object()?.keys() {
        let is_output = port.outputs.iter().any(|prefix| {
            let number = output.strip_prefix(prefix);
            number.is_some_and(|number| number.parse::<u32>().is_ok())
        });
        if !is_output {
            continue;
        }
        match net(ram, output).and_then(|bit| readers.get(&bit.as_u64()?)) {
            None => {}
            Some(Reader::One { cell, port }) if port == "DI" => {
                is_plain_register(&cells[cell], clock).then_some(())?;
                registers.push((output.clone(), cell.clone()));
            }
            Some(_) => return None,
        }
    }
    Some(registers).filter(|registers| !registers.is_empty())
}

/// A flip-flop of a clock's rising edge, without enable or reset, that begins as 0.
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

    /// Two bits of a block RAM, a register behind each; and what a test changes of it.
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

    #[test]
    fn registers_move_into_their_ram() {
        let mut netlist = netlist(|_| ());
        assert_eq!(absorb(&mut netlist, "top", "captured").unwrap(), 2);
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
            assert_eq!(
                absorb(&mut netlist, "top", "captured").unwrap(),
                0,
                "{what}"
            );
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
        assert_eq!(absorb(&mut both, "top", "captured").unwrap(), 2);
        let ram = &both["modules"]["top"]["cells"]["ram"];
        assert_eq!(ram["connections"]["DOA0"], json!([21]));
        assert_eq!(ram["connections"]["OCEA"], json!(["1"]));
        assert_eq!(ram["parameters"]["REGMODE_A"], "OUTREG");
        assert_eq!(ram["parameters"]["REGMODE_B"], "OUTREG");

        // A bit of one half that something else reads keeps those of the other from moving.
        let mut one = netlist(|top| {
            wide(top, 14);
            top["ports"]["q"]["bits"] = json!([20, 21, 14]);
        });
        assert_eq!(absorb(&mut one, "top", "captured").unwrap(), 0);
    }

    #[test]
    fn registers_of_the_wrapper_stay() {
        let mut netlist = netlist(|_| ());
        assert_eq!(absorb(&mut netlist, "top", "sec").unwrap(), 0);
    }

    #[test]
    fn a_netlist_of_another_shape_is_named() {
        let error = absorb(&mut json!({"modules": {}}), "top", "captured").unwrap_err();
        assert!(error.to_string().contains("no module top"), "{error}");
    }
}
