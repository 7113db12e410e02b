//! Modules with Verilog parameters: one Verilog module for all sizes of a queue or an adder.
//!
//! A description in Rust is a function of numbers, and each set of numbers gives a netlist of its own, which is
//! simulated, proved and changed like any other. [`Library::module`] also describes a few samples, derives from them
//! how every number in the Verilog depends on the parameters, and checks the result against the requested member. A
//! design then contains one module with parameters in place of all members.

use super::design::Module;
use super::error::HdlError;
use super::verilog::{Printer, Template};
use std::sync::Arc;

/// A Verilog parameter of a [`Library`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// The name, in capital letters.
    pub name: &'static str,
    /// The comment that is printed after the declaration.
    pub doc: &'static str,
    /// Whether the parameter is one bit that selects between two variants; otherwise it is a number.
    pub flag: bool,
}

impl Parameter {
    /// Declares a parameter that is a number, such as a width.
    pub const fn number(name: &'static str, doc: &'static str) -> Parameter {
        Parameter {
            name,
            doc,
            flag: false,
        }
    }

    /// Declares a parameter of one bit.
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

/// The library module and the parameters of an instance.
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

/// A family of modules that become one Verilog module with parameters. A value of type `P`
/// identifies a member of the family.
///
/// The description of a member must not depend on its numbers in any other way than through widths
/// and values: use [`Builder::simplify`](crate::Builder::simplify)`(false)`. Each number in the
/// Verilog must equal a parameter, a parameter plus or minus 1, or a constant. Other
/// values, such as the number of address bits for a depth, are parameters of their own.
///
/// ```
/// use dynrt_hdl::{Builder, Design, HdlError, Library, Module, Parameter};
/// use std::sync::Arc;
///
/// fn describe(width: u32) -> Result<Arc<Module>, HdlError> {
///     let m = Builder::new(format!("counter_{width}"), "counts.");
///     m.simplify(false);
///     let count = m.reg_reset("count", width, 0);
///     count.next(count.q + m.lit(1u8, width));
///     m.output("value", count.q);
///     m.finish()
/// }
///
/// fn counter(width: u32) -> Result<Arc<Module>, HdlError> {
///     let library = Library {
///         name: "counter",
///         doc: "counts in WIDTH bits.",
///         parameters: &[Parameter::number("WIDTH", "bits of the counter")],
///         values: &|width| vec![*width],
///         samples: &[8, 12],
///         describe: &|width| describe(*width),
///     };
///     library.module(&width)
/// }
///
/// let m = Builder::new("pair", "two counters.");
/// for width in [7, 21] {
///     let instance = m.instance(format!("counter_of_{width}"), &counter(width)?, &[]);
///     m.output(format!("value_{width}"), instance.get("value"));
/// }
/// let files = Design::new(m.finish()?)?.files();
/// let names: Vec<_> = files.iter().map(|(name, _)| name.as_str()).collect();
/// assert_eq!(names, ["counter.v", "pair.v"]);
/// assert!(files[1].1.contains("counter #(.WIDTH(21)) counter_of_21 ("));
/// # Ok::<(), HdlError>(())
/// ```
pub struct Library<'a, P> {
    /// The name of the Verilog module.
    pub name: &'a str,
    /// A description of the module in terms of the parameters, printed in the head of its file.
    pub doc: &'a str,
    /// The parameters.
    pub parameters: &'a [Parameter],
    /// Returns the values of the parameters for a member, in the order of `parameters`.
    pub values: &'a dyn Fn(&P) -> Vec<u32>,
    /// Members that are compared to find out how each number depends on the parameters. No two
    /// parameters may have the same values in all samples, even up to a constant difference. The
    /// first sample gives the default values.
    pub samples: &'a [P],
    /// Describes a member as a module without parameters.
    pub describe: &'a dyn Fn(&P) -> Result<Arc<Module>, HdlError>,
}

impl<P> Library<'_, P> {
    /// Returns a member of the family. It is a module with fixed numbers, which can be simulated,
    /// proved and changed like any other; in a [`Design`](crate::Design) it is emitted as an
    /// instance of the module with parameters.
    ///
    /// # Errors
    /// An error of `describe`; a number of the Verilog that follows from no parameter; two members
    /// whose Verilog differs in more than numbers.
    pub fn module(&self, of: &P) -> Result<Arc<Module>, HdlError> {
        let module = (self.describe)(of)?;
        let error = |message: String| HdlError {
            module: module.ir.name.clone(),
            message: format!("as a member of library {}: {message}", self.name),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builder, Design};

    /// Variants of a counter's description, some of which are invalid in a library.
    #[derive(Clone, Copy, PartialEq)]
    enum Way {
        Plain,
        /// The counter of 8 bits has a second output.
        Another,
        /// The counter counts in steps of its width squared.
        Squared,
    }

    fn counter(way: Way, width: u32) -> Result<Arc<Module>, HdlError> {
        let m = Builder::new(format!("counter_{width}"), "counts.");
        m.simplify(false);
        let count = m.reg_reset("count", width, 3);
        let step = if way == Way::Squared {
            width * width
        } else {
            width - 1
        };
        count.next(count.q + m.lit(step, width));
        m.output("value", count.q);
        if way == Way::Another && width == 8 {
            m.output("any", count.q.any());
        }
        m.finish()
    }

    fn made(way: Way, width: u32, samples: &[u32]) -> Result<Arc<Module>, HdlError> {
        let library = Library {
            name: "counter",
            doc: "counts in WIDTH bits.",
            parameters: &[Parameter::number("WIDTH", "bits")],
            values: &|width| vec![*width],
            samples,
            describe: &|width| counter(way, *width),
        };
        library.module(&width)
    }

    /// Two counters side by side.
    fn pair() -> Arc<Module> {
        let m = Builder::new("pair", "two counters.");
        for width in [7, 21] {
            let module = made(Way::Plain, width, &[8, 12]).unwrap();
            let counter = m.instance(format!("counter_of_{width}"), &module, &[]);
            m.output(format!("value_{width}"), counter.get("value"));
        }
        m.finish().unwrap()
    }

    #[test]
    fn sizes_are_one_module_in_a_design() {
        let design = Design::new(pair()).unwrap();
        assert_eq!(design.modules().len(), 3);
        let files = design.files();
        let names: Vec<_> = files.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["counter.v", "pair.v"]);
        for said in [
            "parameter WIDTH = 8 // bits",
            "output wire [WIDTH-1:0] value",
            "localparam [WIDTH-1:0] WIDTH_THREE = 3;",
            "localparam [WIDTH-1:0] WIDTH_LAST = WIDTH[WIDTH-1:0] - 1;",
            "count <= count + WIDTH_LAST;",
        ] {
            assert!(files[0].1.contains(said), "{said}\n{}", files[0].1);
        }
        assert!(
            files[1].1.contains("counter #(.WIDTH(21)) counter_of_21 ("),
            "{}",
            files[1].1
        );
        // A module alone has no parameters.
        let alone = design.module("counter_7").unwrap();
        assert!(
            alone.verilog().contains("count <= count + 7'd6;"),
            "{}",
            alone.verilog()
        );
        assert_eq!(alone.parameters(), [("WIDTH", 7)]);
        let top = Design::new(alone.clone()).unwrap();
        assert_eq!(top.files()[0].0, "counter_7.v");
    }

    #[test]
    fn what_is_changed_is_none_of_the_library() {
        let design = Design::new(pair()).unwrap();
        let module = design.module("counter_7").unwrap();
        let change = module.signal("count").unwrap().without_reset();
        let changed = design.with(&change).unwrap().files();
        let names: Vec<_> = changed.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["counter_7.v", "counter.v", "pair.v"]);
        assert!(
            changed[2].1.contains("counter_7 counter_of_7 ("),
            "{}",
            changed[2].1
        );
    }

    #[test]
    fn what_has_no_one_text_is_refused() {
        let message = |way, width, samples: &[u32]| made(way, width, samples).unwrap_err().message;
        let other = message(Way::Another, 8, &[9, 12]);
        assert!(
            other.starts_with("as a member of library counter: texts differ in more than numbers"),
            "{other}"
        );
        let other = message(Way::Another, 9, &[8, 12]);
        assert!(
            other.contains("texts differ in more than numbers"),
            "{other}"
        );
        let squared = message(Way::Squared, 9, &[8, 12]);
        assert!(
            squared.contains("[64, 144] does not follow from a parameter"),
            "{squared}"
        );
        // One sample cannot show that a number is not constant; the requested member does.
        let squared = message(Way::Squared, 9, &[8]);
        assert!(squared.contains("is not"), "{squared}");
    }
}
