//! The description of one module.

use super::design::{Direction, Module, Port};
use super::error::HdlError;
use super::ir::{Binary, Id, InstanceData, Item, Netlist, Node, Op, PartData, Place, Register};
use super::mutation::{Mutation, Reads};
use super::pipeline::{Pipeline, Stage};
use super::signal::Signal;
use std::cell::RefCell;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::panic::Location;
use std::sync::Arc;

/// The state of a description.
pub(super) struct Inner {
    pub ir: Netlist,
    pub delays: HashMap<Id, Id>,
    /// Reads by memory, address, and whether they are synchronous.
    pub reads: HashMap<(usize, Id, bool), Id>,
    pub pipelines: u32,
    /// Nodes by their expressions, so that equal expressions share one node.
    pub known: HashMap<(Op, u32, Option<Stage>), Id>,
    /// The part to which the following statements belong; 0 outside of all parts.
    pub part: usize,
    /// Whether the module is complete, so that new nodes belong to its properties.
    pub formal: bool,
    /// Whether expressions are simplified if literals or widths permit it.
    pub simplifies: bool,
    /// Changes that the description names, with their places.
    pub mutations: Vec<(Mutation, Place)>,
}

impl Inner {
    fn new(ir: Netlist) -> Self {
        Inner {
            ir,
            delays: HashMap::new(),
            reads: HashMap::new(),
            pipelines: 0,
            known: HashMap::new(),
            part: 0,
            formal: false,
            simplifies: true,
            mutations: vec![],
        }
    }
}

/// Describes one module.
///
/// A builder hands out [`Signal`]s, records what is done with them, and becomes a [`Module`] in
/// [`Builder::finish`]. No method fails by itself: the first mistake (a width mismatch, a name
/// clash, …) is remembered with the place of the call in the Rust source, and `finish` returns it.
///
/// All signals of a builder borrow it, so a signal cannot outlive its module. Signals of two
/// builders must not be combined; this is a mistake that both builders report.
pub struct Builder {
    pub(super) name: String,
    pub(super) inner: RefCell<Inner>,
    group: RefCell<String>,
    error: RefCell<Option<HdlError>>,
}

/// Words reserved in Verilog or SystemVerilog (tools may read files as either), and the names of clock and reset.
pub(super) const KEYWORDS: &str = "\
    accept_on alias always always_comb always_ff always_latch and assert assign assume automatic before \
    begin bind bins binsof bit break buf bufif0 bufif1 byte case casex casez cell chandle checker class \
    clk clocking cmos config const constraint context continue cover covergroup coverpoint cross \
    deassign default defparam design disable dist do edge else end endcase endchecker endclass \
    endclocking endconfig endfunction endgenerate endgroup endinterface endmodule endpackage \
    endprimitive endprogram endproperty endsequence endspecify endtable endtask enum event eventually \
    expect export extends extern final first_match for force foreach forever fork forkjoin function \
    generate genvar global highz0 highz1 if iff ifnone ignore_bins illegal_bins implements implies \
    import incdir include initial inout input inside instance int integer interconnect interface \
    intersect join join_any join_none large let liblist library local localparam logic longint \
    macromodule matches medium modport module nand negedge nettype new nexttime nmos nor noshowcancelled \
    not notif0 notif1 null or output package packed parameter pmos posedge primitive priority program \
    property protected pull0 pull1 pulldown pullup pulsestyle_ondetect pulsestyle_onevent pure rand \
    randc randcase randsequence rcmos real realtime ref reg reject_on release repeat restrict return \
    rnmos rpmos rst rtran rtranif0 rtranif1 s_always s_eventually s_nexttime s_until s_until_with \
    scalared sequence shortint shortreal showcancelled signed small soft solve specify specparam static \
    string strong strong0 strong1 struct super supply0 supply1 sync_accept_on sync_reject_on table \
    tagged task this throughout time timeprecision timeunit tran tranif0 tranif1 tri tri0 tri1 triand \
    trior trireg type typedef union unique unique0 unsigned until until_with untyped use uwire var \
    vectored virtual void wait wait_order wand weak weak0 weak1 while wildcard wire with within wor xnor \
    xor";

pub(super) fn is_keyword(name: &str) -> bool {
    KEYWORDS.split(' ').any(|keyword| keyword == name)
}

impl Builder {
    /// Starts a module called `name`. The text `doc` is printed in the head of its Verilog file.
    ///
    /// The name starts with a lower-case letter, consists of lower-case letters, digits and `_`,
    /// and is not a keyword of Verilog or SystemVerilog. This holds for all names of ports, wires,
    /// registers, memories and instances.
    #[track_caller]
    pub fn new(name: impl Into<String>, doc: impl Into<String>) -> Builder {
        let (name, place) = (name.into(), Location::caller());
        let builder = Builder {
            inner: RefCell::new(Inner::new(Netlist::new(name.clone(), doc.into(), place))),
            name,
            group: RefCell::default(),
            error: RefCell::default(),
        };
        builder.check_name(&builder.name, place);
        builder
    }

    pub(super) fn fail(&self, place: Place, message: impl Into<String>) {
        self.error.borrow_mut().get_or_insert(HdlError {
            module: self.name.clone(),
            message: message.into(),
            place,
        });
    }

    pub(super) fn node(
        &self,
        op: Op,
        width: u32,
        stage: Option<Stage>,
        place: Place,
    ) -> Signal<'_> {
        let width = if width == 0 {
            self.fail(place, "a signal must have at least 1 bit");
            1
        } else {
            width
        };
        let (op, stage) = match self.evaluate(&op, width) {
            Some(value) => (Op::Literal(value), None),
            None => (op, stage),
        };
        let mut inner = self.inner.borrow_mut();
        let (id, formal) = (inner.ir.nodes.len(), inner.formal);
        let pure = !matches!(
            op,
            Op::Input
                | Op::Wire
                | Op::Register(_)
                | Op::Read(..)
                | Op::Instance(..)
                | Op::AnyConst
                | Op::AnySeq
        );
        if pure {
            match inner.known.entry((op.clone(), width, stage)) {
                Entry::Occupied(known) => {
                    return Signal {
                        builder: self,
                        id: *known.get(),
                    };
                }
                Entry::Vacant(new) => new.insert(id),
            };
        }
        inner.ir.items.push(Item::Node(id));
        inner.ir.nodes.push(Node {
            op,
            width,
            name: None,
            hint: None,
            place,
            stage,
            cleared: false,
            formal,
        });
        Signal { builder: self, id }
    }

    pub(super) fn check_name(&self, name: &str, place: Place) {
        let valid = name.starts_with(|c: char| c.is_ascii_lowercase())
            && name
                .chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
            && !is_keyword(name);
        if !valid {
            self.fail(
                place,
                format!(
                    "\"{name}\" is not a valid name: use lower-case letters, digits and _, and no Verilog keyword"
                ),
            );
        }
    }

    /// Registers a name, which must be valid and unused.
    pub(super) fn claim(&self, name: &str, place: Place) {
        self.check_name(name, place);
        self.claim_unchecked(name, place);
    }

    fn claim_unchecked(&self, name: &str, place: Place) {
        let earlier = self
            .inner
            .borrow_mut()
            .ir
            .names
            .insert(name.to_string(), place);
        if let Some(earlier) = earlier {
            self.fail(
                place,
                format!(
                    "name clash: \"{name}\" is already taken at {}:{}",
                    earlier.file(),
                    earlier.line()
                ),
            );
        }
    }

    /// The module's own logic must precede its properties.
    pub(super) fn must_be_open(&self, what: &str, name: &str, place: Place) {
        if self.inner.borrow().formal {
            let message = format!("{what} \"{name}\" is declared after the module's properties");
            self.fail(place, message);
        }
    }

    pub(super) fn named_node(
        &self,
        op: Op,
        width: u32,
        name: &str,
        stage: Option<Stage>,
        place: Place,
    ) -> Signal<'_> {
        self.claim(name, place);
        let signal = self.node(op, width, stage, place);
        self.inner.borrow_mut().ir.nodes[signal.id].name = Some(name.to_string());
        signal
    }

    /// Sets the heading of the ports that are declared from here on. Ports of one heading are
    /// printed together, under a comment with the heading.
    pub fn group(&self, heading: impl Into<String>) {
        *self.group.borrow_mut() = heading.into();
    }

    /// Prints a comment before the statements that follow.
    pub fn comment(&self, text: impl Into<String>) {
        self.inner
            .borrow_mut()
            .ir
            .items
            .push(Item::Comment(text.into()));
    }

    /// Describes a part of the module, which becomes a Verilog module of its own; `doc` is printed
    /// in the head of its file. The part's module is named `<module>_<name>`, its instance `name`.
    ///
    /// The ports of the part follow from the description: its inputs are the signals that it reads
    /// and that are made outside of it, its outputs are the signals made inside that are read
    /// outside. Ports are named after these signals. A register, a memory or an instance belongs to
    /// the part in which it is made, a wire to the part in which it is driven. Properties
    /// ([`Proof`](crate::Proof)) and [mutations](Mutation) do not see parts: for them the module
    /// remains one netlist.
    ///
    /// A part can be continued later: a second call with the same name adds to it. Parts do not
    /// nest; a part that is begun inside another interrupts it.
    #[track_caller]
    pub fn part<R>(&self, name: &str, doc: &str, describe: impl FnOnce() -> R) -> R {
        let place = Location::caller();
        self.must_be_open("part", name, place);
        let known = {
            let inner = self.inner.borrow();
            let mut parts = inner.ir.parts.iter();
            parts.position(|part| part.name == name)
        };
        let index = known.unwrap_or_else(|| {
            self.check_name(name, place);
            let mut inner = self.inner.borrow_mut();
            inner.ir.parts.push(PartData {
                name: name.to_string(),
                doc: doc.to_string(),
                place,
            });
            inner.ir.parts.len() - 1
        });
        let outer = self.enter(index + 1);
        let result = describe();
        self.enter(outer);
        result
    }

    /// Turns the simplification of expressions on or off for what is described from here on. It is
    /// on at first.
    ///
    /// Simplification replaces expressions that literals or widths of one bit make trivial, such as
    /// `x & 0` or the reduction of a single bit. Without it the structure of the Verilog does not
    /// depend on widths and values, as a module with parameters needs (see
    /// [`Library`](crate::Library)).
    pub fn simplify(&self, whether: bool) {
        self.inner.borrow_mut().simplifies = whether;
    }

    pub(super) fn simplifies(&self) -> bool {
        self.inner.borrow().simplifies
    }

    /// Continues in another part; returns the previous one.
    fn enter(&self, part: usize) -> usize {
        let mut inner = self.inner.borrow_mut();
        inner.ir.items.push(Item::Part(part));
        std::mem::replace(&mut inner.part, part)
    }

    /// Declares an input port of `width` bits that belongs to no pipeline.
    #[track_caller]
    pub fn input(&self, name: impl AsRef<str>, width: u32) -> Signal<'_> {
        self.input_at(name.as_ref(), width, None, Location::caller())
    }

    pub(super) fn input_at(
        &self,
        name: &str,
        width: u32,
        stage: Option<Stage>,
        place: Place,
    ) -> Signal<'_> {
        let signal = self.named_node(Op::Input, width, name, stage, place);
        self.port(name, width, Direction::Input, signal, place);
        signal
    }

    /// Declares an output port that shows `signal`. The port has the width of the signal and, if
    /// the signal is in a pipeline, its stage.
    #[track_caller]
    pub fn output(&self, name: impl AsRef<str>, signal: Signal<'_>) {
        self.output_from(name.as_ref(), signal, Location::caller());
    }

    pub(super) fn output_from(&self, name: &str, signal: Signal<'_>, place: Place) {
        self.claim(name, place);
        self.port(name, signal.width(), Direction::Output, signal, place);
    }

    fn port(&self, name: &str, width: u32, direction: Direction, signal: Signal<'_>, place: Place) {
        self.must_be_open("port", name, place);
        if !std::ptr::eq(signal.builder, self) {
            self.fail(
                place,
                format!(
                    "port \"{name}\" is connected to a signal of module {}",
                    signal.builder.name
                ),
            );
            return;
        }
        let stage = signal.stage_data().map(|s| s.at);
        self.inner.borrow_mut().ir.ports.push((
            Port {
                name: name.to_string(),
                width,
                direction,
                group: self.group.borrow().clone(),
                stage,
            },
            signal.id,
        ));
    }

    /// Returns a literal of `width` bits. It is a mistake if `value` does not fit. Literals have no
    /// stage and can be combined with signals of any stage.
    #[track_caller]
    pub fn lit(&self, value: impl Into<u128>, width: u32) -> Signal<'_> {
        let value = value.into();
        if width < 128 && value >> width != 0 {
            self.fail(
                Location::caller(),
                format!("{value} does not fit in {width} bits"),
            );
        }
        self.node(Op::Literal(value), width, None, Location::caller())
    }

    /// Returns a literal that is declared as a `localparam`. Its name consists of capital letters,
    /// digits and `_`. A second call with the same name, value and width returns the same constant.
    #[track_caller]
    pub fn constant(&self, name: &str, value: impl Into<u128>, width: u32) -> Signal<'_> {
        let (value, place) = (value.into(), Location::caller());
        let known = {
            let inner = self.inner.borrow();
            let mut nodes = inner.ir.nodes.iter();
            nodes.position(|node| node.name.as_deref() == Some(name))
        };
        if let Some(id) = known {
            let node = &self.inner.borrow().ir.nodes[id];
            if (&node.op, node.width) == (&Op::Literal(value), width) {
                return self.adopt(id);
            }
        }
        let literal = self.lit(value, width);
        self.check_name(&name.to_ascii_lowercase(), place);
        if name != name.to_ascii_uppercase() {
            self.fail(
                place,
                format!(
                    "\"{name}\" is not a valid constant name: use capital letters, digits and _"
                ),
            );
        }
        self.claim_unchecked(name, place);
        self.inner.borrow_mut().ir.nodes[literal.id].name = Some(name.to_string());
        literal
    }

    /// Returns a literal of `width` bits, all 0.
    #[track_caller]
    pub fn zero(&self, width: u32) -> Signal<'_> {
        self.node(Op::Literal(0), width, None, Location::caller())
    }

    /// Returns a signal of `width` bits, all 1.
    #[track_caller]
    pub fn ones(&self, width: u32) -> Signal<'_> {
        if width <= 128 {
            let value = if width == 128 {
                u128::MAX
            } else {
                (1 << width) - 1
            };
            self.node(Op::Literal(value), width, None, Location::caller())
        } else {
            self.lit(1u8, 1).repeat(width)
        }
    }

    /// Returns the reset `rst` as a signal of one bit, for logic that reads it. A register with a
    /// reset value needs no such logic: see [`Builder::reg_reset`].
    #[track_caller]
    pub fn reset(&self) -> Signal<'_> {
        self.node(Op::Reset, 1, None, Location::caller())
    }

    /// Declares a wire of `width` bits that is driven later, exactly once, by [`Wire::drive`]. A
    /// wire makes it possible to use a signal before it is computed, for feedback.
    #[track_caller]
    pub fn wire(&self, name: impl AsRef<str>, width: u32) -> Wire<'_> {
        self.wire_from(name.as_ref(), width, Location::caller())
    }

    pub(super) fn wire_from(&self, name: &str, width: u32, place: Place) -> Wire<'_> {
        Wire {
            signal: self.named_node(Op::Wire, width, name, None, place),
        }
    }

    /// Declares a register of `width` bits without a reset value. Its next value is set exactly
    /// once, by [`Reg::next`] or [`Reg::next_when`].
    #[track_caller]
    pub fn reg(&self, name: impl AsRef<str>, width: u32) -> Reg<'_> {
        let op = Op::Register(Register::default());
        Reg {
            q: self.named_node(op, width, name.as_ref(), None, Location::caller()),
        }
    }

    /// Declares a register of `width` bits that the synchronous reset `rst` sets to `value`.
    #[track_caller]
    pub fn reg_reset(&self, name: impl AsRef<str>, width: u32, value: u128) -> Reg<'_> {
        let place = Location::caller();
        if width < 128 && value >> width != 0 {
            self.fail(
                place,
                format!(
                    "reset of \"{}\": {value} does not fit in {width} bits",
                    name.as_ref()
                ),
            );
        }
        let op = Op::Register(Register {
            reset: Some(value),
            ..Register::default()
        });
        Reg {
            q: self.named_node(op, width, name.as_ref(), None, place),
        }
    }

    /// Starts a pipeline; its inputs are at stage 0. A module may have several.
    pub fn pipeline(&self) -> Pipeline<'_> {
        let mut inner = self.inner.borrow_mut();
        inner.pipelines += 1;
        Pipeline {
            builder: self,
            id: inner.pipelines,
        }
    }

    /// Concatenates signals; the first is the most significant. Signals of a pipeline are aligned
    /// to the latest stage among them.
    #[track_caller]
    pub fn concat(&self, parts: &[Signal<'_>]) -> Signal<'_> {
        let place = Location::caller();
        let (aligned, stage) = self.align(parts, place);
        let mut parts: Vec<Signal<'_>> = vec![];
        for part in aligned {
            match parts
                .last()
                .and_then(|last| self.joined(*last, part, place))
            {
                Some(joined) => *parts.last_mut().expect("there is a last part") = joined,
                None => parts.push(part),
            }
        }
        let width = parts.iter().map(|p| p.width()).sum();
        if let [only] = parts[..] {
            return only;
        }
        self.node(
            Op::Concat(parts.iter().map(|p| p.id).collect()),
            width,
            stage,
            place,
        )
    }

    /// Joins two operands of a concatenation that are neighbouring bits of one signal, or literals.
    fn joined<'b>(&'b self, high: Signal<'b>, low: Signal<'b>, place: Place) -> Option<Signal<'b>> {
        let width = high.width() + low.width();
        if let (Some(a), Some(b)) = (high.literal(), low.literal()) {
            return (width <= 128).then(|| self.lit(a << low.width() | b, width));
        }
        let (of, base) = {
            let inner = self.inner.borrow();
            let (a, b) = (&inner.ir.nodes[high.id], &inner.ir.nodes[low.id]);
            match (&a.op, &b.op) {
                (Op::Slice(a_of, a_low), Op::Slice(b_of, b_low))
                    if a_of == b_of
                        && *a_low == b_low + b.width
                        && a.name.is_none()
                        && b.name.is_none()
                        && a.stage == b.stage
                        && a.stage == inner.ir.nodes[*a_of].stage =>
                {
                    (self.adopt(*a_of), *b_low)
                }
                _ => return None,
            }
        };
        Some(of.slice(base, width, place))
    }

    /// Returns the bitwise OR of one or more signals of equal width.
    #[track_caller]
    pub fn or_all(&self, signals: &[Signal<'_>]) -> Signal<'_> {
        self.reduce(signals, Binary::Or, Location::caller())
    }

    /// Returns the bitwise AND of one or more signals of equal width.
    #[track_caller]
    pub fn and_all(&self, signals: &[Signal<'_>]) -> Signal<'_> {
        self.reduce(signals, Binary::And, Location::caller())
    }

    fn reduce(&self, signals: &[Signal<'_>], op: Binary, place: Place) -> Signal<'_> {
        let Some((first, rest)) = signals.split_first() else {
            self.fail(place, "a reduction needs at least one signal");
            return self.zero(1);
        };
        let mut all = Signal {
            builder: self,
            id: first.id,
        };
        for signal in rest {
            all = self.binary(
                op,
                all,
                Signal {
                    builder: self,
                    id: signal.id,
                },
                place,
            );
        }
        all
    }

    /// Returns the value of the first pair `(condition, value)` whose condition is 1, or `default`
    /// if none is. Conditions have one bit, values and default one width.
    #[track_caller]
    pub fn priority<'b>(
        &'b self,
        choices: &[(Signal<'b>, Signal<'b>)],
        default: Signal<'b>,
    ) -> Signal<'b> {
        let mut chosen = default;
        for (condition, value) in choices.iter().rev() {
            chosen = condition.mux(*value, chosen);
        }
        chosen
    }

    /// Returns the choice with the number `index`. An index beyond the last choice selects the last
    /// one. There must be at least one choice.
    #[track_caller]
    pub fn select<'b>(&'b self, index: Signal<'b>, choices: &[Signal<'b>]) -> Signal<'b> {
        let place = Location::caller();
        let Some((last, rest)) = choices.split_last() else {
            self.fail(place, "a selection needs at least one choice");
            return self.zero(1);
        };
        let mut chosen = *last;
        for (i, choice) in rest.iter().enumerate().rev() {
            let names_it = index.equals(i as u128);
            let names_it = names_it.hinted_after(index, format!("is_{i}"));
            chosen = names_it.mux(*choice, chosen);
        }
        chosen
    }

    fn adopt(&self, id: Id) -> Signal<'_> {
        Signal { builder: self, id }
    }

    /// Delays staged signals to the latest stage among them. Literals have no stage.
    pub(super) fn align<'b>(
        &'b self,
        signals: &[Signal<'_>],
        place: Place,
    ) -> (Vec<Signal<'b>>, Option<Stage>) {
        let mut latest: Option<(Stage, &Signal<'_>)> = None;
        let mut unstaged: Option<&Signal<'_>> = None;
        for signal in signals {
            if !std::ptr::eq(signal.builder, self) {
                let message = format!(
                    "{} of module {} is used in another module",
                    signal.describe(),
                    signal.builder.name
                );
                // The builder that is finished first reports the mistake.
                signal.builder.fail(place, &message);
                self.fail(place, message);
                return (vec![self.zero(1); signals.len()], None);
            }
            match (signal.stage_data(), latest) {
                (None, _) if signal.is_literal() => {}
                (None, _) => unstaged = unstaged.or(Some(signal)),
                (Some(s), Some((l, other))) if s.pipeline != l.pipeline => {
                    self.fail(
                        place,
                        format!(
                            "{} and {} are in different pipelines: move one to the other with \
                             untimed and enter_at",
                            other.describe(),
                            signal.describe()
                        ),
                    );
                    return (signals.iter().map(|s| self.adopt(s.id)).collect(), None);
                }
                (Some(s), Some((l, _))) if s.at <= l.at => {}
                (Some(s), _) => latest = Some((s, signal)),
            }
        }
        if let (Some(unstaged), Some((_, staged))) = (unstaged, latest) {
            self.fail(
                place,
                format!(
                    "{} has a stage, {} has none: give it one with enter_at, or use untimed",
                    staged.describe(),
                    unstaged.describe()
                ),
            );
        }
        let latest = latest.map(|(stage, _)| stage);
        let aligned = signals
            .iter()
            .map(|signal| {
                let signal = self.adopt(signal.id);
                match (signal.stage_data(), latest) {
                    (Some(s), Some(l)) => signal.delay_by(l.at - s.at, place),
                    _ => signal,
                }
            })
            .collect();
        (aligned, latest)
    }

    pub(super) fn binary(
        &self,
        op: Binary,
        a: Signal<'_>,
        b: Signal<'_>,
        place: Place,
    ) -> Signal<'_> {
        let (ab, stage) = self.align(&[a, b], place);
        let (a, b) = (ab[0], ab[1]);
        let (wa, wb) = (a.width(), b.width());
        let shifts = matches!(op, Binary::ShiftLeft | Binary::ShiftRight);
        if wa != wb && !shifts && op != Binary::Mul {
            self.fail(
                place,
                format!(
                    "width mismatch: {op:?} of {wa} bits ({}) and {wb} bits ({})",
                    a.describe(),
                    b.describe()
                ),
            );
        }
        let width = match op {
            Binary::Equal | Binary::NotEqual | Binary::Less | Binary::LessEqual => 1,
            Binary::Mul => wa + wb,
            _ => wa,
        };
        if let (true, Some(folded)) = (self.simplifies(), self.fold(op, a, b)) {
            return folded;
        }
        self.node(Op::Binary(op, a.id, b.id), width, stage, place)
    }

    /// The value of an operation on literals of at most 128 bits.
    fn evaluate(&self, op: &Op, width: u32) -> Option<u128> {
        if width > 128 || !self.simplifies() {
            return None;
        }
        let inner = self.inner.borrow();
        // Do not simplify a named signal; its readers refer to the name.
        let literal = |id: &Id| match &inner.ir.nodes[*id] {
            Node {
                op: Op::Literal(value),
                name: None,
                ..
            } => Some(*value),
            _ => None,
        };
        let mask = |w: u32| if w >= 128 { u128::MAX } else { (1 << w) - 1 };
        let bits = |id: &Id| inner.ir.nodes[*id].width;
        Some(match op {
            Op::Not(a) => !literal(a)? & mask(width),
            Op::Any(a) => u128::from(literal(a)? != 0),
            Op::All(a) => u128::from(literal(a)? == mask(bits(a))),
            Op::Parity(a) => u128::from(literal(a)?.count_ones() % 2),
            Op::Slice(a, low) => literal(a)?.checked_shr(*low).unwrap_or(0) & mask(width),
            Op::Repeat(a, times) => {
                let value = literal(a)?;
                let shift = |all: u128| all.checked_shl(bits(a)).unwrap_or(0);
                (0..*times).fold(0, |all, _| shift(all) | value)
            }
            Op::Concat(parts) => {
                let mut all = 0;
                for part in parts {
                    all = if bits(part) >= 128 {
                        0
                    } else {
                        all << bits(part)
                    } | literal(part)?;
                }
                all
            }
            Op::Binary(op, a, b) => {
                let (a, b) = (literal(a)?, literal(b)?);
                match op {
                    Binary::And => a & b,
                    Binary::Or => a | b,
                    Binary::Xor => a ^ b,
                    Binary::Add => a.wrapping_add(b) & mask(width),
                    Binary::Sub => a.wrapping_sub(b) & mask(width),
                    Binary::Mul => a.checked_mul(b)?,
                    Binary::Equal => u128::from(a == b),
                    Binary::NotEqual => u128::from(a != b),
                    Binary::Less => u128::from(a < b),
                    Binary::LessEqual => u128::from(a <= b),
                    Binary::ShiftLeft => {
                        a.checked_shl(b.try_into().ok()?).unwrap_or(0) & mask(width)
                    }
                    Binary::ShiftRight => a.checked_shr(b.try_into().ok()?).unwrap_or(0),
                }
            }
            _ => return None,
        })
    }

    /// Simplifies operations that are trivial because of a literal; lint would report them in the Verilog.
    fn fold<'b>(&'b self, op: Binary, a: Signal<'b>, b: Signal<'b>) -> Option<Signal<'b>> {
        let (la, lb) = (a.literal(), b.literal());
        let full = |w: u32| if w >= 128 { u128::MAX } else { (1 << w) - 1 };
        let w = a.width();
        if a.id == b.id {
            return match op {
                Binary::And | Binary::Or => Some(a),
                Binary::Xor | Binary::Sub => Some(self.zero(w)),
                Binary::Equal | Binary::LessEqual => Some(self.ones(1)),
                Binary::NotEqual | Binary::Less => Some(self.zero(1)),
                _ => None,
            };
        }
        match (op, la, lb) {
            (Binary::And, Some(v), _) | (Binary::And, _, Some(v)) if v == 0 => Some(self.zero(w)),
            (Binary::And, Some(v), _) | (Binary::Or, Some(v), _)
                if v == if op == Binary::And { full(w) } else { 0 } =>
            {
                Some(b)
            }
            (Binary::And, _, Some(v)) | (Binary::Or, _, Some(v))
                if v == if op == Binary::And { full(w) } else { 0 } =>
            {
                Some(a)
            }
            (Binary::Or, Some(v), _) | (Binary::Or, _, Some(v)) if v == full(w) => {
                Some(self.ones(w))
            }
            (Binary::Equal, _, Some(1)) | (Binary::NotEqual, _, Some(0)) if w == 1 => Some(a),
            (Binary::Equal, _, Some(0)) | (Binary::NotEqual, _, Some(1)) if w == 1 => Some(!a),
            (Binary::ShiftLeft | Binary::ShiftRight, Some(0), _) => Some(a),
            (Binary::Mul, Some(0), _) | (Binary::Mul, _, Some(0)) => Some(self.zero(w + b.width())),
            (Binary::Less, _, Some(0)) => Some(self.zero(1)),
            (Binary::LessEqual, Some(0), _) => Some(self.ones(1)),
            (Binary::Less, Some(v), _) if v == full(w) => Some(self.zero(1)),
            (Binary::LessEqual, _, Some(v)) if v == full(w) => Some(self.ones(1)),
            (Binary::Add, Some(0), _) => Some(b),
            (
                Binary::Add | Binary::Sub | Binary::ShiftLeft | Binary::ShiftRight | Binary::Xor,
                _,
                Some(0),
            ) => Some(a),
            (Binary::Xor, Some(0), _) => Some(b),
            (Binary::Xor, _, Some(v)) if v == full(w) => Some(!a),
            _ => None,
        }
    }

    /// Instantiates a finished module. `inputs` gives a signal for each of its input ports, by
    /// name; `clk` and `rst` are connected automatically.
    ///
    /// If the module is pipelined, its inputs are aligned: each staged input is delayed by as many
    /// registers as it needs to arrive at the stage of its port relative to the others, and the
    /// outputs are staged accordingly.
    #[track_caller]
    pub fn instance<'b>(
        &'b self,
        name: impl AsRef<str>,
        module: &Arc<Module>,
        inputs: &[(&str, Signal<'b>)],
    ) -> Outputs<'b> {
        let (name, place) = (name.as_ref(), Location::caller());
        self.must_be_open("instance", name, place);
        self.claim(name, place);
        // The stage in this module that corresponds to stage 0 of the instance.
        let mut base: Option<Stage> = None;
        for (index, (port, signal)) in inputs.iter().enumerate() {
            if !std::ptr::eq(signal.builder, self) {
                self.fail(
                    place,
                    format!(
                        "instance {name}: input {port} is connected to a signal of module {}",
                        signal.builder.name
                    ),
                );
                continue;
            }
            if inputs[..index].iter().any(|(earlier, _)| earlier == port) {
                self.fail(
                    place,
                    format!("instance {name}: input {port} is driven twice"),
                );
            }
            let Some(stage) = signal.stage_data() else {
                continue;
            };
            let Some(enters) = module.port(port).and_then(|p| p.stage) else {
                // A missing input is reported below.
                if module.port(port).is_some() {
                    let message = format!(
                        "instance {name}: input {port} has no stage, {} has one: use untimed",
                        signal.describe()
                    );
                    self.fail(place, message);
                }
                continue;
            };
            let start = Stage {
                at: stage.at.saturating_sub(enters),
                ..stage
            };
            if base.is_some_and(|b| b.pipeline != start.pipeline) {
                self.fail(
                    place,
                    format!("instance {name}: inputs are from different pipelines"),
                );
            }
            base = Some(base.map_or(start, |b| if start.at > b.at { start } else { b }));
        }
        let mut connected = vec![];
        for port in module
            .ports
            .iter()
            .filter(|p| p.direction == Direction::Input)
        {
            if port.name == "clk" || port.name == "rst" {
                continue;
            }
            let Some((_, signal)) = inputs.iter().find(|(n, _)| *n == port.name) else {
                self.fail(
                    place,
                    format!(
                        "instance {name} of {}: input {} is undriven",
                        module.name(),
                        port.name
                    ),
                );
                continue;
            };
            if !std::ptr::eq(signal.builder, self) {
                continue; // reported above
            }
            let signal = match (base, signal.stage_data()) {
                (Some(base), Some(_)) => signal.at(base.at + port.stage.unwrap_or_default()),
                (Some(_), None) if !signal.is_literal() && port.stage.is_some() => {
                    self.fail(
                        place,
                        format!(
                            "instance {name} of {}: {} has no stage, but other inputs have one",
                            module.name(),
                            signal.describe()
                        ),
                    );
                    *signal
                }
                _ => *signal,
            };
            if signal.width() != port.width {
                self.fail(
                    place,
                    format!(
                        "width mismatch: instance {name} of {}: port {} has {} bits, {} has {}",
                        module.name(),
                        port.name,
                        port.width,
                        signal.describe(),
                        signal.width()
                    ),
                );
            }
            connected.push((port.name.clone(), signal.id));
        }
        for (given, _) in inputs {
            let known = module
                .port(given)
                .is_some_and(|p| p.direction == Direction::Input);
            if !known {
                self.fail(
                    place,
                    format!(
                        "instance {name}: module {} has no input {given}",
                        module.name()
                    ),
                );
            }
        }
        let instance = self.inner.borrow().ir.instances.len();
        let mut outputs = vec![];
        for (index, port) in module.ports.iter().enumerate() {
            if port.direction != Direction::Output {
                continue;
            }
            let at = match (base, port.stage) {
                (Some(base), Some(latency)) => Some(Stage {
                    at: base.at + latency,
                    ..base
                }),
                _ => None,
            };
            let wire = format!("{name}_{}", port.name);
            let op = Op::Instance(instance, index);
            let signal = self.named_node(op, port.width, &wire, at, place);
            outputs.push((port.name.clone(), signal.id));
        }
        let mut inner = self.inner.borrow_mut();
        inner.ir.instances.push(InstanceData {
            name: name.to_string(),
            module: module.clone(),
            inputs: connected,
            outputs: outputs.clone(),
        });
        inner.ir.items.push(Item::Instance(instance));
        Outputs {
            builder: self,
            index: instance,
            place,
            module: module.name().to_string(),
            outputs,
        }
    }

    /// Checks the module and prints its Verilog.
    ///
    /// # Errors
    /// The first mistake of the description, with its place in the Rust source; then anything that
    /// only the complete module shows: an undriven wire, register or input, a combinational loop, a
    /// memory that is never written or never read, a mutation that cannot be made.
    pub fn finish(self) -> Result<Arc<Module>, HdlError> {
        if let Some(error) = self.error.borrow_mut().take() {
            return Err(error);
        }
        let inner = self.inner.into_inner();
        let module = Module::of(inner.ir)?;
        module.admits(&inner.mutations)?;
        Ok(Arc::new(module))
    }

    pub(super) fn drive(&self, target: Id, value: Signal<'_>, place: Place) {
        let (width, name) = {
            let inner = self.inner.borrow();
            (
                inner.ir.nodes[target].width,
                inner.ir.nodes[target].name.clone().unwrap_or_default(),
            )
        };
        if !std::ptr::eq(value.builder, self) {
            self.fail(
                place,
                format!(
                    "\"{name}\" is driven by a signal of module {}",
                    value.builder.name
                ),
            );
            return;
        }
        if value.width() != width {
            self.fail(
                place,
                format!(
                    "width mismatch: \"{name}\" has {width} bits, {} has {}",
                    value.describe(),
                    value.width()
                ),
            );
        }
        if value.stage_data().is_some() {
            self.fail(
                place,
                format!(
                    "\"{name}\" has no stage, {} has one: use untimed",
                    value.describe()
                ),
            );
        }
        let mut inner = self.inner.borrow_mut();
        if let Some(earlier) = inner.ir.driven_at.insert(target, place) {
            drop(inner);
            self.fail(
                place,
                format!(
                    "\"{name}\" is driven twice: first at {}:{}",
                    earlier.file(),
                    earlier.line()
                ),
            );
            return;
        }
        inner.ir.drivers.insert(target, value.id);
        inner.ir.items.push(Item::Drive(target));
    }
}

/// An instance of a module, with access to its outputs. Returned by [`Builder::instance`].
#[derive(Clone)]
pub struct Outputs<'b> {
    pub(super) builder: &'b Builder,
    /// Index among the instances of the builder.
    pub(super) index: usize,
    place: Place,
    pub(super) module: String,
    outputs: Vec<(String, Id)>,
}

impl<'b> Outputs<'b> {
    /// Names the signal that an input of the instance reads, for a [`Mutation`].
    pub fn input(&self, port: &str) -> Reads<&'b Builder> {
        let inner = self.builder.inner.borrow();
        let mut inputs = inner.ir.instances[self.index].inputs.iter();
        let input = inputs.position(|(name, _)| name == port);
        let input = input.ok_or_else(|| format!("module {} has no input {port}", self.module));
        Reads::of_input(self.builder, self.index, input)
    }

    /// Returns the output port called `port`. It is a mistake if the module has no such output.
    #[track_caller]
    pub fn get(&self, port: &str) -> Signal<'b> {
        match self.outputs.iter().find(|(name, _)| name == port) {
            Some((_, id)) => Signal {
                builder: self.builder,
                id: *id,
            },
            None => {
                self.builder.fail(
                    Location::caller(),
                    format!(
                        "module {} has no output {port} (instance made at line {})",
                        self.module,
                        self.place.line()
                    ),
                );
                self.builder.zero(1)
            }
        }
    }
}

/// A wire that is driven once, after it was declared. See [`Builder::wire`].
#[derive(Clone, Copy)]
pub struct Wire<'b> {
    signal: Signal<'b>,
}

impl<'b> Wire<'b> {
    /// Returns the signal of the wire.
    pub fn get(&self) -> Signal<'b> {
        self.signal
    }

    /// Drives the wire. The value has the width of the wire and no stage; a wire is driven exactly
    /// once.
    #[track_caller]
    pub fn drive(&self, value: Signal<'b>) {
        self.drive_from(value, Location::caller());
    }

    pub(super) fn drive_from(&self, value: Signal<'b>, place: Place) {
        self.signal.builder.drive(self.signal.id, value, place);
    }
}

/// A register of the module's state. It belongs to no pipeline.
#[derive(Clone, Copy)]
pub struct Reg<'b> {
    /// The current value.
    pub q: Signal<'b>,
}

impl<'b> Reg<'b> {
    /// Sets the value that the register takes at every rising clock edge. The value has the width
    /// of the register and no stage; it is set exactly once.
    #[track_caller]
    pub fn next(&self, value: Signal<'b>) {
        self.set(value, None, Location::caller());
    }

    /// Sets the value that the register takes at a rising clock edge where `enable` (one bit) is 1.
    /// Otherwise the register keeps its value.
    #[track_caller]
    pub fn next_when(&self, enable: Signal<'b>, value: Signal<'b>) {
        self.set(value, Some(enable), Location::caller());
    }

    fn set(&self, value: Signal<'b>, enable: Option<Signal<'b>>, place: Place) {
        let builder = self.q.builder;
        if let Some(enable) = enable {
            let name = self.q.describe();
            if !std::ptr::eq(enable.builder, builder) {
                builder.fail(
                    place,
                    format!(
                        "{name} is enabled by a signal of module {}",
                        enable.builder.name
                    ),
                );
                return;
            }
            if enable.width() != 1 {
                builder.fail(
                    place,
                    format!(
                        "width mismatch: an enable has 1 bit, {} has {}",
                        enable.describe(),
                        enable.width()
                    ),
                );
            }
            if enable.stage_data().is_some() {
                builder.fail(
                    place,
                    format!(
                        "{name} has no stage, its enable ({}) has one: use untimed",
                        enable.describe()
                    ),
                );
            }
        }
        let enable = enable.filter(|enable| enable.literal() != Some(1));
        builder.drive(self.q.id, value, place);
        if let Op::Register(register) = &mut builder.inner.borrow_mut().ir.nodes[self.q.id].op {
            register.next = Some(value.id);
            register.enable = enable.map(|e| e.id);
        }
    }
}
