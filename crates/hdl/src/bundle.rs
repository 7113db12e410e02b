//! Values that go together, as Rust structs: what a word of a memory holds, what a unit's ports are.
//!
//! [`bundle!`](crate::bundle) defines a struct that is generic in its leaf. One definition serves as widths ([`Spec`]), signals,
//! wires that are driven later, and a simulated model's ports; a name that does not exist is an error of the compiler.
//! [`interface!`](crate::interface) defines a unit's inputs and outputs the same way, under their headings.
//!
//! ```
//! use dynrt_hdl::{Builder, Signals, Specs};
//! dynrt_hdl::bundle! {
//!     /// A ray's interval.
//!     pub struct Interval(number: u32) {
//!         /// Where it begins.
//!         near: number,
//!         far: number,
//!     }
//! }
//! dynrt_hdl::bundle! {
//!     struct Entry(number: u32, doubled: bool) {
//!         origin: [number; xyz],         // origin_x, origin_y, origin_z
//!         interval: {Interval}(number), // interval_near, interval_far
//!         second if (doubled): number,
//!     }
//! }
//! let m = Builder::new("example", "An entry a clock later, its interval turned.");
//! let entry = Entry::of(8, false);
//! assert_eq!(entry.width(), 5 * 8);
//! let word = m.input("word", entry.width());
//! let Entry { origin, interval, second } = entry.unpack(word).register();
//! let interval = Interval { near: interval.far, far: interval.near };
//! m.output("turned", entry.pack(Entry { origin, interval, second }));
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

/// A field before it is anything else: its name, its bits, and the heading that it stands under as a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    pub name: String,
    pub width: u32,
    pub heading: String,
}

impl Spec {
    /// The input port.
    #[track_caller]
    pub fn input<'b>(&self, m: &'b Builder) -> Signal<'b> {
        self.input_from(m, None, Location::caller())
    }

    /// The input port of a pipeline, at one of its stages.
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

    /// The stage of the port in a finished module, for the description of another: it must have one.
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

/// A field's name with those of the bundles around it, made into text where it is wanted alone.
#[derive(Clone, Copy, Debug)]
pub struct Name<'a> {
    around: Option<&'a Name<'a>>,
    own: &'a str,
}

impl<'a> Name<'a> {
    /// The name of a bundle in no other; it may be empty.
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

/// How a bundle is built up, whatever its leaf is. Implemented by [`bundle!`](crate::bundle).
pub trait Shape {
    type Of<T>;
    /// Its fields stand among those around it, without its name before theirs.
    const FLAT: bool = false;

    /// Each leaf of what is called `name`, with its full name, in the order of the definition.
    fn each<T, U, E>(
        of: Self::Of<T>,
        name: &Name<'_>,
        f: &mut dyn FnMut(&Name<'_>, T) -> Result<U, E>,
    ) -> Result<Self::Of<U>, E>;

    fn zip<T, U>(a: Self::Of<T>, b: Self::Of<U>) -> Self::Of<(T, U)>;

    /// The name of the field `field` of what is called `around`.
    fn name<'a>(around: &'a Name<'a>, field: &'a str) -> Name<'a> {
        if Self::FLAT {
            *around
        } else {
            around.field(field)
        }
    }
}

/// One value.
pub struct One;
/// A value on each axis, named `_x`, `_y`, `_z`.
pub struct Xyz;
/// So many values, eight at most, named `_0`, `_1` and so on.
pub struct Numbered<const N: usize>;

const NUMBERS: [&str; 8] = ["0", "1", "2", "3", "4", "5", "6", "7"];
/// A bundle for each axis, `_x`, `_y`, `_z` after the names of its fields.
pub struct Axes<S>(S);
/// A field that is not always there.
pub struct Maybe<S>(S);
/// A bundle whose fields keep their own names.
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

/// A bundle with leaves of some kind.
pub trait Bundle: Sized + Clone {
    type Leaf;
    type Shape: Shape<Of<Self::Leaf> = Self>;

    /// The same bundle of what `f` makes of each leaf and its full name, unless that is an error.
    ///
    /// # Errors
    /// The first of `f`.
    fn try_map<U, E>(
        &self,
        mut f: impl FnMut(&Name<'_>, Self::Leaf) -> Result<U, E>,
    ) -> Result<Like<Self, U>, E> {
        Self::Shape::each(self.clone(), &Name::root(""), &mut f)
    }

    /// The same bundle of what `f` makes of each leaf and its full name.
    fn map<U>(&self, f: impl FnMut(&Name<'_>, Self::Leaf) -> U) -> Like<Self, U> {
        self.map_in("", f)
    }

    /// The same with `prefix` before all names.
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

    /// The leaves of two bundles of one shape, side by side.
    ///
    /// # Panics
    /// Where one has a field that the other lacks.
    fn zip<U>(&self, other: Like<Self, U>) -> Like<Self, (Self::Leaf, U)> {
        Self::Shape::zip(self.clone(), other)
    }

    /// Each leaf with that of another bundle of this shape, in order.
    ///
    /// # Panics
    /// Where one has a field that the other lacks.
    fn with<U>(&self, other: Like<Self, U>, mut f: impl FnMut(Self::Leaf, U)) {
        let Ok(_) = Self::Shape::each(self.zip(other), &Name::root(""), &mut |_, (leaf, other)| {
            f(leaf, other);
            Ok::<(), Infallible>(())
        });
    }

    /// The leaves in the order of the definition.
    fn leaves(&self) -> Vec<Self::Leaf> {
        let mut leaves = vec![];
        self.map(|_, leaf| leaves.push(leaf));
        leaves
    }

    /// Names and leaves in the order of the definition.
    fn fields(&self) -> Vec<(String, Self::Leaf)> {
        let mut fields = vec![];
        self.map(|name, leaf| fields.push((name.to_string(), leaf)));
        fields
    }
}

/// A bundle of the same shape with other leaves.
pub type Like<B, T> = <<B as Bundle>::Shape as Shape>::Of<T>;

/// Leaves of two bundles of one shape, in order.
fn pairs<A: Bundle, U>(a: &A, b: Like<A, U>) -> Vec<(A::Leaf, U)> {
    let mut pairs = vec![];
    a.with(b, |a, b| pairs.push((a, b)));
    pairs
}

/// A bundle of signals.
pub trait Signals<'b>: Bundle<Leaf = Signal<'b>> {
    /// Every field one register later.
    #[track_caller]
    fn register(&self) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.delay_by(1, place))
    }

    /// Every field at a later stage of its pipeline.
    #[track_caller]
    fn at(&self, stage: u32) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.at_from(stage, place))
    }

    /// Every field as it is at its stage, for logic outside the pipeline.
    #[track_caller]
    fn untimed(&self) -> Self {
        let place = Location::caller();
        self.map(|_, signal| signal.untimed_from(place))
    }

    /// Names every field in the Verilog, `prefix` before its own name.
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
    /// `then` where this bit is 1, `otherwise` where it is 0, field by field.
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

/// A bundle's definition.
pub trait Specs: Bundle<Leaf = Spec> {
    /// Bits of all fields.
    fn width(&self) -> u32 {
        self.fields().iter().map(|(_, spec)| spec.width).sum()
    }

    /// A word of the fields' values, the first least significant.
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

    /// The fields of a word.
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

    /// One field of a word, a leaf of this definition.
    #[track_caller]
    fn get<'b>(&self, word: Signal<'b>, field: &Spec) -> Signal<'b> {
        let place = Location::caller();
        let fields = self.fields();
        let before = fields.iter().take_while(|(name, _)| *name != field.name);
        let lsb = before.map(|(_, spec)| spec.width).sum();
        let part = word.slice(lsb, field.width, place);
        part.as_part(&field.name, true)
    }

    /// An input port for each field.
    #[track_caller]
    fn inputs<'b>(&self, m: &'b Builder) -> Like<Self, Signal<'b>> {
        let place = Location::caller();
        self.map(|_, spec| spec.input_from(m, None, place))
    }

    /// An input port of a pipeline for each field, at one of its stages.
    #[track_caller]
    fn inputs_at<'b>(&self, p: &Pipeline<'b>, at: u32) -> Like<Self, Signal<'b>> {
        let place = Location::caller();
        self.map(|_, spec| spec.input_from(p.builder, Some((p, at)), place))
    }

    /// An output port for each field.
    #[track_caller]
    fn outputs<'b>(&self, m: &'b Builder, values: Like<Self, Signal<'b>>) {
        let place = Location::caller();
        for (spec, value) in pairs(self, values) {
            m.group(&spec.heading);
            spec.check(value, place);
            m.output_from(&spec.name, value, place);
        }
    }

    /// A wire for each field, to be driven once, later; `prefix` before the field's name.
    #[track_caller]
    fn wires<'b>(&self, m: &'b Builder, prefix: &str) -> Like<Self, Wire<'b>> {
        let place = Location::caller();
        self.map_in(prefix, |name, spec| {
            m.wire_from(&name.to_string(), spec.width, place)
        })
    }

    /// A register for each field, `prefix` before the field's name, which takes these values every clock.
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

    /// A word, of at most 64 bits, of these values.
    fn encode(&self, values: Like<Self, u64>) -> u64 {
        let mut lsb = 0;
        pairs::<_, u64>(self, values)
            .iter()
            .fold(0, |word, (spec, value)| {
                lsb += spec.width;
                word | value << (lsb - spec.width)
            })
    }

    /// The values that a word of at most 64 bits holds.
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

/// A bundle of wires that are driven once, later.
pub trait Wires<'b>: Bundle<Leaf = Wire<'b>> {
    fn get(&self) -> Like<Self, Signal<'b>> {
        self.map(|_, wire| wire.get())
    }

    #[track_caller]
    fn drive(&self, values: Like<Self, Signal<'b>>) {
        let place = Location::caller();
        for (wire, value) in pairs(self, values) {
            wire.drive_from(value, place);
        }
    }
}

impl<'b, B: Bundle<Leaf = Wire<'b>>> Wires<'b> for B {}

/// The ports of a unit with other leaves.
pub type LikePorts<I, O, T> = Ports<Like<I, T>, Like<O, T>>;

/// The ports of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ports<I, O> {
    pub inputs: I,
    pub outputs: O,
}

impl<I: Bundle<Leaf = Spec>, O: Bundle<Leaf = Spec>> Ports<I, O> {
    /// Places a module that has these ports. Inputs and outputs are those of [`Builder::instance`].
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

    /// The same, and the instance itself.
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

    /// What stands for each port elsewhere, a simulated model say.
    ///
    /// # Errors
    /// The first of `of`.
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

/// A connection that carries a payload, whose fields stand beside the connection's own.
macro_rules! connection {
    ($(#[$meta:meta])* $name:ident { $($(#[$of:meta])* $field:ident),* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name<P, T = ()> {
            $($(#[$of])* pub $field: T,)*
            pub payload: P,
        }

        impl<P: Bundle<Leaf = Spec>> $name<P, Spec> {
            /// The definition.
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
    /// A payload that comes in some clocks and is always taken.
    Flow { valid }
}

connection! {
    /// A payload that is taken in the clocks where both `valid` and `ready` are high.
    Stream { valid, #[doc = "Goes against the payload."] ready }
}

impl<P, T> Flow<P, T> {
    pub fn new(valid: T, payload: P) -> Self {
        Flow { valid, payload }
    }
}

crate::bundle! {
    /// A request at a read port.
    pub struct Request(address: u32, tag: u32) {
        address: address,
        tag: tag,
    }
}

crate::bundle! {
    /// The response to a [`Request`].
    pub struct Response(tag: u32, data: u32) {
        tag: tag,
        data: data,
    }
}

crate::bundle! {
    /// A tagged read port: requests, and their responses in any order, always taken.
    pub struct ReadPort(address: u32, tag: u32, data: u32) {
        request: Stream<Request>(address, tag),
        response: Flow<Response>(tag, data),
    }
}

crate::bundle! {
    /// What a unit is given at a read port: whether a request is taken, and responses.
    pub struct ReadInputs(title: &str, responses: &str, tag: u32, data: u32) {
        (format!("{title}: requests")) { request_ready: 1 }
        (format!("{title}: answers, {responses}")) {
            response: Flow<Response>(tag, data),
        }
    }
}

crate::bundle! {
    /// What a unit gives at a read port.
    pub struct ReadOutputs(title: &str, address: u32, tag: u32) {
        (format!("{title}: requests")) {
            request: Flow<Request>(address, tag),
        }
    }
}

impl<T> ReadPort<T> {
    /// The port of a unit.
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
    /// What is written, and where.
    pub struct Write(address: u32, data: u32) {
        address: address,
        data: data,
    }
}

/// Defines a bundle: a struct generic in its leaf, with its shape.
///
/// | field | is |
/// |---|---|
/// | `name: bits` | one value |
/// | `name: [bits; xyz]` | one on each axis |
/// | `name: [bits; 4]` | numbered ones |
/// | `name: {Bundle}(arguments)` | a bundle, its name before its fields' |
/// | `name: ..{Bundle}(arguments)` | a bundle whose fields stand among the others |
/// | `name: Flow<Bundle>(arguments)` | a connection |
/// | `name: {Shape = definition}` | anything else, and `..` before it as above |
/// | `name if (condition): …` | an [`Option`] of any of these |
///
/// `of` makes the definition from what stands in the parentheses after the struct's name. Fields may stand in groups, `"heading" { … }`,
/// whose headings they keep as ports; a heading that is no literal stands in parentheses.
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
            /// The definition.
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

/// Defines a unit's ports: the bundles `Inputs` and `Outputs`, and `ports`, which makes their definition.
///
/// Every group has its direction and its heading; fields are written as in [`bundle!`](crate::bundle).
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
        $crate::bundle!(@fields [[/** The unit's inputs. */] $vis Inputs ($($arg: $type),*)] [] $($ins)*);
        $crate::bundle!(@fields [[/** The unit's outputs. */] $vis Outputs ($($arg: $type),*)] [] $($outs)*);

        /// The definition of the unit's ports.
        $vis fn ports($($arg: $type),*) -> $crate::Ports<Inputs<$crate::Spec>, Outputs<$crate::Spec>> {
            $crate::Ports {
                inputs: Inputs::of($($arg),*),
                outputs: Outputs::of($($arg),*),
            }
        }
    };
}

/// A field of so many bits that has no name yet.
pub fn leaf(width: u32) -> Spec {
    Spec {
        name: String::new(),
        width,
        heading: String::new(),
    }
}

/// The definition of a field, as one of those under a heading.
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
