//! The modules of the memory system that are proved: small instances, which the bus of a machine does not change.

use super::induction::{Induction, of_module};
use crate::hdl::{HdlError, Module};
use crate::hw::memory::axi::{Bus, monitor, monitored};
use crate::hw::memory::{arbiter, combiner, reader};
use anyhow::Result;
use std::sync::Arc;

/// A bus of few bits and few bursts.
const BUS: Bus = Bus {
    data_bits: 32,
    id_bits: 1,
    reads: 2,
    writes: 3,
};

/// The monitor's bound on waiting, in cycles. No proof depends on it.
const PATIENCE: u32 = 100;

/// The modules of a unit, and the name of their proof.
fn modules(unit: &str) -> Result<Vec<(Arc<Module>, &'static str)>, HdlError> {
    let sizes = monitor::Sizes {
        bus: BUS,
        patience: PATIENCE,
    };
    Ok(match unit {
        "axi" => vec![(monitored::module(&sizes)?, "obeys")],
        "combiner" => {
            // Of three lines, two may wait for the bus at once.
            let of = |lines| combiner::Sizes {
                data_bits: 128,
                lines,
                writes: 2,
            };
            let keeps = |lines| Ok((combiner::module(&of(lines))?, "keeps"));
            [2, 3]
                .into_iter()
                .map(keeps)
                .collect::<Result<_, HdlError>>()?
        }
        "arbiter" => vec![(
            arbiter::module(&arbiter::Sizes {
                data_bits: BUS.data_bits,
                clients: vec![1, 2, 1],
            })?,
            "rotates",
        )],
        "reader" => {
            // Beats that are parts of words, and beats of two words.
            let of = |data_bits| reader::Sizes {
                data_bits,
                id_bits: BUS.id_bits,
                words: 16,
                registers_front: false,
            };
            let reads = |data_bits| Ok((reader::module(&of(data_bits))?, "reads"));
            [32, 256]
                .into_iter()
                .map(reads)
                .collect::<Result<_, HdlError>>()?
        }
        _ => vec![],
    })
}

/// All inductions of a unit of the given name; none if it is no unit of the memory system.
///
/// # Errors
/// A mistake in a description.
pub fn proofs(unit: &str) -> Result<Vec<Induction>> {
    let found = modules(unit)?.into_iter();
    found
        .map(|(module, name)| of_module(unit, module, name))
        .collect()
}
