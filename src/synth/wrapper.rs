//! Shift registers at a module's ports. They keep pins off its critical paths, and allow any number of ports.

use super::cells::Cells;
use crate::hdl::{Direction, Module, Port};
use anyhow::{Context, Result, ensure};
use std::fmt::Write as _;

/// The wrapper's module.
pub(super) const NAME: &str = "synthesis_wrapper";
/// The wrapped module's instance in it.
pub(super) const INSTANCE: &str = "unit";
/// The registers that drive inputs, and those that capture outputs.
pub(super) const STIMULUS: &str = "stimulus";
pub(super) const CAPTURED: &str = "captured";

const CLOCK: &str = "clk";

/// Number of bits of the module's inputs without the clock, and of its outputs.
fn widths(module: &Module) -> (u32, u32) {
    let sum = |direction| {
        let ports = module.ports().iter();
        let of = ports.filter(|port| port.direction == direction && port.name != CLOCK);
        of.map(|port| port.width).sum()
    };
    (sum(Direction::Input), sum(Direction::Output))
}

/// The wrapper: one register shifts data from a pin into all inputs; a second captures the outputs and reduces them to another pin.
/// It is protected from optimisation, so its own area is known.
pub(super) fn verilog(module: &Module) -> Result<String> {
    let (inputs, outputs) = widths(module);
    ensure!(
        inputs > 0 && outputs > 0,
        "a module without inputs or outputs cannot be timed"
    );
    let mut connections: Vec<String> = vec![];
    let (mut next_input, mut next_output) = (0, 0);
    for Port {
        name,
        width,
        direction,
        ..
    } in module.ports()
    {
        let bus = match direction {
            _ if name == CLOCK => {
                connections.push(format!("    .{name}({CLOCK})"));
                continue;
            }
            Direction::Input => (STIMULUS, &mut next_input),
            Direction::Output => ("outputs", &mut next_output),
        };
        let (register, next) = bus;
        let least = *next;
        *next += width;
        connections.push(format!("    .{name}({register}[{}:{least}])", *next - 1));
    }
    let mut text = String::new();
    let _ = write!(
        text,
        "// {} between shift registers.\n\
         `default_nettype none\n\
         module {NAME} (\n  input  wire {CLOCK},\n  input  wire serial_in,\n  output wire serial_out\n);\n\
         \x20 (* keep *) reg [{}:0] {STIMULUS};\n\
         \x20 (* keep *) reg [{outputs_high}:0] {CAPTURED};\n\
         \x20 (* keep *) reg [{outputs_high}:0] folded;\n\
         \x20 wire [{outputs_high}:0] outputs;\n\
         \x20 always @(posedge {CLOCK}) begin\n\
         \x20   {STIMULUS} <= {{{STIMULUS}, serial_in}};\n\
         \x20   {CAPTURED} <= outputs;\n\
         \x20   folded <= (folded << 1) ^ {CAPTURED};\n\
         \x20 end\n\
         \x20 assign serial_out = folded[{outputs_high}];\n\
         \x20 {} {INSTANCE} (\n{}\n  );\n\
         endmodule\n\
         `default_nettype wire\n",
        super::unit_name(module),
        inputs - 1,
        super::unit_name(module),
        connections.join(",\n"),
        outputs_high = outputs - 1,
    );
    Ok(text)
}

/// Subtracts the cells of the wrapper on an ECP5: its registers, and the LUTs that reduce outputs (the lowest bit needs none).
pub(super) fn subtract(module: &Module, cells: &mut Cells) -> Result<()> {
    let (inputs, outputs) = widths(module);
    for (kind, own) in [("TRELLIS_FF", inputs + 2 * outputs), ("LUT4", outputs - 1)] {
        let count = cells.entry(kind.to_string()).or_default();
        *count = count.checked_sub(u64::from(own)).with_context(|| {
            format!(
                "Yosys made {count} cells {kind}, of which {own} should stand around the module"
            )
        })?;
    }
    cells.retain(|_, count| *count > 0);
    Ok(())
}
