//! Lists the possible changes of a module.

use super::edit::Editor;
use super::{Change, Edit, Mutation, Slot, Where};
use crate::design::Module;
use crate::ir::{Id, Op, Register, Root};
use crate::verilog::{Printer, literal};
use std::collections::HashSet;

/// The kind of a change.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// An operator is replaced by another one, or removed.
    Operator,
    /// The lowest bit of a literal is inverted.
    Constant,
    /// A condition is inverted, or becomes a constant.
    Condition,
    /// A slice loses its top bit, or starts one bit lower.
    Width,
    /// A register has another reset value, or none.
    Reset,
    /// A pipeline register is bypassed.
    Register,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 6] = [
        Kind::Operator,
        Kind::Constant,
        Kind::Condition,
        Kind::Width,
        Kind::Reset,
        Kind::Register,
    ];

    /// Returns the name in lower case, as it is serialised.
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

/// A possible change of a module, with the expression in its Verilog that it changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Site {
    /// The kind of the change.
    pub kind: Kind,
    /// The change.
    pub mutation: Mutation,
    /// The line in the Verilog of the module where the changed statement begins, counted from 1.
    pub line: usize,
    /// The expression before the change.
    pub before: String,
    /// The expression after the change.
    pub after: String,
}

impl Module {
    /// Returns all single changes of every [`Kind`] that the module admits, in the order of its
    /// Verilog.
    pub fn mutations(&self) -> Vec<Site> {
        let mut printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        let mut walk = Walk {
            printer: &printer,
            editor: &editor,
            line: 0,
            found: vec![],
        };
        let mut seen = HashSet::new();
        for (root, line) in &self.printed.statements {
            if seen.insert(*root) {
                walk.line = *line;
                walk.statement(*root);
            }
        }
        let found: Vec<_> = (walk.found.into_iter())
            .map(|(kind, edit, line)| {
                let module = self.name().to_string();
                let mutation = Mutation { module, edit };
                let instead = editor.resolve(&mutation);
                let instead = instead.expect("what a statement shows can be changed");
                (kind, mutation, line, instead.first().copied())
            })
            .collect();
        printer.extend(&editor.ir);
        let site = |(kind, mutation, line, instead): (_, Mutation, _, Option<(Root, Id)>)| {
            let (before, after) = match (instead, &mutation.edit) {
                (Some((root, new)), _) => {
                    let before = match root {
                        Root::Value(id) => printer.expression(id),
                        root => {
                            let id = editor.get(root);
                            printer.part(id.expect("a statement reads something"))
                        }
                    };
                    (before, printer.part(new))
                }
                (None, Edit::Reset(id, Some(value))) => {
                    let width = self.ir.nodes[*id].width;
                    (literal(value ^ 1, width), literal(*value, width))
                }
                (None, _) => ("rst".into(), "1'b0".into()),
            };
            Site {
                kind,
                mutation,
                line,
                before,
                after,
            }
        };
        found.into_iter().map(site).collect()
    }
}

/// Finds the possible changes of statements.
struct Walk<'a> {
    printer: &'a Printer<'a>,
    editor: &'a Editor,
    line: usize,
    found: Vec<(Kind, Edit, usize)>,
}

impl Walk<'_> {
    fn add(&mut self, kind: Kind, root: Root, path: &[usize], change: Change) {
        let at = Where::At(Slot(root), path.to_vec());
        self.found.push((kind, Edit::Read(at, change), self.line));
    }

    fn op(&self, id: Id) -> &Op {
        &self.printer.plan.ops[id]
    }

    fn statement(&mut self, root: Root) {
        match root {
            Root::Value(id) => self.node(root, &mut vec![], id),
            Root::Next(id) => {
                let registers = match self.printer.plan.in_line[id] {
                    Some((line, _)) => self.printer.plan.lines[line].registers.clone(),
                    None => vec![id],
                };
                for id in registers {
                    if let Op::Register(Register {
                        reset: Some(value), ..
                    }) = self.op(id)
                    {
                        let other = Edit::Reset(id, Some(value ^ 1));
                        for edit in [Edit::Reset(id, None), other] {
                            self.found.push((Kind::Reset, edit, self.line));
                        }
                    }
                }
                self.condition(Root::Enable(id));
                self.read(root);
            }
            Root::Write(memory, _) => {
                self.condition(Root::Write(memory, 0));
                self.read(Root::Write(memory, 1));
                self.read(Root::Write(memory, 2));
            }
            root => self.read(root),
        }
    }

    /// A condition, which may become a constant.
    fn condition(&mut self, root: Root) {
        let Ok(id) = self.editor.get(root) else {
            return;
        };
        for held in [0, 1] {
            if *self.op(id) != Op::Literal(held) {
                self.add(Kind::Condition, root, &[], Change::Value(held));
            }
        }
        self.read(root);
    }

    fn read(&mut self, root: Root) {
        if let Ok(id) = self.editor.get(root) {
            self.operand(root, &mut vec![], id);
        }
    }

    fn operand(&mut self, root: Root, path: &mut Vec<usize>, id: Id) {
        if let Op::Register(_) = self.op(id)
            && self.editor.earlier.contains_key(&id)
        {
            self.add(Kind::Register, root, path, Change::Early);
        }
        if !self.printer.plan.declared[id] {
            self.node(root, path, id);
        }
    }

    /// A node whose expression is printed in place.
    fn node(&mut self, root: Root, path: &mut Vec<usize>, id: Id) {
        let op = self.op(id).clone();
        match &op {
            Op::Register(_) => return,
            Op::Literal(value) => {
                self.add(Kind::Constant, root, path, Change::Value(value ^ 1));
            }
            Op::Not(_) | Op::Binary(..) | Op::Any(_) | Op::All(_) | Op::Parity(_) => {
                self.add(Kind::Operator, root, path, Change::Operator);
            }
            Op::Mux(..) => {
                path.push(0);
                self.add(Kind::Condition, root, path, Change::Inverted);
                path.pop();
            }
            Op::Slice(of, low) => {
                let width = self.printer.plan.width(id);
                if width > 1 && width < self.printer.plan.width(*of) {
                    self.add(Kind::Width, root, path, Change::Shorter);
                    if *low > 0 {
                        self.add(Kind::Width, root, path, Change::Lower);
                    }
                }
            }
            _ => {}
        }
        for (number, operand) in op.operands().into_iter().enumerate() {
            path.push(number);
            self.operand(root, path, operand);
            path.pop();
        }
    }
}
