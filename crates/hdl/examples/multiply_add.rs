//! A pipelined multiply-add, built from a pipelined multiplier.

use dynrt_hdl::{Builder, Design, HdlError, Module};
use std::sync::Arc;

/// A multiplier with a register before and two registers after the product.
pub fn multiply(width: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new("multiply", "y = a * b.");
    let p = m.pipeline();
    let (a, b) = (p.input("a", width), p.input("b", width));
    let product = a.register().mul(b.register()).named("product");
    m.output("y", product.delay(2));
    m.finish()
}

/// `c` and `valid` enter together with `a` and `b`. They are delayed by the latency of the multiplier,
/// which the description does not state.
pub fn multiply_add(width: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new("multiply_add", "y = a * b + c.");
    let p = m.pipeline();
    let (a, b) = (p.input("a", width), p.input("b", width));
    let c = p.input("c", 2 * width);
    let valid = p.valid_input("valid");

    let multiplier = m.instance("multiplier", &multiply(width)?, &[("a", a), ("b", b)]);
    let y = (multiplier.get("y") + c).register();

    m.output("y", y);
    m.output("y_valid", valid.at(y.stage()));
    m.finish()
}

pub fn verilog() -> Result<String, HdlError> {
    let module = multiply_add(8)?;
    assert_eq!(module.latency(), Some(4));
    let design = Design::new(module)?;
    Ok(design.verilog(design.top()))
}

#[allow(dead_code)]
fn main() -> Result<(), HdlError> {
    print!("{}", verilog()?);
    Ok(())
}
