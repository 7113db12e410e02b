//! The registers that the target clock requires outside of the arithmetic units, in one table for all units. The pipelines of the
//! arithmetic units follow from the delays of their steps, see [`fp`](super::fp).

macro_rules! timing {
    ($($(#[doc = $doc:literal])* $name:ident from $mhz:literal;)*) => {
        /// The registers at one target clock.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Timing {
            $($(#[doc = $doc])* pub $name: bool,)*
        }

        impl Timing {
            /// The registers at a clock in MHz.
            pub const fn at(clock_mhz: u32) -> Timing {
                Timing { $($name: clock_mhz >= $mhz,)* }
            }

            /// Each register: its name, the lowest clock in MHz at which it is present, and the reason.
            pub const TABLE: &[(&str, u32, &str)] = &[$((stringify!($name), $mhz, concat!($($doc),*)),)*];
        }
    };
}

timing! {
    /// A register after each comparison whose result selects an operand.
    comparison from 70;
    /// A register after a multiplexer with a fan-out to many block RAMs or operators: the wires take most of a 10 ns period.
    choice from 80;
    /// A second register after a block RAM, whose output takes half of a 10 ns period on an ECP5.
    ram_output from 80;
    /// A third register after a block RAM: the wires from all RAMs of a wide memory take the rest of an 8 ns period.
    wide_ram_output from 120;
    /// Registers for the valid bit and the front word of a queue, which are followed by a multiplexer of queues and the wires to a memory's address.
    queue_front from 105;
    /// A register after a comparison whose result drives every bit of a multiplexer.
    decision from 110;
    /// A register for the destination of a packet after a start or a pop, which is followed by the wires to all queues and memories.
    entered_packet from 120;
    /// A register between a comparison of the update processor and the multiplexer that it controls.
    merge_comparison from 120;
    /// A register after the registers of the update processor, which are in block RAM. At lower clocks a multiplexer of two words follows the RAM directly.
    merge_register from 120;
    /// A register for the arrival of the word at the head of a prefetcher: the selection of its bit and the logic that waits for it do not fit into one cycle.
    arrival from 120;
    /// A register for room in a queue: the test of the count and the logic that waits for it do not fit into one cycle.
    room from 120;
    /// A register after the adder of a step by ulps.
    step_sum from 120;
    /// A register for an event before its counter: the event leaves too little of the cycle for the wires to the counter.
    event from 120;
}

impl Timing {
    /// The latency from the address of a block RAM to its word.
    pub const fn read_latency(&self) -> u32 {
        1 + self.ram_output as u32 + self.wide_ram_output as u32
    }
}
