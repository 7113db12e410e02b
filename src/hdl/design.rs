//! Finished modules and the hierarchy below a top module.

use super::error::HdlError;
use std::collections::BTreeMap;
use std::panic::Location;
use std::rc::Rc;

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

/// A finished module: its interface and its Verilog.
#[derive(Debug)]
pub struct Module {
    pub(super) name: String,
    pub(super) ports: Vec<Port>,
    pub(super) children: Vec<Rc<Module>>,
    pub(super) verilog: String,
    /// Where in `verilog` a module's name begins, ascending.
    pub(super) names: Vec<usize>,
    pub(super) place: &'static Location<'static>,
    /// For each output port (by name) the inputs that reach it through combinational logic.
    pub(super) paths: BTreeMap<String, Vec<String>>,
}

impl Module {
    /// Its name in the description, without the prefix that a design may put before it: see [`Design::emitted`].
    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|p| p.name == name)
    }

    /// Its Verilog, in which modules have their names without a prefix.
    pub fn verilog(&self) -> &str {
        &self.verilog
    }

    /// Its Verilog with another name for every module, its own and those that it places. Line by line it is [`Self::verilog`].
    pub fn verilog_with(&self, emitted: &dyn Fn(&str) -> String) -> String {
        let mut text = String::with_capacity(self.verilog.len());
        let mut done = 0;
        for &place in &self.names {
            let rest = &self.verilog[place..];
            let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
            let name = &rest[..end.unwrap_or(rest.len())];
            text.push_str(&self.verilog[done..place]);
            text.push_str(&emitted(name));
            done = place + name.len();
        }
        text + &self.verilog[done..]
    }

    pub fn children(&self) -> &[Rc<Module>] {
        &self.children
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
                crate::text::escaped(text),
                Prefix::PATTERN,
                Prefix::MOST
            ));
        }
        Ok(Prefix(text.to_string()))
    }
}

/// A top module with everything below it, children first, each module once.
#[derive(Debug)]
pub struct Design {
    modules: Vec<Rc<Module>>,
    prefix: Prefix,
}

impl Design {
    /// # Errors
    /// Where two different modules have one name.
    pub fn new(top: Rc<Module>) -> Result<Design, HdlError> {
        let mut design = Design {
            modules: vec![],
            prefix: Prefix::none(),
        };
        design.add(&top)?;
        Ok(design)
    }

    fn add(&mut self, module: &Rc<Module>) -> Result<(), HdlError> {
        if let Some(other) = self.modules.iter().find(|m| m.name == module.name) {
            if other.verilog != module.verilog {
                return Err(HdlError {
                    module: module.name.clone(),
                    message: format!(
                        "name clash: a different module of this name was made at {}:{}",
                        other.place.file(),
                        other.place.line()
                    ),
                    place: module.place,
                });
            }
            return Ok(());
        }
        for child in &module.children {
            self.add(child)?;
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

    /// A module's Verilog as it is emitted.
    pub fn verilog(&self, module: &Module) -> String {
        module.verilog_with(&|name| self.emitted(name))
    }

    pub fn top(&self) -> &Rc<Module> {
        self.modules.last().expect("a design has a top module")
    }

    /// All modules, children before their parents, the top last.
    pub fn modules(&self) -> &[Rc<Module>] {
        &self.modules
    }

    /// File names and texts as they are emitted, one module a file, children first.
    pub fn files(&self) -> Vec<(String, String)> {
        self.modules
            .iter()
            .map(|m| (self.emitted(&m.name) + ".v", self.verilog(m)))
            .collect()
    }
}
