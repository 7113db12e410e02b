//! The parameters of a machine that all its units share: configuration, widths, arithmetic, timing.

use super::distance;
use super::fp::{Operand, Units, goes_before};
use super::timing::Timing;
use crate::config::{Config, TriangleTest};
use crate::float::Format;
use crate::hdl::fifo::{self, Placed};
use crate::hdl::{Builder, HdlError, Memory, Module, Signal, bits_for};
use std::sync::Arc;

/// The names of the axes in ports and fields.
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// The widths and shared modules of one machine.
#[derive(Clone)]
pub struct Plan {
    pub config: Config,
    pub format: Format,
    pub units: Units,
    /// The modules of plane distances, to near and to far planes.
    pub near_distance: Arc<Module>,
    pub far_distance: Arc<Module>,
    /// The registers that the target clock requires.
    pub timing: Timing,
    /// Whether the machine has trace ports, which show every traversal step, test and transformation.
    pub trace: bool,
}

impl Plan {
    /// Makes the plan of a machine without trace ports.
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

    /// The same machine with or without trace ports.
    pub fn with_trace(self, trace: bool) -> Plan {
        Plan { trace, ..self }
    }

    /// Width of a number.
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

    /// A number from memory: −0 becomes +0.
    pub fn without_minus_zero<'b>(&self, number: Signal<'b>) -> Signal<'b> {
        let (exponent, fraction) = (self.format.exponent_bits(), self.format.fraction_bits());
        let is_normal = number.field(fraction, exponent).any();
        let magnitude = number.low(self.number() - 1);
        (number.msb() & is_normal).concat(magnitude)
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

    /// Width of the index of a ray in its packet.
    pub fn ray_bits(&self) -> u32 {
        bits_for(u64::from(self.rays()))
    }

    /// Width of a packet number.
    pub fn packet_bits(&self) -> u32 {
        bits_for(u64::from(self.packets()))
    }

    /// Width of the index of a stack entry.
    pub fn stack_bits(&self) -> u32 {
        bits_for(u64::from(self.config.stack_depth))
    }

    /// Width of the number of entries in a packet's stack.
    pub fn level_bits(&self) -> u32 {
        bits_for(u64::from(self.config.stack_depth) + 1)
    }

    pub fn address(&self) -> u32 {
        self.config.address_bits
    }

    /// Instantiates a queue: see [`fifo::place`].
    ///
    /// # Errors
    /// None for a depth of at least 1.
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

    /// Instantiates a queue in block RAM: see [`fifo::place_block`].
    ///
    /// # Errors
    /// None for a depth of at least 1.
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

    /// Reads a memory synchronously, with the output registers that the target clock requires.
    pub fn read<'b>(&self, memory: Memory<'b>, address: Signal<'b>) -> Signal<'b> {
        self.settle_read(memory.read(address), 1)
    }

    /// Adds the remaining output registers of [`Plan::read`], after the first `behind`.
    fn settle_read<'b>(&self, word: Signal<'b>, behind: u32) -> Signal<'b> {
        (behind..self.read_latency()).fold(word, |word, _| word.register())
    }

    /// Whether a multiplexer of words read from memories has a register before and after it. The one before it can be the output
    /// register of the block RAM.
    pub fn chooses_after_read(&self) -> bool {
        self.read_latency() >= 3
    }

    /// Delays a choice of registered words to the latency of [`Plan::read`]. Only if
    /// [`Plan::chooses_after_read`].
    pub fn settle_choice<'b>(&self, choice: Signal<'b>) -> Signal<'b> {
        self.settle_read(choice, 2)
    }

    /// The latency of [`Plan::read`] in cycles.
    pub fn read_latency(&self) -> u32 {
        self.timing.read_latency()
    }

    /// Reads as [`Plan::read`], but returns `otherwise` where `wanted` was low in the cycle of the address.
    /// If the word is registered again, the choice of a constant costs only the reset of this register.
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

    /// Width of the address of a packet in world space or in object space.
    pub fn level_packet_bits(&self) -> u32 {
        1 + self.packet_bits()
    }

    /// Depth of a memory with one word per packet in world space, followed by one per packet in object space.
    pub fn level_packets(&self) -> u32 {
        (1 << self.packet_bits()) + self.packets()
    }

    /// Depth of a memory with one word per ray in flight.
    pub fn rays_in_flight(&self) -> u32 {
        self.packets() << self.ray_bits()
    }

    /// The address of a ray in such a memory.
    pub fn ray_index<'b>(&self, packet: Signal<'b>, ray: Signal<'b>) -> Signal<'b> {
        let bits = bits_for(u64::from(self.rays_in_flight())) - self.ray_bits();
        packet.low(bits).concat(ray)
    }

    /// Depth of a memory with one word per ray in flight in world space, followed by one per ray in object space.
    pub fn level_rays_in_flight(&self) -> u32 {
        (1 << bits_for(u64::from(self.rays_in_flight()))) + self.rays_in_flight()
    }

    /// Adds a register after a multiplexer with a large fan-out (a large memory or many operators), if the target clock requires it.
    pub fn choose<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        match self.choose_latency() {
            0 => signal,
            _ => signal.register(),
        }
    }

    /// The latency of [`Plan::choose`] in cycles.
    pub fn choose_latency(&self) -> u32 {
        u32::from(self.timing.choice)
    }

    /// Returns `x` if it is less than `bound`, else `bound`; the bit pattern is unchanged, and a NaN never replaces a bound. The
    /// result is called `name` in the Verilog. A register follows the comparison if the target clock requires it.
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

    /// Returns `x` if it is greater than `bound`, else `bound`; as [`Plan::min`].
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

    /// Adds a register after the result of a comparison, if the target clock requires it.
    pub fn decide<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        if self.timing.decision {
            signal.register()
        } else {
            signal
        }
    }

    /// Adds a register after a comparison whose result selects an operand, if the target clock requires it.
    pub fn settle<'b>(&self, signal: Signal<'b>) -> Signal<'b> {
        if self.timing.comparison {
            signal.register()
        } else {
            signal
        }
    }
}
