//! Modules with parameters: one text for all sizes of a queue, a reader, an adder.
//!
//! A description is given numbers, and each set of them makes a netlist of its own, which is simulated, proved and changed like any other.
//! [`Library::module`] describes a few samples too, finds out how every number in their Verilog follows from the parameters, and checks that
//! the same holds of the module that is asked for. A design then has one module, with Verilog parameters, in place of all of those.

use super::design::Module;
use super::error::HdlError;
use super::verilog::{Printer, Template};
use std::sync::Arc;

/// A Verilog parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    pub name: &'static str,
    /// What it says, behind its name.
    pub doc: &'static str,
    /// Whether it is one bit, an alternative, rather than a number.
    pub flag: bool,
}

impl Parameter {
    /// A number, such as a width.
    pub const fn number(name: &'static str, doc: &'static str) -> Parameter {
        Parameter {
            name,
            doc,
            flag: false,
        }
    }

    /// An alternative: 0 or 1.
    pub const fn flag(name: &'static str, doc: &'static str) -> Parameter {
        Parameter {
            name,
            doc,
            flag: true,
        }
    }
}

/// A module with parameters, as it is printed.
#[derive(Debug, PartialEq)]
pub(super) struct Parameterised {
    pub name: String,
    pub template: Template,
}

/// What a module is printed as where it is placed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Placed {
    pub module: Arc<Parameterised>,
    /// The parameters' values.
    pub values: Vec<u32>,
}

impl Placed {
    /// The parameters' names, and their values.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, u32)> + '_ {
        let names = self.module.template.parameters().iter();
        let names = names.map(|parameter| parameter.name);
        names.zip(self.values.iter().copied())
    }
}

/// Modules of one text, which differ in numbers.
pub struct Library<'a, P> {
    pub name: &'a str,
    /// What the module is, in terms of the parameters.
    pub doc: &'a str,
    pub parameters: &'a [Parameter],
    /// The parameters of a module.
    pub values: &'a dyn Fn(&P) -> Vec<u32>,
    /// Which tell the parameters apart: no two have the same values in all samples. The first gives the defaults.
    pub samples: &'a [P],
    /// Makes a module by itself.
    pub describe: &'a dyn Fn(&P) -> Result<Arc<Module>, HdlError>,
}

impl<P> Library<'_, P> {
    /// The module for some numbers.
    ///
    /// # Errors
    /// As its description. A number of the text follows from the parameters in no simple way, or the texts of two modules differ in more
    /// than numbers.
    pub fn module(&self, of: &P) -> Result<Arc<Module>, HdlError> {
        let module = (self.describe)(of)?;
        let error = |message: String| HdlError {
            module: module.ir.name.clone(),
            message: format!("as the library's {}: {message}", self.name),
            place: module.ir.place,
        };
        let mut samples = vec![];
        for sample in self.samples {
            let described = (self.describe)(sample)?;
            let text = Printer::new(&described.ir).general(self.name, self.doc);
            samples.push(((self.values)(sample), text));
        }
        let template = Template::new(self.parameters, &samples).map_err(error)?;
        let placed = Placed {
            module: Arc::new(Parameterised {
                name: self.name.to_string(),
                template,
            }),
            values: (self.values)(of),
        };
        let text = Printer::new(&module.ir).general(self.name, self.doc);
        let template = &placed.module.template;
        template.check(&placed.values, &text).map_err(error)?;
        let mut ir = module.ir.clone();
        ir.placed = Some(placed);
        Module::of(ir).map(Arc::new)
    }
}
