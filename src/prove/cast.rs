//! The modules of the chip's cast unit that are proved: with a small window of answers and few tags, which no configuration has. The
//! description is the same for any number of packets.

use super::induction::{Induction, of_module};
use crate::config::Config;
use crate::hw::Plan;
use crate::hw::chip::{answers, cast, hits, rays};
use anyhow::Result;

/// The name of the unit.
const UNIT: &str = "cast";

/// Packets of the window of answers: those of two words.
const WINDOW: u32 = 8;

/// A machine with few tags and packets of this many rays.
fn plan(rays: u32, fraction_bits: u32) -> Result<Plan> {
    let mut config = Config::load("tiny")?;
    config.exponent_bits = 4;
    config.fraction_bits = fraction_bits;
    config.rays_per_packet = rays;
    // More than the window has, modulo two passes.
    config.tag_bits = 5;
    Ok(Plan::new(&config)?)
}

/// All inductions of the cast unit; none if `unit` is another one.
///
/// # Errors
/// A mistake in a description.
pub fn proofs(unit: &str) -> Result<Vec<Induction>> {
    if unit != UNIT {
        return Ok(vec![]);
    }
    Ok(vec![
        // Words of four packets.
        of_module(unit, answers::of_window(&plan(8, 5)?, WINDOW)?, "orders")?,
        of_module(unit, rays::module(&plan(4, 5)?)?, "packs")?,
        // Records of one word and of two.
        of_module(unit, hits::module(&plan(4, 5)?)?, "writes")?,
        of_module(unit, hits::module(&plan(2, 20)?)?, "writes")?,
        of_module(unit, cast::module(&plan(4, 5)?)?, "joins")?,
    ])
}
