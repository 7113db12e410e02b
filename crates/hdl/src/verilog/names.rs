//! Names for nodes that the Rust source does not name. They are derived from the port or wire that the node drives, from the word
//! of a field, or from the first reader.

use super::super::builder::KEYWORDS;
use super::super::design::Direction;
use super::super::ir::{Id, Op};
use super::plan::Plan;
use std::collections::{HashMap, HashSet};

pub(in super::super) struct Names {
    /// The names of declared nodes.
    pub of: Vec<String>,
    /// The name without the stage, from which names of pipeline registers are derived.
    stem: Vec<Option<String>>,
    /// The suffix of a name after its stem.
    late: Vec<Option<String>>,
    /// Whether the node is an output port, so that no wire is declared for it.
    pub port: Vec<bool>,
    /// The wire in whose place the node is declared, before it is driven.
    pub early: Vec<Option<Id>>,
    /// For each memory, the names of its copies.
    pub copies: Vec<Vec<String>>,
    pub lines: Vec<String>,
    /// The wire that collects the bits without a reader.
    pub unused: String,
    /// The loop counter of delay lines.
    pub counter: String,
    /// Names that do not follow from the description.
    pub made_up: Vec<(String, Id)>,
    taken: HashSet<String>,
    /// Names that were requested more than once, with the last number used.
    numbers: HashMap<String, u32>,
}

impl Names {
    pub fn new(plan: &Plan) -> Names {
        let ir = plan.ir;
        let nodes = plan.ops.len();
        let mut names = Names {
            of: vec![String::new(); nodes],
            stem: vec![None; nodes],
            late: vec![None; nodes],
            port: vec![false; nodes],
            early: vec![None; nodes],
            copies: vec![],
            lines: vec![],
            unused: String::new(),
            counter: String::new(),
            made_up: vec![],
            taken: ir.names.keys().cloned().collect(),
            numbers: HashMap::new(),
        };
        names.taken.extend(KEYWORDS.split(' ').map(str::to_string));
        names.unused = names.free("unused".to_string());
        for (memory, copies) in ir.memories.iter().zip(&plan.copies) {
            let copy_names = match copies.len() {
                0 | 1 => vec![memory.name.clone(); copies.len()],
                many => (0..many)
                    .map(|i| names.free(format!("{}_copy{i}", memory.name)))
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
            let name = format!("{stem}_delay");
            // The lines of a module's parts have the same name.
            let name = match plan.borders {
                None => names.unique(name, line.registers[0]),
                Some(_) => names.free(name),
            };
            names.lines.push(name);
        }
        names.counter = names.free("age".to_string());
        names
    }

    /// Names the additional nodes of properties. `inside` names signals inside instances.
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

    /// The name of a node, with a number appended if it is used.
    fn unique(&mut self, name: String, id: Id) -> String {
        let unique = self.free(name.clone());
        if unique != name && self.made_up.last().is_none_or(|(_, last)| *last != id) {
            self.made_up.push((unique.clone(), id));
        }
        unique
    }

    /// An unused name.
    pub fn free(&mut self, name: String) -> String {
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

    /// Gives the driver of an output port or wire the name of that port or wire, unless it has its own name. The output of an instance
    /// has none, nor has logic that drives one port and no wire. Registers keep their names.
    fn take_ports_and_wires(&mut self, plan: &Plan) {
        let ports = (plan.ir.ports.iter()).filter(|(port, _)| port.direction == Direction::Output);
        let ports = ports.map(|(port, id)| (port, plan.signal(plan.stands[*id])));
        let nameless = |names: &Names, id: Id| {
            names.of[id].is_empty() || matches!(plan.ops[id], Op::Instance(..))
        };
        let mut goes_to: HashMap<Id, usize> = HashMap::new();
        let wires = (0..plan.ops.len()).filter(|id| plan.signal(*id) != *id);
        let of_wires = wires.map(|wire| plan.signal(wire));
        for id in ports.clone().map(|(_, id)| id).chain(of_wires) {
            *goes_to.entry(id).or_default() += 1;
        }
        for (port, id) in ports {
            let state = matches!(plan.ops[id], Op::Input | Op::Register(_) | Op::Read(..));
            let open = nameless(self, id) || !state && goes_to[&id] == 1;
            if plan.declared[id] && !self.port[id] && open {
                self.of[id] = port.name.clone();
                self.port[id] = true;
            }
        }
        let mut by_wire = HashSet::new();
        for wire in 0..plan.ops.len() {
            let id = plan.signal(wire);
            if id == wire {
                continue;
            }
            if nameless(self, id) && !self.port[id] && by_wire.insert(id) {
                self.of[id] = self.of[wire].clone();
            }
            let declared = self.port[id] || plan.ops[id] == Op::Input;
            if wire < id && !declared {
                self.early[id].get_or_insert(wire);
            }
            self.of[wire] = self.of[id].clone();
        }
    }

    /// Chooses the name of a declared node and, for a pipeline register, the stem for the following ones.
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
                    let stem = match (self.hinted(plan, next), &goals[next]) {
                        (Some((stem, Some(_))), _) => stem,
                        (Some((name, None)), _) => self.unique(name, next),
                        // The destination has this name, and its pipeline registers are named after it.
                        (None, Some(goal)) => {
                            let mut unique = goal.clone();
                            let mut n = 1;
                            while !stems.insert(unique.clone()) {
                                n += 1;
                                unique = format!("{goal}_{n}");
                            }
                            if n > 1 {
                                self.made_up.push((unique.clone(), next));
                            }
                            unique
                        }
                        _ => self.make_up(plan, next),
                    };
                    self.stem[next] = Some(stem.clone());
                    stem
                }
            };
            let late = suffix(plan, id);
            if plan.declared[id] && self.of[id].is_empty() {
                self.of[id] = self.unique(format!("{stem}_{late}"), id);
            }
            self.stem[id] = Some(stem);
            self.late[id] = Some(late);
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
                    Some(match copies.iter().position(|copy| *copy == id) {
                        Some(copy) if copies.len() > 1 => format!("{name}_read{copy}"),
                        _ => format!("{name}_read"),
                    })
                }
                _ => match self.hinted(plan, id) {
                    Some((stem, Some(late))) => {
                        self.of[id] = self.unique(format!("{stem}_{late}"), id);
                        self.stem[id] = Some(stem);
                        self.late[id] = Some(late);
                        return;
                    }
                    Some((name, None)) => Some(name),
                    None => match &goals[id] {
                        Some(name) if self.taken.contains(name) => Some(format!("{name}_next")),
                        goal => goal.clone(),
                    },
                },
            };
            self.of[id] = match name {
                Some(name) => self.unique(name, id),
                None => self.make_up(plan, id),
            };
        }
        stems.insert(self.of[id].clone());
        self.stem[id] = match &plan.ops[id] {
            Op::Inside(..) => None,
            _ => Some(self.of[id].clone()),
        };
    }

    /// The suggested name of a node and its suffix, which gives the delay of its word.
    fn hinted(&self, plan: &Plan, id: Id) -> Option<(String, Option<String>)> {
        match &plan.ops[id] {
            Op::Reset => return Some(("rst".to_string(), None)),
            // Its own name consists of two parts.
            Op::Inside(instance, _) => {
                let instance = &plan.ir.instances[*instance].name;
                return Some((format!("{instance}_inside"), None));
            }
            _ => {}
        }
        let hint = plan.hints[id].as_ref()?;
        let after = match plan.ops[id] {
            Op::Slice(of, _) if hint.after.is_some() => of,
            _ => match hint.after {
                Some(after) => plan.stands[after],
                None => return Some((hint.name.clone(), None)),
            },
        };
        let (stem, late) = match &self.stem[after] {
            Some(stem) => (stem.clone(), self.late[after].clone()),
            None if !self.of[after].is_empty() => (self.of[after].clone(), None),
            None => self.hinted(plan, after)?,
        };
        Some((format!("{stem}_{}", hint.name), late))
    }

    /// A name for a node without one in the description.
    fn make_up(&mut self, plan: &Plan, id: Id) -> String {
        let name = match &plan.ops[id] {
            Op::Slice(of, low) if !self.of[*of].is_empty() => {
                format!("{}_from_{low}", self.of[*of])
            }
            _ => "term".to_string(),
        };
        self.made_up.push((name.clone(), id));
        self.unique(name, id)
    }
}

/// The suffix of a pipeline register's name: its stage, or its delay in cycles.
fn suffix(plan: &Plan, id: Id) -> String {
    if let Some(stage) = plan.ir.nodes[id].stage {
        return format!("s{}", stage.at);
    }
    let (mut clocks, mut at) = (0, id);
    while let Op::Register(register) = &plan.ops[at]
        && register.delay
        && plan.given[at].is_none()
    {
        clocks += 1;
        at = register.next.expect("a delay register has a next value");
    }
    format!("d{clocks}")
}

/// For each node, the name of its first destination, also through pipeline registers.
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
