//! Designs with many changes, one of which is selected.

use super::edit::{Editor, FIRST};
use super::{Edit, Mutation};
use crate::design::{Design, Direction, Module, Port};
use crate::error::HdlError;
use crate::ir::{Binary, Id, Netlist, Node, Op, Root};
use crate::verilog::Printer;
use std::collections::{BTreeMap, HashMap};
use std::panic::Location;
use std::sync::Arc;

/// The way in which a change of [`Design::selectable`] is selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Select<'a> {
    /// By the value of an input port of this name, 32 bits wide, which is added to every module.
    /// Registers with a reset value start with its complement in simulation; otherwise a missing
    /// reset would not show, since simulators start with zeros and most reset values are zero.
    Port(&'a str),
    /// By a constant. Designs made with different constants differ only in that constant.
    Constant(u32),
}

/// Width of the number of a change.
const SELECT_BITS: u32 = 32;

impl Netlist {
    /// Replaces the child modules by modules with the same names and, for `select`, an additional input.
    /// Proofs that refer to a signal that no longer exists are dropped.
    fn place(&mut self, children: &HashMap<&str, Arc<Module>>, select: Option<(&str, Id)>) -> bool {
        let mut placed = false;
        let mut complete = true;
        for (number, instance) in self.instances.iter_mut().enumerate() {
            let Some(child) = children.get(instance.module.name()) else {
                continue;
            };
            placed = true;
            if select.is_some() || child.ir.placed != instance.module.ir.placed {
                self.placed = None;
            }
            for node in &mut self.nodes {
                if let Op::Inside(within, id) = &mut node.op
                    && *within == number
                {
                    match child.declared(instance.module.name_of(*id)) {
                        Some(now) => *id = now,
                        None => complete = false,
                    }
                }
            }
            instance.module = child.clone();
            let select = select.map(|(name, id)| (name.to_string(), id));
            instance.inputs.extend(select);
            for (name, id) in &instance.outputs {
                let port = child.ports.iter().position(|port| port.name == *name);
                let port = port.expect("a changed module has the outputs that it had");
                self.nodes[*id].op = Op::Instance(number, port);
            }
        }
        if !complete {
            self.proofs.clear();
        }
        placed
    }
}

impl Design {
    /// Returns the design with a change in one of its modules.
    ///
    /// # Errors
    /// The design has no such module, the module is a part of another, or the change is not
    /// possible (see [`Module::with`]).
    #[track_caller]
    pub fn with(&self, mutation: &Mutation) -> Result<Design, HdlError> {
        let place = Location::caller();
        self.changeable(&mutation.module)?;
        self.rebuilt(&|module, children| {
            if module.name() == mutation.module {
                return module.changed(mutation, place).map(Some);
            }
            let mut ir = module.ir.clone();
            let placed = ir.place(children, None);
            placed.then(|| Module::of(ir).map(Arc::new)).transpose()
        })
    }

    /// Returns a module by its name in the description, without a prefix.
    ///
    /// # Errors
    /// The design has no such module; the message suggests similar names.
    #[track_caller]
    pub fn module(&self, name: &str) -> Result<&Arc<Module>, HdlError> {
        let place = Location::caller();
        let found = self.modules.iter().find(|module| module.name() == name);
        found.ok_or_else(|| {
            let names: Vec<_> = self.modules.iter().map(|module| module.name()).collect();
            let top = self.top();
            top.missing("the design has no module", name, &names, place)
        })
    }

    /// Checks that a module is not a part, because parts are derived from their modules.
    #[track_caller]
    fn changeable(&self, name: &str) -> Result<(), HdlError> {
        let place = Location::caller();
        let module = self.module(name)?;
        let of = |whole: &&Arc<Module>| whole.parts().iter().any(|part| part.name() == name);
        match self.modules.iter().find(of) {
            Some(whole) => {
                let message = format!(
                    "it is a part of {}: change that module instead",
                    whole.name()
                );
                Err(module.error(message, place))
            }
            None => Ok(()),
        }
    }

    /// Returns the design in which [parts](crate::Builder::part) have become ordinary modules, as
    /// they are in the Verilog. Properties are dropped.
    ///
    /// # Errors
    /// None for a design made by this crate; an error of a module that is rebuilt is passed on.
    pub fn apart(&self) -> Result<Design, HdlError> {
        let mut printed: HashMap<&str, Arc<Module>> = HashMap::new();
        let mut top = self.top().clone();
        for module in &self.modules {
            let shown = module
                .outline
                .as_ref()
                .map_or(module, |outline| &outline.top);
            let mut ir = shown.ir.clone();
            top = match ir.place(&printed, None) {
                true => Arc::new(Module::of(ir)?),
                false => shown.clone(),
            };
            printed.insert(module.name(), top.clone());
        }
        Ok(Design::new(top)?.with_prefix(self.prefix.clone()))
    }

    /// Returns a design that contains many changes, each with a number. The change whose number is
    /// selected takes effect; none does if the selected number is 0 or not among them.
    ///
    /// # Errors
    /// A change is of no module of the design, or is not possible (see [`Module::with`]).
    #[track_caller]
    pub fn selectable(
        &self,
        changes: &[(u32, &Mutation)],
        select: Select<'_>,
    ) -> Result<Design, HdlError> {
        let place = Location::caller();
        for (_, change) in changes {
            self.changeable(&change.module)?;
        }
        self.rebuilt(&|module, children| {
            let of_module = changes.iter().filter(|(_, m)| m.module == module.name());
            let of_module: Vec<_> = of_module.copied().collect();
            let selected = module.selecting(&of_module, select, children);
            selected
                .map_err(|why| module.error(why, place))
                .and_then(Module::of)
                .map(|module| Some(Arc::new(module)))
        })
    }

    fn rebuilt(&self, change: &Rebuild<'_>) -> Result<Design, HdlError> {
        let mut changed: HashMap<&str, Arc<Module>> = HashMap::new();
        let mut top = self.top().clone();
        // Parts are derived from their modules.
        for module in self.units() {
            let new = change(module, &changed)?;
            if let Some(new) = &new {
                changed.insert(module.name(), new.clone());
            }
            top = new.unwrap_or_else(|| module.clone());
        }
        Ok(Design::new(top)?.with_prefix(self.prefix.clone()))
    }
}

/// Rebuilds a module if it or a module below it has changed.
type Rebuild<'a> =
    dyn Fn(&Module, &HashMap<&str, Arc<Module>>) -> Result<Option<Arc<Module>>, HdlError> + 'a;

impl Module {
    fn selecting(
        &self,
        changes: &[(u32, &Mutation)],
        select: Select<'_>,
        children: &HashMap<&str, Arc<Module>>,
    ) -> Result<Netlist, String> {
        let printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        let selected = match select {
            Select::Constant(number) => editor.literal(number.into(), SELECT_BITS),
            Select::Port(_) => editor.push((0, FIRST), Op::Input, SELECT_BITS),
        };
        let mut choices: BTreeMap<Root, Vec<(Id, Id)>> = BTreeMap::new();
        let mut resets: BTreeMap<Id, Vec<(Id, Option<u128>)>> = BTreeMap::new();
        for (number, mutation) in changes {
            let number = editor.literal((*number).into(), SELECT_BITS);
            let holds = Op::Binary(Binary::Equal, selected, number);
            let holds = editor.push((0, FIRST), holds, 1);
            for (root, new) in editor.resolve(mutation)? {
                choices.entry(root).or_default().push((holds, new));
            }
            if let Edit::Reset(register, value) = mutation.edit {
                let register = editor.stands[register];
                resets.entry(register).or_default().push((holds, value));
            }
        }
        for (root, choices) in choices {
            let gap = editor.gap(root);
            let mut chosen = match editor.get(root) {
                Err(_) if matches!(root, Root::Enable(_)) => editor.literal(1, 1),
                id => id?,
            };
            for (holds, new) in choices {
                let width = editor.ir.nodes[chosen].width;
                chosen = editor.push(gap, Op::Mux(holds, new, chosen), width);
                if let Root::Value(id) = root {
                    editor.exempt.insert((chosen, id));
                }
            }
            editor.set(root, chosen);
        }
        let mut input = None;
        if let Select::Port(name) = select {
            input = Some((name, selected));
            editor.input(name, selected)?;
            for node in &mut editor.ir.nodes {
                let width = node.width;
                if let Op::Register(register) = &mut node.op {
                    register.initial = register.reset.map(|value| !value & ones(width));
                }
            }
        }
        for (register, choices) in resets {
            editor.choose_reset(register, &choices);
        }
        editor.ir.place(children, input);
        Ok(editor.finish())
    }
}

pub(super) fn ones(width: u32) -> u128 {
    if width >= 128 {
        u128::MAX
    } else {
        (1 << width) - 1
    }
}

impl Editor {
    /// Replaces a node by an input.
    fn input(&mut self, name: &str, id: Id) -> Result<(), String> {
        if self
            .ir
            .names
            .insert(name.to_string(), self.ir.place)
            .is_some()
        {
            return Err(format!("name clash: a signal is already called {name}"));
        }
        self.ir.nodes[id].name = Some(name.to_string());
        let port = Port {
            name: name.to_string(),
            width: SELECT_BITS,
            direction: Direction::Input,
            group: String::new(),
            stage: None,
        };
        self.ir.ports.insert(0, (port, id));
        Ok(())
    }

    /// Replaces the reset of a register by logic, so that the reset value can be selected.
    fn choose_reset(&mut self, id: Id, choices: &[(Id, Option<u128>)]) {
        let Node { op, width, .. } = self.ir.nodes[id].clone();
        let Op::Register(register) = op else {
            return; // resolved: it is one that reset sets
        };
        let (Some(reset), Some(mut next)) = (register.reset, register.next) else {
            return;
        };
        let gap = self.gap(Root::Next(id));
        if let Some(enable) = register.enable {
            next = self.push(gap, Op::Mux(enable, next, id), width);
        }
        let mut resets = self.push((0, FIRST), Op::Reset, 1);
        let mut value = self.literal(reset, width);
        for (holds, choice) in choices {
            match choice {
                Some(other) => {
                    let other = self.literal(*other, width);
                    value = self.push(gap, Op::Mux(*holds, other, value), width);
                }
                None => {
                    let not = self.not(gap, *holds);
                    resets = self.push(gap, Op::Binary(Binary::And, resets, not), 1);
                }
            }
        }
        let next = self.push(gap, Op::Mux(resets, value, next), width);
        self.set(Root::Next(id), next);
        if let Op::Register(register) = &mut self.ir.nodes[id].op {
            (register.enable, register.reset) = (None, None);
        }
    }
}
