//! Finished modules and the hierarchy below a top module.

use super::check;
use super::error::HdlError;
use super::ir::{Id, Netlist, Op};
use super::outline::{Outline, outline};
use super::verilog::{self, Printed, Printer};
use std::collections::{BTreeMap, HashSet};
use std::panic::Location;
use std::sync::Arc;

/// The direction of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The module reads the port.
    Input,
    /// The module drives the port.
    Output,
}

/// A port of a module. The clock `clk` and the reset `rst` are listed as ports too, if the
/// module has them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// The name.
    pub name: String,
    /// The width in bits, at least 1.
    pub width: u32,
    /// The direction.
    pub direction: Direction,
    /// The heading under which the port is declared: see [`Builder::group`](crate::Builder::group).
    pub group: String,
    /// The stage of the port in its pipeline; `None` for a port that belongs to no pipeline.
    pub stage: Option<u32>,
}

/// A finished module: its ports, its netlist and its Verilog.
///
/// Two modules are equal if their netlists are.
#[derive(Debug)]
pub struct Module {
    pub(super) ir: Netlist,
    pub(super) ports: Vec<Port>,
    pub(super) children: Vec<Arc<Module>>,
    pub(super) printed: Printed,
    /// The text with library modules instantiated by parameters, if there are any.
    placing: Option<Printed>,
    /// For a module of a library, the text shared by all its sizes.
    library: Option<Printed>,
    /// For a module with parts, its printed form, except for properties.
    pub(super) outline: Option<Outline>,
    /// For each output port (by name), the inputs that reach it through combinational logic.
    pub(super) paths: BTreeMap<String, Vec<String>>,
}

/// Compares the netlists.
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

    /// Returns the name in the description, without the prefix of a design (see
    /// [`Design::emitted`]).
    pub fn name(&self) -> &str {
        &self.ir.name
    }

    /// Returns all ports in the order in which the Verilog declares them.
    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    /// Returns the port called `name`, if there is one.
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

    /// Returns the names of signals in the Verilog that do not follow from the description, each
    /// with the place where the signal is made in the Rust source. Such names tell a reader
    /// nothing; [`Signal::named`](super::Signal::named) and
    /// [`Signal::hinted`](super::Signal::hinted) replace them.
    pub fn made_up_names(&self) -> impl Iterator<Item = (&str, &'static Location<'static>)> {
        let names = self.printed.made_up.iter();
        names.map(|(name, node)| (name.as_str(), self.ir.nodes[*node].place))
    }

    /// Returns the number of signals that the Verilog declares.
    pub fn signal_count(&self) -> usize {
        self.printed.signals.iter().flatten().count()
    }

    /// Returns the Verilog of this module alone, with modules named without a prefix and without
    /// parameters. For a module with [parts](crate::Builder::part) this is the module that
    /// instantiates them.
    pub fn verilog(&self) -> &str {
        &self.shown().text
    }

    /// Returns the [parts](crate::Builder::part) of the module, each as a module.
    pub fn parts(&self) -> &[Arc<Module>] {
        (self.outline.as_ref()).map_or(&[], |outline| outline.parts.as_slice())
    }

    /// The printed form, except for properties.
    fn shown(&self) -> &Printed {
        (self.outline.as_ref()).map_or(&self.printed, |outline| &outline.top.printed)
    }

    /// Returns the name of the module in the Verilog of a design, without a prefix. For a module of
    /// a [`Library`](crate::Library) this is the name of the library, which all its sizes share;
    /// otherwise it is [`Module::name`].
    pub fn module_name(&self) -> &str {
        match &self.ir.placed {
            Some(placed) => &placed.module.name,
            None => self.name(),
        }
    }

    /// Returns the names and values of the Verilog parameters of a module of a
    /// [`Library`](crate::Library); nothing for other modules.
    pub fn parameters(&self) -> Vec<(&'static str, u32)> {
        let placed = self.ir.placed.iter();
        placed.flat_map(|placed| placed.parameters()).collect()
    }

    /// The text in a design, in which library modules are instantiated by parameters.
    fn placing(&self) -> &Printed {
        let module = match &self.outline {
            Some(outline) => &outline.top,
            None => self,
        };
        module.placing.as_ref().unwrap_or(&module.printed)
    }

    /// Returns the Verilog with every module name replaced by `emitted` of it, both the module's
    /// own name and those of the modules that it instantiates. It has the same lines as
    /// [`Module::verilog`].
    pub fn verilog_with(&self, emitted: &dyn Fn(&str) -> String) -> String {
        renamed(&self.shown().text, &self.shown().names, emitted)
    }

    /// Returns the modules that are instantiated, in the order of the instances. A module that is
    /// instantiated twice is listed twice.
    pub fn children(&self) -> &[Arc<Module>] {
        (self.outline.as_ref()).map_or(&self.children, |outline| &outline.top.children)
    }

    /// Returns the pipeline stage of a port.
    ///
    /// # Errors
    /// The module has no such port, or the port belongs to no pipeline.
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

    /// Returns the number of registers between the inputs at stage 0 and the outputs of a pipelined
    /// module. The result is `None` if an output has no stage, if the outputs have different
    /// stages, or if there is no output.
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

/// A text with the names of modules, which start at `places`, replaced.
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

/// A prefix for the names of all modules of a design, so that two designs can be used in one
/// project.
///
/// A prefix is parsed from text: it consists of a lower-case letter followed by lower-case letters,
/// digits and `_`, at most [`Prefix::MOST`] characters in all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Prefix(String);

impl Prefix {
    /// The regular expression that a prefix matches.
    pub const PATTERN: &str = "[a-z][a-z0-9_]*";
    /// The greatest length of a prefix in characters. Files are named after modules, so the prefix
    /// is part of file names.
    pub const MOST: usize = 100;

    /// Returns the empty prefix: modules keep the names of the description.
    pub fn none() -> Prefix {
        Prefix::default()
    }

    /// Returns the prefix as text; it is empty for [`Prefix::none`].
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

/// A top module and all modules below it. Every module is listed once, children before their
/// parents.
#[derive(Clone, Debug)]
pub struct Design {
    pub(super) modules: Vec<Arc<Module>>,
    pub(super) prefix: Prefix,
    /// Whether the Verilog contains properties for simulators.
    checked: bool,
}

impl Design {
    /// Collects the modules below `top`.
    ///
    /// # Errors
    /// Two different modules have the same name.
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

    /// Checks that a library module's name is not used by another module.
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

    /// Returns the design with `prefix` before the names of all modules.
    pub fn with_prefix(self, prefix: Prefix) -> Design {
        Design { prefix, ..self }
    }

    /// Returns the prefix; it is empty unless [`Design::with_prefix`] has set one.
    pub fn prefix(&self) -> &Prefix {
        &self.prefix
    }

    /// Returns the name that a module called `name` has in the emitted Verilog: the prefix followed
    /// by the name.
    pub fn emitted(&self, name: &str) -> String {
        format!("{}{name}", self.prefix.0)
    }

    /// Returns the design with the properties of its modules in the Verilog, which simulators check
    /// if the macro `DYNRT_CHECKS` is defined (see [`Module::checked`]).
    pub fn with_checks(self) -> Design {
        Design {
            checked: true,
            ..self
        }
    }

    /// Returns whether the Verilog contains properties (see [`Design::with_checks`]).
    pub fn is_checked(&self) -> bool {
        self.checked
    }

    /// Returns the name of a module of this design in the emitted Verilog, with the prefix. Its
    /// file has the same name.
    pub fn module_name(&self, module: &Module) -> String {
        // Many properties of a module refer to its numbers, so with checks it is not shared.
        let by_itself = self.checked || std::ptr::eq(module, &**self.top());
        self.emitted(match by_itself {
            true => module.name(),
            false => module.module_name(),
        })
    }

    /// Returns the emitted Verilog of a module of this design. A module of a
    /// [`Library`](crate::Library) has parameters, unless it is the top module or the design is
    /// [checked](Design::with_checks).
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

    /// Returns the top module.
    pub fn top(&self) -> &Arc<Module> {
        self.modules.last().expect("a design has a top module")
    }

    /// Returns all modules, children before their parents, the top module last.
    /// [Parts](crate::Builder::part) of modules are among them.
    pub fn modules(&self) -> &[Arc<Module>] {
        &self.modules
    }

    /// Returns the modules that are not [parts](crate::Builder::part) of others, children before
    /// their parents.
    pub fn units(&self) -> impl Iterator<Item = &Arc<Module>> {
        let parts = self.modules.iter().flat_map(|module| module.parts());
        let parts: HashSet<&str> = parts.map(|part| part.name()).collect();
        (self.modules.iter()).filter(move |module| !parts.contains(module.name()))
    }

    /// Returns one module for each module of the emitted Verilog, children before their parents.
    /// All sizes of a [`Library`](crate::Library) share one Verilog module, for which the first of
    /// them is returned.
    pub fn emitted_modules(&self) -> Vec<&Arc<Module>> {
        let mut names = HashSet::new();
        let modules = self.modules.iter();
        let modules = modules.filter(|module| names.insert(self.module_name(module)));
        modules.collect()
    }

    /// Returns the names and contents of the emitted files, one module per file, children before
    /// their parents.
    pub fn files(&self) -> Vec<(String, String)> {
        let modules = self.emitted_modules().into_iter();
        modules
            .map(|module| (self.module_name(module) + ".v", self.verilog(module)))
            .collect()
    }
}
