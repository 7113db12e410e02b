//! What every unit of one machine agrees on: its configuration, the widths that follow from it, its arithmetic.

use super::distance;
use super::fp::{Operand, Units, goes_before};
use super::timing::Timing;
use crate::config::{Config, TriangleTest};
use crate::float::Format;
use crate::hdl::fifo::{self, Placed};
use crate::hdl::{Builder, HdlError, Memory, Module, Signal, bits_for};
use std::sync::Arc;

/// The axes, as ports and fields are named after them.
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// The widths and shared modules of one machine.
#[derive(Clone)]
pub struct Plan {
    pub config: Config,
    pub format: Format,
    pub units: Units,
    /// Plane distances, three ulps down and up.
    pub near_distance: Arc<Module>,
    pub far_distance: Arc<Module>,
    /// Registers that the clock asks for.
    pub timing: Timing,
    /// Whether the machine has trace ports, which show every packet step, test and transformation.
    pub trace: bool,
}

impl Plan {
    /// Of a machine without trace ports.
    pub fn new(config: &Config) -> Result<Plan, HdlError> {
        let format = config.format();
        let units = Units::new(format, config.clock_mhz)?;
        Ok(Plan {
            config: config.clone(),
            format,
            near_distance: distance::near(&units)?,
            far_distance: distance::far(&units)?,
            units,
            timing: Timing::at(config.clock_mhz),
            trace: false,
        })
    }

    /// The same machine, with trace ports or without.
    pub fn with_trace(self, trace: bool) -> Plan {
        Plan { trace, ..self }
    }

    /// Bits of a number.
    pub fn number(&self) -> u32 {
        self.format.width()
    }

    pub fn infinity<'b>(&self, m: &'b Builder) -> Signal<'b> {
        m.constant("INFINITY", self.format.infinity(), self.number())
    }

    pub fn minus_infinity<'b>(&self, m: &'b Builder) -> Signal<'b> {
        let value = self.format.infinity() | self.format.sign_bit();
        m.constant("MINUS_INFINITY", value, self.number())
    }

    pub fn watertight(&self) -> bool {
        self.config.triangle_test == TriangleTest::Watertight
    }

    pub fn rays(&self) -> u32 {
        self.config.rays_per_packet
    }

    pub fn packets(&self) -> u32 {
        self.config.packets_in_flight
    }

    /// Bits that number a ray of a packet.
    pub fn ray_bits(&self) -> u32 {
        bits_for(u64::from(self.rays()))
    }

    /// Bits that number a packet in flight.
    pub fn packet_bits(&self) -> u32 {
        bits_for(u64::from(self.packets()))
    }

    /// Bits that index an entry of a packet's stack.
    pub fn stack_bits(&self) -> u32 {
        bits_for(u64::from(self.config.stack_depth))
    }

    /// Bits that count the entries of a packet's stack.
    pub fn level_bits(&self) -> u32 {
        bits_for(u64::from(self.config.stack_depth) + 1)
    }

    pub fn address(&self) -> u32 {
        self.config.address_bits
    }

    /// A queue: see [`fifo::place`].
    ///
    /// # Errors
    /// None of a depth of at least 1.
    pub fn queue<'b>(
        &self,
        name: &str,
        depth: u32,
        push: Signal<'b>,
        data: Signal<'b>,
        pop: Signal<'b>,
    ) -> Result<Placed<'b>, HdlError> {
        fifo::place(self.timing.queue_front, name, depth, push, data, pop)
    }

    /// A queue in block RAM: see [`fifo::place_block`].
    ///
    /// # Errors
    /// None of a depth of at least 1.
    pub fn block_queue<'b>(
        &self,
        name: &str,
        depth: u32,
        push: Signal<'b>,
        data: Signal<'b>,
        pop: Signal<'b>,
    ) -> Result<Placed<'b>, HdlError> {
        fifo::place_block(self.read_latency(), name, depth, push, data, pop)
    }

    /// A synchronous read, with more registers where the clock asks for them.
    pub fn read<'b>(&self, memory: Memory<'b>, address: Signal<'b>) -> Signal<'b> {
        self.settle_read(memory.read(address), 1)
    }

    /// The registers that [`Plan::read`] has behind the first so many.
    fn settle_read<'b>(&self, word: Signal<'b>, behind: u32) -> Signal<'b> {
        (behind..self.read_latency()).fold(word, |word, _| word.register())
    }

    /// Whether a choice of what was read has a register before it as well as behind: that before it can be a block RAM's own.
    pub fn chooses_after_read(&self) -> bool {
        self.read_latency() >= 3
    }

    /// A choice of what was read and registered, as late as [`Plan::read`] has a word. Only where
    /// [`Plan::chooses_after_read`].
    pub fn settle_choice<'b>(&self, choice: Signal<'b>) -> Signal<'b> {
        self.settle_read(choice, 2)
    }

    /// Registers that [`Plan::read`] takes.
    pub fn read_latency(&self) -> u32 {
        self.timing.read_latency()
    }

    /// A read as [`Plan::read`] makes it, but `otherwise` where `wanted`, which stands beside the address, is low.
    /// Where the word is registered again, choosing a constant costs only that register's reset.
    pub fn read_where<'b>(
        &self,
        memory: Memory<'b>,
        address: Signal<'b>,
        wanted: Signal<'b>,
        otherwise: Signal<'b>,
    ) -> Signal<'b> {
        let wanted = wanted.hinted(format!("{}_wanted", memory.name()));
        let (wanted, word) = (wanted.register(), memory.read(address));
        let choice = |wanted: Signal<'b>, read: Signal<'b>| {
            let choice = wanted.mux(read, otherwise);
            choice.hinted_after(word, "or_default")
        };
        if self.chooses_after_read() {
            self.settle_choice(choice(wanted.register(), word.register()))
        } else {
            self.settle_read(choice(wanted, word), 1)
        }
    }

    /// Bits that number a packet in the world and in an object's space.
    pub fn level_packet_bits(&self) -> u32 {
        1 + self.packet_bits()
    }

    /// Words of a memory that has one for each packet in the world, and behind them one for each in an object's space.
    pub fn level_packets(&self) -> u32 {
        (1 << self.packet_bits()) + self.packets()
    }

    /// Words of a memory that has one for each ray in flight.
    pub fn rays_in_flight(&self) -> u32 {
        self.packets() << self.ray_bits()
    }

    /// The word of a ray in such a memory.
    pub fn ray_index<'b>(&self, packet: Signal<'b>, ray: Signal<'b>) -> Signal<'b> {
        let bits = bits_for(u64::from(self.rays_in_flight())) - self.ray_bits();
        packet.low(bits).concat(ray)
    }

    /// Words of a memory that has one for each ray in flight in the world, and behind them one for each in an object's space.
    pub fn level_rays_in_flight(&self) -> u32 {
        (1 << bits_for(u64::from(self.rays_in_flight()))) + self.rays_in_flight()
    }

    /// A register after a choice whose result goes far, to a large memory or to many operators, where the clock asks for it.
    pub fn choose<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        match self.choose_latency() {
            0 => signal,
            _ => signal.register(),
        }
    }

    /// Registers that [`Plan::choose`] takes.
    pub fn choose_latency(&self) -> u32 {
        u32::from(self.timing.choice)
    }

    /// `x` where it is less than `bound`, else `bound`, its pattern unchanged: a NaN never replaces a bound. Called `name` in the
    /// Verilog. Where the clock asks for it, a register follows the comparison.
    pub fn min<'b>(
        &self,
        name: impl AsRef<str>,
        bound: impl Into<Operand<'b>>,
        x: impl Into<Operand<'b>>,
    ) -> Signal<'b> {
        let (bound, x) = (bound.into(), x.into());
        let name = name.as_ref();
        let less = goes_before(self.format, &format!("{name}_is_less"), x, bound);
        self.replaced(name, less, bound, x)
    }

    /// `x` where it is greater than `bound`, else `bound`; as [`Plan::min`].
    pub fn max<'b>(
        &self,
        name: impl AsRef<str>,
        bound: impl Into<Operand<'b>>,
        x: impl Into<Operand<'b>>,
    ) -> Signal<'b> {
        let (bound, x) = (bound.into(), x.into());
        let name = name.as_ref();
        let greater = goes_before(self.format, &format!("{name}_is_greater"), bound, x);
        self.replaced(name, greater, bound, x)
    }

    fn replaced<'b>(
        &self,
        name: &str,
        replaces: Signal<'b>,
        bound: Operand<'b>,
        x: Operand<'b>,
    ) -> Signal<'b> {
        self.decide(replaces)
            .mux(x.signal(), bound.signal())
            .named(name)
    }

    /// A register after what a comparison decides, where the clock asks for it.
    pub fn decide<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        if self.timing.decision {
            signal.register()
        } else {
            signal
        }
    }

    /// A register after a comparison whose result chooses, where the clock asks for it.
    pub fn settle<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        if self.timing.comparison {
            signal.register()
        } else {
            signal
        }
    }
}
