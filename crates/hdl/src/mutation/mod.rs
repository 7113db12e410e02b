//! Single changes of a module: mutants, and faults that proofs and tests must detect.

mod edit;
mod refs;
mod select;
mod sites;

pub use refs::{InstanceRef, MemoryRef, SignalRef};
pub use select::Select;
pub use sites::{Kind, Site};

use super::builder::Builder;
#[cfg(doc)]
use super::design::Design;
use super::design::Module;
use super::ir::{Id, Netlist, Place, Root};
use super::memory::Memory;
use super::signal::Signal;
use std::panic::Location;

/// A single change of one module: a mutant, or a fault that proofs and tests must detect.
///
/// It states that one place reads another value. It is made from [`Signal`]s in a description, or
/// from [`SignalRef`]s, by name, in a finished module; [`Reads`] lists the changes. [`Module::with`] returns the
/// module with the change, [`Design::with`] the design, and [`Design::selectable`] a design with many
/// changes, one of which can be selected. [`Module::mutations`] lists all single changes of a module.
///
/// Only the nodes between the place and the replaced value are copied: other readers of shared logic are not
/// affected.
///
/// ```
/// use dynrt_hdl::{Builder, HdlError};
/// let m = Builder::new("adder", "sum = a + b.");
/// m.output("sum", (m.input("a", 8) + m.input("b", 8)).register());
/// let adder = m.finish()?;
///
/// let (sum, a) = (adder.signal("sum")?, adder.signal("a")?);
/// let faulty = adder.with(&sum.reads(a).as_value(0))?;
/// assert!(adder.verilog().contains("sum <= a + b;"));
/// assert!(faulty.verilog().contains("sum <= 8'd0 + b;"));
/// # Ok::<(), HdlError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Mutation {
    module: String,
    edit: Edit,
}

impl Mutation {
    /// Returns the name of the module that is changed.
    pub fn module(&self) -> &str {
        &self.module
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Edit {
    Read(Where, Change),
    /// The reset value of a register, or none.
    Reset(Id, Option<u128>),
    /// The reason why the change does not exist.
    Wrong(String),
}

/// The place of a change.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Where {
    /// A node in the computation of a signal.
    Of(Point, Id),
    /// The literals with a value in the computation of a signal.
    Literal(Point, u128),
    /// An operand of the expression that computes a signal, or an operand of that operand, and so on.
    Operand(Point, Vec<usize>),
    /// A signal, for all of its readers.
    Everywhere(Point),
    /// The node that a place reads, or an operand of it, given by a path.
    At(Slot, Vec<usize>),
}

/// A signal, by its node or, for an output, by its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Point {
    Node(Id),
    Output(usize),
}

/// A place that reads a node, with a name in the public interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Slot(pub(super) Root);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Change {
    Value(u128),
    Inverted,
    /// The bits of a mask are inverted.
    Flipped(u128),
    Signal(Id),
    Late,
    Early,
    /// Another operator, or none.
    Operator,
    /// A slice without its top bit, or one bit lower.
    Shorter,
    Lower,
}

/// The source of signals: a description, or a finished module.
pub trait Owner: Sized {
    type Signal;

    fn made(&self, edit: Edit, place: Place) -> Mutation;

    /// The node of the signal, if it belongs to the owner.
    fn point(&self, signal: Self::Signal) -> Option<Point>;

    fn id(&self, point: Point) -> Id;
}

impl<'b> Owner for &'b Builder {
    type Signal = Signal<'b>;

    fn made(&self, edit: Edit, place: Place) -> Mutation {
        let module = self.name.clone();
        let mutation = Mutation { module, edit };
        let mut inner = self.inner.borrow_mut();
        inner.mutations.push((mutation.clone(), place));
        mutation
    }

    fn point(&self, signal: Signal<'b>) -> Option<Point> {
        std::ptr::eq(signal.builder, *self).then_some(Point::Node(signal.id))
    }

    fn id(&self, point: Point) -> Id {
        self.inner.borrow().ir.node_of(point)
    }
}

impl<'m> Owner for &'m Module {
    type Signal = SignalRef<'m>;

    fn made(&self, edit: Edit, _: Place) -> Mutation {
        let module = self.name().to_string();
        Mutation { module, edit }
    }

    fn point(&self, signal: SignalRef<'m>) -> Option<Point> {
        std::ptr::eq(signal.module, *self).then_some(signal.point)
    }

    fn id(&self, point: Point) -> Id {
        self.ir.node_of(point)
    }
}

impl Netlist {
    fn node_of(&self, point: Point) -> Id {
        match point {
            Point::Node(id) => id,
            Point::Output(port) => self.ports[port].1,
        }
    }
}

/// One or more places that read a signal, without the replacement. Each method
/// completes it to a [`Mutation`].
///
/// Whether the mutation is possible is checked later: by
/// [`Builder::finish`](crate::Builder::finish) if it is part of a description, otherwise by
/// [`Module::with`].
#[must_use]
#[derive(Clone)]
pub struct Reads<O> {
    owner: O,
    at: Result<Where, String>,
}

impl<O: Owner> Reads<O> {
    fn made_of(self, change: Result<Change, String>, place: Place) -> Mutation {
        let edit = match self.at.and_then(|at| Ok(Edit::Read(at, change?))) {
            Ok(edit) => edit,
            Err(why) => Edit::Wrong(why),
        };
        self.owner.made(edit, place)
    }

    /// Reads a constant instead. The value must fit the width.
    #[track_caller]
    pub fn as_value(self, value: u128) -> Mutation {
        self.made_of(Ok(Change::Value(value)), Location::caller())
    }

    /// Reads the value with all bits inverted.
    #[track_caller]
    pub fn inverted(self) -> Mutation {
        self.made_of(Ok(Change::Inverted), Location::caller())
    }

    /// Reads the value with the bits of `mask` inverted. The mask must fit the width.
    #[track_caller]
    pub fn with_flipped(self, mask: u128) -> Mutation {
        self.made_of(Ok(Change::Flipped(mask)), Location::caller())
    }

    /// Reads another signal of the module, which must have the same width.
    #[track_caller]
    pub fn as_signal(self, other: O::Signal) -> Mutation {
        let point = self.owner.point(other);
        let change = point.map(|point| Change::Signal(self.owner.id(point)));
        let change = change.ok_or("the signal to be read instead is of another module".to_string());
        self.made_of(change, Location::caller())
    }

    /// Replaces the operator that computes the value by a related one, such as `-` for `+` or `|`
    /// for `&`; removes it if it is `~`.
    #[track_caller]
    pub fn other_operator(self) -> Mutation {
        self.made_of(Ok(Change::Operator), Location::caller())
    }

    /// Reads the value of the previous cycle.
    #[track_caller]
    pub fn one_clock_late(self) -> Mutation {
        self.made_of(Ok(Change::Late), Location::caller())
    }

    /// Reads the value one cycle early: the input of a pipeline register instead of its output.
    #[track_caller]
    pub fn one_clock_early(self) -> Mutation {
        self.made_of(Ok(Change::Early), Location::caller())
    }
}

macro_rules! changes_of_signals {
    ($signal:ty, $owner:ty, $of:expr) => {
        /// Places for a [`Mutation`].
        impl<'b> $signal {
            fn reading(self, at: impl FnOnce(Point) -> Where) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                let point = owner.point(self).expect("a signal is of its own module");
                Reads {
                    at: Ok(at(point)),
                    owner,
                }
            }

            /// Names the places where the computation of this signal reads `of`.
            ///
            /// The computation of a signal is its combinational logic; that of a wire is the logic
            /// of its driver, that of a register the logic of its next value and its enable. If the
            /// logic back to the nearest named signals reads `of`, only that is changed; otherwise
            /// the search continues beyond them. In a pipeline, `of` also stands for its delayed
            /// copies if it is not read itself.
            pub fn reads(self, of: Self) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                let of = owner.point(of).map(|of| owner.id(of));
                match of {
                    Some(of) => self.reading(|point| Where::Of(point, of)),
                    None => Reads {
                        at: Err("the signal that is read is of another module".into()),
                        owner,
                    },
                }
            }

            /// Names the literals of this value in the computation of this signal: see
            /// [`reads`](Self::reads).
            pub fn literal_of(self, value: u128) -> Reads<$owner> {
                self.reading(|point| Where::Literal(point, value))
            }

            /// Names an operand in the expression that computes this signal. The path holds the
            /// number of an operand, from 0, then the number of an operand of that, and so on; an
            /// empty path names the whole expression.
            pub fn operand(self, path: &[usize]) -> Reads<$owner> {
                self.reading(|point| Where::Operand(point, path.to_vec()))
            }

            /// Names all places that read this signal.
            pub fn fault(self) -> Reads<$owner> {
                self.reading(Where::Everywhere)
            }

            /// Names the enable of this register; a register without one has the constant 1.
            pub fn enable(self) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                self.reading(|point| Where::At(Slot(Root::Enable(owner.id(point))), vec![]))
            }

            /// Removes the reset of this register: reset leaves it as it is.
            #[track_caller]
            pub fn without_reset(self) -> Mutation {
                let owner: $owner = $of(&self);
                let point = owner.point(self).expect("a signal is of its own module");
                owner.made(Edit::Reset(owner.id(point), None), Location::caller())
            }
        }
    };
}
changes_of_signals!(Signal<'b>, &'b Builder, |signal: &Signal<'b>| signal
    .builder);
changes_of_signals!(SignalRef<'b>, &'b Module, |signal: &SignalRef<'b>| signal
    .module);

impl<'b> Reads<&'b Builder> {
    pub(super) fn of_input(
        owner: &'b Builder,
        instance: usize,
        input: Result<usize, String>,
    ) -> Self {
        let slot = |input| Where::At(Slot(Root::Input(instance, input)), vec![]);
        Reads {
            owner,
            at: input.map(slot),
        }
    }
}

fn write_port<O>(owner: O, memory: usize, role: usize) -> Reads<O> {
    Reads {
        owner,
        at: Ok(Where::At(Slot(Root::Write(memory, role)), vec![])),
    }
}

impl<'b> Memory<'b> {
    /// Names the enable of the write port, for a [`Mutation`].
    pub fn write_enable(&self) -> Reads<&'b Builder> {
        write_port(self.builder, self.index, 0)
    }

    /// Names the address of the write port, for a [`Mutation`].
    pub fn write_address(&self) -> Reads<&'b Builder> {
        write_port(self.builder, self.index, 1)
    }

    /// Names the data of the write port, for a [`Mutation`].
    pub fn write_data(&self) -> Reads<&'b Builder> {
        write_port(self.builder, self.index, 2)
    }
}
