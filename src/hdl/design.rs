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
    pub(super) place: &'static Location<'static>,
    /// For each output port (by name) the inputs that reach it through combinational logic.
    pub(super) paths: BTreeMap<String, Vec<String>>,
}

impl Module {
    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|p| p.name == name)
    }

    pub fn verilog(&self) -> &str {
        &self.verilog
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

/// A top module with everything below it, children first, each module once.
#[derive(Debug)]
pub struct Design {
    modules: Vec<Rc<Module>>,
}

impl Design {
    /// # Errors
    /// Where two different modules have one name.
    pub fn new(top: Rc<Module>) -> Result<Design, HdlError> {
        let mut design = Design { modules: vec![] };
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

    pub fn top(&self) -> &Rc<Module> {
        self.modules.last().expect("a design has a top module")
    }

    /// All modules, children before their parents, the top last.
    pub fn modules(&self) -> &[Rc<Module>] {
        &self.modules
    }

    /// File names and texts, one module a file, children first.
    pub fn files(&self) -> Vec<(String, String)> {
        self.modules
            .iter()
            .map(|m| (format!("{}.v", m.name), m.verilog.clone()))
            .collect()
    }
}
