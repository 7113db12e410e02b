//! Compares the arithmetic units with exact arithmetic and one rounding, for all operands.
//!
//! Yosys converts a unit and its reference to gates. The unit's registers are replaced by wires after a check, gate by
//! gate, that every path from an operand to the result has as many registers as the unit's latency ([`Circuit::transparent`]).
//! Therefore a proof about the gates holds for the pipeline, whatever operands precede and follow. ABC then proves that the
//! results are equal for all operands. If there are few operands, all of them are tried on the gates instead.

use super::aig::{Circuit, Fixed, Graph};
use super::reference::{self, Relation};
use super::tools;
use super::{Outcome, Seeded};
use crate::float::Format;
use crate::hdl::{Builder, HdlError, Module, Mutation, Signal};
use crate::hw::fp::{self, Knowing, Known, Operand, Units};
use crate::tools::Ended;
use anyhow::{Context, Result, ensure};
use std::cell::OnceCell;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The slack of the machine's plane distances, in ulps.
const ULPS: i32 = 3;

/// Time limit of ABC for one case. The slowest case of the reference format takes about 1 % of it.
const CASE_LIMIT: Duration = Duration::from_secs(120);

/// Up to this number of free input bits, all operands are tried.
const EXHAUSTIBLE: u32 = 24;

/// A unit, its reference, and the cases into which the operands are divided.
pub struct Equivalence {
    pub module: Arc<Module>,
    pub what: String,
    reference: String,
    pub cases: Vec<Case>,
    method: Method,
    pub faults: Vec<Seeded<Change>>,
}

/// The place of a seeded fault.
pub enum Change {
    Unit(Mutation),
    /// The reference has the fault, because the property is one of the reference alone.
    Reference(String),
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Method {
    /// By ABC's `iprove`.
    Reasoned,
    /// By trying all operands.
    Exhausted,
}

/// Operands with some bits fixed.
pub struct Case {
    name: String,
    fixed: Vec<Fixed>,
    /// Whether it is also proved with `--quick`.
    pub quick: bool,
}

impl Case {
    fn all() -> Case {
        Case {
            name: "all operands".into(),
            fixed: vec![],
            quick: true,
        }
    }
}

fn fixed(input: &str, lsb: u32, width: u32, value: u64) -> Fixed {
    Fixed {
        input: input.into(),
        bits: lsb..lsb + width,
        value,
    }
}

fn seeded(what: &str, mutation: Mutation) -> Seeded<Change> {
    Seeded {
        what: what.into(),
        change: Change::Unit(mutation),
    }
}

/// A tie is rounded up independent of the last bit: `half & (more | last)` becomes `half`.
fn odd(unit: &Module) -> Result<Seeded<Change>, HdlError> {
    let round_up = unit.signal("round_up")?;
    Ok(seeded(
        "a tie is rounded away from zero",
        round_up.operand(&[1]).as_value(1),
    ))
}

/// All equivalences of the unit with this name; empty if it is not an arithmetic unit.
///
/// # Errors
/// A mistake in the description of a unit.
pub fn proofs(unit: &str, format: Format, clock_mhz: u32) -> Result<Vec<Equivalence>> {
    let units = Units::new(format, clock_mhz)?;
    Ok(match unit {
        "add" => sums(&units.add, format, false)?,
        "sub" => sums(&units.sub, format, true)?,
        "mul" => vec![Equivalence {
            module: units.mul.clone(),
            what: "a * b, exact then rounded once".into(),
            reference: reference::product(format),
            cases: vec![Case::all()],
            method: Method::Reasoned,
            faults: vec![
                odd(&units.mul)?,
                seeded(
                    "an infinity is a number unless both are",
                    units.mul.signal("special")?.operand(&[]).other_operator(),
                ),
            ],
        }],
        "reciprocal" => vec![Equivalence {
            module: units.reciprocal.clone(),
            what: "1 / a, exact then rounded once".into(),
            reference: reference::reciprocal(format),
            cases: vec![Case::all()],
            method: if format.width() <= EXHAUSTIBLE {
                Method::Exhausted
            } else {
                Method::Reasoned
            },
            faults: {
                let signal = |name| units.reciprocal.signal(name);
                let (rounded, exponent) = (signal("rounded")?, signal("y_exponent")?);
                let without_carry = exponent.reads(rounded).as_signal(signal("unrounded")?);
                vec![
                    seeded("nothing is rounded up", rounded.operand(&[1]).as_value(0)),
                    seeded("rounding does not carry into the exponent", without_carry),
                ]
            },
        }],
        "compare" => [
            ("less", "a < b", Relation::Less),
            ("less_equal", "a <= b", Relation::LessEqual),
            ("equal", "a = b", Relation::Equal),
            ("min", "b where b < a, else a", Relation::Min),
            ("max", "b where b > a, else a", Relation::Max),
        ]
        .into_iter()
        .flat_map(|(name, what, relation)| {
            let knowing = match relation {
                Relation::Less | Relation::LessEqual | Relation::Equal => &KNOWING[..],
                Relation::Min | Relation::Max => &KNOWING[..1],
            };
            (knowing.iter()).map(move |known| related(name, what, relation, *known, format))
        })
        .collect::<Result<_>>()?,
        "step" => [("down", -ULPS), ("up", ULPS)]
            .into_iter()
            .map(|(name, ulps)| stepped(name, ulps, format))
            .collect::<Result<_>>()?,
        _ => vec![],
    })
}

/// The proofs of a sum: numbers by the distance of their exponents, all other operands, and the completeness of these cases.
fn sums(
    module: &Arc<Module>,
    format: Format,
    subtract: bool,
) -> Result<Vec<Equivalence>, HdlError> {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let operator = if subtract { '-' } else { '+' };
    // Mistakes are likely where the smaller operand reaches the rounding bits, and where it leaves them.
    let edge = |distance: u32| distance < 3 || (f - 1..f + 4).contains(&distance);
    let distances = (0..(1u32 << e) - 2).map(|distance| Case {
        name: format!("exponents {distance} apart"),
        fixed: vec![fixed("distance", 0, e, distance.into())],
        quick: edge(distance),
    });
    let special = |operand: &str, name: &str, exponent: u64| Case {
        name: format!("{operand} is {name}"),
        fixed: vec![fixed(&format!("operand_{operand}"), f, e, exponent)],
        quick: true,
    };
    let ones = format.exponent_mask();
    Ok(vec![
        Equivalence {
            module: module.clone(),
            what: format!("a {operator} b of numbers, exact then rounded once"),
            reference: reference::sum_of_numbers(format, subtract),
            cases: distances.collect(),
            method: Method::Reasoned,
            faults: vec![odd(module)?],
        },
        Equivalence {
            module: module.clone(),
            what: format!("a {operator} b with a zero, an infinity or a NaN"),
            reference: reference::sum_of_specials(format, subtract),
            cases: vec![
                special("a", "a zero", 0),
                special("b", "a zero", 0),
                special("a", "an infinity or a NaN", ones),
                special("b", "an infinity or a NaN", ones),
            ],
            method: Method::Reasoned,
            faults: vec![seeded(
                "nothing ever gives a NaN",
                module.signal("nan")?.fault().as_value(0),
            )],
        },
        Equivalence {
            module: module.clone(),
            what: "every pair of numbers is one of the cases".into(),
            reference: reference::sum_coverage(format, "LAST"),
            cases: vec![Case::all()],
            method: Method::Reasoned,
            faults: vec![Seeded {
                what: "the greatest distance is no case".into(),
                change: Change::Reference(reference::sum_coverage(format, "LAST - 1")),
            }],
        },
    ])
}

/// Facts about both operands: first none, then every pair that occurs in the machine's comparisons.
const KNOWING: [[Known; 2]; 12] = {
    use Known::{NoNan, Nothing, Number, Positive, Result};
    [
        [Nothing, Nothing],
        [NoNan, NoNan],
        [NoNan, Nothing],
        [Nothing, NoNan],
        [Result, Result],
        [Result, Number],
        [Number, Result],
        [Result, Positive],
        [Positive, Result],
        [Number, Positive],
        [Positive, Number],
        [Positive, Positive],
    ]
};

/// The operand if the fact `known` holds for it, otherwise +0, for which it holds.
fn made_known<'b>(format: Format, operand: Signal<'b>, known: Known) -> Signal<'b> {
    let m = operand.module();
    let zero = m.zero(format.width());
    let nan = fp::is_nan(format, operand);
    let operators_nan = operand.equals(u128::from(format.nan()));
    let result = (!fp::is_zero(format, operand) | operand.is_zero()) & (!nan | operators_nan);
    let number = result & !nan;
    let holds = match known {
        Known::Nothing => return operand,
        Known::NoNan => !nan,
        Known::Result => result,
        Known::Number => number,
        Known::Positive => number & !operand.msb(),
    };
    holds.mux(operand, zero)
}

fn relation_of<'b>(
    format: Format,
    relation: Relation,
    a: Operand<'b>,
    b: Operand<'b>,
) -> Signal<'b> {
    match relation {
        Relation::Less => fp::less(format, "less", a, b),
        Relation::LessEqual => fp::less_equal(format, "less_equal", a, b),
        Relation::Equal => fp::equal(format, "equal", a, b),
        Relation::Min => fp::goes_before(format, "lesser", b, a).mux(b.signal(), a.signal()),
        Relation::Max => fp::goes_before(format, "greater", a, b).mux(b.signal(), a.signal()),
    }
}

/// A relation of any two operands. A relation that uses known facts must give the same result as one that does not.
fn related(
    name: &str,
    what: &str,
    relation: Relation,
    known: [Known; 2],
    format: Format,
) -> Result<Equivalence> {
    let m = Builder::new(
        format!("fp_{name}"),
        format!("{name} of a and b in {format}."),
    );
    let (a, b) = (m.input("a", format.width()), m.input("b", format.width()));
    let of = |a, b| relation_of(format, relation, a, b);
    let any = of(a.into(), b.into());
    let blind = known == KNOWING[0];
    let mut turned = None;
    let (y, fault) = match blind {
        true if relation == Relation::Equal => {
            let fault = any.reads(a.eq(b)).inverted();
            (any, seeded("unlike patterns are equal", fault))
        }
        true => {
            if matches!(relation, Relation::Less | Relation::LessEqual) {
                let fault = any.fault().as_signal(of(b.into(), a.into()));
                turned = Some(seeded("the order is turned round", fault));
            }
            let fault = any.reads(a.msb()).as_signal(b.msb());
            (any, seeded("the sign of b is taken for that of a", fault))
        }
        false => {
            let [a, b] = [(a, known[0]), (b, known[1])]
                .map(|(operand, known)| (made_known(format, operand, known), known));
            let knows = of(a.0.known(a.1), b.0.known(b.1));
            // The two may share logic, so the fault is placed after it.
            let differs = (knows ^ of(a.0.into(), b.0.into())).named("differs");
            let fault = differs.fault().inverted();
            (
                any ^ differs,
                seeded("what knows more says the opposite", fault),
            )
        }
    };
    m.output("y", y.extend(format.width()));
    Ok(Equivalence {
        module: m.finish()?,
        what: match blind {
            true => what.into(),
            false => format!("{what}, a: {:?}, b: {:?}", known[0], known[1]).to_lowercase(),
        },
        reference: reference::relation(format, relation),
        cases: vec![Case::all()],
        method: Method::Reasoned,
        faults: turned.into_iter().chain([fault]).collect(),
    })
}

fn stepped(name: &str, ulps: i32, format: Format) -> Result<Equivalence> {
    let what = format!("the number {ulps:+} ulps from a");
    let m = Builder::new(format!("fp_{name}"), format!("y = {what} in {format}."));
    let a = m.input("a", format.width());
    let too_far = OnceCell::new();
    let y = fp::step(format, a, ulps, |sum| {
        let count = u128::from(ulps.unsigned_abs());
        let _ = too_far.set(sum.literal_of(count).as_value(count + 1));
        sum
    });
    m.output("y", y);
    let too_far = too_far.into_inner().context("a step is a sum")?;
    Ok(Equivalence {
        module: m.finish()?,
        what,
        reference: reference::step(format, ulps),
        cases: vec![Case::all()],
        method: Method::Reasoned,
        faults: vec![seeded("it steps one ulp too far away from zero", too_far)],
    })
}

impl Equivalence {
    /// The method of the proof, for reports.
    pub fn how(&self) -> String {
        let registers = self.module.latency().unwrap_or(0);
        let how = match self.method {
            Method::Reasoned => "abc iprove",
            Method::Exhausted => "all operands on the gates",
        };
        match registers {
            0 => how.into(),
            _ => format!("{how}, {registers} registers on all paths"),
        }
    }

    /// Proves the requested cases, or finds operands with different results. `done` is called after each case.
    ///
    /// # Errors
    /// If a tool fails, or if a fault cannot be made.
    pub fn prove(
        &self,
        folder: &Path,
        quick: bool,
        fault: Option<usize>,
        done: &dyn Fn(),
    ) -> Result<(usize, Outcome)> {
        let graph = match self.gates(folder, fault)? {
            Ok(graph) => graph,
            Err(imbalance) => return Ok((0, Outcome::Refuted(imbalance))),
        };
        let mut proved = 0;
        for case in self.cases.iter().filter(|case| case.quick || !quick) {
            let mut graph = graph.fixed(&case.fixed)?;
            let outcome = match self.method {
                Method::Reasoned => reason(&mut graph, folder)?,
                Method::Exhausted => exhaust(&mut graph)?,
            };
            match outcome {
                Outcome::Proved => proved += 1,
                Outcome::Refuted(text) => {
                    return Ok((proved, Outcome::Refuted(format!("{}: {text}", case.name))));
                }
                Outcome::Undecided(text) => {
                    return Ok((proved, Outcome::Undecided(format!("{}: {text}", case.name))));
                }
            }
            done();
        }
        ensure!(proved > 0, "{}: no case to prove", self.what);
        Ok((proved, Outcome::Proved))
    }

    /// Unit and reference as one combinational circuit, or the reason why the unit is not a pipeline of its latency.
    fn gates(&self, folder: &Path, fault: Option<usize>) -> Result<Result<Graph, String>> {
        let name = self.module.name();
        ensure!(
            self.module.children().is_empty(),
            "{name} has children, which no reference stands in for"
        );
        let (mut module, mut reference) = (self.module.clone(), &self.reference);
        match fault.map(|fault| &self.faults[fault].change) {
            Some(Change::Unit(mutation)) => module = module.with(mutation)?,
            Some(Change::Reference(changed)) => reference = changed,
            None => {}
        }
        let has_unit = reference.contains("dut dut");
        let text = module.verilog_with(&|_| "dut".to_string());
        for (file, text) in [("dut.v", &text), ("case.v", reference)] {
            std::fs::write(folder.join(file), text).with_context(|| file.to_string())?;
        }
        tools::yosys(
            folder,
            "read_verilog dut.v case.v; hierarchy -check -top prove_case; proc; flatten; \
             opt -nodffe -nosdff; techmap; opt -nodffe -nosdff; aigmap; opt_clean; \
             write_aiger -ascii -symbols case.aag",
        )?;
        let aiger = std::fs::read_to_string(folder.join("case.aag")).context("case.aag")?;
        let latency = self.module.latency().unwrap_or(0);
        let of_unit = |word: &str| if word == "y" && has_unit { latency } else { 0 };
        let circuit = Circuit::parse(&aiger)?;
        Ok(circuit
            .transparent(of_unit)
            .map_err(|error| format!("{error:#}")))
    }
}

/// Asks ABC whether the results differ for any operands.
fn reason(graph: &mut Graph, folder: &Path) -> Result<Outcome> {
    let differs = graph.differs("legal", "y", "expected")?;
    ensure!(
        meaningful(graph)?,
        "no operands of the case satisfy its assumptions: the proof is vacuous"
    );
    std::fs::write(folder.join("case.aig"), graph.to_aiger(differs)).context("case.aig")?;
    let found = folder.join("counterexample");
    let _ = std::fs::remove_file(&found);
    let script =
        "read_aiger case.aig; strash; ifraig; dch; drwsat; iprove; write_cex -n counterexample";
    let text = match tools::tools()?
        .abc
        .run_for(folder, CASE_LIMIT, &["-c", script])?
    {
        Ended::With { text, .. } => text,
        Ended::OutOfTime => {
            let limit = CASE_LIMIT.as_secs();
            return Ok(Outcome::Undecided(format!("ABC takes more than {limit} s")));
        }
    };
    let says = |word: &str| text.lines().any(|line| line.starts_with(word));
    if says("UNSATISFIABLE") {
        return Ok(Outcome::Proved);
    }
    if !says("SATISFIABLE") {
        return Ok(Outcome::Undecided("ABC returns no decision".into()));
    }
    let text = std::fs::read_to_string(&found).context("ABC's counterexample")?;
    let mut inputs = vec![0; graph.inputs.len()];
    for line in text.lines() {
        let Some((place, value)) = line.strip_prefix("pi").and_then(|l| l.split_once("@0=")) else {
            continue;
        };
        let place: usize = place.parse().context("ABC's counterexample")?;
        *inputs
            .get_mut(place)
            .context("ABC's counterexample has more inputs")? = value.parse()?;
    }
    let values = graph.simulate(&inputs);
    ensure!(
        values.literal(differs) & 1 == 1,
        "the counterexample of ABC shows no difference on the gates"
    );
    Ok(Outcome::Refuted(shown(graph, &inputs, 0)?))
}

/// Tries all assignments of the inputs of operand `a`.
fn exhaust(graph: &mut Graph) -> Result<Outcome> {
    let differs = graph.differs("legal", "y", "expected")?;
    let places: Vec<usize> = (graph.inputs.iter().enumerate())
        .filter(|(_, name)| name.starts_with("operand_a"))
        .map(|(place, _)| place)
        .collect();
    ensure!(
        places.len() as u32 <= EXHAUSTIBLE,
        "2^{} operands are too many for an exhaustive simulation",
        places.len()
    );
    /// The lowest six inputs count through the 64 bits of a word.
    const LOWEST: [u64; 6] = [
        0xaaaa_aaaa_aaaa_aaaa,
        0xcccc_cccc_cccc_cccc,
        0xf0f0_f0f0_f0f0_f0f0,
        0xff00_ff00_ff00_ff00,
        0xffff_0000_ffff_0000,
        0xffff_ffff_0000_0000,
    ];
    // Four words at once: 256 operands. In each word, the first two higher bits are the word's number.
    const WORDS: usize = 4;
    let rest = places.len().saturating_sub(LOWEST.len());
    let mut inputs = vec![[0; WORDS]; graph.inputs.len()];
    let mut nodes = vec![];
    for high in (0..1u64 << rest).step_by(WORDS) {
        for (i, place) in places.iter().enumerate() {
            inputs[*place] = std::array::from_fn(|word| match LOWEST.get(i) {
                Some(pattern) => *pattern,
                None => 0u64.wrapping_sub((high + word as u64) >> (i - LOWEST.len()) & 1),
            });
        }
        graph.evaluate(&inputs, &mut nodes);
        let wrong = Graph::literal(&nodes, differs);
        if let Some(word) = wrong.iter().position(|word| *word != 0) {
            let inputs: Vec<u64> = inputs.iter().map(|words| words[word]).collect();
            return Ok(Outcome::Refuted(shown(
                graph,
                &inputs,
                wrong[word].trailing_zeros(),
            )?));
        }
    }
    Ok(Outcome::Proved)
}

/// Whether a case has legal operands. Most operands are legal, so a few random tries find one.
fn meaningful(graph: &Graph) -> Result<bool> {
    let mut random = fastrand::Rng::with_seed(1);
    for _ in 0..1000 {
        let inputs: Vec<u64> = graph.inputs.iter().map(|_| random.u64(..)).collect();
        let values = graph.simulate(&inputs);
        for assignment in 0..64 {
            if values.word("legal", assignment)? == 1 {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// Operands and results of one of 64 assignments, as text.
fn shown(graph: &Graph, inputs: &[u64], assignment: u32) -> Result<String> {
    let values = graph.simulate(inputs);
    let mut text = String::new();
    for (i, name) in ["a", "b", "y", "expected"].into_iter().enumerate() {
        let comma = if i > 0 { ", " } else { "" };
        let _ = write!(
            text,
            "{comma}{name} = {:#x}",
            values.word(name, assignment)?
        );
    }
    Ok(text)
}
