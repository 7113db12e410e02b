//! Which registers the target clock asks for, beside those of the arithmetic, which [`fp`](super::fp) schedules by its steps' delays: one
//! table for all units.

macro_rules! timing {
    ($($(#[doc = $doc:literal])* $name:ident from $mhz:literal;)*) => {
        /// Registers of one target clock.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Timing {
            $($(#[doc = $doc])* pub $name: bool,)*
        }

        impl Timing {
            /// Registers for a clock in MHz.
            pub const fn at(clock_mhz: u32) -> Timing {
                Timing { $($name: clock_mhz >= $mhz,)* }
            }

            /// Each register: its name, the clock in MHz from which on it is there, and why.
            pub const TABLE: &[(&str, u32, &str)] = &[$((stringify!($name), $mhz, concat!($($doc),*)),)*];
        }
    };
}

timing! {
    /// A register after each comparison whose result chooses.
    comparison from 70;
    /// A register after a choice whose result goes to many block RAMs or operators: the wires to all of them take most of a 10 ns period.
    choice from 80;
    /// A second register behind a block RAM, whose output takes half of a 10 ns period on an ECP5.
    ram_output from 80;
    /// A third one: the wires from all the RAMs of a wide memory take the rest of an 8 ns period.
    wide_ram_output from 120;
    /// Registers for a queue's valid bit and front word: a choice between queues and the wires to a memory's address follow them.
    queue_front from 105;
    /// A register after what a comparison decides, which goes to each bit of a choice.
    decision from 110;
    /// A register for where a packet goes after a start or a pop: the wires to all queues and memories follow it.
    entered_packet from 120;
    /// A register between a comparison of the update processor and the choice that it makes.
    merge_comparison from 120;
    /// A register behind the update processor's registers, which lie in block RAM. Below, a choice between two words follows the RAM.
    merge_register from 120;
    /// A register for whether the word at a reader's head has arrived: the choice of its bit and all that waits for it do not fit in a clock.
    arrival from 120;
    /// A register for whether there is room: a count's test and all that waits for room do not fit in a clock.
    room from 120;
    /// A register behind the adder of a step by ulps.
    step_sum from 120;
    /// A register for an event before it is counted: it leaves too little of the clock for the wires to a counter.
    event from 120;
}

impl Timing {
    /// Registers from a block RAM's address to its word.
    pub const fn read_latency(&self) -> u32 {
        1 + self.ram_output as u32 + self.wide_ram_output as u32
    }
}
