//! The registers of the chip's AXI4-Lite slave.

use crate::config::{Config, TriangleTest};
use std::fmt::Write as _;

/// Bytes of the register window.
pub const WINDOW: u32 = 4096;

/// The value of register `ID`: the letters `DynR`, first letter in the lowest byte.
pub const ID: u32 = u32::from_le_bytes(*b"DynR");

/// The version of the programming interface: major in bits 31:16, minor in bits 15:0.
pub const VERSION: u32 = 0x0001_0000;

/// What an access to a register does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// A constant or a status; writes have no effect.
    ReadOnly,
    /// A stored value.
    ReadWrite,
    /// Each bit is cleared by writing 1 to it.
    ClearByOne,
    /// A write starts something; a read returns 0.
    Trigger,
}

impl Access {
    /// The access as documentation writes it.
    pub fn name(self) -> &'static str {
        match self {
            Access::ReadOnly => "ro",
            Access::ReadWrite => "rw",
            Access::ClearByOne => "w1c",
            Access::Trigger => "wo",
        }
    }
}

/// A named range of bits of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    pub name: &'static str,
    pub lsb: u32,
    pub width: u32,
    pub what: &'static str,
}

/// A register of 32 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Register {
    pub name: String,
    /// Bytes from the base of the window, a multiple of 4.
    pub offset: u32,
    pub access: Access,
    /// The value after reset; of a constant, its value.
    pub reset: u32,
    pub what: String,
    pub fields: Vec<Field>,
}

/// Offsets of the registers that are not constants.
pub mod offset {
    pub const LIST: u32 = 0x40;
    pub const DOORBELL: u32 = 0x44;
    pub const STATUS: u32 = 0x48;
    pub const ERROR_CODE: u32 = 0x4c;
    pub const ERROR_DESCRIPTOR: u32 = 0x50;
    pub const ERROR_ADDRESS: u32 = 0x54;
    pub const INTERRUPT_STATUS: u32 = 0x58;
    pub const INTERRUPT_ENABLE: u32 = 0x5c;
    pub const SNAPSHOT: u32 = 0x60;
    /// The first counter; each takes two registers, the low half first.
    pub const COUNTERS: u32 = 0x100;
}

/// Bits of `STATUS`.
pub mod status {
    pub const BUSY: u32 = 0;
    pub const QUEUED: u32 = 1;
    pub const OVERRUN: u32 = 2;
}

/// Bits of `INTERRUPT_STATUS` and `INTERRUPT_ENABLE`.
pub mod interrupt {
    pub const END: u32 = 0;
    pub const SIGNAL: u32 = 1;
    pub const ERROR: u32 = 2;
    pub const OVERRUN: u32 = 3;
    pub const COUNT: u32 = 4;
}

const INTERRUPTS: [Field; interrupt::COUNT as usize] = [
    Field {
        name: "end",
        lsb: interrupt::END,
        width: 1,
        what: "a list has ended without an error",
    },
    Field {
        name: "signal",
        lsb: interrupt::SIGNAL,
        width: 1,
        what: "a `signal` with its flag set was executed",
    },
    Field {
        name: "error",
        lsb: interrupt::ERROR,
        width: 1,
        what: "a list has ended with an error",
    },
    Field {
        name: "overrun",
        lsb: interrupt::OVERRUN,
        width: 1,
        what: "a doorbell had no effect because a list was queued already; `STATUS` shows the same bit",
    },
];

/// Bits of a counter; it wraps.
pub const COUNTER_BITS: u32 = 40;

/// The counters, in the order of their registers: those of the ray casting unit, of the update processor, and of the chip.
pub const COUNTERS: &[(&str, &str)] = &[
    ("cycles", "cycles since reset"),
    ("packet_steps", "traversal steps"),
    ("ray_triangle_tests", "ray–triangle tests"),
    (
        "tpu_busy_cycles",
        "cycles in which a traversal step is decided",
    ),
    (
        "tpu_starved_cycles",
        "cycles with packets in flight but without a traversal step",
    ),
    ("ray_transforms", "rays transformed into object space"),
    (
        "gu_busy_cycles",
        "cycles in which a slot of the triangle test is used",
    ),
    (
        "gu_starved_cycles",
        "cycles with packets in flight but without a used slot",
    ),
    ("skin_influences", "influences issued"),
    ("skin_cycles", "cycles in which a mesh is skinned"),
    ("update_instructions", "update instructions executed"),
    (
        "update_busy_cycles",
        "cycles in which the update processor runs",
    ),
    (
        "update_stalled_cycles",
        "cycles of an update in which no instruction executes",
    ),
    (
        "update_vertex_wait_cycles",
        "cycles in which a load waits for its vertex",
    ),
    (
        "update_node_wait_cycles",
        "cycles in which a node waits to be written",
    ),
    ("list_cycles", "cycles in which a list runs"),
    ("cast_cycles", "cycles in which the cast unit is not idle"),
    ("cast_rays", "rays that have entered the ray casting unit"),
    ("node_requests", "requests to the cache of nodes"),
    ("node_hits", "hits in the cache of nodes"),
    ("node_misses", "lines requested by the cache of nodes"),
    (
        "node_stalls",
        "cycles in which a request waits in the cache of nodes",
    ),
    (
        "record_requests",
        "requests to the cache of triangle records",
    ),
    ("record_hits", "hits in the cache of triangle records"),
    (
        "record_misses",
        "lines requested by the cache of triangle records",
    ),
    (
        "record_stalls",
        "cycles in which a request waits in the cache of triangle records",
    ),
    ("vertex_requests", "requests to the cache of vertices"),
    ("vertex_hits", "hits in the cache of vertices"),
    ("vertex_misses", "lines requested by the cache of vertices"),
    (
        "vertex_stalls",
        "cycles in which a request waits in the cache of vertices",
    ),
    (
        "moved_requests",
        "requests to the cache of the vertices that are updated",
    ),
    (
        "moved_hits",
        "hits in the cache of the vertices that are updated",
    ),
    (
        "moved_misses",
        "lines requested by the cache of the vertices that are updated",
    ),
    (
        "moved_stalls",
        "cycles in which a request waits in the cache of the vertices that are updated",
    ),
    ("read_beats", "beats of read data on the bus"),
    (
        "read_waits",
        "cycles in which a read address waits for the bus",
    ),
    ("write_beats", "beats of write data on the bus"),
    (
        "write_waits",
        "cycles in which a write address or write data waits for the bus",
    ),
];

/// The offsets of the low and the high half of a counter.
pub fn counter(place: usize) -> [u32; 2] {
    let low = offset::COUNTERS + 8 * place as u32;
    [low, low + 4]
}

/// A constant register, by its fields and their values.
fn constant(
    name: &str,
    offset: u32,
    what: &str,
    fields: &[(&'static str, u32, u32, u32, &'static str)],
) -> Register {
    let reset = fields
        .iter()
        .fold(0, |word, &(name, lsb, width, value, _)| {
            assert!(u64::from(value) < 1 << width, "{name} fits its field");
            word | value << lsb
        });
    let field = |&(name, lsb, width, _, what)| Field {
        name,
        lsb,
        width,
        what,
    };
    Register {
        name: name.into(),
        offset,
        access: Access::ReadOnly,
        reset,
        what: what.into(),
        fields: fields.iter().map(field).collect(),
    }
}

/// The constants that describe a machine.
fn capabilities(config: &Config) -> Vec<Register> {
    let watertight = u32::from(config.triangle_test == TriangleTest::Watertight);
    let whole = |name, offset, value, what| Register {
        reset: value,
        ..constant(name, offset, what, &[])
    };
    vec![
        whole("ID", 0x00, ID, "the letters `DynR`"),
        whole(
            "VERSION",
            0x04,
            VERSION,
            "version of this interface: major in bits 31:16, minor in bits 15:0",
        ),
        constant(
            "FORMAT",
            0x08,
            "the format of numbers",
            &[
                ("exponent_bits", 0, 8, config.exponent_bits, "exponent bits"),
                ("fraction_bits", 8, 8, config.fraction_bits, "fraction bits"),
            ],
        ),
        constant(
            "PACKETS",
            0x0c,
            "packets of rays",
            &[
                ("rays", 0, 8, config.rays_per_packet, "rays per packet"),
                (
                    "in_flight",
                    8,
                    8,
                    config.packets_in_flight,
                    "packets in flight",
                ),
                (
                    "tag_bits",
                    16,
                    8,
                    config.tag_bits,
                    "a cast has at most 2^tag_bits packets",
                ),
            ],
        ),
        constant(
            "TREE",
            0x10,
            "the trees that the machine can traverse",
            &[
                (
                    "address_bits",
                    0,
                    8,
                    config.address_bits,
                    "an index has this number of bits",
                ),
                (
                    "stack_depth",
                    8,
                    8,
                    config.stack_depth,
                    "greatest depth in inner nodes",
                ),
                (
                    "axes_per_node",
                    16,
                    2,
                    config.axes_per_node,
                    "axes per node",
                ),
                (
                    "watertight",
                    24,
                    1,
                    watertight,
                    "the triangle test is watertight",
                ),
            ],
        ),
        constant(
            "BUS",
            0x14,
            "the memory bus",
            &[
                (
                    "data_bytes",
                    0,
                    8,
                    config.bus_data_bits / 8,
                    "bytes per beat",
                ),
                ("reads", 8, 8, config.bus_reads, "read bursts outstanding"),
                (
                    "writes",
                    16,
                    8,
                    config.bus_writes,
                    "write bursts outstanding",
                ),
            ],
        ),
        constant(
            "CACHES",
            0x18,
            "the caches",
            &[
                (
                    "line_bytes",
                    0,
                    8,
                    config.cache_line_bytes,
                    "bytes per line",
                ),
                ("ways", 8, 8, config.cache_ways, "lines per set"),
                (
                    "misses",
                    16,
                    8,
                    config.cache_misses,
                    "lines in flight, each cache",
                ),
            ],
        ),
        constant(
            "CACHE_KIB",
            0x1c,
            "the sizes of the caches",
            &[
                ("nodes", 0, 8, config.cache_nodes_kib, "KiB for nodes"),
                (
                    "records",
                    8,
                    8,
                    config.cache_records_kib,
                    "KiB for triangle records",
                ),
                (
                    "vertices",
                    16,
                    8,
                    config.cache_vertices_kib,
                    "KiB for vertices",
                ),
                (
                    "update",
                    24,
                    8,
                    config.cache_update_kib,
                    "KiB for vertices that are updated",
                ),
            ],
        ),
        constant(
            "SKINNING",
            0x20,
            "what can be skinned",
            &[(
                "joints",
                0,
                16,
                config.skinning_joints,
                "matrices per palette",
            )],
        ),
        constant(
            "UPDATE",
            0x24,
            "the update programs that the machine runs",
            &[
                (
                    "vertex_registers",
                    0,
                    8,
                    config.update_vertex_registers,
                    "vertex registers",
                ),
                (
                    "box_registers",
                    8,
                    8,
                    config.update_box_registers,
                    "box registers",
                ),
            ],
        ),
    ]
}

/// All registers of a machine, by offset.
pub fn registers(config: &Config) -> Vec<Register> {
    let mut all = capabilities(config);
    let mut add = |name: &str, offset, access, what: &str, fields: &[Field]| {
        all.push(Register {
            name: name.into(),
            offset,
            access,
            reset: 0,
            what: what.into(),
            fields: fields.to_vec(),
        });
    };
    use Access::{ClearByOne, ReadOnly, ReadWrite, Trigger};
    let bit = |name, lsb, what| Field {
        name,
        lsb,
        width: 1,
        what,
    };
    add(
        "LIST",
        offset::LIST,
        ReadWrite,
        "address of the command list that a doorbell starts, a multiple of 64",
        &[],
    );
    add(
        "DOORBELL",
        offset::DOORBELL,
        Trigger,
        "a write starts or queues the list at `LIST`",
        &[],
    );
    let states = [
        bit("busy", status::BUSY, "a list runs"),
        bit("queued", status::QUEUED, "one more list is queued"),
        bit(
            "overrun",
            status::OVERRUN,
            "a doorbell had no effect; cleared through `INTERRUPT_STATUS`",
        ),
    ];
    add(
        "STATUS",
        offset::STATUS,
        ReadOnly,
        "what the chip does",
        &states,
    );
    add(
        "ERROR_CODE",
        offset::ERROR_CODE,
        ReadOnly,
        "why the last list ended early, or 0",
        &[],
    );
    add(
        "ERROR_DESCRIPTOR",
        offset::ERROR_DESCRIPTOR,
        ReadOnly,
        "address of the descriptor with the error",
        &[],
    );
    add(
        "ERROR_ADDRESS",
        offset::ERROR_ADDRESS,
        ReadOnly,
        "the address or the value that is wrong",
        &[],
    );
    add(
        "INTERRUPT_STATUS",
        offset::INTERRUPT_STATUS,
        ClearByOne,
        "events since they were cleared",
        &INTERRUPTS,
    );
    add(
        "INTERRUPT_ENABLE",
        offset::INTERRUPT_ENABLE,
        ReadWrite,
        "events that raise the interrupt",
        &INTERRUPTS,
    );
    add(
        "SNAPSHOT",
        offset::SNAPSHOT,
        Trigger,
        "a write copies all counters to the registers below",
        &[],
    );
    for (place, (name, what)) in COUNTERS.iter().enumerate() {
        let [low, high] = counter(place);
        let upper = name.to_uppercase();
        add(
            &format!("{upper}_LOW"),
            low,
            ReadOnly,
            &format!("{what}: bits 31:0"),
            &[],
        );
        add(
            &format!("{upper}_HIGH"),
            high,
            ReadOnly,
            &format!("{what}: bits {}:32", COUNTER_BITS - 1),
            &[],
        );
    }
    all
}

/// The table of `docs/registers.md`.
pub fn table(config: &Config) -> String {
    let mut text =
        String::from("| offset | name | access | reset | what |\n|---|---|---|---|---|\n");
    let all = registers(config);
    for register in &all {
        let _ = writeln!(
            text,
            "| {:#05x} | `{}` | {} | {:#x} | {} |",
            register.offset,
            register.name,
            register.access.name(),
            register.reset,
            register.what
        );
    }
    for register in all.iter().filter(|register| !register.fields.is_empty()) {
        let _ = write!(
            text,
            "\n### `{}`\n\n| bits | field | what |\n|---|---|---|\n",
            register.name
        );
        for field in &register.fields {
            let bits = match field.width {
                1 => field.lsb.to_string(),
                width => format!("{}:{}", field.lsb + width - 1, field.lsb),
            };
            let _ = writeln!(text, "| {bits} | `{}` | {} |", field.name, field.what);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_have_places_of_their_own() {
        let all = registers(&Config::reference());
        for pair in all.windows(2) {
            assert!(
                pair[0].offset + 4 <= pair[1].offset,
                "{} and {}",
                pair[0].name,
                pair[1].name
            );
        }
        for register in &all {
            assert!(register.offset.is_multiple_of(4) && register.offset < WINDOW);
            let mut end = 0;
            for field in &register.fields {
                assert!(field.lsb >= end && field.lsb + field.width <= 32);
                end = field.lsb + field.width;
            }
        }
    }
}
