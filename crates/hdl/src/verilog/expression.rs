//! Expressions and assignments. All operands of an operator are printed with the same width, so Verilog's implicit
//! extension applies only to products, which are always assigned with their full width.

use super::super::ir::{Binary, Id, Op};
use super::{LINE, Printer, length};
use std::fmt::Write as _;

pub(in super::super) fn literal(value: u128, width: u32) -> String {
    if width == 1 {
        format!("1'b{value}")
    } else if value < 1000 {
        format!("{width}'d{value}")
    } else {
        format!("{width}'h{value:x}")
    }
}

/// The bits `high` to `low`, for a signal or a declaration.
pub(super) fn bits(high: u32, low: u32) -> String {
    if high == low {
        format!("[{low}]")
    } else {
        format!("[{high}:{low}]")
    }
}

impl Printer<'_> {
    /// A node as an operand: its name, or its expression in parentheses if they are needed.
    fn operand(&self, id: Id) -> String {
        let text = self.part(id);
        if self.plan.declared[id] {
            return text;
        }
        match &self.plan.ops[id] {
            Op::Binary(..) | Op::Mux(..) | Op::Any(_) | Op::All(_) | Op::Parity(_) => {
                format!("({text})")
            }
            Op::Not(_) if text.starts_with("~|") => format!("({text})"),
            _ => text,
        }
    }

    /// Verilog does not allow a unary operator directly after a unary operator.
    fn unary_operand(&self, id: Id) -> String {
        let text = self.operand(id);
        if text.starts_with('~') {
            format!("({text})")
        } else {
            text
        }
    }

    /// A node in a position that needs no parentheses.
    pub fn part(&self, id: Id) -> String {
        if self.plan.declared[id] {
            self.names.of[id].clone()
        } else {
            self.expression(id)
        }
    }

    /// The expression of a node, even if the node is declared.
    pub fn expression(&self, id: Id) -> String {
        let plan = &self.plan;
        match &plan.ops[id] {
            Op::Register(_) => match plan.in_line[id] {
                Some((line, at)) => {
                    let name = &self.names.lines[line];
                    format!("{name}[{at}]")
                }
                None => self.names.of[id].clone(),
            },
            Op::Input
            | Op::Wire
            | Op::Instance(..)
            | Op::AnyConst
            | Op::AnySeq
            | Op::Inside(..) => self.names.of[id].clone(),
            Op::Peek(memory, address) => {
                let copy = self.names.copies[*memory].first();
                let copy = copy.expect("a memory that properties read is read by the module");
                format!("{copy}[{}]", self.part(*address))
            }
            Op::Read(memory, _, address, _) => {
                let copy = plan.copies[*memory].iter().position(|copy| *copy == id);
                let copy = copy.expect("a memory has a copy for each read");
                format!(
                    "{}[{}]",
                    self.names.copies[*memory][copy],
                    self.part(*address)
                )
            }
            Op::Literal(value) => self.numbers.literal(*value, plan.width(id)),
            Op::Reset => "rst".to_string(),
            Op::Not(a) => match &plan.ops[*a] {
                Op::Any(of) if !plan.declared[*a] => format!("~|{}", self.unary_operand(*of)),
                _ => format!("~{}", self.unary_operand(*a)),
            },
            Op::Binary(op, a, b) => {
                let left = if self.continues(*op, *a) {
                    self.expression(*a)
                } else {
                    self.operand(*a)
                };
                format!("{left} {} {}", symbol(*op), self.operand(*b))
            }
            Op::Mux(condition, a, b) => {
                format!(
                    "{} ? {} : {}",
                    self.operand(*condition),
                    self.operand(*a),
                    self.operand(*b)
                )
            }
            Op::Concat(parts) => {
                format!("{{{}}}", self.parts(parts).join(", "))
            }
            Op::Repeat(a, times) => {
                format!("{{{}{{{}}}}}", self.numbers.plain(*times), self.part(*a))
            }
            Op::Slice(of, low) => {
                let width = plan.width(id);
                let name = self.part(*of);
                if width == plan.width(*of) {
                    return name;
                }
                format!("{name}{}", self.numbers.bits(low + width - 1, *low))
            }
            Op::Bit(of, index) => format!("{}[{}]", self.part(*of), self.part(*index)),
            Op::Any(a) => format!("|{}", self.unary_operand(*a)),
            Op::All(a) => format!("&{}", self.unary_operand(*a)),
            Op::Parity(a) => format!("^{}", self.unary_operand(*a)),
        }
    }

    /// The operands of a concatenation, with nested concatenations flattened.
    fn parts(&self, parts: &[Id]) -> Vec<String> {
        let mut text = vec![];
        for id in parts {
            match &self.plan.ops[*id] {
                Op::Concat(ir) if !self.plan.declared[*id] => text.extend(self.parts(ir)),
                _ => text.push(self.part(*id)),
            }
        }
        text
    }

    /// Whether a left operand continues a chain of an associative operator, so that it needs no parentheses.
    fn continues(&self, op: Binary, left: Id) -> bool {
        op.is_associative()
            && !self.plan.declared[left]
            && matches!(&self.plan.ops[left], Op::Binary(ir, ..) if *ir == op)
    }

    /// `target id;`, with the node's name if it has one.
    pub(super) fn assignment(&self, target: &str, id: Id) -> String {
        if self.plan.declared[id] {
            format!("{target} {};", self.names.of[id])
        } else {
            self.definition(target, id)
        }
    }

    /// `target expression;`, divided over several lines if it is long.
    pub(super) fn definition(&self, target: &str, id: Id) -> String {
        let mut text = target.to_string();
        // Statements in `always` blocks are indented further.
        let most = LINE - if target.ends_with("<=") { 4 } else { 2 };
        if let Op::Mux(_, _, rest) = self.plan.ops[id] {
            let chain = !self.plan.declared[rest] && matches!(self.plan.ops[rest], Op::Mux(..));
            if !chain {
                let line = format!("{target} {};", self.expression(id));
                if length(&line) <= most {
                    return line;
                }
            }
            let mut at = id;
            while let Op::Mux(c, a, b) = self.plan.ops[at]
                && (at == id || !self.plan.declared[at])
            {
                let _ = write!(text, "\n      {} ? {} :", self.operand(c), self.operand(a));
                at = b;
            }
            let _ = write!(text, "\n      {};", self.operand(at));
            return text;
        }
        let line = match &self.plan.ops[id] {
            // Otherwise the second line would look like another assignment.
            Op::Binary(Binary::LessEqual, ..) if target.ends_with("<=") => {
                format!("{target} ({});", self.expression(id))
            }
            _ => format!("{target} {};", self.expression(id)),
        };
        if length(&line) <= most {
            return line;
        }
        match &self.plan.ops[id] {
            Op::Concat(parts) => {
                format!(
                    "{target} {{\n      {}\n    }};",
                    self.parts(parts).join(",\n      ")
                )
            }
            Op::Binary(op, a, b) => {
                let (mut operands, mut left) = (vec![*b], *a);
                while let Op::Binary(_, a, b) = self.plan.ops[left]
                    && self.continues(*op, left)
                {
                    operands.push(b);
                    left = a;
                }
                operands.push(left);
                operands.reverse();
                let operands: Vec<_> = operands.iter().map(|id| self.operand(*id)).collect();
                let separator = format!(" {}\n      ", symbol(*op));
                format!("{target}\n      {};", operands.join(&separator))
            }
            _ => line,
        }
    }
}

fn symbol(op: Binary) -> &'static str {
    match op {
        Binary::And => "&",
        Binary::Or => "|",
        Binary::Xor => "^",
        Binary::Add => "+",
        Binary::Sub => "-",
        Binary::Mul => "*",
        Binary::Equal => "==",
        Binary::NotEqual => "!=",
        Binary::Less => "<",
        Binary::LessEqual => "<=",
        Binary::ShiftLeft => "<<",
        Binary::ShiftRight => ">>",
    }
}
