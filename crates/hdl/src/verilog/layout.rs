//! The order of statements in a module's text, and the division of long lines.

use super::super::ir::{Id, Item, Op};
use super::plan::Plan;
use super::{LINE, MARK, Names, STATEMENT};

/// The positions of memories.
pub(super) struct Layout {
    /// For each item, the memories that are printed after it, where all of their writes and addresses are declared.
    pub memories: Vec<Vec<usize>>,
    /// For words that are read, whether they are declared before their memory.
    pub early: Vec<bool>,
}

impl Layout {
    pub fn new(plan: &Plan, names: &Names) -> Layout {
        let ir = plan.ir;
        // The item after which a node can be read.
        let mut from = vec![0; ir.nodes.len()];
        let mut declared_at = vec![0; ir.memories.len()];
        for (place, item) in ir.items.iter().enumerate() {
            match item {
                Item::Node(id) => {
                    from[*id] = match (&plan.ops[*id], plan.in_line[*id]) {
                        (_, Some((line, _))) if !plan.declared[*id] => {
                            from[plan.lines[line].registers[0]]
                        }
                        (Op::Register(_), _) => place,
                        _ if plan.declared[*id] => place,
                        (op, _) => {
                            let operands = op.operands().into_iter();
                            operands.map(|id| from[id]).max().unwrap_or(0)
                        }
                    };
                }
                Item::Instance(index) => {
                    for (_, id) in &ir.instances[*index].outputs {
                        if !names.port[*id] && names.early[*id].is_none() {
                            from[*id] = place;
                        }
                    }
                }
                Item::Memory(index) => declared_at[*index] = place,
                Item::Drive(_) | Item::Comment(_) | Item::Part(_) => {}
            }
        }
        let mut layout = Layout {
            memories: vec![vec![]; ir.items.len()],
            early: vec![false; ir.nodes.len()],
        };
        let mut places = vec![None; ir.memories.len()];
        for (memory, reads) in plan.copies.iter().enumerate() {
            if reads.is_empty() {
                continue;
            }
            let address = |read: &Id| match plan.ops[*read] {
                Op::Read(_, _, address, _) => Some(address),
                _ => None,
            };
            let needed = plan.write_port(memory).into_iter();
            let needed = needed.chain(reads.iter().filter_map(address));
            let place = needed.map(|id| from[id]).max().unwrap_or(0);
            let place = place.max(declared_at[memory]);
            layout.memories[place].push(memory);
            places[memory] = Some(place);
        }
        for (place, item) in ir.items.iter().enumerate() {
            if let Item::Node(id) = item
                && let Op::Read(memory, ..) = plan.ops[*id]
            {
                layout.early[*id] = places[memory].is_some_and(|memory| memory >= place);
            }
        }
        layout
    }
}

/// A text with long lines of code divided, after conditions and operators and with as few open brackets as
/// possible.
pub(super) fn folded(text: &str) -> String {
    let mut folded = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        let mut rest = line.to_string();
        let mut further = 4;
        while let Some((at, conditional)) = fold(rest.trim_end()) {
            folded.push_str(&rest[..at]);
            folded.push('\n');
            let indent = rest.len() - rest.trim_start().len();
            let indent = indent + if conditional { 2 } else { further };
            if !conditional {
                further = 0;
            }
            rest = format!("{:indent$}{}", "", &rest[at + 1..]);
        }
        folded.push_str(&rest);
    }
    folded
}

/// The blank at which a long line is divided, and whether it follows a condition.
fn fold(line: &str) -> Option<(usize, bool)> {
    const OPERATORS: &str = " & | ^ + - * ? : = == != < <= > >= << >> ";
    let (mut column, mut depth, mut marked) = (0, 0, false);
    let mut best: Option<(i32, usize)> = None;
    let mut condition = None;
    let mut code = String::new();
    for (at, c) in line.char_indices() {
        marked ^= c == STATEMENT;
        if marked || matches!(c, MARK | STATEMENT) {
            continue;
        }
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth -= 1,
            ' ' if column < LINE => {
                let word = code.rsplit(' ').next().unwrap_or_default();
                let operator = word.ends_with(',')
                    || !word.is_empty() && OPERATORS.contains(&format!(" {word} "));
                if operator && best.is_none_or(|(least, _)| depth <= least) {
                    best = Some((depth, at));
                }
                let of_condition = depth == 0 && word.ends_with(')') && condition.is_none();
                if of_condition
                    && ["if (", "else if ("]
                        .iter()
                        .any(|s| code.trim_start().starts_with(s))
                {
                    condition = Some(at);
                }
            }
            _ => {}
        }
        code.push(c);
        column += 1;
    }
    let code = code.trim_start();
    if column <= LINE || code.starts_with("//") {
        return None;
    }
    let behind = condition.map(|at| (at, true));
    behind.or(best.map(|(_, at)| (at, false)))
}
