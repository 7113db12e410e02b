//! The emitted Verilog as text: words, expressions, and what single change each of them admits.
//!
//! Only what the printer of [`crate::hdl`] writes need be read: declarations with an expression, assignments, clocked blocks of `if`,
//! `else` and `<=`, and instances. Everything else is left alone.

use std::ops::Range;

/// What a change changes.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// One operator in place of another, or none.
    Operator,
    /// The lowest bit of a literal.
    Constant,
    /// A condition negated, or held.
    Condition,
    /// A slice that loses its top bit, or lies a bit lower.
    Width,
    /// A register's value in reset, or no reset at all.
    Reset,
    /// A pipeline's register left out: a value from the stage before.
    Register,
}

impl Kind {
    pub const ALL: [Kind; 6] = [
        Kind::Operator,
        Kind::Constant,
        Kind::Condition,
        Kind::Width,
        Kind::Reset,
        Kind::Register,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Operator => "operator",
            Kind::Constant => "constant",
            Kind::Condition => "condition",
            Kind::Width => "width",
            Kind::Reset => "reset",
            Kind::Register => "register",
        }
    }
}

/// A single change of a module's text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Site {
    pub kind: Kind,
    /// The expression in which it lies, in bytes.
    pub expression: Range<usize>,
    /// What is replaced, in bytes.
    pub place: Range<usize>,
    /// What stands there instead.
    pub instead: String,
}

impl Site {
    /// The expression as it becomes.
    pub fn changed(&self, text: &str) -> String {
        format!(
            "{}{}{}",
            &text[self.expression.start..self.place.start],
            self.instead,
            &text[self.place.end..self.expression.end]
        )
    }

    /// The text of the module with this change alone.
    pub fn apply(&self, text: &str) -> String {
        let mut changed = text.to_string();
        changed.replace_range(self.place.clone(), &self.instead);
        changed
    }

    /// The line of the change, from 1 on.
    pub fn line(&self, text: &str) -> usize {
        text[..self.place.start].matches('\n').count() + 1
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Name,
    /// With width and base.
    Literal,
    /// Plain digits.
    Digits,
    Symbol,
}

#[derive(Clone, Copy, Debug)]
struct Token {
    word: Word,
    start: usize,
    end: usize,
}

/// Symbols of more than one character, the longest first.
const LONG: [&str; 10] = ["<=", ">=", "==", "!=", "&&", "||", "<<", ">>", "~^", "**"];

fn tokens(text: &str) -> Vec<Token> {
    let bytes = text.as_bytes();
    let mut found = vec![];
    let mut at = 0;
    let while_true = |mut at: usize, holds: &dyn Fn(u8) -> bool| {
        while at < bytes.len() && holds(bytes[at]) {
            at += 1;
        }
        at
    };
    while at < bytes.len() {
        let rest = &text[at..];
        let byte = bytes[at];
        if byte.is_ascii_whitespace() {
            at += 1;
            continue;
        }
        let skipped = [("//", "\n"), ("(*", "*)"), ("`", "\n")];
        if let Some((open, close)) = skipped.into_iter().find(|(open, _)| rest.starts_with(open)) {
            let end = rest[open.len()..].find(close);
            at = end.map_or(text.len(), |end| at + open.len() + end + close.len());
            continue;
        }
        let (word, end) = if byte.is_ascii_alphabetic() || byte == b'_' || byte == b'$' {
            let end = while_true(at, &|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'$');
            (Word::Name, end)
        } else if byte.is_ascii_digit() {
            let digits = while_true(at, &|b| b.is_ascii_digit());
            match bytes.get(digits) {
                Some(b'\'') => {
                    let end = while_true(digits + 1, &|b| b.is_ascii_alphanumeric() || b == b'_');
                    (Word::Literal, end)
                }
                _ => (Word::Digits, digits),
            }
        } else {
            let long = LONG.iter().find(|symbol| rest.starts_with(**symbol));
            (Word::Symbol, at + long.map_or(1, |symbol| symbol.len()))
        };
        found.push(Token {
            word,
            start: at,
            end,
        });
        at = end;
    }
    found
}

/// Every single change that a module's text admits, in the order of the text.
pub fn sites(text: &str) -> Vec<Site> {
    let tokens = tokens(text);
    let mut reader = Reader {
        text,
        tokens: &tokens,
        at: 0,
        sites: vec![],
    };
    reader.module();
    reader.sites
}

struct Reader<'a> {
    text: &'a str,
    tokens: &'a [Token],
    at: usize,
    sites: Vec<Site>,
}

impl Reader<'_> {
    fn word(&self, at: usize) -> &str {
        self.tokens
            .get(at)
            .map_or("", |token| &self.text[token.start..token.end])
    }

    fn is(&self, word: &str) -> bool {
        self.word(self.at) == word
    }

    /// Goes behind the next `word` outside of brackets.
    fn skip_past(&mut self, word: &str) -> usize {
        let mut depth = 0usize;
        while self.at < self.tokens.len() {
            let here = self.at;
            self.at += 1;
            match self.word(here) {
                found if depth == 0 && found == word => return here,
                "(" | "[" | "{" => depth += 1,
                ")" | "]" | "}" => depth = depth.saturating_sub(1),
                _ => {}
            }
        }
        self.tokens.len()
    }

    fn module(&mut self) {
        // Behind the ports.
        self.skip_past(";");
        while self.at < self.tokens.len() && !self.is("endmodule") {
            match self.word(self.at) {
                "always" => {
                    self.skip_past("begin");
                    while self.at < self.tokens.len() && !self.is("end") {
                        self.statement(false);
                    }
                    self.at += 1;
                }
                "wire" | "assign" => self.declaration(),
                _ => {
                    self.skip_past(";");
                }
            }
        }
    }

    /// `wire … name;`, `wire … name = expression;` or `assign name = expression;`
    fn declaration(&mut self) {
        let first = self.at;
        let end = self.skip_past(";");
        let equals = (first..end).find(|&at| self.word(at) == "=");
        if let Some(equals) = equals
            // What gathers the bits that nothing reads has no function.
            && self.word(equals - 1) != "unused"
        {
            self.expression(equals + 1, end, false);
        }
    }

    /// `if (…) statement else statement`, or `place <= expression;`
    fn statement(&mut self, in_reset: bool) {
        if self.is("if") {
            let open = self.at + 1;
            self.at += 2;
            let close = self.skip_past(")");
            let resets = close == open + 2 && self.word(open + 1) == "rst";
            self.condition(open + 1, close, resets);
            self.statement(in_reset || resets);
            if self.is("else") {
                self.at += 1;
                self.statement(in_reset);
            }
            return;
        }
        if self.is("begin") {
            self.at += 1;
            while self.at < self.tokens.len() && !self.is("end") {
                self.statement(in_reset);
            }
            self.at += 1;
            return;
        }
        self.skip_past("<=");
        let first = self.at;
        let end = self.skip_past(";");
        self.expression(first, end, in_reset);
    }

    fn span(&self, first: usize, end: usize) -> Range<usize> {
        self.tokens[first].start..self.tokens[end - 1].end
    }

    fn add(&mut self, kind: Kind, expression: &Range<usize>, place: Range<usize>, instead: String) {
        self.sites.push(Site {
            kind,
            expression: expression.clone(),
            place,
            instead,
        });
    }

    /// The condition of an `if`, of tokens `first` to `end`.
    fn condition(&mut self, first: usize, end: usize, resets: bool) {
        if first >= end {
            return;
        }
        let whole = self.span(first, end);
        let held: &[&str] = if resets { &["1'b0"] } else { &["1'b0", "1'b1"] };
        let kind = if resets { Kind::Reset } else { Kind::Condition };
        for value in held {
            self.add(kind, &whole, whole.clone(), value.to_string());
        }
        if !resets {
            self.expression(first, end, false);
        }
    }

    fn expression(&mut self, first: usize, end: usize, in_reset: bool) {
        if first >= end || end > self.tokens.len() {
            return;
        }
        let whole = self.span(first, end);
        // Starts of the groups that are open, and whether they are selects.
        let mut open: Vec<(usize, bool)> = vec![(first, false)];
        for at in first..end {
            let token = self.tokens[at];
            let place = token.start..token.end;
            let word = self.word(at).to_string();
            let in_select = open.last().is_some_and(|group| group.1);
            let after_operand = at > first && {
                let before = self.tokens[at - 1];
                before.word != Word::Symbol || matches!(self.word(at - 1), ")" | "]" | "}")
            };
            match token.word {
                Word::Literal if in_reset => {
                    if let Some(instead) = flipped(&word) {
                        self.add(Kind::Reset, &whole, place, instead);
                    }
                }
                Word::Literal if !in_select => {
                    if let Some(instead) = flipped(&word) {
                        self.add(Kind::Constant, &whole, place, instead);
                    }
                }
                Word::Name if !in_select => {
                    if let Some(instead) = self.stage_before(&word) {
                        self.add(Kind::Register, &whole, place, instead);
                    }
                    self.select(at, end, &whole);
                }
                Word::Symbol => match &*word {
                    "[" => open.push((at + 1, after_operand)),
                    "(" | "{" => open.push((at + 1, false)),
                    ")" | "]" | "}" => {
                        open.pop();
                    }
                    // What follows stands alone, for a condition.
                    "," | ":" => {
                        if let Some(group) = open.last_mut() {
                            group.0 = at + 1;
                        }
                    }
                    "?" if !in_select => {
                        let from = open.last().map_or(first, |group| group.0);
                        if from < at {
                            let place = self.span(from, at);
                            let negated = format!("!({})", &self.text[place.clone()]);
                            self.add(Kind::Condition, &whole, place, negated);
                        }
                        if let Some(group) = open.last_mut() {
                            group.0 = at + 1;
                        }
                    }
                    _ if !in_select => {
                        if let Some(instead) = other_operator(&word, after_operand) {
                            self.add(Kind::Operator, &whole, place, instead.to_string());
                        }
                    }
                    _ => {}
                },
                _ => {}
            }
        }
    }

    /// Changes of `name[high:low]`.
    fn select(&mut self, at: usize, end: usize, whole: &Range<usize>) {
        let numbers = [at + 2, at + 4].map(|n| self.word(n).parse::<u64>().ok());
        let [Some(high), Some(low)] = numbers else {
            return;
        };
        let is_select =
            self.word(at + 1) == "[" && self.word(at + 3) == ":" && self.word(at + 5) == "]";
        if !is_select || at + 5 >= end || high <= low {
            return;
        }
        let name = self.word(at).to_string();
        let place = self.span(at, at + 6);
        let shorter = format!("{{1'b0, {name}[{}:{low}]}}", high - 1);
        self.add(Kind::Width, whole, place.clone(), shorter);
        if low > 0 {
            let lower = format!("{name}[{}:{}]", high - 1, low - 1);
            self.add(Kind::Width, whole, place, lower);
        }
    }

    /// The same value a stage earlier, where the text has it: `name_s3` → `name_s2`.
    fn stage_before(&self, name: &str) -> Option<String> {
        let (base, stage) = name.rsplit_once("_s")?;
        let stage: u32 = stage.parse().ok()?;
        let before = match stage {
            0 => return None,
            1 => base.to_string(),
            _ => format!("{base}_s{}", stage - 1),
        };
        self.tokens
            .iter()
            .any(|token| self.text[token.start..token.end] == before)
            .then_some(before)
    }
}

/// A literal with its lowest bit the other way.
fn flipped(literal: &str) -> Option<String> {
    let (width, digits) = literal.split_once('\'')?;
    let base = digits.chars().next()?;
    let digits = digits[1..].replace('_', "");
    let radix = match base {
        'b' => 2,
        'd' => 10,
        'h' => 16,
        _ => return None,
    };
    let (value, count) = (u128::from_str_radix(&digits, radix).ok()? ^ 1, digits.len());
    let text = match base {
        'b' => format!("{value:0count$b}"),
        'd' => format!("{value}"),
        _ => format!("{value:0count$x}"),
    };
    Some(format!("{width}'{base}{text}"))
}

fn other_operator(operator: &str, is_binary: bool) -> Option<&'static str> {
    Some(match (operator, is_binary) {
        ("&", _) => "|",
        ("|", _) => "&",
        ("^", true) => "|",
        ("^", false) => "&",
        ("~", false) => "",
        ("!", false) => "",
        ("+", true) => "-",
        ("-", true) => "+",
        ("*", true) => "+",
        ("==", true) => "!=",
        ("!=", true) => "==",
        ("<", true) => "<=",
        ("<=", true) => "<",
        (">", true) => ">=",
        (">=", true) => ">",
        ("&&", true) => "||",
        ("||", true) => "&&",
        ("<<", true) => ">>",
        (">>", true) => "<<",
        _ => return None,
    })
}

/// The name of the input that selects a mutant, and its bits.
pub const SELECT: (&str, u32) = ("mutant", 32);

/// Registers and the literals that reset gives them: `if (rst) name <= literal;`
fn reset_values(text: &str) -> Vec<(String, String)> {
    let tokens = tokens(text);
    let word = |token: &Token| &text[token.start..token.end];
    let resets = tokens.windows(8).filter(|window| {
        let words: Vec<&str> = window.iter().map(word).collect();
        words[..4] == ["if", "(", "rst", ")"]
            && window[4].word == Word::Name
            && words[5] == "<="
            && window[6].word == Word::Literal
            && words[7] == ";"
    });
    resets
        .map(|window| (word(&window[4]).to_string(), word(&window[6]).to_string()))
        .collect()
}

/// A module's text in which each of `changes` holds where [`SELECT`] has its number, and which hands that input on to its children,
/// modules of the names of `modules`.
///
/// Registers that reset sets begin as the complement of what it gives them. Verilator begins with zeros, which most resets give too:
/// a reset left out would change nothing.
pub fn instrument(text: &str, changes: &[(u32, &Site)], modules: &[&str]) -> String {
    let (select, bits) = SELECT;
    // From the end on, so that what lies before stays where it is.
    let mut edits: Vec<(Range<usize>, String)> = vec![];
    let mut expressions: Vec<&Range<usize>> = changes.iter().map(|(_, s)| &s.expression).collect();
    expressions.sort_by_key(|range| (range.start, range.end));
    expressions.dedup();
    for expression in expressions {
        let mut choice = String::from("(");
        for (number, site) in changes.iter().filter(|(_, s)| s.expression == *expression) {
            choice += &format!(
                "({select} == {bits}'d{number}) ? ({}) :\n      ",
                site.changed(text)
            );
        }
        choice += &format!("({}))", &text[expression.clone()]);
        edits.push((expression.clone(), choice));
    }
    let tokens = tokens(text);
    let word = |at: usize| tokens.get(at).map_or("", |t: &Token| &text[t.start..t.end]);
    for at in 0..tokens.len() {
        if word(at) == "module" {
            // module name (
            let behind = tokens[at + 2].end;
            let port = format!("\n  input  wire [{}:0] {select},", bits - 1);
            edits.push((behind..behind, port));
        }
        let starts = at == 0 || matches!(word(at - 1), ";" | "end" | "endmodule");
        if starts && modules.contains(&word(at)) && word(at + 2) == "(" {
            let behind = tokens[at + 2].end;
            edits.push((behind..behind, format!("\n    .{select}({select}),")));
        }
    }
    let resets = reset_values(text);
    if let Some(end) = text.rfind("endmodule").filter(|_| !resets.is_empty()) {
        let mut initial = String::from("initial begin\n");
        for (name, value) in &resets {
            initial += &format!("    {name} = ~{value};\n");
        }
        edits.push((end..end, format!("  {initial}  end\n\n")));
    }
    edits.sort_by_key(|(range, _)| range.start);
    let mut changed = text.to_string();
    for (range, instead) in edits.into_iter().rev() {
        changed.replace_range(range, &instead);
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "\
// small: a module.
`default_nettype none

module small (
  input  wire       clk,
  input  wire       rst,
  input  wire [3:0] a,
  output wire [3:0] b
);

  // A comment with a & b ? c : d.
  wire [3:0] sum = a[3:1] + 4'd5;
  wire       low = ~sum[0] ? (a < 4'd3) : |a;
  reg  [3:0] kept;
  reg  [3:0] sum_s1, sum_s2;
  (* ram_style = \"distributed\" *)
  reg  [3:0] words [0:3];

  child inner (
    .clk(clk),
    .data(a & sum)
  );

  always @(posedge clk) begin
    if (rst) kept <= 4'd2; else if (low) kept <= sum_s2;
    sum_s1 <= sum;
  end

  assign b = kept;

  // What nothing reads.
  wire unused = &{1'b0, a[0]};

endmodule
";

    fn found(kind: Kind) -> Vec<(String, String)> {
        let sites = sites(TEXT).into_iter().filter(|site| site.kind == kind);
        sites
            .map(|site| (TEXT[site.place.clone()].to_string(), site.instead))
            .collect()
    }

    fn pairs(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        let own = |&(a, b): &(&str, &str)| (a.to_string(), b.to_string());
        pairs.iter().map(own).collect()
    }

    #[test]
    fn every_kind_is_found_and_nothing_else() {
        assert_eq!(
            found(Kind::Operator),
            pairs(&[("+", "-"), ("~", ""), ("<", "<="), ("|", "&")])
        );
        assert_eq!(
            found(Kind::Constant),
            pairs(&[("4'd5", "4'd4"), ("4'd3", "4'd2")])
        );
        assert_eq!(
            found(Kind::Condition),
            pairs(&[("~sum[0]", "!(~sum[0])"), ("low", "1'b0"), ("low", "1'b1")])
        );
        assert_eq!(
            found(Kind::Width),
            pairs(&[("a[3:1]", "{1'b0, a[2:1]}"), ("a[3:1]", "a[2:0]")])
        );
        assert_eq!(
            found(Kind::Reset),
            pairs(&[("rst", "1'b0"), ("4'd2", "4'd3")])
        );
        assert_eq!(found(Kind::Register), pairs(&[("sum_s2", "sum_s1")]));
    }

    #[test]
    fn a_site_changes_its_place_alone() {
        for site in sites(TEXT) {
            let changed = site.apply(TEXT);
            assert!(changed.contains(&site.changed(TEXT)));
            let (before, after) = (&TEXT[..site.place.start], &TEXT[site.place.end..]);
            assert!(changed.starts_with(before) && changed.ends_with(after));
            assert!(site.line(TEXT) > 10);
        }
    }

    #[test]
    fn the_selector_reaches_children() {
        let all = sites(TEXT);
        let numbered: Vec<_> = (1..).zip(&all).collect();
        let text = instrument(TEXT, &numbered, &["child"]);
        assert!(text.contains("module small (\n  input  wire [31:0] mutant,"));
        assert!(text.contains("child inner (\n    .mutant(mutant),\n    .clk(clk)"));
        assert_eq!(text.matches("mutant == 32'd").count(), all.len());
        assert!(
            text.contains("(mutant == 32'd1) ? (a[2:0] + 4'd5)")
                || text.contains("(mutant == 32'd1) ? ({1'b0, a[2:1]} + 4'd5)")
        );
    }

    #[test]
    fn registers_begin_as_what_reset_does_not_give() {
        assert_eq!(
            reset_values(TEXT),
            [("kept".to_string(), "4'd2".to_string())]
        );
        let text = instrument(TEXT, &[], &["child"]);
        assert!(text.contains("\n  initial begin\n    kept = ~4'd2;\n  end\n\nendmodule\n"));
        let without = TEXT.replace("if (rst) kept <= 4'd2; else ", "");
        assert!(!instrument(&without, &[], &["child"]).contains("initial"));
    }

    #[test]
    fn literals_flip_in_their_base() {
        for (literal, other) in [
            ("1'b0", "1'b1"),
            ("8'hff", "8'hfe"),
            ("6'd10", "6'd11"),
            ("4'b0110", "4'b0111"),
        ] {
            assert_eq!(flipped(literal).as_deref(), Some(other));
        }
        assert_eq!(flipped("4'bxxxx"), None);
    }
}
