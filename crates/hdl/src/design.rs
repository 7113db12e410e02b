//! Finished modules and the hierarchy below a top module.

use super::check;
use super::error::HdlError;
use super::ir::{Id, Netlist, Op};
use super::outline::{Outline, outline};
use super::verilog::{self, Printed, Printer};
use std::collections::{BTreeMap, HashSet};
use std::panic::Location;
use std::sync::Arc;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    Input,
    Output,
}

/// A port of a module. `clk` and `rst` are ports like others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    pub name: String,
    pub width: u32,
    pub direction: Direction,
    /// The heading of the group that the port stands in.
    pub group: String,
    /// The pipeline stage of a pipelined module's port.
    pub stage: Option<u32>,
}

/// A finished module: its interface, its netlist, and the Verilog that is printed from it.
#[derive(Debug)]
pub struct Module {
    pub(super) ir: Netlist,
    pub(super) ports: Vec<Port>,
    pub(super) children: Vec<Arc<Module>>,
    pub(super) printed: Printed,
    /// The same where modules of the library stand with parameters, if it places any.
    placing: Option<Printed>,
    /// Of a module of the library: the text that it shares.
    library: Option<Printed>,
    /// Of a module in parts: as it is printed for all but properties.
    pub(super) outline: Option<Outline>,
    /// For each output port (by name) the inputs that reach it through combinational logic.
    pub(super) paths: BTreeMap<String, Vec<String>>,
}

/// Modules of one netlist are one module.
impl PartialEq for Module {
    fn eq(&self, other: &Module) -> bool {
        self.ir == other.ir
    }
}

impl Module {
    /// Checks a netlist and prints it.
    pub(super) fn of(ir: Netlist) -> Result<Module, HdlError> {
        let paths = check::check(&ir)?;
        let mut printer = Printer::new(&ir);
        let printed = printer.print();
        let (placing, library) = (printer.placing(), printer.library());
        if let (Some(proof), false) = (ir.proofs.first(), printed.clocked && printed.reset) {
            return Err(HdlError {
                module: ir.name.clone(),
                message: format!("proof {}: the module needs a clock and a reset", proof.name),
                place: proof.place,
            });
        }
        for node in &ir.nodes {
            if let Op::Peek(memory, _) = node.op
                && printed.copies[memory] == 0
            {
                let name = &ir.memories[memory].name;
                return Err(HdlError {
                    module: ir.name.clone(),
                    message: format!("memory \"{name}\" is read only by properties"),
                    place: node.place,
                });
            }
        }
        let mut ports = vec![];
        for (present, name) in [(printed.clocked, "clk"), (printed.reset, "rst")] {
            if present {
                ports.push(Port {
                    name: name.to_string(),
                    width: 1,
                    direction: Direction::Input,
                    group: String::new(),
                    stage: None,
                });
            }
        }
        let order = verilog::port_order(&ir.ports);
        ports.extend(order.into_iter().map(|i| ir.ports[i].0.clone()));
        let instances = ir.instances.iter();
        let module = Module {
            ports,
            children: instances.map(|instance| instance.module.clone()).collect(),
            printed,
            placing,
            library,
            outline: outline(&printer)?,
            paths,
            ir,
        };
        if let Some(outline) = &module.outline {
            module.compare_parts(outline).map_err(|what| HdlError {
                module: module.name().to_string(),
                message: format!("internal error: its parts differ from the whole: {what}"),
                place: module.ir.place,
            })?;
        }
        Ok(module)
    }

    /// Its name in the description, without the prefix that a design may put before it: see [`Design::emitted`].
    pub fn name(&self) -> &str {
        &self.ir.name
    }

    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|p| p.name == name)
    }

    /// The node that is declared under a name in the Verilog.
    pub(super) fn declared(&self, name: &str) -> Option<Id> {
        let names = self.printed.signals.iter();
        names
            .clone()
            .position(|known| known.as_deref() == Some(name))
    }

    /// The name under which a node is declared in the Verilog.
    pub(super) fn name_of(&self, node: Id) -> &str {
        self.printed.signals[node]
            .as_deref()
            .expect("a node that was found by its name")
    }

    /// Names of signals in its Verilog that the description does not say, and where each signal is made: they tell a reader nothing.
    /// [`Signal::named`](super::Signal::named) and [`Signal::hinted`](super::Signal::hinted) give better ones.
    pub fn made_up_names(&self) -> impl Iterator<Item = (&str, &'static Location<'static>)> {
        let names = self.printed.made_up.iter();
        names.map(|(name, node)| (name.as_str(), self.ir.nodes[*node].place))
    }

    /// How many signals its Verilog declares.
    pub fn signal_count(&self) -> usize {
        self.printed.signals.iter().flatten().count()
    }

    /// Its Verilog by itself, in which modules have their names without a prefix and no parameters. Of a module in parts, that which
    /// places them.
    pub fn verilog(&self) -> &str {
        &self.shown().text
    }

    /// Its parts as modules.
    pub fn parts(&self) -> &[Arc<Module>] {
        (self.outline.as_ref()).map_or(&[], |outline| outline.parts.as_slice())
    }

    /// What is printed for all but properties.
    fn shown(&self) -> &Printed {
        (self.outline.as_ref()).map_or(&self.printed, |outline| &outline.top.printed)
    }

    /// The name that its module has in a design's Verilog, without a prefix: one of the library stands for all that differ in numbers.
    pub fn module_name(&self) -> &str {
        match &self.ir.placed {
            Some(placed) => &placed.module.name,
            None => self.name(),
        }
    }

    /// Of a module of the library: the names of its parameters, and their values.
    pub fn parameters(&self) -> Vec<(&'static str, u32)> {
        let placed = self.ir.placed.iter();
        placed.flat_map(|placed| placed.parameters()).collect()
    }

    /// What a design has of it by itself: modules of the library that it places stand with parameters.
    fn placing(&self) -> &Printed {
        let module = match &self.outline {
            Some(outline) => &outline.top,
            None => self,
        };
        module.placing.as_ref().unwrap_or(&module.printed)
    }

    /// Its Verilog with another name for every module, its own and those that it places. Line by line it is [`Self::verilog`].
    pub fn verilog_with(&self, emitted: &dyn Fn(&str) -> String) -> String {
        renamed(&self.shown().text, &self.shown().names, emitted)
    }

    /// The modules that it places, in the order of the instances.
    pub fn children(&self) -> &[Arc<Module>] {
        (self.outline.as_ref()).map_or(&self.children, |outline| &outline.top.children)
    }

    /// The stage of a pipelined module's port.
    ///
    /// # Errors
    /// There is no such port, or it has no stage.
    #[track_caller]
    pub fn stage(&self, port: &str) -> Result<u32, HdlError> {
        let place = Location::caller();
        let stage = self.port(port).map(|port| port.stage);
        let message = match stage {
            Some(Some(stage)) => return Ok(stage),
            Some(None) => format!("port {port} has no stage"),
            None => format!("has no port {port}"),
        };
        Err(HdlError {
            module: self.name().to_string(),
            message,
            place,
        })
    }

    /// Registers between inputs and outputs of a pipelined module; `None` where outputs have no stage
    /// or differing ones.
    pub fn latency(&self) -> Option<u32> {
        let mut outputs = self
            .ports
            .iter()
            .filter(|p| p.direction == Direction::Output)
            .map(|p| p.stage);
        let first = outputs.next()??;
        outputs.all(|s| s == Some(first)).then_some(first)
    }
}

/// A text with other names for modules, which begin at `places`.
pub(super) fn renamed(text: &str, places: &[usize], emitted: &dyn Fn(&str) -> String) -> String {
    let mut renamed = String::with_capacity(text.len());
    let mut done = 0;
    for &place in places {
        let rest = &text[place..];
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
        let name = &rest[..end.unwrap_or(rest.len())];
        renamed.push_str(&text[done..place]);
        renamed.push_str(&emitted(name));
        done = place + name.len();
    }
    renamed + &text[done..]
}

/// What the names of all modules of a design begin with, so that two machines can stand in one design.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Prefix(String);

impl Prefix {
    /// What a prefix must be.
    pub const PATTERN: &str = "[a-z][a-z0-9_]*";
    /// The most characters of a prefix: files are named after modules.
    pub const MOST: usize = 100;

    /// No prefix: modules have the names of the description.
    pub fn none() -> Prefix {
        Prefix::default()
    }

    /// The prefix as text; empty for none.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl std::str::FromStr for Prefix {
    type Err = String;

    fn from_str(text: &str) -> Result<Prefix, String> {
        let follows = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        let matches =
            text.starts_with(|c: char| c.is_ascii_lowercase()) && text.chars().all(follows);
        if !matches || text.len() > Prefix::MOST {
            return Err(format!(
                "prefix `{}`: is not of the pattern {} and at most {} characters long, such as small_",
                text.escape_debug(),
                Prefix::PATTERN,
                Prefix::MOST
            ));
        }
        Ok(Prefix(text.to_string()))
    }
}

/// A top module with everything below it, children first, each module once.
#[derive(Clone, Debug)]
pub struct Design {
    pub(super) modules: Vec<Arc<Module>>,
    pub(super) prefix: Prefix,
    /// Whether simulators are to check properties.
    checked: bool,
}

impl Design {
    /// # Errors
    /// Where two different modules have one name.
    pub fn new(top: Arc<Module>) -> Result<Design, HdlError> {
        let mut design = Design {
            modules: vec![],
            prefix: Prefix::none(),
            checked: false,
        };
        design.add(&top)?;
        for module in &design.modules {
            design.check_library(module)?;
        }
        Ok(design)
    }

    /// Checks that a module of the library has a name of its own.
    fn check_library(&self, module: &Module) -> Result<(), HdlError> {
        let Some(placed) = &module.ir.placed else {
            return Ok(());
        };
        let clashes = |other: &&Arc<Module>| match &other.ir.placed {
            Some(known) => known.module != placed.module && known.module.name == placed.module.name,
            None => other.name() == placed.module.name,
        };
        match self.modules.iter().find(clashes) {
            None => Ok(()),
            Some(other) => Err(HdlError {
                module: module.name().to_string(),
                message: format!(
                    "name clash: it is a member of library {}, and {} is a different module of that name",
                    placed.module.name,
                    other.name()
                ),
                place: module.ir.place,
            }),
        }
    }

    fn add(&mut self, module: &Arc<Module>) -> Result<(), HdlError> {
        if let Some(other) = self.modules.iter().find(|m| m.name() == module.name()) {
            if other != module {
                return Err(HdlError {
                    module: module.name().to_string(),
                    message: format!(
                        "name clash: a different module of this name was made at {}:{}",
                        other.ir.place.file(),
                        other.ir.place.line()
                    ),
                    place: module.ir.place,
                });
            }
            return Ok(());
        }
        for below in module.parts().iter().chain(&module.children) {
            self.add(below)?;
        }
        self.modules.push(module.clone());
        Ok(())
    }

    /// The same design, every module's name after a prefix wherever it is printed.
    pub fn with_prefix(self, prefix: Prefix) -> Design {
        Design { prefix, ..self }
    }

    /// What names begin with; none in a design that was just made.
    pub fn prefix(&self) -> &Prefix {
        &self.prefix
    }

    /// How a module (or another part) of this name is called in the emitted Verilog: the prefix, then the name. Files are named so too.
    pub fn emitted(&self, name: &str) -> String {
        format!("{}{name}", self.prefix.0)
    }

    /// The same design, whose Verilog simulators check where the macro `DYNRT_CHECKS` is defined: see [`Module::checked`].
    pub fn with_checks(self) -> Design {
        Design {
            checked: true,
            ..self
        }
    }

    pub fn is_checked(&self) -> bool {
        self.checked
    }

    /// The name of a module in the emitted Verilog; its file is named after it.
    pub fn module_name(&self, module: &Module) -> String {
        // Of a module's properties many are about its numbers: checked, it stands by itself.
        let by_itself = self.checked || std::ptr::eq(module, &**self.top());
        self.emitted(match by_itself {
            true => module.name(),
            false => module.module_name(),
        })
    }

    /// A module's Verilog as it is emitted. The top has no parameters.
    pub fn verilog(&self, module: &Module) -> String {
        let emitted = |name: &str| self.emitted(name);
        if self.checked {
            return module.checked(&emitted);
        }
        let shown = match &module.library {
            Some(library) if !std::ptr::eq(module, &**self.top()) => library,
            _ => module.placing(),
        };
        renamed(&shown.text, &shown.names, &emitted)
    }

    pub fn top(&self) -> &Arc<Module> {
        self.modules.last().expect("a design has a top module")
    }

    /// All modules, children before their parents, the top last.
    pub fn modules(&self) -> &[Arc<Module>] {
        &self.modules
    }

    /// The modules without the parts of others, children before their parents.
    pub fn units(&self) -> impl Iterator<Item = &Arc<Module>> {
        let parts = self.modules.iter().flat_map(|module| module.parts());
        let parts: HashSet<&str> = parts.map(|part| part.name()).collect();
        (self.modules.iter()).filter(move |module| !parts.contains(module.name()))
    }

    /// The modules of the emitted Verilog, children first: of those that are one module of the library the first.
    pub fn emitted_modules(&self) -> Vec<&Arc<Module>> {
        let mut names = HashSet::new();
        let modules = self.modules.iter();
        let modules = modules.filter(|module| names.insert(self.module_name(module)));
        modules.collect()
    }

    /// File names and texts as they are emitted, one module a file, children first.
    pub fn files(&self) -> Vec<(String, String)> {
        let modules = self.emitted_modules().into_iter();
        modules
            .map(|module| (self.module_name(module) + ".v", self.verilog(module)))
            .collect()
    }
}
