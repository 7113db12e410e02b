//! Checks of a whole module: every signal driven, no combinational loop.

use super::design::Direction;
use super::error::HdlError;
use super::ir::{Id, Netlist, Op};
use std::collections::BTreeMap;

impl Netlist {
    /// The nodes on which a node depends without a register in between.
    pub(super) fn combinational_inputs(&self, id: Id) -> Vec<Id> {
        match &self.nodes[id].op {
            Op::Register(_) | Op::Read(_, _, _, true) => vec![],
            Op::Wire => self.drivers.get(&id).copied().into_iter().collect(),
            Op::Instance(instance, port) => {
                let instance = &self.instances[*instance];
                let port = &instance.module.ports[*port].name;
                let sources = &instance.module.paths[port];
                instance
                    .inputs
                    .iter()
                    .filter(|(name, _)| sources.contains(name))
                    .map(|(_, id)| *id)
                    .collect()
            }
            op => op.operands(),
        }
    }
}

/// Returns, for each output, the inputs that reach it combinationally.
pub(super) fn check(ir: &Netlist) -> Result<BTreeMap<String, Vec<String>>, HdlError> {
    let error = |place, message| HdlError {
        module: ir.name.clone(),
        message,
        place,
    };
    for (id, node) in ir.nodes.iter().enumerate() {
        let undriven = match &node.op {
            Op::Wire => !ir.drivers.contains_key(&id),
            Op::Register(register) => register.next.is_none(),
            _ => false,
        };
        if undriven {
            return Err(error(
                node.place,
                format!(
                    "\"{}\" is undriven",
                    node.name.as_deref().unwrap_or_default()
                ),
            ));
        }
    }
    for memory in &ir.memories {
        if memory.write.is_none() {
            return Err(error(
                memory.place,
                format!(
                    "memory \"{}\" is undriven: it is never written",
                    memory.name
                ),
            ));
        }
        if memory.reads == 0 {
            return Err(error(
                memory.place,
                format!("memory \"{}\" is never read", memory.name),
            ));
        }
    }
    find_loop(ir).map_or(Ok(()), |cycle| {
        // Named signals are sufficient. Every loop contains a wire, because all other nodes are read only after they are made.
        let wire = |id: &Id| matches!(ir.nodes[*id].op, Op::Wire);
        let start = cycle.iter().position(wire).unwrap_or(0);
        let mut names: Vec<_> = cycle[start..]
            .iter()
            .chain(&cycle[..start])
            .filter_map(|id| ir.nodes[*id].name.clone())
            .collect();
        names.extend(names.first().cloned());
        let place = ir.driven_at.get(&cycle[start]);
        Err(error(
            place.copied().unwrap_or(ir.nodes[cycle[start]].place),
            format!("combinational loop: {}", names.join(" <- ")),
        ))
    })?;
    let mut paths = BTreeMap::new();
    for (port, id) in &ir.ports {
        if port.direction == Direction::Output {
            paths.insert(port.name.clone(), reaching_inputs(ir, *id));
        }
    }
    Ok(paths)
}

fn reaching_inputs(ir: &Netlist, output: Id) -> Vec<String> {
    let mut seen = vec![false; ir.nodes.len()];
    let mut open = vec![output];
    let mut inputs = vec![];
    while let Some(id) = open.pop() {
        if std::mem::replace(&mut seen[id], true) {
            continue;
        }
        if let Op::Input = ir.nodes[id].op {
            inputs.extend(ir.nodes[id].name.clone());
        }
        open.extend(ir.combinational_inputs(id));
    }
    inputs.sort();
    inputs
}

/// Returns a cycle of nodes, if there is one.
fn find_loop(ir: &Netlist) -> Option<Vec<Id>> {
    #[derive(Clone, Copy, PartialEq)]
    enum Mark {
        New,
        Open,
        Done,
    }
    let mut marks = vec![Mark::New; ir.nodes.len()];
    for start in 0..ir.nodes.len() {
        if marks[start] != Mark::New {
            continue;
        }
        marks[start] = Mark::Open;
        let mut path = vec![(start, ir.combinational_inputs(start), 0)];
        while let Some((id, inputs, next)) = path.last_mut() {
            let Some(&input) = inputs.get(*next) else {
                marks[*id] = Mark::Done;
                path.pop();
                continue;
            };
            *next += 1;
            match marks[input] {
                Mark::Done => {}
                Mark::New => {
                    marks[input] = Mark::Open;
                    path.push((input, ir.combinational_inputs(input), 0));
                }
                Mark::Open => {
                    let from = path.iter().position(|(id, ..)| *id == input)?;
                    return Some(path[from..].iter().map(|(id, ..)| *id).collect());
                }
            }
        }
    }
    None
}
