//! Describes a counter with dynrt-hdl, builds a Verilator model of it, and checks it cycle by cycle.

use dynrt_hdl::{Builder, Design, HdlError, Module, Specs};
use dynrt_verilated::model::{BuildOptions, Model, Sources, build};
use std::fmt::Write;
use std::sync::Arc;

dynrt_hdl::interface! {
    pub (width: u32) {
        in "Control" { enable: 1, limit: width }
        out "Result" { value: width, last: 1 }
    }
}

/// A counter that starts again after `limit`.
pub fn counter(width: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new("counter", "counts from 0 to a limit, then starts again.");
    let ports = ports(width);
    let Inputs { enable, limit } = ports.inputs.inputs(&m);
    let count = m.reg_reset("count", width, 0);
    let last = count.q.eq(limit);
    let one = m.lit(1u8, width);
    count.next_when(enable, last.mux(m.zero(width), count.q + one));
    let value = count.q;
    ports.outputs.outputs(&m, Outputs { value, last });
    m.finish()
}

/// Simulates 12 cycles and returns a line for each.
pub fn simulate(options: &BuildOptions) -> anyhow::Result<String> {
    let sources = Sources::of(&Design::new(counter(8)?)?);
    let built = build(&sources, options, &|_| ())?;
    let mut model = Model::load(&built, &sources.ports)?;
    // The ports as a typed bundle: a misspelt name does not compile.
    let ports = model.ports(&ports(8))?;
    model.reset(2);

    let mut lines = String::new();
    let mut expected = 0;
    for cycle in 0..12 {
        let enable = u64::from(cycle % 4 != 3);
        model.drive(&ports.inputs, Inputs { enable, limit: 5 });
        model.eval(); // `last` depends on `limit` in the same cycle
        let Outputs { value, last } = model.sample(&ports.outputs);
        assert_eq!((value, last), (expected, u64::from(expected == 5)));
        writeln!(
            lines,
            "cycle {cycle:2}: enable {enable}, value {value}, last {last}"
        )?;
        model.clock();
        expected = (expected + enable) % 6;
    }
    Ok(lines)
}

#[allow(dead_code)]
fn main() -> anyhow::Result<()> {
    print!("{}", simulate(&BuildOptions::default())?);
    Ok(())
}
