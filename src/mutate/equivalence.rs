//! Proves that a mutated module is equivalent to the original at its ports in all cycles, by induction over the pairs of signals of
//! the same name that Yosys finds. A module with much memory is not tried.
//!
//! A mutation without an effect at the ports may change internal signals, such as `<` instead of `<=` before a choice between equal
//! values. Pairs of internal signals that are not proved are therefore no longer matched, and the proof is repeated. Ports stay
//! matched, and every remaining pair must be proved. The induction shows that two modules that have agreed for [`DEPTH`] cycles
//! agree in all later cycles. The earlier runs, which every survivor has passed, show that they agree at the beginning.

use super::next_state;
use crate::hdl::{Design, HdlError, MemoryRef, Mutation, Select};
use crate::prove::tools;
use crate::temporary;
use crate::tools::Ended;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

/// Maximum number of memory bits of a module that is tried; they become registers.
const MOST_MEMORY_BITS: u64 = 4096;

const LIMIT: Duration = Duration::from_secs(60);

/// Number of cycles of the induction.
const DEPTH: u32 = 6;

/// Maximum number of attempts at a proof, each with fewer internal signals matched.
const ATTEMPTS: usize = 4;

/// Files in a proof's folder: the internal signals that are not matched, and the signals that were not proved.
const UNMATCHED: &str = "unmatched.txt";
const STATUS: &str = "status.txt";

/// Returns the description of the proof if there is one within the time limit.
///
/// # Errors
/// If Yosys cannot be started.
pub(super) fn proved(design: &Design, mutation: &Mutation) -> Result<Option<String>> {
    let top = design.module(mutation.module())?;
    // The two designs differ only in the selecting constant, so the same signals have the same names.
    let of_module = Design::new(top.clone())?;
    let selected = |number| -> Result<Design, HdlError> {
        of_module.selectable(&[(1, mutation)], Select::Constant(number))
    };
    let designs = [("gold", selected(0)?), ("gate", selected(1)?)];
    if next_state::proved(&designs)? {
        return Ok(Some(next_state::PROOF.into()));
    }
    let memories = (of_module.modules().iter()).flat_map(|module| module.memories());
    let bits = |m: MemoryRef<'_>| u64::from(m.width()) * u64::from(m.depth()) * m.copies() as u64;
    if memories.map(bits).sum::<u64>() > MOST_MEMORY_BITS {
        return Ok(None);
    }
    let folder = temporary::Folder::new().context("cannot create a temporary folder")?;
    let mut script = String::new();
    let name = top.name();
    for (kind, design) in &designs {
        script += "design -reset; ";
        script += &read(folder.path(), kind, design)?;
        let _ = write!(
            script,
            "prep -flatten -top {name}; memory_map; opt -full; design -stash {kind}; "
        );
    }
    let _ = write!(
        script,
        "design -copy-from gold -as gold {name}; design -copy-from gate -as gate {name}; \
         equiv_make -blacklist {UNMATCHED} gold gate equiv; hierarchy -top equiv; clean; \
         equiv_simple -seq {DEPTH}; equiv_induct -seq {DEPTH}; tee -q -o {STATUS} equiv_status; equiv_status -assert"
    );
    let is_port = |name: &String| top.port(name).is_some();
    let mut unmatched: BTreeSet<String> = BTreeSet::new();
    for _ in 0..ATTEMPTS {
        let list: Vec<&str> = unmatched.iter().map(String::as_str).collect();
        std::fs::write(folder.path().join(UNMATCHED), list.join("\n"))
            .context("cannot write a temporary file")?;
        let ended = tools::tools()?
            .yosys
            .run_for(folder.path(), LIMIT, &["-q", "-p", &script])?;
        match ended {
            Ended::With { success: true, .. } => {
                return Ok(Some(format!("Yosys: equiv_induct -seq {DEPTH}")));
            }
            Ended::With { .. } => {}
            Ended::OutOfTime => return Ok(None),
        }
        // Without a status file, Yosys failed for another reason.
        let Ok(status) = std::fs::read_to_string(folder.path().join(STATUS)) else {
            return Ok(None);
        };
        let before = unmatched.len();
        unmatched.extend(unproved(&status).filter(|name| !is_port(name)));
        if unmatched.len() == before {
            return Ok(None);
        }
    }
    Ok(None)
}

/// The signals with an unproved bit in the output of `equiv_status`.
fn unproved(status: &str) -> impl Iterator<Item = String> {
    let lines = status
        .lines()
        .filter_map(|line| line.trim().strip_prefix("Unproven $equiv "));
    lines.flat_map(|line| {
        let words = line.split_whitespace().filter_map(|word| {
            let name = word.strip_prefix('\\')?;
            name.strip_suffix("_gold").or(name.strip_suffix("_gate"))
        });
        words.map(str::to_string).collect::<Vec<_>>()
    })
}

/// Writes a design's files and returns the script that reads them.
///
/// # Errors
/// If they cannot be written.
pub(super) fn read(folder: &Path, kind: &str, design: &Design) -> Result<String> {
    let mut script = String::new();
    for (name, text) in design.files() {
        let name = format!("{kind}_{name}");
        std::fs::write(folder.join(&name), text).context("cannot write a temporary file")?;
        let _ = write!(script, "read_verilog {name}; ");
    }
    Ok(script)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hdl::{Builder, Module, Style};
    use std::sync::Arc;

    /// The proof that a change is equivalent, if there is one.
    fn verdict(module: &Arc<Module>, mutation: &Mutation) -> Option<String> {
        proved(&Design::new(module.clone()).unwrap(), mutation).unwrap()
    }

    /// The mutation that results in this expression.
    fn becomes(module: &Module, after: &str) -> Mutation {
        let sites = module.mutations();
        let site = sites.iter().find(|site| site.after == after);
        let site = site.unwrap_or_else(|| panic!("{after}: {sites:#?}"));
        site.mutation.clone()
    }

    #[test]
    fn what_no_one_can_see_is_proved_and_nothing_else() {
        let m = Builder::new("counter", "counts to two.");
        let step = m.input("step", 1);
        let count = m.reg_reset("count", 2, 0);
        let at_end = count.q.equals(2).named("at_end");
        let next = at_end.mux(m.zero(2), count.q + m.lit(1u8, 2));
        count.next_when(step, next);
        let never = (step & count.q.equals(3) & count.q.equals(1)).named("never");
        let high = (at_end | never).named("high");
        m.output("is_high", high);
        let changes = [
            (next.literal_of(1).as_value(2), false),
            (at_end.literal_of(2).as_value(3), false),
            (high.operand(&[]).other_operator(), false),
            (count.q.enable().as_value(1), false),
            // `count == 3` and `count == 1` exclude each other; so do `count == 2` and `count == 1`.
            (never.literal_of(3).as_value(2), true),
            (high.reads(never).as_value(0), true),
            (never.reads(step).as_value(1), true),
        ];
        let module = m.finish().unwrap();
        for (change, same) in changes {
            assert_eq!(verdict(&module, &change).is_some(), same, "{change:?}");
        }
        assert!(verdict(&module, &becomes(&module, "at_end ? 2'd0 : (count - 2'd1)")).is_none());
    }

    /// A memory, too large to become registers, that stores the lesser of two numbers; with `more`, `b + 1` in place of `b`.
    fn kept(more: bool) -> (Arc<Module>, [Mutation; 3]) {
        let m = Builder::new("kept", "the lesser of two.");
        let (write, address) = (m.input("write", 1), m.input("address", 10));
        let (a, b) = (m.input("a", 16), m.input("b", 16));
        let less = a.lt(b).named("less");
        let lesser = less.mux(a, if more { b + m.lit(1u8, 16) } else { b });
        let words = m.memory("words", 1024, 16, Style::Block);
        words.write(write, address, lesser);
        m.output("y", words.read(address).register());
        let changes = [
            less.operand(&[]).other_operator(),
            lesser.reads(less).inverted(),
            words.write_enable().as_value(1),
        ];
        (m.finish().unwrap(), changes)
    }

    #[test]
    fn memories_of_any_size_are_no_hindrance() {
        let (module, [or_equal, other, always]) = kept(false);
        assert_eq!(
            verdict(&module, &or_equal).as_deref(),
            Some(next_state::PROOF)
        );
        assert_eq!(verdict(&module, &other), None);
        assert_eq!(verdict(&module, &always), None);
        // Here the choice between equal values has an effect.
        let (module, [or_equal, ..]) = kept(true);
        assert_eq!(verdict(&module, &or_equal), None);
    }

    /// The lesser of two numbers, chosen one cycle after the comparison.
    #[test]
    fn a_change_that_shows_inside_alone_is_proved() {
        let m = Builder::new("lesser", "the lesser of two.");
        let (a, b) = (m.input("a", 4), m.input("b", 4));
        let term = a.lt(b).named("term");
        let signs = a.msb() ^ b.msb();
        let less = signs.mux(b.msb(), term).named("less");
        let y = less
            .register()
            .mux(a.register(), b.register())
            .named("chosen");
        m.output("y", y.register());
        let changes = [
            // Of equal numbers, either may be chosen.
            (term.operand(&[]).other_operator(), true),
            // If both are negative, the wrong one, or the one of another cycle, is chosen.
            (signs.operand(&[]).other_operator(), false),
            (y.reads(a.register()).one_clock_early(), false),
        ];
        let module = m.finish().unwrap();
        for (change, same) in changes {
            assert_eq!(verdict(&module, &change).is_some(), same, "{change:?}");
        }
    }

    #[test]
    fn what_is_not_proved_is_read() {
        let status = "Found 3 $equiv cells in equiv:\n\
            \x20 Unproven $equiv $auto$equiv_make.cc:274:find_same_wires$29: \\inner.term_gold [2] \\inner.term_gate [2]\n\
            \x20 Unproven $equiv $auto$equiv_make.cc:242:find_same_wires$27: \\y_gold \\y_gate\n";
        let names: BTreeSet<String> = unproved(status).collect();
        assert_eq!(names.into_iter().collect::<Vec<_>>(), ["inner.term", "y"]);
    }
}
