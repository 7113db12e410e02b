//! Bundles: Rust structs of signals, for the fields of a word and for the ports of a module.
//!
//! [`bundle!`](macro@crate::bundle) defines a struct that is generic in the type of its leaves. With leaves of type
//! [`Spec`] it is the definition, with names and widths; the same struct holds [`Signal`]s, [`Wire`]s, the ports of
//! a simulated model, or numbers. A misspelt field is an error of the Rust compiler.
//! [`interface!`](crate::interface) defines the inputs and outputs of a module the same way, under headings.
//!
//! ```
//! use dynrt_hdl::{Builder, Signals, Specs};
//! dynrt_hdl::bundle! {
//!     /// An interval of numbers.
//!     pub struct Interval(number: u32) {
//!         /// The lower bound.
//!         low: number,
//!         /// The upper bound.
//!         high: number,
//!     }
//! }
//! dynrt_hdl::bundle! {
//!     struct Entry(number: u32, doubled: bool) {
//!         origin: [number; xyz],         // origin_x, origin_y, origin_z
//!         interval: {Interval}(number), // interval_low, interval_high
//!         second if (doubled): number,
//!     }
//! }
//! let m = Builder::new("example", "Delays an entry by a cycle and swaps its bounds.");
//! let entry = Entry::of(8, false);
//! assert_eq!(entry.width(), 5 * 8);
//! let word = m.input("word", entry.width());
//! let Entry { origin, interval, second } = entry.unpack(word).register();
//! let interval = Interval { low: interval.high, high: interval.low };
//! m.output("swapped", entry.pack(Entry { origin, interval, second }));
//! m.finish().unwrap();
//! ```

use super::builder::{Builder, Outputs, Wire};
use super::design::Module;
use super::ir::Place;
use super::pipeline::Pipeline;
use super::signal::Signal;
use std::convert::Infallible;
use std::fmt;
use std::panic::Location;
use std::sync::Arc;

/// The definition of a field: its name, its width and the heading under which it is declared as a
/// port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    /// The full name, with the names of the bundles that contain the field.
    pub name: String,
    /// The width in bits.
    pub width: u32,
    /// The heading of the port; empty for none.
    pub heading: String,
}

impl Spec {
    /// Declares the field as an input port without a stage.
    #[track_caller]
    pub fn input<'b>(&self, m: &'b Builder) -> Signal<'b> {
        self.input_from(m, None, Location::caller())
    }

    /// Declares the field as an input port of a pipeline, at stage `at`.
    #[track_caller]
    pub fn input_at<'b>(&self, p: &Pipeline<'b>, at: u32) -> Signal<'b> {
        self.input_from(p.builder, Some((p, at)), Location::caller())
    }

    fn input_from<'b>(
        &self,
        m: &'b Builder,
        staged: Option<(&Pipeline<'b>, u32)>,
        place: Place,
    ) -> Signal<'b> {
        m.group(&self.heading);
        let stage = staged.map(|(p, at)| p.stage(at));
        m.input_at(&self.name, self.width, stage, place)
    }

    /// Returns the stage that this port has in a finished module, for use in the description `m` of
    /// another. It is a mistake of `m` if the port has no stage; the result is then 0.
    #[track_caller]
    pub fn stage(&self, m: &Builder, module: &Module) -> u32 {
        let place = Location::caller();
        module.stage(&self.name).unwrap_or_else(|error| {
            m.fail(place, format!("module {}: {}", error.module, error.message));
            0
        })
    }

    fn check(&self, signal: Signal<'_>, place: Place) {
        if signal.width() != self.width {
            signal.builder.fail(
                place,
                format!(
                    "width mismatch: {} has {} bits, {} has {}",
                    self.name,
                    self.width,
                    signal.describe(),
                    signal.width()
                ),
            );
        }
    }
}

/// The full name of a field: its own, after the names of the bundles that contain it, joined by
/// `_`. It is formatted on demand by its [`Display`](fmt::Display) implementation.
#[derive(Clone, Copy, Debug)]
pub struct Name<'a> {
    around: Option<&'a Name<'a>>,
    own: &'a str,
}

impl<'a> Name<'a> {
    /// The name of a bundle that is in no other bundle; it may be empty.
    fn root(own: &'a str) -> Name<'a> {
        Name { around: None, own }
    }

    fn field(&'a self, own: &'a str) -> Name<'a> {
        let around = (!self.own.is_empty()).then_some(self);
        Name { around, own }
    }
}

impl fmt::Display for Name<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(around) = self.around {
            write!(f, "{around}_")?;
        }
        f.write_str(self.own)
    }
}

/// The structure of a bundle, independent of the type of its leaves. It is implemented by
/// [`bundle!`](macro@crate::bundle).
pub trait Shape {
    /// The bundle with leaves of type `T`.
    type Of<T>;
    /// Whether the names of the fields omit the name of this bundle.
    const FLAT: bool = false;

    /// Calls `f` for every leaf, with its full name, in the order of the definition, and returns
    /// the bundle of the results. `name` is the name of the bundle itself.
    ///
    /// # Errors
    /// The first error of `f`.
    fn each<T, U, E>(
        of: Self::Of<T>,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<Self::Of<U>, E>;

    /// Pairs the leaves of two bundles.
    ///
    /// # Panics
    /// If an optional field is present in only one of them.
    fn zip<T, U>(a: Self::Of<T>, b: Self::Of<U>) -> Self::Of<(T, U)>;

    /// Returns the name of the field `field` in a bundle called `around`.
    fn name<'a>(around: &'a Name<'a>, field: &'a str) -> Name<'a> {
        if Self::FLAT {
            *around
        } else {
            around.field(field)
        }
    }
}

/// The shape of a single value.
pub struct One;
/// The shape of three values, with the suffixes `_x`, `_y` and `_z`.
pub struct Xyz;
/// The shape of `N` values, at most 8, with the suffixes `_0`, `_1`, ….
pub struct Numbered<const N: usize>;

const NUMBERS: [&str; 8] = ["0", "1", "2", "3", "4", "5", "6", "7"];
/// The shape of three bundles. The suffixes `_x`, `_y` and `_z` follow the names of their fields.
pub struct Axes<S>(S);
/// The shape of an optional field.
pub struct Maybe<S>(S);
/// The shape of a bundle whose fields are named without the name of the bundle.
pub struct Flat<S>(S);

impl Shape for One {
    type Of<T> = T;

    fn each<T, U, E>(
        of: T,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<U, E> {
        f(name, of)
    }

    fn zip<T, U>(a: T, b: U) -> (T, U) {
        (a, b)
    }
}

impl Shape for Xyz {
    type Of<T> = [T; 3];

    fn each<T, U, E>(
        [x, y, z]: [T; 3],
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<[U; 3], E> {
        let mut of = |axis, value| f(&name.field(axis), value);
        Ok([of("x", x)?, of("y", y)?, of("z", z)?])
    }

    fn zip<T, U>(a: [T; 3], b: [U; 3]) -> [(T, U); 3] {
        Numbered::<3>::zip(a, b)
    }
}

impl<const N: usize> Shape for Numbered<N> {
    type Of<T> = [T; N];

    fn each<T, U, E>(
        of: [T; N],
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<[U; N], E> {
        let mut all = Vec::with_capacity(N);
        for (i, value) in of.into_iter().enumerate() {
            all.push(f(&name.field(NUMBERS[i]), value)?);
        }
        Ok(all.try_into().unwrap_or_else(|_| unreachable!("N values")))
    }

    fn zip<T, U>(a: [T; N], b: [U; N]) -> [(T, U); N] {
        let mut b = b.into_iter();
        a.map(|a| (a, b.next().expect("N values")))
    }
}

impl<S: Shape> Shape for Axes<S> {
    type Of<T> = [S::Of<T>; 3];

    fn each<T, U, E>(
        [x, y, z]: Self::Of<T>,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<Self::Of<U>, E> {
        let mut of = |axis, of| S::each(of, name, &mut |name, value| f(&name.field(axis), value));
        Ok([of("x", x)?, of("y", y)?, of("z", z)?])
    }

    fn zip<T, U>([ax, ay, az]: Self::Of<T>, [bx, by, bz]: Self::Of<U>) -> Self::Of<(T, U)> {
        [S::zip(ax, bx), S::zip(ay, by), S::zip(az, bz)]
    }
}

impl<S: Shape> Shape for Maybe<S> {
    type Of<T> = Option<S::Of<T>>;
    const FLAT: bool = S::FLAT;

    fn each<T, U, E>(
        of: Self::Of<T>,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<Self::Of<U>, E> {
        of.map(|of| S::each(of, name, f)).transpose()
    }

    fn zip<T, U>(a: Self::Of<T>, b: Self::Of<U>) -> Self::Of<(T, U)> {
        match (a, b) {
            (Some(a), Some(b)) => Some(S::zip(a, b)),
            (None, None) => None,
            _ => panic!("an optional field is present in only one of two bundles"),
        }
    }
}

impl<S: Shape> Shape for Flat<S> {
    type Of<T> = S::Of<T>;
    const FLAT: bool = true;

    fn each<T, U, E>(
        of: Self::Of<T>,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<Self::Of<U>, E> {
        S::each(of, name, f)
    }

    fn zip<T, U>(a: Self::Of<T>, b: Self::Of<U>) -> Self::Of<(T, U)> {
        S::zip(a, b)
    }
}

/// A bundle: a struct whose fields are leaves of type [`Bundle::Leaf`], or bundles of such leaves.
///
/// It is implemented by [`bundle!`](macro@crate::bundle). The names that the methods pass to closures are
/// full names, see [`Name`].
pub trait Bundle: Sized + Clone {
    /// The type of the leaves, such as [`Spec`], [`Signal`] or [`Wire`].
    type Leaf;
    /// The structure.
    type Shape: Shape<Of<Self::Leaf> = Self>;

    /// Calls `f` for every leaf and returns the bundle of the results.
    ///
    /// # Errors
    /// The first error of `f`.
    fn try_map<U, E>(
        &self,
        mut f: impl FnMut(&Name<'_>, Self::Leaf) -> Result<U, E>,
    ) -> Result<Like<Self, U>, E> {
        Self::Shape::each(self.clone(), &Name::root(""), &mut f)
    }

    /// Calls `f` for every leaf, with its full name, and returns the bundle of the results.
    fn map<U>(&self, f: impl FnMut(&Name<'_>, Self::Leaf) -> U) -> Like<Self, U> {
        self.map_in("", f)
    }

    /// As [`map`](Bundle::map), with `prefix` and `_` before all names.
    fn map_in<U>(
        &self,
        prefix: &str,
        mut f: impl FnMut(&Name<'_>, Self::Leaf) -> U,
    ) -> Like<Self, U> {
        let Ok(all) = Self::Shape::each(self.clone(), &Name::root(prefix), &mut |name, leaf| {
            Ok::<U, Infallible>(f(name, leaf))
        });
        all
    }

    /// Pairs the leaves with those of another bundle of the same shape.
    ///
    /// # Panics
    /// If an optional field is present in only one of the bundles.
    fn zip<U>(&self, other: Like<Self, U>) -> Like<Self, (Self::Leaf, U)> {
        Self::Shape::zip(self.clone(), other)
    }

    /// Calls `f` for every leaf together with that of another bundle of the same shape, in the
    /// order of the definition.
    ///
    /// # Panics
    /// If an optional field is present in only one of the bundles.
    fn with<U>(&self, other: Like<Self, U>, mut f: impl FnMut(Self::Leaf, U)) {
        let Ok(_) = Self::Shape::each(self.zip(other), &Name::root(""), &mut |_, (leaf, other)| {
            f(leaf, other);
            Ok::<(), Infallible>(())
        });
    }

    /// Returns the leaves in the order of the definition.
    fn leaves(&self) -> Vec<Self::Leaf> {
        let mut leaves = vec![];
        self.map(|_, leaf| leaves.push(leaf));
        leaves
    }

    /// Returns the names and the leaves in the order of the definition.
    fn fields(&self) -> Vec<(String, Self::Leaf)> {
        let mut fields = vec![];
        self.map(|name, leaf| fields.push((name.to_string(), leaf)));
        fields
    }
}

/// The bundle of the same shape as `B` with leaves of type `T`.
pub type Like<B, T> = <<B as Bundle>::Shape as Shape>::Of<T>;

/// The leaves of two bundles of the same shape, in order.
fn pairs<A: Bundle, U>(a: &A, b: Like<A, U>) -> Vec<(A::Leaf, U)> {
    let mut pairs = vec![];
    a.with(b, |a, b| pairs.push((a, b)));
    pairs
}

/// Operations on all signals of a bundle.
pub trait Signals<'b>: Bundle<Leaf = Signal<'b>> {
    /// Delays every field by one register.
    #[track_caller]
    fn register(&self) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.delay_by(1, place))
    }

    /// Delays every field to the given stage of its pipeline.
    #[track_caller]
    fn at(&self, stage: u32) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.at_from(stage, place))
    }

    /// Removes the stage of every field without delaying it: see [`Signal::untimed`].
    #[track_caller]
    fn untimed(&self) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.untimed_from(place))
    }

    /// Names every field in the Verilog, with `prefix` and `_` before its own name.
    #[track_caller]
    fn named(&self, prefix: impl AsRef<str>) -> Self {
        let place = Location::caller();
        self.map_in(prefix.as_ref(), |name, signal| {
            signal.named_from(&name.to_string(), place)
        })
    }
}

impl<'b, B: Bundle<Leaf = Signal<'b>>> Signals<'b> for B {}

impl<'b> Signal<'b> {
    /// Returns `then` where this bit is 1, `otherwise` where it is 0: a multiplexer for every
    /// field.
    #[track_caller]
    pub fn choose<B: Signals<'b>>(self, then: B, otherwise: B) -> B {
        let place = Location::caller();
        let mut chosen = pairs(&then, otherwise).into_iter();
        then.map(|_, _| {
            let (then, otherwise) = chosen.next().expect("a pair for each field");
            self.mux_from(then, otherwise, place)
        })
    }
}

/// Operations on the definition of a bundle.
pub trait Specs: Bundle<Leaf = Spec> {
    /// Returns the sum of the widths of all fields.
    fn width(&self) -> u32 {
        self.fields().iter().map(|(_, spec)| spec.width).sum()
    }

    /// Concatenates the values of the fields into a word. The first field is the least significant.
    /// The values must have the widths of the definition.
    #[track_caller]
    fn pack<'b>(&self, values: Like<Self, Signal<'b>>) -> Signal<'b> {
        let place = Location::caller();
        let mut parts = vec![];
        for (spec, value) in pairs(self, values) {
            spec.check(value, place);
            parts.push(value);
        }
        parts.reverse();
        parts[0].builder.concat(&parts)
    }

    /// Splits a word into the fields, the inverse of [`pack`](Specs::pack). The word must have the
    /// [width](Specs::width) of the bundle.
    #[track_caller]
    fn unpack<'b>(&self, word: Signal<'b>) -> Like<Self, Signal<'b>> {
        let place = Location::caller();
        if word.width() != self.width() {
            word.builder.fail(
                place,
                format!(
                    "width mismatch: a bundle of {} bits, {} has {}",
                    self.width(),
                    word.describe(),
                    word.width()
                ),
            );
            return self.map(|_, spec| word.builder.zero(spec.width));
        }
        let mut lsb = 0;
        self.map(|name, spec| {
            lsb += spec.width;
            let field = word.slice(lsb - spec.width, spec.width, place);
            field.as_part(&name.to_string(), true)
        })
    }

    /// Returns one field of a word. `field` is a leaf of this definition.
    #[track_caller]
    fn get<'b>(&self, word: Signal<'b>, field: &Spec) -> Signal<'b> {
        let place = Location::caller();
        let fields = self.fields();
        let before = fields.iter().take_while(|(name, _)| *name != field.name);
        let lsb = before.map(|(_, spec)| spec.width).sum();
        let part = word.slice(lsb, field.width, place);
        part.as_part(&field.name, true)
    }

    /// Declares an input port for each field.
    #[track_caller]
    fn inputs<'b>(&self, m: &'b Builder) -> Like<Self, Signal<'b>> {
        let place = Location::caller();
        self.map(|_, spec| spec.input_from(m, None, place))
    }

    /// Declares an input port of a pipeline for each field, at stage `at`.
    #[track_caller]
    fn inputs_at<'b>(&self, p: &Pipeline<'b>, at: u32) -> Like<Self, Signal<'b>> {
        let place = Location::caller();
        self.map(|_, spec| spec.input_from(p.builder, Some((p, at)), place))
    }

    /// Declares an output port for each field. The values must have the widths of the definition.
    #[track_caller]
    fn outputs<'b>(&self, m: &'b Builder, values: Like<Self, Signal<'b>>) {
        let place = Location::caller();
        for (spec, value) in pairs(self, values) {
            m.group(&spec.heading);
            spec.check(value, place);
            m.output_from(&spec.name, value, place);
        }
    }

    /// Declares a wire for each field, to be driven once, later. Its name is `prefix`, `_` and the
    /// name of the field.
    #[track_caller]
    fn wires<'b>(&self, m: &'b Builder, prefix: &str) -> Like<Self, Wire<'b>> {
        let place = Location::caller();
        self.map_in(prefix, |name, spec| {
            m.wire_from(&name.to_string(), spec.width, place)
        })
    }

    /// Declares a register without a reset value for each field and loads it with the given value
    /// every cycle. Its name is `prefix`, `_` and the name of the field. The result is the outputs
    /// of the registers.
    #[track_caller]
    fn hold<'b>(&self, prefix: &str, values: Like<Self, Signal<'b>>) -> Like<Self, Signal<'b>> {
        let mut held = vec![];
        for ((name, spec), (_, value)) in self
            .fields()
            .into_iter()
            .zip(pairs::<_, Signal<'b>>(self, values))
        {
            let register =
                (value.builder).reg(Name::root(prefix).field(&name).to_string(), spec.width);
            register.next(value);
            held.push(register.q);
        }
        let mut held = held.into_iter();
        self.map(|_, _| held.next().expect("a register for each field"))
    }

    /// Packs numbers into a word as [`pack`](Specs::pack) packs signals, for simulation. The bundle
    /// has at most 64 bits, and each number must fit its field.
    fn encode(&self, values: Like<Self, u64>) -> u64 {
        let mut lsb = 0;
        pairs::<_, u64>(self, values)
            .iter()
            .fold(0, |word, (spec, value)| {
                lsb += spec.width;
                word | value << (lsb - spec.width)
            })
    }

    /// Splits a word into numbers, the inverse of [`encode`](Specs::encode). The bundle has at most
    /// 64 bits.
    fn decode(&self, word: u64) -> Like<Self, u64> {
        debug_assert!(self.width() <= 64);
        let mut lsb = 0;
        self.map(|_, spec| {
            lsb += spec.width;
            word >> (lsb - spec.width) & (u64::MAX >> (64 - spec.width))
        })
    }
}

impl<B: Bundle<Leaf = Spec>> Specs for B {}

/// Operations on all wires of a bundle.
pub trait Wires<'b>: Bundle<Leaf = Wire<'b>> {
    /// Returns the signals of the wires.
    fn get(&self) -> Like<Self, Signal<'b>> {
        self.map(|_, wire| wire.get())
    }

    /// Drives every wire, as [`Wire::drive`].
    #[track_caller]
    fn drive(&self, values: Like<Self, Signal<'b>>) {
        let place = Location::caller();
        for (wire, value) in pairs(self, values) {
            wire.drive_from(value, place);
        }
    }
}

impl<'b, B: Bundle<Leaf = Wire<'b>>> Wires<'b> for B {}

/// [`Ports`] of the same shape as `Ports<I, O>` with leaves of type `T`.
pub type LikePorts<I, O, T> = Ports<Like<I, T>, Like<O, T>>;

/// The ports of a module as two bundles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ports<I, O> {
    /// The input ports.
    pub inputs: I,
    /// The output ports.
    pub outputs: O,
}

impl<I: Bundle<Leaf = Spec>, O: Bundle<Leaf = Spec>> Ports<I, O> {
    /// Instantiates `module`, which has these ports, and returns its outputs. See
    /// [`Builder::instance`] for the alignment of pipelined inputs.
    #[track_caller]
    pub fn place<'b>(
        &self,
        name: impl AsRef<str>,
        m: &'b Builder,
        module: &Arc<Module>,
        inputs: Like<I, Signal<'b>>,
    ) -> Like<O, Signal<'b>> {
        self.instance(name, m, module, inputs).0
    }

    /// As [`place`](Ports::place); the second result is the instance itself.
    #[track_caller]
    pub fn instance<'b>(
        &self,
        name: impl AsRef<str>,
        m: &'b Builder,
        module: &Arc<Module>,
        inputs: Like<I, Signal<'b>>,
    ) -> (Like<O, Signal<'b>>, Outputs<'b>) {
        let inputs = pairs(&self.inputs, inputs);
        let inputs: Vec<_> = (inputs.iter())
            .map(|(spec, value)| (spec.name.as_str(), *value))
            .collect();
        let placed = m.instance(name, module, &inputs);
        (self.outputs.map(|_, spec| placed.get(&spec.name)), placed)
    }

    /// Calls `of` for every port and returns the results in the same shape, for example handles to
    /// the ports of a simulated model.
    ///
    /// # Errors
    /// The first error of `of`.
    pub fn try_map<T, E>(
        &self,
        mut of: impl FnMut(Spec) -> Result<T, E>,
    ) -> Result<LikePorts<I, O, T>, E> {
        Ok(Ports {
            inputs: self.inputs.try_map(|_, spec| of(spec))?,
            outputs: self.outputs.try_map(|_, spec| of(spec))?,
        })
    }
}

/// Defines a connection with a payload. The names of the payload's fields do not include that of the payload.
macro_rules! connection {
    ($(#[$meta:meta])* $name:ident { $($(#[$of:meta])* $field:ident),* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name<P, T = ()> {
            $($(#[$of])* pub $field: T,)*
            /// The bundle that is transferred.
            pub payload: P,
        }

        impl<P: Bundle<Leaf = Spec>> $name<P, Spec> {
            /// Returns the definition of the connection, given that of its payload.
            pub fn of(payload: P) -> Self {
                $name { $($field: leaf(1),)* payload }
            }
        }

        impl<S: Shape> Shape for $name<S> {
            type Of<T> = $name<S::Of<T>, T>;

            fn each<T, U, E>(
                of: Self::Of<T>,
                name: &Name<'_>,
                f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
            ) -> Result<Self::Of<U>, E> {
                Ok($name {
                    $($field: f(&name.field(stringify!($field)), of.$field)?,)*
                    payload: S::each(of.payload, name, f)?,
                })
            }

            fn zip<T, U>(a: Self::Of<T>, b: Self::Of<U>) -> Self::Of<(T, U)> {
                $name {
                    $($field: (a.$field, b.$field),)*
                    payload: S::zip(a.payload, b.payload),
                }
            }
        }

        impl<T: Clone, P: Bundle<Leaf = T>> Bundle for $name<P, T> {
            type Leaf = T;
            type Shape = $name<P::Shape>;
        }
    };
}

connection! {
    /// A payload with a valid bit and without back-pressure: the receiver takes it in every cycle in which
    /// `valid` is 1.
    Flow { #[doc = "Whether the payload is present in this cycle."] valid }
}

connection! {
    /// A payload with a ready/valid handshake: it is transferred in every cycle in which both `valid` and
    /// `ready` are 1.
    Stream {
        #[doc = "Whether the sender offers a payload in this cycle."]
        valid,
        #[doc = "Whether the receiver accepts it. This signal goes against the direction of the payload."]
        ready
    }
}

impl<P, T> Flow<P, T> {
    /// Creates a flow from a valid bit and a payload.
    pub fn new(valid: T, payload: P) -> Self {
        Flow { valid, payload }
    }
}

crate::bundle! {
    /// A read request: an address, and a tag that the response repeats.
    pub struct Request(address: u32, tag: u32) {
        /// The address to read.
        address: address,
        /// The tag, returned with the response.
        tag: tag,
    }
}

crate::bundle! {
    /// The response to a [`Request`].
    pub struct Response(tag: u32, data: u32) {
        /// The tag of the request.
        tag: tag,
        /// The word that was read.
        data: data,
    }
}

crate::bundle! {
    /// A tagged read port: requests with ready/valid handshake, and responses in any order, which
    /// are always accepted.
    pub struct ReadPort(address: u32, tag: u32, data: u32) {
        /// The requests.
        request: Stream<Request>(address, tag),
        /// The responses.
        response: Flow<Response>(tag, data),
    }
}

crate::bundle! {
    /// The inputs of a module that owns a read port: whether a request is accepted, and the
    /// responses.
    pub struct ReadInputs(title: &str, responses: &str, tag: u32, data: u32) {
        (format!("{title}: requests")) {
            /// Whether the request is accepted in this cycle.
            request_ready: 1
        }
        (format!("{title}: responses, {responses}")) {
            /// The responses.
            response: Flow<Response>(tag, data),
        }
    }
}

crate::bundle! {
    /// The outputs of a module that owns a read port: the requests.
    pub struct ReadOutputs(title: &str, address: u32, tag: u32) {
        (format!("{title}: requests")) {
            /// The requests, each held until it is accepted.
            request: Flow<Request>(address, tag),
        }
    }
}

impl<T> ReadPort<T> {
    /// Assembles the read port from the outputs and inputs of a module.
    pub fn of_unit(outputs: ReadOutputs<T>, inputs: ReadInputs<T>) -> ReadPort<T> {
        ReadPort {
            request: Stream {
                valid: outputs.request.valid,
                ready: inputs.request_ready,
                payload: outputs.request.payload,
            },
            response: inputs.response,
        }
    }
}

crate::bundle! {
    /// A word to be written, and its address.
    pub struct Write(address: u32, data: u32) {
        /// The address to write.
        address: address,
        /// The word to write.
        data: data,
    }
}

/// Defines a bundle: a struct that is generic in the type of its leaves.
///
/// ```text
/// bundle! {
///     /// Documentation.
///     pub struct Name(argument: Type, ...) { fields }
/// }
/// ```
///
/// The macro defines `Name<T>` and the function `Name::of(argument, ...)`, which returns the definition
/// `Name<Spec>`. The expressions in the fields may use the arguments. Each field has one of these forms:
///
/// | Form | Meaning |
/// |---|---|
/// | `name: width` | one value |
/// | `name: [width; xyz]` | three values, `name_x`, `name_y`, `name_z` |
/// | `name: [width; 4]` | values `name_0`, `name_1`, …; at most 8 |
/// | `name: {Bundle}(arguments)` | another bundle; its fields are named `name_…` |
/// | `name: ..{Bundle}(arguments)` | another bundle whose fields keep their names |
/// | `name: Flow<Bundle>(arguments)` | a [`Flow`](crate::Flow) or [`Stream`](crate::Stream) of a bundle |
/// | `name: {Shape = definition}` | any [`Shape`](crate::bundle::Shape) with its definition; also with `..` before it |
/// | `name if (condition): …` | any of these as an [`Option`], present if the condition holds |
///
/// Fields can be grouped as `"heading" { fields }`; the heading is printed above them where they are declared as
/// ports. A heading that is not a literal is put in parentheses. See the [module documentation](mod@crate::bundle)
/// for an example.
#[macro_export]
macro_rules! bundle {
    ($(#[$meta:meta])* $vis:vis struct $name:ident ($($arg:ident: $type:ty),*) {
        $($heading:tt { $($fields:tt)* })+
    }) => {
        $crate::bundle!(@fields [[$(#[$meta])*] $vis $name ($($arg: $type),*)] [] $($heading { $($fields)* })+);
    };
    ($(#[$meta:meta])* $vis:vis struct $name:ident ($($arg:ident: $type:ty),*) { $($body:tt)* }) => {
        $crate::bundle!(@fields [[$(#[$meta])*] $vis $name ($($arg: $type),*)] [] "" { $($body)* });
    };
    (@fields $head:tt [$($done:tt)*] $heading:tt {}) => {
        $crate::bundle!(@emit $head $($done)*);
    };
    (@fields $head:tt $done:tt $heading:tt {} $($groups:tt)+) => {
        $crate::bundle!(@fields $head $done $($groups)+);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : [$width:expr; xyz] $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$crate::bundle::Xyz] ([$width; 3].map($crate::bundle::leaf)) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : [$width:expr; $count:literal] $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$crate::bundle::Numbered<$count>] ([$width; $count].map($crate::bundle::leaf)) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : $around:ident<$shape:ident>($($of:expr),* $(,)?) $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$around<$shape>] ($around::of($shape::of($($of),*))) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : {$shape:ident}($($of:expr),* $(,)?) $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$shape] ($shape::of($($of),*)) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : ..{$shape:ident}($($of:expr),* $(,)?) $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$crate::bundle::Flat<$shape>] ($shape::of($($of),*)) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : {$shape:ty = $def:expr} $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$shape] ($def) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : ..{$shape:ty = $def:expr} $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$crate::bundle::Flat<$shape>] ($def) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@fields $head:tt $done:tt $heading:tt {
        $(#[$meta:meta])* $field:ident $(if ($cond:expr))? : $width:expr $(, $($rest:tt)*)?
    } $($groups:tt)*) => {
        $crate::bundle!(@add [$($cond)?] [$crate::bundle::One] ($crate::bundle::leaf($width)) [$(#[$meta])*] $field $heading
            $head $done $heading { $($($rest)*)? } $($groups)*);
    };
    (@add [] [$shape:ty] ($def:expr) $meta:tt $field:ident $heading:tt $head:tt [$($done:tt)*] $($groups:tt)*) => {
        $crate::bundle!(@fields $head [$($done)* { $meta $field [$shape] ($def) $heading }] $($groups)*);
    };
    (@add [$cond:expr] [$shape:ty] ($def:expr) $meta:tt $field:ident $heading:tt $head:tt [$($done:tt)*] $($groups:tt)*) => {
        $crate::bundle!(@fields $head [$($done)* {
            $meta $field [$crate::bundle::Maybe<$shape>] (($cond).then(|| $def)) $heading
        }] $($groups)*);
    };
    (@emit [[$(#[$meta:meta])*] $vis:vis $name:ident ($($arg:ident: $type:ty),*)] $({
        [$(#[$of:meta])*] $field:ident [$shape:ty] ($def:expr) $heading:tt
    })*) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $vis struct $name<T = ()> {
            $($(#[$of])* pub $field: <$shape as $crate::bundle::Shape>::Of<T>,)*
        }

        impl $crate::bundle::Shape for $name {
            type Of<T> = $name<T>;

            fn each<T, U, E>(
                of: $name<T>,
                name: &$crate::bundle::Name<'_>,
                f: &mut dyn FnMut(&$crate::bundle::Name<'_>, T) -> Result<U, E>,
            ) -> Result<$name<U>, E> {
                Ok($name {
                    $($field: {
                        let name = <$shape as $crate::bundle::Shape>::name(name, stringify!($field));
                        <$shape as $crate::bundle::Shape>::each(of.$field, &name, f)?
                    },)*
                })
            }

            fn zip<T, U>(a: $name<T>, b: $name<U>) -> $name<(T, U)> {
                $name {
                    $($field: <$shape as $crate::bundle::Shape>::zip(
                        a.$field,
                        b.$field,
                    ),)*
                }
            }
        }

        impl<T: Clone> $crate::Bundle for $name<T> {
            type Leaf = T;
            type Shape = $name;
        }

        impl $name<$crate::Spec> {
            /// Returns the definition of the bundle.
            #[allow(dead_code, unused_variables)]
            $vis fn of($($arg: $type),*) -> Self {
                $name {
                    $($field: $crate::bundle::define::<$shape>(
                        $def,
                        stringify!($field),
                        $heading,
                    ),)*
                }
            }
        }
    };
}

/// Defines the ports of a module: the bundles `Inputs` and `Outputs`, and the function `ports`, which returns
/// their definition as [`Ports`](crate::Ports).
///
/// Each group has a direction and a heading; the fields are written as in [`bundle!`](macro@crate::bundle).
///
/// ```
/// use dynrt_hdl::{Builder, Specs};
/// dynrt_hdl::interface! {
///     pub (width: u32) {
///         in "Operands" { a: width, b: width }
///         out "Result" { sum: width }
///     }
/// }
/// let m = Builder::new("adder", "sum = a + b.");
/// let ports = ports(8);
/// let Inputs { a, b } = ports.inputs.inputs(&m);
/// ports.outputs.outputs(&m, Outputs { sum: a + b });
/// assert_eq!(m.finish().unwrap().ports().len(), 3);
/// ```
#[macro_export]
macro_rules! interface {
    ($vis:vis ($($arg:ident: $type:ty),*) { $($groups:tt)* }) => {
        $crate::interface!(@split [$vis ($($arg: $type),*)] [] [] $($groups)*);
    };
    (@split $head:tt [$($ins:tt)*] $outs:tt in $heading:tt { $($fields:tt)* } $($rest:tt)*) => {
        $crate::interface!(@split $head [$($ins)* $heading { $($fields)* }] $outs $($rest)*);
    };
    (@split $head:tt $ins:tt [$($outs:tt)*] out $heading:tt { $($fields:tt)* } $($rest:tt)*) => {
        $crate::interface!(@split $head $ins [$($outs)* $heading { $($fields)* }] $($rest)*);
    };
    (@split [$vis:vis ($($arg:ident: $type:ty),*)] [$($ins:tt)*] [$($outs:tt)*]) => {
        $crate::bundle!(@fields [[/** The inputs of the module. */] $vis Inputs ($($arg: $type),*)] [] $($ins)*);
        $crate::bundle!(@fields [[/** The outputs of the module. */] $vis Outputs ($($arg: $type),*)] [] $($outs)*);

        /// Returns the definition of the module's ports.
        $vis fn ports($($arg: $type),*) -> $crate::Ports<Inputs<$crate::Spec>, Outputs<$crate::Spec>> {
            $crate::Ports {
                inputs: Inputs::of($($arg),*),
                outputs: Outputs::of($($arg),*),
            }
        }
    };
}

/// Returns a field of `width` bits without a name. Used by [`bundle!`](macro@crate::bundle).
pub fn leaf(width: u32) -> Spec {
    Spec {
        name: String::new(),
        width,
        heading: String::new(),
    }
}

/// Names the fields of a bundle after `field` and puts those without a heading under `heading`.
/// Used by [`bundle!`](macro@crate::bundle).
pub fn define<S: Shape>(of: S::Of<Spec>, field: &str, heading: impl Into<String>) -> S::Of<Spec> {
    let heading = heading.into();
    let Ok(defined) = S::each(of, &S::name(&Name::root(""), field), &mut |name, spec| {
        Ok::<_, Infallible>(Spec {
            name: name.to_string(),
            width: spec.width,
            heading: match spec.heading.is_empty() {
                true => heading.clone(),
                false => spec.heading,
            },
        })
    });
    defined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Design;

    bundle! {
        /// A place and what is there.
        struct Item(bits: u32, wide: bool) {
            /// Where it is.
            place: [2; xyz],
            value: bits,
            more if (wide): [bits; 2],
        }
    }

    bundle! {
        struct Pair(bits: u32) {
            first: {Item}(bits, true),
            second: ..{Item}(bits, false),
            flag if (bits > 3): 1,
        }
    }

    bundle! {
        struct Sum(bits: u32) {
            along: {Axes<Write> = [2, 3, 4].map(|address| Write::of(address, bits))},
            total: ..{Stream<Item> = Stream::of(Item::of(bits, false))},
        }
    }

    mod unit {
        use super::*;

        interface! {
            pub(super) (bits: u32) {
                in "Items" { item: Flow<Item>(bits, false), sent: 1 }
                out "Memory" { read: Flow<Request>(bits, 2) }
                in (format!("{bits} bits")) {
                    read_ready: 1,
                    response: Flow<Response>(2, bits),
                }
                out "Items" { ready: 1 }
            }
        }
    }

    fn zeros<'b>(of: &Item<Spec>, m: &'b Builder) -> Item<Signal<'b>> {
        of.map(|_, spec| m.zero(spec.width))
    }

    fn named(fields: &[(String, Spec)]) -> Vec<(&str, u32)> {
        let both = fields.iter().map(|(name, spec)| {
            assert_eq!(*name, spec.name);
            (name.as_str(), spec.width)
        });
        both.collect()
    }

    #[test]
    fn fields_have_names_and_widths_in_their_order() {
        let item = [("place_x", 2), ("place_y", 2), ("place_z", 2), ("value", 3)];
        let of = Item::of(3, true);
        assert_eq!(named(&of.fields())[..4], item);
        assert_eq!(named(&of.fields())[4..], [("more_0", 3), ("more_1", 3)]);
        let of = Pair::of(4);
        let names: Vec<_> = of.fields().into_iter().map(|(name, _)| name).collect();
        let names: Vec<_> = names.iter().map(String::as_str).collect();
        let first = [
            "first_place_x",
            "first_place_y",
            "first_place_z",
            "first_value",
        ];
        assert_eq!(names[..4], first);
        assert_eq!(names[4..6], ["first_more_0", "first_more_1"]);
        assert_eq!(
            names[6..],
            ["place_x", "place_y", "place_z", "value", "flag"]
        );
        assert_eq!(of.width(), 6 + 3 * 4 + 6 + 4 + 1);
        assert_eq!(Pair::of(3).flag, None);
        let sum = Sum::of(9).fields();
        let along = [
            ("along_address_x", 2),
            ("along_data_x", 9),
            ("along_address_y", 3),
        ];
        assert_eq!(named(&sum)[..3], along);
        assert_eq!(
            named(&sum)[6..9],
            [("valid", 1), ("ready", 1), ("place_x", 2)]
        );
        let port = ReadPort::of(8, 2, 32).fields();
        let names = [
            "request_valid",
            "request_ready",
            "request_address",
            "request_tag",
        ];
        assert_eq!(
            named(&port)[..4]
                .iter()
                .map(|(name, _)| *name)
                .collect::<Vec<_>>(),
            names
        );
        let response = [
            ("response_valid", 1),
            ("response_tag", 2),
            ("response_data", 32),
        ];
        assert_eq!(named(&port)[4..], response);
    }

    #[test]
    fn a_word_holds_its_fields_first_lowest() {
        let m = Builder::new("words", "Fields of words.");
        let of = Item::of(3, true);
        let item = Item {
            place: [1u8, 2, 3].map(|x| m.lit(x, 2)),
            value: m.lit(5u8, 3),
            more: Some([6u8, 7].map(|x| m.lit(x, 3))),
        };
        let word = of.pack(item);
        let bits = 0x7d79;
        assert_eq!((word.width(), word.literal()), (15, Some(bits)));
        let values = of.unpack(word).map(|_, signal| signal.literal().unwrap());
        assert_eq!(
            (values.place, values.value, values.more),
            ([1, 2, 3], 5, Some([6, 7]))
        );
        assert_eq!(of.get(word, &of.value).literal(), Some(5));
        let zero = zeros(&of, &m);
        let least = m.lit(0u8, 1).choose(item, zero);
        assert_eq!(of.pack(least).literal(), Some(0));
        let both = item.zip(values).fields();
        assert!(
            both.iter()
                .all(|(_, (signal, value))| signal.literal() == Some(*value))
        );
    }

    #[test]
    fn a_bundle_goes_through_registers_and_wires_and_is_named() {
        let m = Builder::new("staged", "A bundle in a pipeline.");
        let of = Item::of(3, false);
        let p = m.pipeline();
        let item = of.inputs_at(&p, 1);
        let wires = of.wires(&m, "later");
        let later = item.register().at(4).untimed().named("late");
        wires.drive(later);
        let Item { place, value, .. } = wires.get();
        m.output("x", place[0]);
        m.output("value_later", value);
        let text = m.finish().unwrap().verilog().to_string();
        for line in [
            "late_place_x <= place_x_s3;",
            "reg  [2:0] late_value;",
            "[1:0] place_x",
        ] {
            assert!(text.contains(line), "no {line} in {text}");
        }
    }

    #[test]
    fn ports_stand_under_their_headings_and_an_instance_has_them_typed() {
        let ports = unit::ports(3);
        let m = Builder::new("unit", "A unit.");
        let unit::Inputs {
            item,
            sent,
            read_ready,
            response,
        } = ports.inputs.inputs(&m);
        let outputs = unit::Outputs {
            read: Flow {
                valid: item.valid & sent & response.valid,
                payload: Request {
                    address: item.payload.value,
                    tag: response.payload.tag,
                },
            },
            ready: read_ready & response.payload.data.any() & item.payload.place[0].any(),
        };
        ports.outputs.outputs(&m, outputs);
        let module = m.finish().unwrap();
        let headings = module.ports().iter();
        let headings: Vec<_> = headings
            .map(|port| (port.name.as_str(), port.group.as_str()))
            .collect();
        assert_eq!(headings[0], ("item_valid", "Items"));
        assert_eq!(
            headings[5..8],
            [
                ("sent", "Items"),
                ("ready", "Items"),
                ("read_ready", "3 bits")
            ]
        );
        assert_eq!(
            headings[8..10],
            [("response_valid", "3 bits"), ("response_tag", "3 bits")]
        );
        assert_eq!(
            headings[11..13],
            [("read_valid", "Memory"), ("read_address", "Memory")]
        );
        let mistaken = Builder::new("mistaken", "Asks for the stage of a port that has none.");
        ports.inputs.sent.stage(&mistaken, &module);
        let error = mistaken.finish().unwrap_err();
        assert_eq!(error.message, "module unit: port sent has no stage");
        assert!(error.place.file().ends_with("bundle.rs"));
        let m = Builder::new("around", "What is around it.");
        let placed = ports.place("unit0", &m, &module, ports.inputs.inputs(&m));
        ports.outputs.outputs(&m, placed);
        let design = Design::new(m.finish().unwrap()).unwrap();
        assert!(design.files()[1].1.contains(".item_place_x(item_place_x)"));
        let names = ports.try_map(|spec| match spec.width {
            0 => Err(()),
            _ => Ok(spec.name),
        });
        assert_eq!(names.unwrap().outputs.read.payload.tag, "read_tag");
        let too_wide = ports.try_map(|spec| {
            if spec.width > 2 {
                Err(spec.name)
            } else {
                Ok(())
            }
        });
        assert_eq!(too_wide.unwrap_err(), "item_value");
    }

    #[test]
    fn a_wrong_width_is_told_where_it_is_made() {
        let wrong = |make: for<'b> fn(&'b Builder, Item<Spec>, Item<Signal<'b>>) -> u32| {
            let (m, item) = (Builder::new("wrong", "A mistake."), Item::of(3, false));
            let value = m.zero(4);
            let wrong = Item {
                value,
                ..zeros(&item, &m)
            };
            let line = make(&m, item, wrong);
            let error = m.finish().unwrap_err();
            assert_eq!((error.place.file(), error.place.line()), (file!(), line));
            error.message
        };
        let packed = wrong(|_, item, wrong| {
            item.pack(wrong);
            line!() - 1
        });
        assert_eq!(packed, "width mismatch: value has 3 bits, literal 0 has 4");
        let unpacked = wrong(|_, item, wrong| {
            item.unpack(wrong.value);
            line!() - 1
        });
        let expected = "width mismatch: a bundle of 9 bits, literal 0 has 4";
        assert_eq!(unpacked, expected);
        let driven = wrong(|m, item, wrong| {
            item.wires(m, "w").drive(wrong);
            line!() - 1
        });
        let expected = "width mismatch: \"w_value\" has 3 bits, literal 0 has 4";
        assert_eq!(driven, expected);
        let shown = wrong(|m, item, wrong| {
            item.outputs(m, wrong);
            line!() - 1
        });
        assert_eq!(shown, packed);
    }

    #[test]
    #[should_panic(expected = "an optional field is present in only one of two bundles")]
    fn a_missing_field_is_told() {
        let m = Builder::new("lacking", "A mistake.");
        Item::of(3, true).pack(zeros(&Item::of(3, false), &m));
    }
}
