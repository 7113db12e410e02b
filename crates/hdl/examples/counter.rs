//! A counter with an enable and a limit.

use dynrt_hdl::{Builder, Design, HdlError, Module};
use std::sync::Arc;

pub fn counter(width: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new("counter", "counts from 0 to a limit, then starts again.");
    m.group("Control");
    let enable = m.input("enable", 1);
    let limit = m.input("limit", width);

    let count = m.reg_reset("count", width, 0);
    let last = count.q.eq(limit).named("at_limit");
    let one = m.lit(1u8, width);
    count.next_when(enable, last.mux(m.zero(width), count.q + one));

    m.group("Result");
    m.output("value", count.q);
    m.output("last", last);
    m.finish()
}

pub fn verilog() -> Result<String, HdlError> {
    let design = Design::new(counter(8)?)?;
    Ok(design.verilog(design.top()))
}

#[allow(dead_code)]
fn main() -> Result<(), HdlError> {
    print!("{}", verilog()?);
    Ok(())
}
