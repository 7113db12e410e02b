//! Whether a mutated module does at its ports what the module does, for ever: by induction over Yosys' pairs of signals of the
//! same name. A module that holds much memory is not tried.
//!
//! A mutation that no port shows may well show inside: `<` for `<=` before a choice between equals. So pairs of inner signals that
//! were not proved are matched no more, and the rest is tried again; ports stay, and every pair that is left must be proved. The induction
//! says that two modules which have agreed for [`DEPTH`] clocks do so ever after. That they agree in the first place is what the
//! runs before have shown, which every survivor has passed.

use super::next_state;
use super::text::Site;
use crate::prove::tools::{self, Ended};
use crate::temporary;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::time::Duration;

/// Bits of memory up to which a module is tried: they become registers.
const MOST_MEMORY_BITS: u64 = 4096;

const LIMIT: Duration = Duration::from_secs(60);

/// Clocks over which the induction looks back.
const DEPTH: u32 = 6;

/// Times that a proof is tried, with fewer and fewer inner signals matched.
const ATTEMPTS: usize = 4;

/// The inner signals that are not matched, and what was not proved, in files of a proof's folder.
const UNMATCHED: &str = "unmatched.txt";
const STATUS: &str = "status.txt";

/// Says what proved it, if it was proved within the time.
///
/// # Errors
/// Yosys cannot be started.
pub(super) fn proved(
    texts: &[String],
    names: &[&str],
    at: usize,
    site: &Site,
) -> Result<Option<String>> {
    let below = below(texts, names, at);
    if next_state::proved(texts, names, &below, at, site)? {
        return Ok(Some(next_state::PROOF.into()));
    }
    let memory: u64 = below
        .iter()
        .map(|&module| memory_bits(&texts[module]))
        .sum();
    if memory > MOST_MEMORY_BITS {
        return Ok(None);
    }
    let folder = temporary::Folder::new().context("cannot create a temporary folder")?;
    let mut script = String::new();
    for (design, changed) in [("gold", false), ("gate", true)] {
        script += "design -reset; ";
        for &module in &below {
            let name = format!("{design}_{}.v", names[module]);
            let text = match changed && module == at {
                true => site.apply(&texts[module]),
                false => texts[module].clone(),
            };
            std::fs::write(folder.path().join(&name), text)
                .context("cannot write a temporary file")?;
            let _ = write!(script, "read_verilog {name}; ");
        }
        let top = names[at];
        let _ = write!(
            script,
            "prep -flatten -top {top}; memory_map; opt -full; design -stash {design}; "
        );
    }
    let top = names[at];
    let _ = write!(
        script,
        "design -copy-from gold -as gold {top}; design -copy-from gate -as gate {top}; \
         equiv_make -blacklist {UNMATCHED} gold gate equiv; hierarchy -top equiv; clean; \
         equiv_simple -seq {DEPTH}; equiv_induct -seq {DEPTH}; tee -q -o {STATUS} equiv_status; equiv_status -assert"
    );
    let ports = ports(&texts[at]);
    let mut unmatched: BTreeSet<String> = BTreeSet::new();
    for _ in 0..ATTEMPTS {
        let list: Vec<&str> = unmatched.iter().map(String::as_str).collect();
        std::fs::write(folder.path().join(UNMATCHED), list.join("\n"))
            .context("cannot write a temporary file")?;
        let ended = tools::run(folder.path(), LIMIT, "yosys", &["-q", "-p", &script])?;
        match ended {
            Ended::With { success: true, .. } => {
                return Ok(Some(format!("Yosys: equiv_induct -seq {DEPTH}")));
            }
            Ended::With { .. } => {}
            Ended::OutOfTime => return Ok(None),
        }
        // Without a status it was not the proof that failed.
        let Ok(status) = std::fs::read_to_string(folder.path().join(STATUS)) else {
            return Ok(None);
        };
        let before = unmatched.len();
        unmatched.extend(unproved(&status).filter(|name| !ports.contains(name)));
        if unmatched.len() == before {
            return Ok(None);
        }
    }
    Ok(None)
}

/// The signals of which `equiv_status` says that a bit is not proved.
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

/// The names of a module's ports, of which there is one a line.
fn ports(text: &str) -> BTreeSet<String> {
    let lines = text.lines().map(str::trim);
    lines
        .filter(|line| line.starts_with("input ") || line.starts_with("output "))
        .filter_map(|line| line.trim_end_matches(',').split_whitespace().last())
        .map(str::to_string)
        .collect()
}

/// A module and all below it.
fn below(texts: &[String], names: &[&str], at: usize) -> BTreeSet<usize> {
    let mut found = BTreeSet::from([at]);
    let mut open = vec![at];
    while let Some(module) = open.pop() {
        for (other, name) in names.iter().enumerate() {
            let placed = texts[module].contains(&format!("\n  {name} "));
            if placed && found.insert(other) {
                open.push(other);
            }
        }
    }
    found
}

/// Bits of the memories that a text declares: `reg [high:0] name [0:last];`
fn memory_bits(text: &str) -> u64 {
    let size = |range: &str, first: &str, last: &str| -> Option<u64> {
        let inner = range.strip_prefix(first)?.strip_suffix(last)?;
        Some(inner.parse::<u64>().ok()? + 1)
    };
    let lines = text.lines().map(str::trim);
    let memories = lines.filter(|line| line.starts_with("reg ") && line.ends_with("];"));
    memories
        .filter_map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let width = match words.len() {
                4 => size(words[1], "[", ":0]")?,
                _ => 1,
            };
            Some(width * size(words.last()?, "[0:", "];")?)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mutate::text::{Kind, sites};

    const TEXT: &str = "\
module counter (
  input  wire       clk,
  input  wire       rst,
  input  wire       step,
  output wire       high
);

  reg  [1:0] count;

  always @(posedge clk) begin
    if (rst) count <= 2'd0; else if (step) count <= (count == 2'd2) ? 2'd0 : (count + 2'd1);
  end

  wire never = step & (count == 2'd3) & (count == 2'd1);
  assign high = (count == 2'd2) | never;

endmodule
";

    #[test]
    fn what_no_one_can_see_is_proved_and_nothing_else() {
        let texts = [TEXT.to_string()];
        let all = sites(TEXT);
        let verdict = |before: &str, instead: &str| {
            let site = all
                .iter()
                .find(|site| &TEXT[site.place.clone()] == before && site.instead == instead);
            let site = site.unwrap_or_else(|| panic!("{before} → {instead}: {all:?}"));
            proved(&texts, &["counter"], 0, site).unwrap().is_some()
        };
        assert!(!verdict("+", "-"));
        assert!(!verdict("2'd2", "2'd3"));
        // The first `&` of what can never hold: then it is step or nothing.
        assert!(!verdict("|", "&"));
        let equal = all.iter().filter(|site| site.kind == Kind::Operator);
        let last = equal
            .filter(|site| TEXT[..site.place.start].contains("never =") && site.instead == "&");
        assert!(last.count() > 0);
        // `count == 3` and `count == 1` exclude each other; so do `count == 2` and `count == 1`.
        let site = all
            .iter()
            .find(|site| &TEXT[site.place.clone()] == "2'd3" && site.instead == "2'd2");
        assert!(
            proved(&texts, &["counter"], 0, site.unwrap())
                .unwrap()
                .is_some()
        );
    }

    /// The lesser of two numbers, which a memory too large to become registers keeps.
    const KEPT: &str = "\
module kept (
  input  wire        clk,
  input  wire        write,
  input  wire [9:0]  address,
  input  wire [15:0] a,
  input  wire [15:0] b,
  output reg  [15:0] y
);

  reg  [15:0] words [0:1023];
  reg  [15:0] word_s1;

  wire less = a < b;
  wire [15:0] lesser = less ? a : b;

  always @(posedge clk) begin
    if (write & less) words[address] <= lesser;
    if (write & ~less) words[address] <= lesser + 16'd1;
    word_s1 <= words[address];
    y <= word_s1;
  end

endmodule
";

    #[test]
    fn memories_of_any_size_are_no_hindrance() {
        let kept = KEPT.replace("    if (write & less) words[address] <= lesser;\n", "");
        let kept = kept.replace(
            "if (write & ~less) words[address] <= lesser + 16'd1",
            "if (write) words[address] <= lesser",
        );
        let verdict = |text: &str, before: &str, instead: &str| {
            let texts = [text.to_string()];
            let all = sites(text);
            let site = (all.iter())
                .find(|site| &text[site.place.clone()] == before && site.instead == instead);
            let site = site.unwrap_or_else(|| panic!("{before} → {instead}: {all:?}"));
            proved(&texts, &["kept"], 0, site).unwrap()
        };
        assert_eq!(
            verdict(&kept, "<", "<=").as_deref(),
            Some(next_state::PROOF)
        );
        // Here it matters which of the two equals is less.
        assert_eq!(verdict(KEPT, "<", "<="), None);
        assert_eq!(verdict(&kept, "less", "!(less)"), None);
        assert_eq!(verdict(&kept, "write", "1'b1"), None);
    }

    /// The lesser of two numbers, chosen a clock later than compared.
    const LESSER: &str = "\
module lesser (
  input  wire       clk,
  input  wire [3:0] a,
  input  wire [3:0] b,
  output reg  [3:0] y
);

  wire term = a < b;
  wire less = (a[3] ^ b[3]) ? b[3] : term;
  reg  less_s1;
  reg  [3:0] a_s1, b_s1;

  always @(posedge clk) begin
    less_s1 <= less;
    a_s1 <= a;
    b_s1 <= b;
    y <= less_s1 ? a_s1 : b_s1;
  end

endmodule
";

    #[test]
    fn a_change_that_shows_inside_alone_is_proved() {
        let texts = [LESSER.to_string()];
        let verdict = |before: &str, instead: &str| {
            let all = sites(LESSER);
            let site = (all.iter())
                .find(|site| &LESSER[site.place.clone()] == before && site.instead == instead);
            let site = site.unwrap_or_else(|| panic!("{before} → {instead}: {all:?}"));
            proved(&texts, &["lesser"], 0, site).unwrap().is_some()
        };
        // Of equal numbers either is the lesser.
        assert!(verdict("<", "<="));
        // Where both are negative the wrong one, or one of two clocks, is chosen.
        assert!(!verdict("^", "|"));
        assert!(!verdict("a_s1", "a"));
    }

    #[test]
    fn what_is_not_proved_is_read_and_ports_are_known() {
        let status = "Found 3 $equiv cells in equiv:\n\
            \x20 Unproven $equiv $auto$equiv_make.cc:274:find_same_wires$29: \\inner.term_gold [2] \\inner.term_gate [2]\n\
            \x20 Unproven $equiv $auto$equiv_make.cc:242:find_same_wires$27: \\y_gold \\y_gate\n";
        let names: BTreeSet<String> = unproved(status).collect();
        assert_eq!(names.into_iter().collect::<Vec<_>>(), ["inner.term", "y"]);
        let names: Vec<String> = ports(LESSER).into_iter().collect();
        assert_eq!(names, ["a", "b", "clk", "y"]);
    }

    #[test]
    fn memories_are_counted() {
        let text = "  reg  [23:0] limit [0:47];\n  reg  [5:0] head;\n  reg  flags [0:7];\n";
        assert_eq!(memory_bits(text), 24 * 48 + 8);
    }
}
