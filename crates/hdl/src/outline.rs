//! Divides a module with parts into one module per part, and one that instantiates them.
//!
//! Properties and mutations use the undivided netlist. The modules of the parts are made when the module is finished and compared with
//! it, so proofs about the undivided netlist hold for the printed modules.

use super::design::{Direction, Module, Port};
use super::error::HdlError;
use super::ir::{Hint, Id, InstanceData, Item, Netlist, Node, Op, Place};
use super::verilog::{Borders, Printer, slice_of};
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// The printed form of a module with parts.
#[derive(Debug)]
pub(super) struct Outline {
    /// The module with the same name and ports that instantiates the parts.
    pub top: Arc<Module>,
    pub parts: Vec<Arc<Module>>,
    /// For the top module and then for each part, the correspondence of its nodes to those of the whole.
    pub numbers: Vec<HashMap<Id, Id>>,
}

/// The modules of a module's parts; `None` if it has no parts.
pub(super) fn outline(printer: &Printer<'_>) -> Result<Option<Outline>, HdlError> {
    let ir = printer.plan.ir;
    let Some(borders) = &printer.plan.borders else {
        return Ok(None);
    };
    let whole = Whole {
        ir,
        printer,
        borders,
    };
    let mut parts = vec![];
    let mut numbers = vec![HashMap::new()];
    for part in 1..=ir.parts.len() {
        let mut maker = Maker::new(&whole, part);
        maker.ports_of_part();
        maker.make();
        parts.push(Arc::new(Module::of(maker.made)?));
        numbers.push(maker.numbers);
    }
    let mut maker = Maker::new(&whole, 0);
    maker.place_parts(&parts);
    maker.make();
    maker.ports_of_whole();
    for part in &ir.parts {
        if let Some(earlier) = maker.made.names.insert(part.name.clone(), part.place) {
            return Err(HdlError {
                module: ir.name.clone(),
                message: format!(
                    "name clash: part \"{}\" stands where a signal has its name, made at {}:{}",
                    part.name,
                    earlier.file(),
                    earlier.line()
                ),
                place: part.place,
            });
        }
    }
    numbers[0] = maker.numbers;
    let top = Arc::new(Module::of(maker.made)?);
    Ok(Some(Outline {
        top,
        parts,
        numbers,
    }))
}

/// The module to divide.
struct Whole<'a> {
    ir: &'a Netlist,
    printer: &'a Printer<'a>,
    borders: &'a Borders,
}

impl Whole<'_> {
    /// The name of a part in the headings of other parts.
    fn name(&self, part: usize) -> &str {
        match part {
            0 => &self.ir.name,
            part => &self.ir.parts[part - 1].name,
        }
    }

    /// The heading of an input of a part: that of the module's port, or the part from which it comes.
    fn from(&self, id: Id) -> String {
        let plan = &self.printer.plan;
        let (of, _) = slice_of(plan, id);
        let mut ports = self.ir.ports.iter();
        let port = ports.find(|(port, node)| *node == of && port.direction == Direction::Input);
        match port {
            Some((port, _)) if !port.group.is_empty() => port.group.clone(),
            _ => format!("From {}", self.name(self.borders.source(plan, id))),
        }
    }

    /// The heading of an output of a part.
    fn to(&self, id: Id) -> String {
        let plan = &self.printer.plan;
        let mut ports = self.ir.ports.iter();
        let port = ports.find(|(port, node)| {
            plan.signal(plan.stands[*node]) == id && port.direction == Direction::Output
        });
        match port {
            Some((port, _)) if !port.group.is_empty() => port.group.clone(),
            _ => {
                let readers: Vec<_> = self
                    .borders
                    .readers(id)
                    .map(|part| self.name(part))
                    .collect();
                format!("To {}", readers.join(", "))
            }
        }
    }
}

/// Creates the netlist of a part, or of the module that instantiates the parts.
struct Maker<'a> {
    whole: &'a Whole<'a>,
    part: usize,
    made: Netlist,
    /// For each node of the whole that is in this part, or is an input of it, its node in the part.
    numbers: HashMap<Id, Id>,
    /// The nodes of this part that other parts read.
    leaves: BTreeSet<Id>,
    /// The instance of each part, in the module that instantiates them.
    placed: Vec<usize>,
}

impl<'a> Maker<'a> {
    fn new(whole: &'a Whole<'a>, part: usize) -> Maker<'a> {
        let ir = whole.ir;
        let made = match part {
            0 => Netlist::new(ir.name.clone(), ir.doc.clone(), ir.place),
            part => {
                let part = &ir.parts[part - 1];
                let name = format!("{}_{}", ir.name, part.name);
                Netlist::new(name, part.doc.clone(), part.place)
            }
        };
        Maker {
            whole,
            part,
            made,
            numbers: HashMap::new(),
            leaves: whole.borders.leaves(&whole.printer.plan, part),
            placed: vec![],
        }
    }

    fn add(&mut self, of: Id, op: Op, name: Option<String>) -> Id {
        let node = &self.whole.ir.nodes[of];
        if let Some(name) = &name {
            self.made.names.insert(name.clone(), node.place);
        }
        self.made.nodes.push(Node {
            op,
            name,
            hint: None,
            stage: None,
            formal: false,
            ..node.clone()
        });
        self.made.nodes.len() - 1
    }

    /// The node in this part for a node of the whole.
    fn at(&self, id: Id) -> Id {
        let plan = &self.whole.printer.plan;
        let id = plan.stands[id];
        let here = self.numbers.get(&id);
        *here.unwrap_or_else(|| &self.numbers[&plan.signal(id)])
    }

    /// The name that a node has in the whole.
    fn name(&self, id: Id) -> String {
        self.whole.printer.names.of[id].clone()
    }

    fn port(&mut self, id: Id, direction: Direction, group: String, node: Id) {
        let (name, place) = (self.name(id), self.whole.ir.nodes[id].place);
        self.made.names.insert(name.clone(), place);
        let port = Port {
            name,
            width: self.whole.ir.nodes[id].width,
            direction,
            group,
            stage: None,
        };
        self.made.ports.push((port, node));
    }

    /// Creates the inputs of a part; its outputs get their nodes later.
    fn ports_of_part(&mut self) {
        let (whole, borders) = (self.whole, self.whole.borders);
        let plan = &whole.printer.plan;
        let mut entering: Vec<Id> = borders.enters[self.part].iter().copied().collect();
        entering.sort_by_key(|id| (borders.source(plan, *id), *id));
        for id in entering {
            let node = self.add(id, Op::Input, Some(self.name(id)));
            self.made.items.push(Item::Node(node));
            self.numbers.insert(id, node);
            self.port(id, Direction::Input, whole.from(id), node);
        }
    }

    /// Creates the wires between parts, and an instance of each part.
    fn place_parts(&mut self, parts: &[Arc<Module>]) {
        let (whole, borders) = (self.whole, self.whole.borders);
        let plan = &whole.printer.plan;
        self.made
            .items
            .push(Item::Comment("Between the parts.".into()));
        for part in 1..=parts.len() {
            for id in borders.leaves(plan, part) {
                // A port of the module needs no wire.
                let name = (!whole.printer.names.port[id]).then(|| self.name(id));
                let wire = self.add(id, Op::Wire, name);
                self.made.items.push(Item::Node(wire));
                self.numbers.insert(id, wire);
            }
        }
        for module in parts {
            self.placed.push(self.made.instances.len());
            self.made.instances.push(InstanceData {
                name: whole.ir.parts[self.placed.len() - 1].name.clone(),
                module: module.clone(),
                inputs: vec![],
                outputs: vec![],
            });
        }
    }

    /// Copies the nodes of the whole that belong to this part.
    fn make(&mut self) {
        let whole = self.whole;
        let plan = &whole.printer.plan;
        let has = &whole.borders.has[self.part];
        for &id in has {
            // The operands may be made later.
            let number = self.add(id, Op::Input, None);
            self.numbers.insert(id, number);
        }
        let memories = self.memories();
        let instances = self.instances();
        for &id in has {
            let number = self.numbers[&id];
            let op = plan.ops[id].map(&mut |id| self.at(id));
            let op = match op {
                Op::Read(memory, copy, address, synchronous) => {
                    Op::Read(memories[&memory], copy, address, synchronous)
                }
                Op::Instance(instance, port) => Op::Instance(instances[&instance], port),
                op => op,
            };
            if let Some(driver) = whole.ir.drivers.get(&id) {
                let driver = self.at(*driver);
                self.made.drivers.insert(number, driver);
            }
            if let Some(place) = whole.ir.driven_at.get(&id) {
                self.made.driven_at.insert(number, *place);
            }
            let (name, hint) = self.naming(id);
            if let Some(name) = &name {
                let place: Place = whole.ir.nodes[id].place;
                self.made.names.insert(name.clone(), place);
            }
            let node = &mut self.made.nodes[number];
            (node.op, node.name, node.hint) = (op, name, hint);
            node.stage = whole.ir.nodes[id].stage;
        }
        if self.part > 0 {
            for id in self.leaves.clone() {
                self.port(id, Direction::Output, whole.to(id), self.numbers[&id]);
            }
        }
        self.items(&memories, &instances);
    }

    /// A node's name and its hint, which are the same as in the whole.
    fn naming(&self, id: Id) -> (Option<String>, Option<Hint>) {
        let plan = &self.whole.printer.plan;
        let called = |name| Hint {
            name,
            after: None,
            field: true,
        };
        match (&plan.given[id], &plan.ops[id]) {
            // The port has its name.
            _ if self.part > 0 && self.leaves.contains(&id) => (None, None),
            _ if plan.signal(id) != id => (Some(self.name(id)), None),
            (Some(name), _) => (Some(name.clone()), None),
            _ if !plan.declared[id] => {
                let hint = plan.hints[id].clone().filter(|hint| hint.after.is_none());
                (None, hint)
            }
            // A port of the module stays a port here.
            _ if self.part == 0 && self.whole.printer.names.port[id] => (None, None),
            (None, Op::Register(_)) => (Some(self.name(id)), None),
            _ => (None, Some(called(self.name(id)))),
        }
    }

    fn memories(&mut self) -> HashMap<usize, usize> {
        let whole = self.whole;
        let plan = &whole.printer.plan;
        let mut numbers = HashMap::new();
        for (index, memory) in whole.ir.memories.iter().enumerate() {
            if whole.borders.owners.memories[index] == self.part && !plan.copies[index].is_empty() {
                let mut memory = memory.clone();
                let write = memory.write;
                memory.write = write.map(|(e, a, d)| (self.at(e), self.at(a), self.at(d)));
                self.made.names.insert(memory.name.clone(), memory.place);
                numbers.insert(index, self.made.memories.len());
                self.made.memories.push(memory);
            }
        }
        numbers
    }

    fn instances(&mut self) -> HashMap<usize, usize> {
        let whole = self.whole;
        let mut numbers = HashMap::new();
        for (index, instance) in whole.ir.instances.iter().enumerate() {
            if whole.borders.owners.instances[index] != self.part {
                continue;
            }
            let mut instance = instance.clone();
            for (_, id) in &mut instance.inputs {
                *id = self.at(*id);
            }
            for (_, id) in &mut instance.outputs {
                *id = self.numbers[id];
            }
            self.made
                .names
                .insert(instance.name.clone(), whole.ir.place);
            numbers.insert(index, self.made.instances.len());
            self.made.instances.push(instance);
        }
        numbers
    }

    /// The items of this part in order, with each instance of a part at the end of the part's description.
    fn items(&mut self, memories: &HashMap<usize, usize>, instances: &HashMap<usize, usize>) {
        let whole = self.whole;
        let has = &whole.borders.has[self.part];
        let mut ends = HashMap::new();
        let mut part = 0;
        for (place, item) in whole.ir.items.iter().enumerate() {
            if let Item::Part(begun) = item {
                ends.insert(part, place);
                part = *begun;
            }
        }
        for (place, item) in whole.ir.items.iter().enumerate() {
            match item {
                Item::Part(begun) => {
                    if self.part == 0 && part > 0 && ends[&part] == place {
                        self.connect(part);
                    }
                    part = *begun;
                }
                Item::Comment(_) if part == self.part => self.made.items.push(item.clone()),
                Item::Node(id) if has.contains(id) => {
                    self.made.items.push(Item::Node(self.numbers[id]));
                }
                Item::Drive(id) if has.contains(id) => {
                    self.made.items.push(Item::Drive(self.numbers[id]));
                }
                Item::Memory(index) => {
                    let here = memories.get(index).map(|index| Item::Memory(*index));
                    self.made.items.extend(here);
                }
                Item::Instance(index) => {
                    let here = instances.get(index).map(|index| Item::Instance(*index));
                    self.made.items.extend(here);
                }
                Item::Comment(_) | Item::Node(_) | Item::Drive(_) => {}
            }
        }
    }

    /// Connects the instance of a part.
    fn connect(&mut self, part: usize) {
        let (whole, borders) = (self.whole, self.whole.borders);
        let plan = &whole.printer.plan;
        let instance = self.placed[part - 1];
        let inputs = borders.enters[part].iter();
        let inputs: Vec<_> = inputs
            .map(|id| (self.name(*id), self.numbers[id]))
            .collect();
        self.made.instances[instance].inputs = inputs;
        let mut drives = vec![];
        for id in borders.leaves(plan, part) {
            let name = self.name(id);
            let ports = &self.made.instances[instance].module.ports;
            let port = ports.iter().position(|port| port.name == name);
            let port = port.expect("a part has a port for what leaves it");
            let output = self.add(id, Op::Instance(instance, port), None);
            let wire = self.numbers[&id];
            self.made.instances[instance].outputs.push((name, output));
            self.made.drivers.insert(wire, output);
            self.made.items.push(Item::Node(output));
            drives.push(Item::Drive(wire));
        }
        self.made.items.push(Item::Instance(instance));
        self.made.items.extend(drives);
    }

    /// Creates the ports of the whole.
    fn ports_of_whole(&mut self) {
        for (port, id) in &self.whole.ir.ports {
            let place = self.whole.ir.nodes[*id].place;
            self.made.names.insert(port.name.clone(), place);
            let node = self.at(*id);
            self.made.ports.push((port.clone(), node));
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Builder, Design, Direction, Module, Select, Style};
    use std::sync::Arc;

    fn adder() -> Arc<Module> {
        let m = Builder::new("adder", "adds, a clock later.");
        let p = m.pipeline();
        let sum = p.input("a", 8) + p.input("b", 8);
        m.output("sum", sum.register());
        m.finish().unwrap()
    }

    /// A unit that stores requests in a list and sums them, unless told to wait.
    fn unit(in_parts: bool) -> Arc<Module> {
        let m = Builder::new("unit", "lists and sums.");
        let part = |name: &str, doc: &str, describe: &dyn Fn()| match in_parts {
            true => m.part(name, doc, describe),
            false => describe(),
        };
        m.group("Requests");
        let (valid, word) = (m.input("valid", 1), m.input("word", 24));
        m.group("Sums");
        let ready = m.input("ready", 1);
        let taken = m.wire("taken", 1);
        let count = std::cell::Cell::new(None);
        let listed = std::cell::Cell::new(None);
        part("list", "keeps what was asked for.", &|| {
            m.comment("The newest word has the number `count`.");
            let number = m.reg_reset("count", 2, 0);
            number.next_when(valid, number.q + m.lit(1u8, 2));
            let words = m.memory("words", 4, 16, Style::Distributed);
            words.write(valid & taken.get(), number.q, word.low(16));
            listed.set(Some(words.read(number.q)));
            count.set(Some(number.q));
        });
        let listed = listed.get().unwrap();
        let sum = std::cell::Cell::new(None);
        part("summing", "adds the halves of a word.", &|| {
            let p = m.pipeline();
            let (a, b) = (p.enter_at(listed.low(8), 0), p.enter_at(listed.high(8), 0));
            let adder = m.instance("adder", &adder(), &[("a", a), ("b", b)]);
            let total = (adder.get("sum") + a).named("total").register();
            let late = (total ^ b.at(8)).at(9).untimed();
            taken.drive(ready & !late.any());
            sum.set(Some(late));
        });
        m.output("sum", sum.get().unwrap());
        m.output("busy", count.get().unwrap().any() & !taken.get());
        m.output("top", word.high(8));
        m.finish().unwrap()
    }

    fn text(design: &Design, module: &str) -> String {
        design.verilog(design.module(module).unwrap())
    }

    #[test]
    fn parts_are_modules_of_their_own() {
        let design = Design::new(unit(true)).unwrap();
        let files = design.files();
        let names: Vec<_> = files.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(
            names,
            ["unit_list.v", "adder.v", "unit_summing.v", "unit.v"]
        );
        let ports = |name: &str, direction| -> Vec<String> {
            let module = design.module(name).unwrap();
            let ports = module.ports().iter();
            let ports = ports.filter(|port| port.direction == direction);
            ports.map(|port| port.name.clone()).collect()
        };
        use Direction::{Input, Output};
        // The field crosses the boundary, not its word.
        assert_eq!(
            ports("unit_list", Input),
            ["clk", "rst", "valid", "words_write_data", "taken"]
        );
        assert_eq!(ports("unit_list", Output), ["count", "words_read"]);
        assert_eq!(ports("unit_summing", Input), ["clk", "ready", "words_read"]);
        assert_eq!(ports("unit_summing", Output), ["sum", "taken"]);
        let top = text(&design, "unit");
        for line in [
            "wire [15:0] words_write_data = word[15:0];\n\n  unit_list list (",
            "  wire taken;\n",
            ".sum(sum),",
            "assign busy = (|count) & ~taken;",
        ] {
            assert!(top.contains(line), "no {line} in {top}");
        }
        assert!(
            !top.contains("always") && !top.contains("assign sum"),
            "{top}"
        );
        assert!(text(&design, "unit_list").contains("\n  // To summing\n"));
        assert!(text(&design, "unit_summing").contains("\n  // From list\n"));
    }

    #[test]
    fn what_is_in_parts_is_the_whole() {
        let (whole, parts) = (unit(false), unit(true));
        let compared = parts.compare_parts(parts.outline.as_ref().unwrap());
        let compared = compared.unwrap();
        assert_eq!((compared.outputs, compared.registers), (4, 1));
        assert_eq!((compared.memories, compared.instances), (1, 1));
        assert_eq!(whole.compare_outputs(&parts), Ok(compared));
        // After any change of the whole, its parts differ from the original ones.
        let mutations = parts.mutations();
        assert!(mutations.len() > 20, "only {} mutations", mutations.len());
        for site in mutations {
            let changed = parts.with(&site.mutation).unwrap();
            let differs = changed.compare_parts(parts.outline.as_ref().unwrap());
            assert!(differs.is_err(), "{} for {}", site.after, site.before);
        }
    }

    #[test]
    fn changes_reach_the_parts() {
        let design = Design::new(unit(true)).unwrap();
        let total = unit(true).signal("total").unwrap().fault().inverted();
        let changed = design.with(&total).unwrap();
        assert_ne!(
            text(&changed, "unit_summing"),
            text(&design, "unit_summing")
        );
        assert_eq!(text(&changed, "unit_list"), text(&design, "unit_list"));
        let of_part = design.module("unit_list").unwrap();
        let of_part = of_part.signal("count").unwrap().fault().inverted();
        let refused = design.with(&of_part).unwrap_err().message;
        assert_eq!(refused, "it is a part of unit: change that module instead");
        let apart = design.apart().unwrap();
        assert_eq!(apart.files(), design.files());
        let changed = apart.with(&of_part).unwrap();
        assert_ne!(text(&changed, "unit_list"), text(&design, "unit_list"));
        let selectable = apart.selectable(&[(1, &of_part)], Select::Port("mutant"));
        let top = text(&selectable.unwrap(), "unit");
        assert_eq!(top.matches(".mutant(mutant)").count(), 2, "{top}");
    }

    #[test]
    fn a_simulator_checks_what_is_in_parts() {
        let m = Builder::new("unit", "counts.");
        let step = m.input("step", 1);
        let count = m.part("count", "counts steps.", || {
            let count = m.reg_reset("steps", 4, 0);
            count.next_when(step, count.q + m.lit(1u8, 4));
            count.q
        });
        m.output("last", count.all());
        let proof = m.proof("few", "it counts few");
        proof.assert("it is less", count.low(3).lt(m.lit(7u8, 3)));
        let module = m.finish().unwrap();
        let checked = module.checked(&str::to_string);
        assert!(checked.contains("unit_count count ("), "{checked}");
        assert!(checked.contains("if (!(steps[2:0] < 3'd7))"), "{checked}");
        let formal = module.formal("few", &str::to_string).unwrap().text;
        assert!(formal.contains("reg  [3:0] steps;"), "{formal}");
    }
}
