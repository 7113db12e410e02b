//! A text in which numbers depend on parameters.

use super::super::library::Parameter;
use super::expression::{bits, literal};
use super::range;
use std::fmt::Write as _;

/// Delimits a number of a text that may depend on parameters.
const NUMBER: char = '\u{3}';
/// Marks the start of a port's name; the names of a module's ports are aligned.
pub(super) const COLUMN: char = '\u{4}';
/// Marks the position at which parameters, and constants that depend on them, are declared.
pub(super) const PARAMETERS: char = '\u{5}';
pub(super) const CONSTANTS: char = '\u{6}';

/// Assumed length of a number in a text with parameters when lines are divided.
const NUMBER_LENGTH: usize = 8;

/// The notation of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// The range of a declaration, from a width; empty for one bit.
    Range,
    /// Width and value.
    Literal,
    /// The highest and the lowest bit, in brackets.
    Bits,
    Plain,
}

/// The treatment of numbers that may depend on parameters.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Numbers {
    /// Numbers are written out.
    Written,
    /// Numbers are marked.
    Marked,
}

fn marked(form: char, numbers: &[u128]) -> String {
    let numbers: Vec<String> = numbers.iter().map(u128::to_string).collect();
    format!("{NUMBER}{form}{}{NUMBER}", numbers.join(","))
}

impl Numbers {
    pub fn range(self, width: u32) -> String {
        match self {
            Numbers::Written => range(width),
            Numbers::Marked => marked('r', &[width.into()]),
        }
    }

    pub fn literal(self, value: u128, width: u32) -> String {
        match self {
            Numbers::Written => literal(value, width),
            Numbers::Marked => marked('l', &[width.into(), value]),
        }
    }

    pub fn bits(self, high: u32, low: u32) -> String {
        match self {
            Numbers::Written => bits(high, low),
            Numbers::Marked => marked('b', &[high.into(), low.into()]),
        }
    }

    pub fn plain(self, value: u32) -> String {
        match self {
            Numbers::Written => value.to_string(),
            Numbers::Marked => marked('n', &[value.into()]),
        }
    }
}

/// The length of a text in characters, with a fixed length for each marked number.
pub(super) fn length(text: &str) -> usize {
    let mut length = 0;
    for (at, part) in text.split(NUMBER).enumerate() {
        length += if at % 2 == 0 {
            part.len()
        } else {
            NUMBER_LENGTH
        };
    }
    length
}

/// A text with the names of its ports aligned.
pub(super) fn aligned(text: &str) -> String {
    let before = |line: &str| line.find(COLUMN);
    let column = text.lines().filter_map(before).max().unwrap_or(0);
    let mut aligned = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        match line.split_once(COLUMN) {
            Some((kind, name)) => {
                let _ = write!(aligned, "{kind:column$}{name}");
            }
            None => aligned.push_str(line),
        }
    }
    aligned
}

/// Numbers of a text with their notation.
#[derive(Debug, PartialEq)]
struct Mark<N> {
    form: Form,
    numbers: Vec<N>,
}

/// Divides a text at its marked numbers.
fn divided(text: &str) -> (Vec<String>, Vec<Mark<u128>>) {
    let (mut pieces, mut marks) = (vec![], vec![]);
    for (at, part) in text.split(NUMBER).enumerate() {
        if at % 2 == 0 {
            pieces.push(part.to_string());
            continue;
        }
        let (form, numbers) = part.split_at(1);
        marks.push(Mark {
            form: match form {
                "r" => Form::Range,
                "l" => Form::Literal,
                "b" => Form::Bits,
                _ => Form::Plain,
            },
            numbers: (numbers.split(','))
                .map(|number| number.parse().expect("a number that was marked"))
                .collect(),
        });
    }
    (pieces, marks)
}

/// The dependence of a number on the parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Term {
    Constant(u128),
    /// A parameter, by its index, plus a constant.
    Parameter(usize, i64),
}

impl Term {
    /// The term that gives these numbers for these values of the parameters.
    fn new(samples: &[(Vec<u32>, u128)]) -> Option<Term> {
        let parameters = 0..samples[0].0.len();
        let further = parameters.flat_map(|at| [0, -1, 1].map(|more| Term::Parameter(at, more)));
        let mut terms = std::iter::once(Term::Constant(samples[0].1)).chain(further);
        terms.find(|term| {
            (samples.iter()).all(|(values, number)| term.value(values) == Some(*number))
        })
    }

    fn value(self, values: &[u32]) -> Option<u128> {
        match self {
            Term::Constant(value) => Some(value),
            Term::Parameter(at, more) => u128::try_from(i64::from(values[at]) + more).ok(),
        }
    }

    fn plus(self, more: i64) -> Term {
        match self {
            Term::Constant(value) => Term::Constant(value.wrapping_add_signed(more.into())),
            Term::Parameter(at, already) => Term::Parameter(at, already + more),
        }
    }
}

/// A text with parameters.
#[derive(Debug, PartialEq)]
pub(in super::super) struct Template {
    parameters: Vec<Parameter>,
    defaults: Vec<u32>,
    pieces: Vec<String>,
    marks: Vec<Mark<Term>>,
}

/// The names and declarations of the constants in a text with parameters.
type Constants = Vec<(String, String)>;

impl Template {
    /// Derives the text from samples for several values of the parameters.
    pub fn new(
        parameters: &[Parameter],
        samples: &[(Vec<u32>, String)],
    ) -> Result<Template, String> {
        let divided: Vec<_> = samples.iter().map(|(_, text)| divided(text)).collect();
        let Some((pieces, first)) = divided.first() else {
            return Err("the library has no samples".into());
        };
        for (others, marks) in &divided[1..] {
            same(pieces, first, others, marks)?;
        }
        let mut marks = vec![];
        for (at, mark) in first.iter().enumerate() {
            let mut numbers = vec![];
            for place in 0..mark.numbers.len() {
                let values = samples.iter().zip(&divided);
                let number = values
                    .map(|((values, _), (_, marks))| (values.clone(), marks[at].numbers[place]));
                let number: Vec<_> = number.collect();
                numbers.push(Term::new(&number).ok_or_else(|| {
                    let numbers: Vec<_> = number.iter().map(|(_, number)| number).collect();
                    format!(
                        "{numbers:?} does not follow from a parameter, after {}",
                        tail(&pieces[at])
                    )
                })?);
            }
            let form = mark.form;
            marks.push(Mark { form, numbers });
        }
        let template = Template {
            parameters: parameters.to_vec(),
            defaults: samples[0].0.clone(),
            pieces: pieces.clone(),
            marks,
        };
        let (_, mut constants) = template.body();
        constants.sort();
        match constants.windows(2).find(|two| two[0].0 == two[1].0) {
            Some(two) => Err(format!(
                "{} and {} are both called {}",
                two[0].1, two[1].1, two[0].0
            )),
            None => Ok(template),
        }
    }

    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// Checks that a text equals this one for the given values of the parameters.
    pub fn check(&self, values: &[u32], text: &str) -> Result<(), String> {
        let (pieces, marks) = divided(text);
        same(&self.pieces, &self.marks, &pieces, &marks)?;
        for (at, (mark, found)) in self.marks.iter().zip(&marks).enumerate() {
            for (term, number) in mark.numbers.iter().zip(&found.numbers) {
                if term.value(values) != Some(*number) {
                    return Err(format!(
                        "{number} is not {}, after {}",
                        self.term(*term),
                        tail(&self.pieces[at])
                    ));
                }
            }
        }
        Ok(())
    }

    /// The text after the module's name in an instance.
    pub(super) fn connected(&self, values: &[u32], numbers: Numbers) -> String {
        let parameters = self.parameters.iter().zip(values);
        let connected = parameters.map(|(parameter, value)| {
            let value = match parameter.flag {
                true => numbers.literal((*value).into(), 1),
                false => numbers.plain(*value),
            };
            format!(".{}({value})", parameter.name)
        });
        let connected: Vec<String> = connected.collect();
        connected.join(", ")
    }

    /// The text, with marks of other kinds.
    pub fn text(&self) -> String {
        let (text, constants) = self.body();
        let constants = constants.iter();
        let constants = constants.map(|(_, declared)| format!("  localparam {declared};\n"));
        let constants: String = constants.collect();
        let blank = if constants.is_empty() { "" } else { "\n" };
        text.replace(PARAMETERS, &self.declared())
            .replace(CONSTANTS, &format!("{blank}{constants}"))
    }

    /// The text without declarations of parameters and constants, and the constants that it uses.
    fn body(&self) -> (String, Constants) {
        let mut constants = vec![];
        let mut text = String::new();
        for (at, piece) in self.pieces.iter().enumerate() {
            text.push_str(piece);
            if let Some(mark) = self.marks.get(at) {
                text += &self.written(mark, &mut constants);
            }
        }
        (text, constants)
    }

    /// The declarations of the parameters.
    fn declared(&self) -> String {
        let lines = self.parameters.iter().zip(&self.defaults).enumerate();
        let lines = lines.map(|(at, (parameter, default))| {
            let comma = if at + 1 < self.parameters.len() {
                ","
            } else {
                ""
            };
            match parameter.flag {
                true => format!("parameter [0:0] {} = 1'b{default}{comma}", parameter.name),
                false => format!("parameter {} = {default}{comma}", parameter.name),
            }
        });
        let lines: Vec<String> = lines.collect();
        let column = lines.iter().map(String::len).max().unwrap_or(0);
        let docs = self.parameters.iter().map(|parameter| parameter.doc);
        let lines = lines.iter().zip(docs);
        let lines = lines.map(|(line, doc)| format!("  {line:column$} // {doc}\n"));
        format!("#(\n{}) ", lines.collect::<String>())
    }

    fn term(&self, term: Term) -> String {
        match term {
            Term::Constant(value) => value.to_string(),
            Term::Parameter(at, 0) => self.parameters[at].name.to_string(),
            Term::Parameter(at, more) => format!("{}{more:+}", self.parameters[at].name),
        }
    }

    fn written(&self, mark: &Mark<Term>, constants: &mut Constants) -> String {
        let small = |value: u128| u32::try_from(value).expect("a width or a bit");
        match (mark.form, mark.numbers.as_slice()) {
            (Form::Range, [Term::Constant(width)]) => range(small(*width)),
            (Form::Range, [width]) => format!("[{}:0] ", self.term(width.plus(-1))),
            (Form::Bits, [Term::Constant(high), Term::Constant(low)]) => {
                bits(small(*high), small(*low))
            }
            (Form::Bits, [high, low]) if high == low => format!("[{}]", self.term(*low)),
            (Form::Bits, [high, low]) => format!("[{}:{}]", self.term(*high), self.term(*low)),
            (Form::Literal, [width, value]) => self.literal(*width, *value, constants),
            (_, numbers) => {
                let numbers: Vec<String> = numbers.iter().map(|term| self.term(*term)).collect();
                numbers.concat()
            }
        }
    }

    /// A literal: as a number, as a flag, or by the name of a constant.
    fn literal(&self, width: Term, value: Term, constants: &mut Constants) -> String {
        match (width, value) {
            (Term::Constant(width), Term::Constant(value)) => {
                literal(value, u32::try_from(width).expect("a width"))
            }
            (Term::Constant(1), Term::Parameter(at, 0)) if self.parameters[at].flag => {
                self.parameters[at].name.to_string()
            }
            (width, Term::Constant(0)) => format!("{{{}{{1'b0}}}}", self.term(width)),
            (width, value) => {
                let called = match width {
                    Term::Parameter(at, _) => self.parameters[at].name,
                    Term::Constant(_) => "VALUE",
                };
                let called = called.trim_end_matches("_BITS").trim_end_matches("_WIDTH");
                let what = match value {
                    Term::Constant(1) => "ONE".to_string(),
                    Term::Constant(2) => "TWO".to_string(),
                    Term::Constant(3) => "THREE".to_string(),
                    Term::Constant(value) => value.to_string(),
                    Term::Parameter(_, -1) => "LAST".to_string(),
                    Term::Parameter(at, _) => self.parameters[at].name.to_string(),
                };
                let name = format!("{called}_{what}");
                let range = format!("[{}:0]", self.term(width.plus(-1)));
                let value = match value {
                    // With as many bits as it needs, for lint.
                    Term::Parameter(at, more) if more != 0 => {
                        let sign = if more < 0 { '-' } else { '+' };
                        let more = more.unsigned_abs();
                        format!("{}{range} {sign} {more}", self.parameters[at].name)
                    }
                    value => self.term(value),
                };
                let declared = format!("{range} {name} = {value}");
                let constant = (name.clone(), declared);
                if !constants.contains(&constant) {
                    constants.push(constant);
                }
                name
            }
        }
    }
}

/// Whether two texts differ only in numbers.
fn same<A, B>(
    pieces: &[String],
    marks: &[Mark<A>],
    others: &[String],
    of_others: &[Mark<B>],
) -> Result<(), String> {
    let differs = pieces
        .iter()
        .zip(others)
        .position(|(one, other)| one != other);
    if let Some(at) = differs {
        return Err(format!(
            "texts differ in more than numbers: {} and {}",
            tail(&pieces[at]),
            tail(&others[at])
        ));
    }
    let forms = marks.iter().zip(of_others);
    let same = forms
        .clone()
        .all(|(one, other)| one.form == other.form && one.numbers.len() == other.numbers.len());
    if pieces.len() != others.len() || marks.len() != of_others.len() || !same {
        return Err("texts differ in more than numbers".into());
    }
    Ok(())
}

/// The last line of a text, for a message.
fn tail(text: &str) -> String {
    format!("{:?}", text.lines().last().unwrap_or_default())
}
