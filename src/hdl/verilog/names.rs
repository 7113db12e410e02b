//! Names for what the Rust source does not name: after the port or wire that it drives, after what it computes,
//! or after where it goes.

use super::super::builder::KEYWORDS;
use super::super::design::Direction;
use super::super::ir::{Binary, Id, Op};
use super::plan::Plan;
use std::collections::{HashMap, HashSet};

/// The longest name that is made of what a signal computes.
const LONG_NAME: usize = 36;

pub(super) struct Names {
    /// Of declared nodes.
    pub of: Vec<String>,
    /// The name without the stage, from which the names of delays are made.
    stem: Vec<Option<String>>,
    /// The node is this output port: no other wire is declared for it.
    pub port: Vec<bool>,
    /// The node is this wire, declared earlier.
    pub wire: Vec<Option<Id>>,
    /// For each memory, the names of its copies.
    pub copies: Vec<Vec<String>>,
    pub lines: Vec<String>,
    /// The wire that takes what nothing reads.
    pub unused: String,
    taken: HashSet<String>,
    /// Names that were wanted more than once, with the last number that they got.
    numbers: HashMap<String, u32>,
}

impl Names {
    pub fn new(plan: &Plan) -> Names {
        let ir = plan.ir;
        let nodes = plan.ops.len();
        let mut names = Names {
            of: vec![String::new(); nodes],
            stem: vec![None; nodes],
            port: vec![false; nodes],
            wire: vec![None; nodes],
            copies: vec![],
            lines: vec![],
            unused: String::new(),
            taken: ir.names.keys().cloned().collect(),
            numbers: HashMap::new(),
        };
        names.taken.extend(KEYWORDS.split(' ').map(str::to_string));
        names.unused = names.unique("unused".to_string());
        for (memory, copies) in ir.memories.iter().zip(&plan.copies) {
            let copy_names = match copies.len() {
                0 | 1 => vec![memory.name.clone(); copies.len()],
                many => (0..many)
                    .map(|i| names.unique(format!("{}_copy{i}", memory.name)))
                    .collect(),
            };
            names.copies.push(copy_names);
        }
        for id in 0..nodes {
            if let (true, Some(name)) = (plan.declared[id], &plan.given[id]) {
                names.of[id] = name.clone();
            }
        }
        names.take_ports_and_wires(plan);
        let goals = goals(plan);
        let mut stems = HashSet::new();
        for id in 0..nodes {
            if plan.live[id] || plan.declared[id] {
                names.choose(plan, &goals, &mut stems, id);
            }
        }
        for line in &plan.lines {
            let stem = names.stem[line.registers[0]].clone().unwrap_or_default();
            let name = names.unique(format!("{stem}_delay"));
            names.lines.push(name);
        }
        names
    }

    /// Names what stands beside the module for its properties. `inside` names signals inside instances.
    pub fn extend(&mut self, plan: &Plan, beside: &[Id], inside: &dyn Fn(usize, Id) -> String) {
        let mut stems = HashSet::new();
        for &id in beside.iter().filter(|id| plan.declared[**id]) {
            self.of[id] = match (&plan.given[id], &plan.ops[id]) {
                (_, Op::Inside(instance, node)) => inside(*instance, *node),
                (Some(name), _) => name.clone(),
                _ => String::new(),
            };
        }
        let goals = vec![None; plan.ops.len()];
        for &id in beside {
            self.choose(plan, &goals, &mut stems, id);
        }
    }

    pub fn unique(&mut self, name: String) -> String {
        if self.taken.insert(name.clone()) {
            return name;
        }
        let number = self.numbers.entry(name.clone()).or_insert(1);
        loop {
            *number += 1;
            let unique = format!("{name}_{number}");
            if self.taken.insert(unique.clone()) {
                return unique;
            }
        }
    }

    /// A nameless node that drives an output port or an earlier wire is that port or wire.
    fn take_ports_and_wires(&mut self, plan: &Plan) {
        for (port, id) in &plan.ir.ports {
            let id = plan.stands[*id];
            if port.direction == Direction::Output && plan.declared[id] && self.of[id].is_empty() {
                self.of[id] = port.name.clone();
                self.port[id] = true;
            }
        }
        for wire in 0..plan.ops.len() {
            if !plan.live[wire] || plan.ops[wire] != Op::Wire {
                continue;
            }
            let id = plan.driver(wire);
            let clocked = match &plan.ops[id] {
                Op::Register(_) => plan.in_line[id].is_none(),
                Op::Read(_, _, _, synchronous) => *synchronous,
                _ => false,
            };
            if wire < id && !clocked && plan.declared[id] && self.of[id].is_empty() {
                self.of[id] = self.of[wire].clone();
                self.wire[id] = Some(wire);
            }
        }
    }

    fn choose(
        &mut self,
        plan: &Plan,
        goals: &[Option<String>],
        stems: &mut HashSet<String>,
        id: Id,
    ) {
        if let Op::Register(register) = &plan.ops[id]
            && register.delay
        {
            let next = register.next.expect("a delay register has a next value");
            if plan.given[id].is_some() {
                self.stem[id] = plan.given[id].clone();
                return;
            }
            let stem = match &self.stem[next] {
                Some(stem) => stem.clone(),
                None => {
                    let phrase = self.phrase(plan, next, 2);
                    let unique = match (phrase, &goals[next]) {
                        (Some(name), _) if name.len() <= LONG_NAME => self.unique(name),
                        // The goal has this name, its delays are called after it.
                        (_, Some(goal)) => {
                            let mut unique = goal.clone();
                            let mut n = 1;
                            while !stems.insert(unique.clone()) {
                                n += 1;
                                unique = format!("{goal}_{n}");
                            }
                            unique
                        }
                        _ => self.unique(kind(&plan.ops[next]).to_string()),
                    };
                    self.stem[next] = Some(unique.clone());
                    unique
                }
            };
            if plan.declared[id] && self.of[id].is_empty() {
                let suffix = match plan.ir.nodes[id].stage {
                    Some(stage) => format!("s{}", stage.at),
                    None => {
                        let (mut clocks, mut at) = (1, next);
                        while let Op::Register(before) = &plan.ops[at]
                            && before.delay
                            && plan.given[at].is_none()
                        {
                            clocks += 1;
                            at = before.next.expect("a delay register has a next value");
                        }
                        format!("d{clocks}")
                    }
                };
                self.of[id] = self.unique(format!("{stem}_{suffix}"));
            }
            self.stem[id] = Some(stem);
            return;
        }
        if !plan.declared[id] {
            return;
        }
        if self.of[id].is_empty() {
            let name = match &plan.ops[id] {
                Op::Read(memory, ..) => {
                    let copies = &plan.copies[*memory];
                    let name = &plan.ir.memories[*memory].name;
                    match copies.iter().position(|copy| *copy == id) {
                        Some(copy) if copies.len() > 1 => format!("{name}_read{copy}"),
                        _ => format!("{name}_read"),
                    }
                }
                op => self
                    .phrase(plan, id, 2)
                    .filter(|name| name.len() <= LONG_NAME)
                    .or_else(|| match &goals[id] {
                        Some(name) if self.taken.contains(name) => Some(format!("{name}_next")),
                        goal => goal.clone(),
                    })
                    .unwrap_or_else(|| kind(op).to_string()),
            };
            self.of[id] = self.unique(name);
        }
        stems.insert(self.of[id].clone());
        self.stem[id] = match &plan.ops[id] {
            Op::Inside(..) => None,
            _ => Some(self.of[id].clone()),
        };
    }

    /// What a node computes, in words; `depth` operators at most.
    fn phrase(&self, plan: &Plan, id: Id, depth: u32) -> Option<String> {
        if let Op::Inside(instance, _) = &plan.ops[id] {
            // Its own name is of two parts.
            return Some(format!("{}_inside", plan.ir.instances[*instance].name));
        }
        if let Some(stem) = &self.stem[id] {
            return Some(stem.clone());
        }
        if !self.of[id].is_empty() {
            return Some(self.of[id].clone());
        }
        let width = plan.width(id);
        match &plan.ops[id] {
            Op::Reset => return Some("rst".to_string()),
            Op::Literal(value) => return (*value < 1000).then(|| value.to_string()),
            Op::Slice(of, low) => {
                let of = self.phrase(plan, *of, depth)?;
                return Some(if width == 1 {
                    format!("{of}_{low}")
                } else {
                    format!("{of}_{}_{low}", low + width - 1)
                });
            }
            _ => {}
        }
        let depth = depth.checked_sub(1)?;
        let of = |id: Id| self.phrase(plan, id, depth);
        Some(match &plan.ops[id] {
            Op::Not(a) => match &plan.ops[*a] {
                Op::Any(a) => format!("{}_is_zero", of(*a)?),
                _ => format!("not_{}", of(*a)?),
            },
            Op::Any(a) => format!("any_{}", of(*a)?),
            Op::All(a) => format!("all_{}", of(*a)?),
            Op::Parity(a) => format!("parity_{}", of(*a)?),
            Op::Binary(op, a, b) => {
                let verb = match op {
                    Binary::And => "and",
                    Binary::Or => "or",
                    Binary::Xor => "xor",
                    Binary::Add => "plus",
                    Binary::Sub => "minus",
                    Binary::Mul => "times",
                    Binary::Equal => "is",
                    Binary::NotEqual => "is_not",
                    Binary::Less => "below",
                    Binary::LessEqual => "at_most",
                    Binary::ShiftLeft => "left_by",
                    Binary::ShiftRight => "right_by",
                };
                match (&plan.ops[*a], of(*b)?) {
                    // A name cannot begin with a digit.
                    (Op::Literal(_), _) => return None,
                    (_, b) => format!("{}_{verb}_{b}", of(*a)?),
                }
            }
            _ => return None,
        })
    }
}

fn kind(op: &Op) -> &'static str {
    match op {
        Op::Binary(Binary::Add, ..) => "sum",
        Op::Binary(Binary::Sub, ..) => "difference",
        Op::Binary(Binary::Mul, ..) => "product",
        Op::Binary(Binary::Equal | Binary::NotEqual | Binary::Less | Binary::LessEqual, ..) => {
            "comparison"
        }
        Op::Binary(Binary::ShiftLeft | Binary::ShiftRight, ..) => "shifted",
        Op::Mux(..) => "choice",
        Op::Concat(_) | Op::Repeat(..) => "joined",
        Op::Slice(..) => "part",
        _ => "term",
    }
}

/// For each node the name of the first place that it goes to, through delay registers too.
fn goals(plan: &Plan) -> Vec<Option<String>> {
    let ir = plan.ir;
    let mut goals: Vec<Option<String>> = vec![None; plan.ops.len()];
    let mut set = |id: Id, name: String| {
        goals[plan.stands[id]].get_or_insert(name);
    };
    for (port, id) in &ir.ports {
        if port.direction == Direction::Output {
            set(*id, port.name.clone());
        }
    }
    for (id, op) in plan.ops.iter().enumerate() {
        if !plan.live[id] {
            continue;
        }
        let name = plan.given[id].as_deref().unwrap_or_default();
        match op {
            Op::Wire => set(plan.driver(id), name.to_string()),
            Op::Register(register) if !register.delay => {
                if let Some(next) = register.next {
                    set(next, format!("{name}_next"));
                }
                if let Some(enable) = register.enable {
                    set(enable, format!("{name}_enable"));
                }
            }
            Op::Read(memory, _, address, _) => {
                set(
                    *address,
                    format!("{}_read_address", ir.memories[*memory].name),
                );
            }
            _ => {}
        }
    }
    for (memory, copies) in plan.copies.iter().enumerate() {
        if !copies.is_empty() {
            let roles = ["enable", "address", "data"];
            for (id, role) in plan.write_port(memory).into_iter().zip(roles) {
                set(id, format!("{}_write_{role}", ir.memories[memory].name));
            }
        }
    }
    for instance in &ir.instances {
        for (port, id) in &instance.inputs {
            set(*id, format!("{}_{port}", instance.name));
        }
    }
    for id in (0..plan.ops.len()).rev() {
        if let (true, Op::Register(register)) = (plan.live[id], &plan.ops[id])
            && let (true, Some(next)) = (register.delay, register.next)
            && plan.given[id].is_none()
            && goals[next].is_none()
        {
            goals[next] = goals[id].clone();
        }
    }
    goals
}
