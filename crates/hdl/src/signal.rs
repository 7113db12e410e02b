//! Signals and their combinational operators.

use super::builder::Builder;
use super::ir::{Binary, Hint, Id, Item, Op, Place, Register};
use super::pipeline::Stage;
use std::ops;
use std::panic::Location;

/// An unsigned value of a fixed number of bits in a module that is being described.
///
/// The operators `&`, `|`, `^`, `+` and `-` take operands of one width and return a result of that
/// width; `+` and `-` wrap around. `!` inverts all bits. Operands in a pipeline are aligned to the
/// latest stage among them: see [`Pipeline`](crate::Pipeline).
#[derive(Clone, Copy)]
pub struct Signal<'b> {
    pub(super) builder: &'b Builder,
    pub(super) id: Id,
}

impl<'b> Signal<'b> {
    /// Returns the width in bits, at least 1.
    pub fn width(&self) -> u32 {
        self.builder.inner.borrow().ir.nodes[self.id].width
    }

    /// Returns the builder that the signal belongs to.
    pub fn module(&self) -> &'b Builder {
        self.builder
    }

    pub(super) fn stage_data(&self) -> Option<Stage> {
        self.builder.inner.borrow().ir.nodes[self.id].stage
    }

    /// Returns the stage in the pipeline; `None` for a signal outside a pipeline.
    pub fn staged(&self) -> Option<u32> {
        self.stage_data().map(|s| s.at)
    }

    /// Returns the stage in the pipeline. It is a mistake if the signal is outside a pipeline; the
    /// result is then 0.
    #[track_caller]
    pub fn stage(&self) -> u32 {
        let place = Location::caller();
        self.staged().unwrap_or_else(|| {
            let message = format!("{} has no stage: it is not in a pipeline", self.describe());
            self.builder.fail(place, message);
            0
        })
    }

    /// Returns the value of the signal if it is a literal, or an expression that was simplified to
    /// one.
    pub fn literal(&self) -> Option<u128> {
        match self.builder.inner.borrow().ir.nodes[self.id].op {
            Op::Literal(value) => Some(value),
            _ => None,
        }
    }

    pub(super) fn is_literal(&self) -> bool {
        self.literal().is_some()
    }

    pub(super) fn describe(&self) -> String {
        let inner = self.builder.inner.borrow();
        let node = &inner.ir.nodes[self.id];
        match (&node.name, &node.op) {
            (Some(name), _) => format!("\"{name}\""),
            (None, Op::Literal(value)) => format!("literal {value}"),
            _ => format!(
                "the signal made at {}:{}",
                node.place.file(),
                node.place.line()
            ),
        }
    }

    /// Sets the name of the signal in the Verilog. A signal that has a name already, and a literal,
    /// remain as they are.
    #[track_caller]
    pub fn named(self, name: impl AsRef<str>) -> Signal<'b> {
        self.named_from(name.as_ref(), Location::caller())
    }

    pub(super) fn named_from(self, name: &str, place: Place) -> Signal<'b> {
        let fresh = {
            let inner = self.builder.inner.borrow();
            let node = &inner.ir.nodes[self.id];
            node.name.is_none() && !matches!(node.op, Op::Literal(_))
        };
        if fresh {
            self.builder.claim(name, place);
            self.builder.inner.borrow_mut().ir.nodes[self.id].name = Some(name.to_string());
        }
        self
    }

    /// Suggests a name for the signal. It is used if the signal is declared in the Verilog, as it
    /// is where several places read it; `_2`, `_3`, … is appended if it is taken.
    #[track_caller]
    pub fn hinted(self, name: impl AsRef<str>) -> Signal<'b> {
        self.builder.check_name(name.as_ref(), Location::caller());
        self.hint(None, name.as_ref(), false)
    }

    /// As [`hinted`](Signal::hinted), with the name of the signal `other` and `_` before `name`.
    #[track_caller]
    pub fn hinted_after(self, other: Signal<'b>, name: impl AsRef<str>) -> Signal<'b> {
        self.hint(Some(other.id), name.as_ref(), false)
    }

    fn hint(self, after: Option<Id>, name: &str, field: bool) -> Signal<'b> {
        let mut inner = self.builder.inner.borrow_mut();
        let formal = inner.formal;
        let node = &mut inner.ir.nodes[self.id];
        // A name given for properties does not apply to nodes of the module itself.
        let free = (node.hint.as_ref()).is_none_or(|hint| field && !hint.field);
        if free && (node.formal || !formal) && !matches!(node.op, Op::Literal(_)) {
            let name = name.to_string();
            node.hint = Some(Hint { name, after, field });
        }
        drop(inner);
        self
    }

    /// Returns `width` bits from bit `lsb` upwards, like [`field`](Signal::field), and suggests a
    /// name for them: that of this signal, `_` and `name`.
    #[track_caller]
    pub fn part(self, name: impl AsRef<str>, lsb: u32, width: u32) -> Signal<'b> {
        self.field(lsb, width).as_part(name.as_ref(), false)
    }

    /// A slice of a word with the name of its part; other signals do not change.
    pub(super) fn as_part(self, name: &str, field: bool) -> Signal<'b> {
        let inner = self.builder.inner.borrow();
        let node = &inner.ir.nodes[self.id];
        let word = match node.op {
            Op::Slice(of, _) if inner.ir.nodes[of].width != node.width => Some(of),
            _ => None,
        };
        drop(inner);
        match word {
            Some(_) => self.hint(word, name, field),
            None => self,
        }
    }

    /// Lets reset clear the pipeline registers that delay this signal, as is useful for a valid
    /// bit.
    pub fn cleared_by_reset(self) -> Signal<'b> {
        self.builder.inner.borrow_mut().ir.nodes[self.id].cleared = true;
        self
    }

    fn unary(self, op: fn(Id) -> Op, width: u32, place: Place) -> Signal<'b> {
        self.builder
            .node(op(self.id), width, self.stage_data(), place)
    }

    pub(super) fn restaged(self, stage: Option<Stage>, place: Place) -> Signal<'b> {
        // A slice of all bits gives the same signal with another stage.
        self.builder
            .node(Op::Slice(self.id, 0), self.width(), stage, place)
    }

    /// Returns the signal without its stage, for logic outside the pipeline. No register is added:
    /// the value is that of the signal at its stage.
    #[track_caller]
    pub fn untimed(self) -> Signal<'b> {
        self.untimed_from(Location::caller())
    }

    pub(super) fn untimed_from(self, place: Place) -> Signal<'b> {
        if self.stage_data().is_none() {
            return self;
        }
        self.restaged(None, place)
    }

    /// Returns the signal delayed by one register.
    #[track_caller]
    pub fn register(self) -> Signal<'b> {
        self.delay_by(1, Location::caller())
    }

    /// Returns the signal delayed by the given number of registers.
    #[track_caller]
    pub fn delay(self, registers: u32) -> Signal<'b> {
        self.delay_by(registers, Location::caller())
    }

    /// Returns the signal delayed to the given stage of its pipeline, which must not be before its
    /// own.
    #[track_caller]
    pub fn at(self, stage: u32) -> Signal<'b> {
        self.at_from(stage, Location::caller())
    }

    pub(super) fn at_from(self, stage: u32, place: Place) -> Signal<'b> {
        match self.stage_data() {
            None if self.is_literal() => self,
            None => {
                self.builder
                    .fail(place, format!("{} is not in a pipeline", self.describe()));
                self
            }
            Some(s) if s.at > stage => {
                self.builder.fail(
                    place,
                    format!(
                        "{} is at stage {}, after stage {stage}",
                        self.describe(),
                        s.at
                    ),
                );
                self
            }
            Some(s) => self.delay_by(stage - s.at, place),
        }
    }

    pub(super) fn delay_by(self, registers: u32, place: Place) -> Signal<'b> {
        let mut signal = self;
        if signal.is_literal() {
            return signal;
        }
        for _ in 0..registers {
            let known = self.builder.inner.borrow().delays.get(&signal.id).copied();
            signal = match known {
                Some(id) => Signal {
                    builder: self.builder,
                    id,
                },
                None => {
                    let cleared = self.builder.inner.borrow().ir.nodes[signal.id].cleared;
                    let stage = signal.stage_data().map(|s| Stage { at: s.at + 1, ..s });
                    let delayed = self.builder.node(
                        Op::Register(Register {
                            next: Some(signal.id),
                            reset: cleared.then_some(0),
                            delay: true,
                            ..Register::default()
                        }),
                        signal.width(),
                        stage,
                        place,
                    );
                    let mut inner = self.builder.inner.borrow_mut();
                    inner.ir.nodes[delayed.id].cleared = cleared;
                    inner.ir.drivers.insert(delayed.id, signal.id);
                    inner.delays.insert(signal.id, delayed.id);
                    inner.ir.items.push(Item::Drive(delayed.id));
                    delayed
                }
            };
        }
        signal
    }

    /// Returns the bits `high` down to `low`, inclusive.
    #[track_caller]
    pub fn bits(self, high: u32, low: u32) -> Signal<'b> {
        let place = Location::caller();
        if high < low || high >= self.width() {
            self.builder.fail(
                place,
                format!(
                    "{} has no bits {high} to {low}: it has {} bits",
                    self.describe(),
                    self.width()
                ),
            );
            return self;
        }
        self.slice(low, high - low + 1, place)
    }

    pub(super) fn slice(self, low: u32, width: u32, place: Place) -> Signal<'b> {
        if low == 0 && width == self.width() {
            return self;
        }
        if let Some(value) = self.literal() {
            let value = if low >= 128 { 0 } else { value >> low };
            let value = if width >= 128 {
                value
            } else {
                value & ((1 << width) - 1)
            };
            return self.builder.lit(value, width);
        }
        let (stage, source, low) = {
            let inner = self.builder.inner.borrow();
            let node = &inner.ir.nodes[self.id];
            match &node.op {
                // Merge a slice of a slice into one slice, unless the inner slice has a name.
                Op::Slice(of, base)
                    if inner.ir.nodes[*of].stage == node.stage && !node.is_part() =>
                {
                    (node.stage, *of, base + low)
                }
                // A slice within one operand of a concatenation is a slice of that operand.
                Op::Concat(parts) => {
                    let mut base = node.width;
                    let mut found = None;
                    for part in parts {
                        base -= inner.ir.nodes[*part].width;
                        if low >= base && low + width <= base + inner.ir.nodes[*part].width {
                            found = Some((*part, low - base));
                            break;
                        }
                    }
                    match found {
                        Some((part, inside)) => {
                            drop(inner);
                            let part = Signal {
                                builder: self.builder,
                                id: part,
                            };
                            return part.slice(inside, width, place);
                        }
                        None => (node.stage, self.id, low),
                    }
                }
                _ => (node.stage, self.id, low),
            }
        };
        self.builder
            .node(Op::Slice(source, low), width, stage, place)
    }

    /// Returns the bit with the number `index`, which is less than the width.
    #[track_caller]
    pub fn bit(self, index: u32) -> Signal<'b> {
        self.bits(index, index)
    }

    /// Returns the bit whose number is the value of `index`. The result is undefined if `index` is
    /// not less than the width.
    #[track_caller]
    pub fn bit_numbered(self, index: Signal<'b>) -> Signal<'b> {
        let place = Location::caller();
        let (aligned, stage) = self.builder.align(&[self, index], place);
        let op = Op::Bit(aligned[0].id, aligned[1].id);
        self.builder.node(op, 1, stage, place)
    }

    /// Returns the most significant bit.
    #[track_caller]
    pub fn msb(self) -> Signal<'b> {
        self.bit(self.width() - 1)
    }

    /// Returns the `width` least significant bits.
    #[track_caller]
    pub fn low(self, width: u32) -> Signal<'b> {
        self.field(0, width)
    }

    /// Returns the `width` most significant bits.
    #[track_caller]
    pub fn high(self, width: u32) -> Signal<'b> {
        self.field(self.width().saturating_sub(width), width)
    }

    /// Returns `width` bits (at least 1) from bit `lsb` upwards.
    #[track_caller]
    pub fn field(self, lsb: u32, width: u32) -> Signal<'b> {
        let place = Location::caller();
        if width == 0 || width > self.width() || lsb > self.width() - width {
            self.builder.fail(
                place,
                format!(
                    "{} has no {width} bits from bit {lsb}: it has {} bits",
                    self.describe(),
                    self.width()
                ),
            );
            return self;
        }
        self.slice(lsb, width, place)
    }

    /// Zero-extends the signal to `width` bits, which is at least its own width.
    #[track_caller]
    pub fn extend(self, width: u32) -> Signal<'b> {
        if width < self.width() {
            self.builder.fail(
                Location::caller(),
                format!(
                    "{} has {} bits, cannot be extended to {width}",
                    self.describe(),
                    self.width()
                ),
            );
            return self;
        }
        if width == self.width() {
            return self;
        }
        if let Some(value) = self.literal() {
            return self.builder.lit(value, width);
        }
        self.builder
            .concat(&[self.builder.zero(width - self.width()), self])
    }

    /// Concatenates this signal, as the more significant part, with `low`.
    #[track_caller]
    pub fn concat(self, low: Signal<'b>) -> Signal<'b> {
        self.builder.concat(&[self, low])
    }

    /// Concatenates the signal with itself, `times` copies in all.
    #[track_caller]
    pub fn repeat(self, times: u32) -> Signal<'b> {
        if times == 1 && self.builder.simplifies() {
            return self;
        }
        self.builder.node(
            Op::Repeat(self.id, times),
            self.width() * times,
            self.stage_data(),
            Location::caller(),
        )
    }

    /// Returns the full product. Its width is the sum of the operands' widths, which may differ.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // the product is wider than its factors, and their widths may differ
    pub fn mul(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::Mul, self, other, Location::caller())
    }

    /// Returns whether two signals of equal width have equal values, as one bit.
    #[track_caller]
    pub fn eq(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::Equal, self, other, Location::caller())
    }

    /// Returns whether two signals of equal width have different values, as one bit.
    #[track_caller]
    pub fn ne(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::NotEqual, self, other, Location::caller())
    }

    /// Returns whether the signal has the given constant value, as one bit. The value must fit its
    /// width.
    #[track_caller]
    pub fn equals(self, value: u128) -> Signal<'b> {
        self.eq(self.builder.lit(value, self.width()))
    }

    /// Returns whether this signal is less than `other`, both unsigned and of equal width, as one
    /// bit.
    #[track_caller]
    pub fn lt(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::Less, self, other, Location::caller())
    }

    /// Returns whether this signal is at most `other`, both unsigned and of equal width, as one
    /// bit.
    #[track_caller]
    pub fn le(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::LessEqual, self, other, Location::caller())
    }

    /// Returns whether this signal is greater than `other`, both unsigned and of equal width, as
    /// one bit.
    #[track_caller]
    pub fn gt(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::Less, other, self, Location::caller())
    }

    /// Returns whether this signal is at least `other`, both unsigned and of equal width, as one
    /// bit.
    #[track_caller]
    pub fn ge(self, other: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::LessEqual, other, self, Location::caller())
    }

    /// Shifts the signal to the left, towards the most significant bit, by the value of `by`. The
    /// width remains; zeros are shifted in.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // the amount is a signal of another width
    pub fn shl(self, by: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::ShiftLeft, self, by, Location::caller())
    }

    /// Shifts the signal to the right, towards the least significant bit, by the value of `by`. The
    /// width remains; zeros are shifted in.
    #[track_caller]
    #[allow(clippy::should_implement_trait)] // the amount is a signal of another width
    pub fn shr(self, by: Signal<'b>) -> Signal<'b> {
        self.builder
            .binary(Binary::ShiftRight, self, by, Location::caller())
    }

    /// Returns `then` where this bit is 1, `otherwise` where it is 0: a multiplexer. Both have the
    /// same width.
    #[track_caller]
    pub fn mux(self, then: Signal<'b>, otherwise: Signal<'b>) -> Signal<'b> {
        self.mux_from(then, otherwise, Location::caller())
    }

    pub(super) fn mux_from(
        self,
        then: Signal<'b>,
        otherwise: Signal<'b>,
        place: Place,
    ) -> Signal<'b> {
        let (all, stage) = self.builder.align(&[self, then, otherwise], place);
        let (condition, then, otherwise) = (all[0], all[1], all[2]);
        if condition.width() != 1 {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: a multiplexer is selected by 1 bit, {} has {}",
                    condition.describe(),
                    condition.width()
                ),
            );
        }
        if then.width() != otherwise.width() {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: a multiplexer of {} bits ({}) and {} bits ({})",
                    then.width(),
                    then.describe(),
                    otherwise.width(),
                    otherwise.describe()
                ),
            );
        }
        if then.id == otherwise.id {
            return then;
        }
        match (condition.literal(), then.literal(), otherwise.literal()) {
            (Some(0), ..) => otherwise,
            (Some(_), ..) => then,
            (None, Some(1), Some(0)) if then.width() == 1 => condition,
            (None, Some(0), Some(1)) if then.width() == 1 => !condition,
            _ => self.builder.node(
                Op::Mux(condition.id, then.id, otherwise.id),
                then.width(),
                stage,
                place,
            ),
        }
    }

    /// Returns whether any bit is 1: the OR of all bits.
    #[track_caller]
    pub fn any(self) -> Signal<'b> {
        if self.width() == 1 && self.builder.simplifies() {
            return self;
        }
        self.unary(Op::Any, 1, Location::caller())
    }

    /// Returns whether all bits are 1: the AND of all bits.
    #[track_caller]
    pub fn all(self) -> Signal<'b> {
        if self.width() == 1 && self.builder.simplifies() {
            return self;
        }
        self.unary(Op::All, 1, Location::caller())
    }

    /// Returns whether the number of 1 bits is odd: the XOR of all bits.
    #[track_caller]
    pub fn parity(self) -> Signal<'b> {
        self.unary(Op::Parity, 1, Location::caller())
    }

    /// Returns whether all bits are 0.
    #[track_caller]
    pub fn is_zero(self) -> Signal<'b> {
        !self.any()
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:ident) => {
        impl<'b> ops::$trait for Signal<'b> {
            type Output = Signal<'b>;
            #[track_caller]
            fn $method(self, other: Signal<'b>) -> Signal<'b> {
                self.builder
                    .binary(Binary::$op, self, other, Location::caller())
            }
        }
    };
}
operator!(BitAnd, bitand, And);
operator!(BitOr, bitor, Or);
operator!(BitXor, bitxor, Xor);
operator!(Add, add, Add);
operator!(Sub, sub, Sub);

impl<'b> ops::Not for Signal<'b> {
    type Output = Signal<'b>;
    #[track_caller]
    fn not(self) -> Signal<'b> {
        let place = Location::caller();
        let simpler = {
            let inner = self.builder.inner.borrow();
            let node = &inner.ir.nodes[self.id];
            match &node.op {
                // Do not look into a named signal; the reader refers to the name.
                _ if node.name.is_some() => None,
                Op::Not(a) if inner.ir.nodes[*a].stage == node.stage => {
                    return Signal {
                        builder: self.builder,
                        id: *a,
                    };
                }
                Op::Binary(Binary::Equal, a, b) => Some(Op::Binary(Binary::NotEqual, *a, *b)),
                Op::Binary(Binary::NotEqual, a, b) => Some(Op::Binary(Binary::Equal, *a, *b)),
                Op::Binary(Binary::Less, a, b) => Some(Op::Binary(Binary::LessEqual, *b, *a)),
                Op::Binary(Binary::LessEqual, a, b) => Some(Op::Binary(Binary::Less, *b, *a)),
                _ => None,
            }
        };
        let op = simpler.unwrap_or(Op::Not(self.id));
        self.builder
            .node(op, self.width(), self.stage_data(), place)
    }
}
