//! Properties of a module, and their text for provers and simulators.

use super::builder::{Builder, Outputs, Reg, Wire};
use super::design::{Design, Direction, Module, renamed};
use super::error::HdlError;
use super::ir::{Id, Op, ProofData};
use super::memory::Memory;
use super::mutation::Mutation;
use super::signal::Signal;
use super::verilog;
use std::ops::RangeInclusive;
use std::panic::Location;

/// Properties that are proved together, expressed in the module's own signals: assumptions about its environment,
/// assertions, and conditions that must be reachable. Returned by [`Builder::proof`].
///
/// Properties are described last, when the module is complete. They are not part of the Verilog of the module;
/// [`Module::formal`] prints module and properties for a prover, [`Module::checked`] for a simulator. This crate
/// runs no prover.
///
/// ```
/// use dynrt_hdl::Builder;
/// let m = Builder::new("counter", "counts to 9.");
/// let step = m.input("step", 1);
/// let count = m.reg_reset("count", 4, 0);
/// let next = count.q.equals(9).mux(m.zero(4), count.q + m.lit(1u8, 4));
/// count.next_when(step, next);
/// m.output("digit", count.q);
///
/// let proof = m.proof("digit", "a counter of one decimal digit");
/// proof.assert("it stays a digit", count.q.le(m.lit(9u8, 4)));
/// let before = proof.past(count.q);
/// let stepped = proof.past(step & !m.reset());
/// proof.assert("it changes when it steps", stepped.implies(count.q.ne(before)));
/// proof.cover("it wraps around", stepped & count.q.is_zero());
/// let module = m.finish().unwrap();
/// assert!(!module.verilog().contains("assert"));
/// assert!(module.formal("digit", &str::to_string).unwrap().text.contains("assert (count <= 4'd9)"));
/// ```
#[derive(Clone, Copy)]
pub struct Proof<'b> {
    builder: &'b Builder,
    index: usize,
}

impl Builder {
    /// Begins a proof: all its assertions are proved under all its assumptions. `what` describes it
    /// in words.
    ///
    /// The module must be complete, because only properties may follow. The outputs of instances
    /// have arbitrary values in the proof, unless the instances are [kept](Proof::keep).
    #[track_caller]
    pub fn proof(&self, name: impl Into<String>, what: impl Into<String>) -> Proof<'_> {
        let (name, place) = (name.into(), Location::caller());
        self.check_name(&name, place);
        let mut inner = self.inner.borrow_mut();
        inner.formal = true;
        let index = inner.ir.proofs.len();
        let clash = inner.ir.proofs.iter().any(|proof| proof.name == name);
        inner.ir.proofs.push(ProofData {
            name: name.clone(),
            what: what.into(),
            place,
            assumes: vec![],
            asserts: vec![],
            covers: vec![],
            cut: vec![],
            kept: vec![],
            depth: 1,
            arrays: false,
            faults: vec![],
        });
        drop(inner);
        if clash {
            self.fail(place, format!("two proofs are called \"{name}\""));
        }
        Proof {
            builder: self,
            index,
        }
    }
}

impl<'b> Signal<'b> {
    /// Returns `!self | other`, for a condition of one bit: if it is 1, `other` must be 1 too.
    #[track_caller]
    pub fn implies(self, other: Signal<'b>) -> Signal<'b> {
        !self | other
    }

    /// Returns the signal at each of these stages of its pipeline, as signals without a stage.
    #[track_caller]
    pub fn stages(self, stages: RangeInclusive<u32>) -> Vec<Signal<'b>> {
        stages.map(|stage| self.at(stage).untimed()).collect()
    }

    /// Returns the number of 1 bits as a number of `width` bits, modulo 2^`width`.
    #[track_caller]
    pub fn count_ones(self, width: u32) -> Signal<'b> {
        let bits = (0..self.width()).map(|i| self.bit(i).extend(width));
        bits.reduce(|sum, bit| sum + bit)
            .expect("a signal has a bit")
    }

    /// Returns the bit with the number `index`; 0 if there is no such bit.
    #[track_caller]
    pub fn bit_at(self, index: Signal<'b>) -> Signal<'b> {
        let one = self.builder.lit(1u8, self.width());
        (self & one.shl(index)).any()
    }
}

impl<'b> Memory<'b> {
    /// Returns the stored word at `address` for use in properties, without adding a read port. The
    /// module must read the memory too.
    #[track_caller]
    pub fn peek(&self, address: Signal<'b>) -> Signal<'b> {
        self.stored(address, Location::caller())
    }
}

impl<'b> Proof<'b> {
    /// Returns the builder of the module.
    pub fn module(&self) -> &'b Builder {
        self.builder
    }

    fn data<T>(&self, change: impl FnOnce(&mut ProofData) -> T) -> T {
        change(&mut self.builder.inner.borrow_mut().ir.proofs[self.index])
    }

    /// The name of an element that exists only in this proof.
    fn name(&self, name: &str) -> String {
        self.data(|data| format!("f_{}_{name}", data.name))
    }

    /// A condition at its stage, without the stage.
    #[track_caller]
    fn bit(&self, what: &str, condition: Signal<'b>) -> Id {
        let place = Location::caller();
        if !std::ptr::eq(condition.builder, self.builder) {
            let message = format!(
                "{what}: the condition is a signal of module {}",
                condition.builder.name
            );
            self.builder.fail(place, message);
        } else if what.contains(['%', '"', '\\', '\n']) {
            let message = format!(
                "{what:?}: is printed in Verilog and must not contain %, \", \\ or line breaks"
            );
            self.builder.fail(place, message);
        } else if condition.width() != 1 {
            let message = format!(
                "{what}: the condition has {} bits, must have 1",
                condition.width()
            );
            self.builder.fail(place, message);
        } else if condition.literal() == Some(0) {
            let message = format!("{what}: the condition is always 0");
            self.builder.fail(place, message);
        }
        condition.id
    }

    /// Assumes that a condition of one bit is 1 in every cycle. `what` describes it in words; it is
    /// printed in the Verilog and must not contain `%`, `"`, `\` or line breaks.
    #[track_caller]
    pub fn assume(&self, what: impl Into<String>, condition: Signal<'b>) {
        let what = what.into();
        let id = self.bit(&what, condition);
        self.data(|data| data.assumes.push((what, id)));
    }

    /// Asserts that a condition of one bit is 1 in every cycle after the first cycle of a reset.
    /// `what` is as in [`assume`](Proof::assume).
    #[track_caller]
    pub fn assert(&self, what: impl Into<String>, condition: Signal<'b>) {
        let what = what.into();
        let id = self.bit(&what, condition);
        self.data(|data| data.asserts.push((what, id)));
    }

    /// Demands that a condition of one bit can become 1 soon after reset, which shows that the
    /// assumptions do not exclude it. `what` is as in [`assume`](Proof::assume).
    #[track_caller]
    pub fn cover(&self, what: impl Into<String>, condition: Signal<'b>) {
        let what = what.into();
        let id = self.bit(&what, condition);
        self.data(|data| data.covers.push((what, id)));
    }

    /// Returns an arbitrary value that is the same in every cycle.
    #[track_caller]
    pub fn any_const(&self, name: &str, width: u32) -> Signal<'b> {
        let place = Location::caller();
        self.builder
            .named_node(Op::AnyConst, width, &self.name(name), None, place)
    }

    /// Returns a value that is arbitrary in every cycle.
    #[track_caller]
    pub fn any_seq(&self, name: &str, width: u32) -> Signal<'b> {
        let place = Location::caller();
        self.builder
            .named_node(Op::AnySeq, width, &self.name(name), None, place)
    }

    /// Returns the value that a signal had in the previous cycle.
    #[track_caller]
    pub fn past(&self, signal: Signal<'b>) -> Signal<'b> {
        signal.untimed().register()
    }

    /// Declares a register that only the proof has. Its name is prefixed with `f_` and the name of
    /// the proof.
    #[track_caller]
    pub fn reg(&self, name: &str, width: u32) -> Reg<'b> {
        self.builder.reg(self.name(name), width)
    }

    /// Declares a register that only the proof has and that reset sets to `value`.
    #[track_caller]
    pub fn reg_reset(&self, name: &str, width: u32, value: u128) -> Reg<'b> {
        self.builder.reg_reset(self.name(name), width, value)
    }

    /// Declares a wire that only the proof has, to be driven later.
    #[track_caller]
    pub fn wire(&self, name: &str, width: u32) -> Wire<'b> {
        self.builder.wire(self.name(name), width)
    }

    /// Names a signal that only the proof has.
    #[track_caller]
    pub fn named(&self, name: &str, signal: Signal<'b>) -> Signal<'b> {
        signal.named(self.name(name))
    }

    /// Gives a signal an arbitrary value in every cycle, independent of its driver. What is proved
    /// for arbitrary values holds for the actual ones. The signal must have a name.
    #[track_caller]
    pub fn cut(&self, signal: Signal<'b>) {
        self.data(|data| data.cut.push(signal.id));
    }

    /// Includes an instance in the proof with its actual logic, and with it all instances of the
    /// same module.
    #[track_caller]
    pub fn keep(&self, instance: &Outputs<'b>) {
        let index = instance.index;
        self.data(|data| {
            if !data.kept.contains(&index) {
                data.kept.push(index);
            }
        });
    }

    /// Registers a fault of the module that must make the proof fail, which shows that the proof
    /// depends on what it changes. `what` describes the fault in words.
    pub fn fault(&self, what: impl Into<String>, mutation: Mutation) {
        let what = what.into();
        self.data(|data| data.faults.push((what, mutation)));
    }

    /// Sets the depth of the induction: the number of cycles that the induction step looks back. It
    /// is 1 at first.
    pub fn depth(&self, clocks: u32) {
        self.data(|data| data.depth = clocks);
    }

    /// Leaves memories as arrays for the solver instead of mapping them to registers. Use it for
    /// memories of many words.
    pub fn arrays(&self) {
        self.data(|data| data.arrays = true);
    }
}

impl<'b> Outputs<'b> {
    /// Returns a register, wire or port inside the instance, by its name in the Verilog, for use in
    /// properties.
    #[track_caller]
    pub fn inside(&self, name: &str) -> Signal<'b> {
        let place = Location::caller();
        let found = {
            let inner = self.builder.inner.borrow();
            let module = &inner.ir.instances[self.index].module;
            module
                .declared(name)
                .map(|id| (id, module.ir.nodes[id].width))
        };
        match found {
            Some((id, width)) => self
                .builder
                .node(Op::Inside(self.index, id), width, None, place),
            None => {
                let message = format!("module {} has no signal {name}", self.module);
                self.builder.fail(place, message);
                self.builder.zero(1)
            }
        }
    }
}

/// The contents of a proof in words, and its options.
#[derive(Clone, Debug)]
pub struct ProofFacts {
    /// The name of the proof.
    pub name: String,
    /// Its description.
    pub what: String,
    /// The descriptions of the assumptions.
    pub assumes: Vec<String>,
    /// The descriptions of the assertions.
    pub asserts: Vec<String>,
    /// The descriptions of the covered conditions.
    pub covers: Vec<String>,
    /// The depth of the induction.
    pub depth: u32,
    /// Whether memories remain arrays: see [`Proof::arrays`].
    pub arrays: bool,
    /// The faults that must make the proof fail, each with its description.
    pub faults: Vec<(String, Mutation)>,
}

/// A module with the properties of one proof, as input for Yosys.
#[derive(Clone, Debug)]
pub struct Formal {
    /// The module, followed by replacements of the modules that it instantiates: SystemVerilog for
    /// `read_verilog -formal -sv`.
    pub text: String,
    /// The line of each assertion in the text, counted from 1.
    pub asserts: Vec<usize>,
    /// The names of the wires that have arbitrary values, for the command `cutpoint` of Yosys.
    pub cut: Vec<String>,
}

impl Module {
    /// Returns the proofs of the module.
    pub fn proofs(&self) -> Vec<ProofFacts> {
        let words = |of: &[(String, Id)]| of.iter().map(|(what, _)| what.clone()).collect();
        let facts = |proof: &ProofData| ProofFacts {
            name: proof.name.clone(),
            what: proof.what.clone(),
            assumes: words(&proof.assumes),
            asserts: words(&proof.asserts),
            covers: words(&proof.covers),
            depth: proof.depth,
            arrays: proof.arrays,
            faults: proof.faults.clone(),
        };
        self.ir.proofs.iter().map(facts).collect()
    }

    /// Returns the module with the properties of the proof called `proof`. The function `emitted`
    /// maps the names of modules to those in the text.
    ///
    /// # Errors
    /// The module has no such proof, or a signal that is cut has no name in the Verilog.
    pub fn formal(
        &self,
        proof: &str,
        emitted: &dyn Fn(&str) -> String,
    ) -> Result<Formal, HdlError> {
        let error = |place, message| HdlError {
            module: self.name().to_string(),
            message,
            place,
        };
        let found = self.ir.proofs.iter().position(|data| data.name == proof);
        let index = found.ok_or_else(|| {
            let known: Vec<_> = (self.ir.proofs.iter())
                .map(|data| data.name.as_str())
                .collect();
            error(
                self.ir.place,
                format!(
                    "there is no proof {proof}; the proofs are {}",
                    known.join(", ")
                ),
            )
        })?;
        let data = &self.ir.proofs[index];
        let printed = verilog::with_proof(&self.ir, data);
        let mut cut = vec![];
        for id in &data.cut {
            cut.push(printed.names[*id].clone().ok_or_else(|| {
                error(
                    data.place,
                    format!("proof {proof}: a signal that is cut has no name"),
                )
            })?);
        }
        let mut texts = vec![renamed(&printed.text, &printed.modules, emitted)];
        let kept = |name: &str| {
            let mut kept = data.kept.iter().map(|index| &self.ir.instances[*index]);
            kept.any(|instance| instance.module.name() == name)
        };
        for child in &self.children {
            let below = match kept(child.name()) {
                true => Design::new(child.clone())?.modules().to_vec(),
                false => vec![],
            };
            let whole = below.iter().map(|module| module.verilog_with(emitted));
            let any = (below.is_empty()).then(|| child.of_any_value(emitted(child.name())));
            for text in whole.chain(any) {
                if !texts.contains(&text) {
                    texts.push(text);
                }
            }
        }
        Ok(Formal {
            text: texts.concat(),
            asserts: printed.asserts,
            cut,
        })
    }

    /// Returns the Verilog of the module with its properties, which a simulator checks if the macro
    /// `DYNRT_CHECKS` is defined. A violated property is reported and stops the simulation.
    /// Properties of arbitrary values ([`Proof::any_const`], [`Proof::any_seq`]) are left out. The
    /// function `emitted` maps the names of modules to those in the text.
    pub fn checked(&self, emitted: &dyn Fn(&str) -> String) -> String {
        let (text, modules) = verilog::with_checks(&self.ir, self.outline.as_ref());
        renamed(&text, &modules, emitted)
    }

    /// A module with the same ports whose outputs are arbitrary in each cycle.
    fn of_any_value(&self, name: String) -> String {
        let mut ports = vec![];
        let mut body = String::new();
        for port in self.ports() {
            let range = format!("[{}:0]", port.width - 1);
            let port_name = &port.name;
            if port.direction == Direction::Input {
                ports.push(format!("  input wire {range} {port_name}"));
            } else {
                ports.push(format!("  output wire {range} {port_name}"));
                body += &format!(
                    "  (* anyseq *) wire {range} any_{port_name};\n  assign {port_name} = any_{port_name};\n"
                );
            }
        }
        format!(
            "\nmodule {name} (\n{}\n);\n{body}endmodule\n",
            ports.join(",\n")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Style;
    use std::sync::Arc;

    fn same(name: &str) -> String {
        name.to_string()
    }

    /// A module for tests of properties: a delayed value, a stored word, a counter.
    fn child() -> Arc<Module> {
        let m = Builder::new("child", "counts.");
        let count = m.reg_reset("count", 3, 0);
        count.next_when(m.input("step", 1), count.q + m.lit(1u8, 3));
        m.output("last", count.q.all());
        m.finish().unwrap()
    }

    fn module(properties: bool) -> Result<Arc<Module>, HdlError> {
        let m = Builder::new("unit", "keeps a word, late.");
        let p = m.pipeline();
        let valid = p.valid_input("valid");
        let data = p.input("data", 8);
        let sum = (data + m.lit(3u8, 8)).named("sum");
        let (late_valid, late) = (valid.at(6), sum.at(6));
        let words = m.memory("words", 4, 8, Style::Distributed);
        let place = m.input("place", 2);
        words.write(late_valid.untimed(), place, late.untimed());
        let counter = m.instance("counter", &child(), &[("step", late_valid.untimed())]);
        m.output("word", words.read_now(place));
        m.output("last", counter.get("last"));
        m.output("late", late.untimed());
        if properties {
            let proof = m.proof("keeps", "what is written is kept");
            let at = proof.any_const("at", 2);
            let here = late_valid.untimed() & place.eq(at);
            let written = proof.reg_reset("written", 1, 0);
            let word = proof.reg("word", 8);
            written.next(written.q | here);
            word.next_when(here, late.untimed());
            proof.assume("the data is not 0", data.untimed().any());
            proof.assert("it is kept", written.q.implies(words.peek(at).eq(word.q)));
            let sums = m.concat(&sum.stages(1..=6));
            proof.assert(
                "the newest sum is more than 2",
                sums.high(8).gt(m.lit(2u8, 8)),
            );
            let tripled = sum.at(3).untimed().mul(m.lit(3u8, 2));
            proof.assert("a product has its width", tripled.le(m.lit(765u32, 10)));
            proof.assert(
                "the counter counts",
                counter.inside("count").any() | !written.q,
            );
            proof.cover("something is written", written.q);
            proof.cut(sum.untimed());
            proof.depth(2);
            let other = m.proof("counts", "the counter stays in it");
            other.keep(&counter);
            other.assert("it is no 9", counter.inside("count").lt(m.lit(7u8, 3)));
        }
        m.finish()
    }

    #[test]
    fn the_module_is_printed_as_without_properties() {
        let (with, without) = (module(true).unwrap(), module(false).unwrap());
        assert_eq!(with.verilog(), without.verilog());
        assert_eq!(with.ports(), without.ports());
        let formal = with.formal("keeps", &same).unwrap();
        let end = with.verilog().find("\nendmodule").unwrap();
        assert!(formal.text.starts_with(&with.verilog()[..end]));
        assert_eq!(without.checked(&same), without.verilog());
    }

    #[test]
    fn a_proof_s_text_has_its_properties_alone() {
        let module = module(true).unwrap();
        let formal = module.formal("keeps", &|name| format!("p_{name}")).unwrap();
        let text = &formal.text;
        assert_eq!(formal.cut, ["sum"]);
        assert_eq!(text.matches("assert (").count(), 4, "{text}");
        assert_eq!(text.matches("assume (").count(), 2, "{text}");
        assert_eq!(text.matches("cover (").count(), 1, "{text}");
        for (line, what) in formal.asserts.iter().zip(&module.proofs()[0].asserts) {
            let line = text.lines().nth(line - 1).unwrap();
            assert!(
                line.contains("assert (") && line.ends_with(what),
                "{line}: {what}"
            );
        }
        // Properties find registers of a delay line, stored words and counters at their places in the parts.
        for part in [
            "sum_delay[0]",
            "wire [7:0] sum_s3 = sum_delay[2];",
            "= sum_s3 * 2'd3;",
            "words[f_keeps_at]",
            "(* hierconn *) wire [2:0] \\counter.count ;",
            "(* anyconst *) wire [1:0] f_keeps_at;",
            "module p_unit (",
            "\n  p_child counter (",
            "module p_child (",
            "(* anyseq *) wire [0:0] any_last;",
        ] {
            assert!(text.contains(part), "no {part} in {text}");
        }
        let other = module.formal("counts", &same).unwrap().text;
        assert!(
            !other.contains("anyseq") && !other.contains("f_keeps_at"),
            "{other}"
        );
        let facts = &module.proofs()[0];
        assert_eq!(
            (facts.name.as_str(), facts.depth, facts.arrays),
            ("keeps", 2, false)
        );
    }

    #[test]
    fn a_simulator_checks_what_is_of_no_choice() {
        let text = module(true).unwrap().checked(&same);
        assert!(text.contains("`ifdef DYNRT_CHECKS\n"));
        assert!(text.contains("counter.count < 3'd7"), "{text}");
        assert!(
            !text.contains("f_keeps_at") && !text.contains("hierconn"),
            "{text}"
        );
        assert!(
            text.contains("not so: it is no 9")
                && text.contains("not so: assumed: the data is not 0"),
            "{text}"
        );
    }

    #[test]
    fn mistakes_have_their_place() {
        let error = |describe: &dyn Fn(&Builder)| {
            let m = Builder::new("unit", "is wrong.");
            let a = m.input("a", 4);
            m.output("y", a.any());
            describe(&m);
            let error = m.finish().unwrap_err();
            assert!(error.place.file().ends_with("proof.rs"));
            error.message
        };
        let wide = error(&|m| m.proof("p", "").assert("it is so", m.zero(4)));
        assert_eq!(wide, "it is so: the condition has 4 bits, must have 1");
        let late = error(&|m| {
            m.proof("p", "");
            m.input("b", 1);
        });
        assert_eq!(late, "port \"b\" is declared after the module's properties");
        let twice = error(&|m| {
            m.proof("p", "");
            m.proof("p", "");
        });
        assert_eq!(twice, "two proofs are called \"p\"");
        let unit = module(true).unwrap();
        let none = unit.formal("is", &same).unwrap_err().message;
        assert_eq!(none, "there is no proof is; the proofs are keeps, counts");
    }
}
