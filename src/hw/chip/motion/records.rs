//! Records: vertices, nodes and a box as writes of 16-byte words.

use super::Around;
use crate::bkd::bytes::{ByteRecord, Part};
use crate::hdl::{Reg, Signal};
use crate::hw::chip::fitted;
use crate::hw::memory::ADDRESS_BITS;
use crate::hw::memory::combiner::{WORD_BITS, WORD_BYTES, Word};

/// Byte addresses of the arrays, and of the box.
#[derive(Clone, Copy)]
pub(super) struct Bases<'b> {
    pub vertices: Signal<'b>,
    pub nodes: Signal<'b>,
    pub bounds: Signal<'b>,
}

/// The writer of records. A record of 32 bytes takes two words.
pub(super) struct Writer<'b> {
    pub valid: Reg<'b>,
    pub word: Word<Signal<'b>>,
    pub takes_vertex: Signal<'b>,
    pub takes_node: Signal<'b>,
    pub takes_box: Signal<'b>,
    // For the properties.
    pub loads: Signal<'b>,
    /// Whether the second word of the offered record comes next; only if a record can have two.
    pub second: Option<Reg<'b>>,
}

/// A record that is offered.
#[derive(Clone, Copy)]
struct Offer<'b> {
    valid: Signal<'b>,
    address: Signal<'b>,
    /// Its words from the lowest on, with their strobes: one, or two.
    words: [(Signal<'b>, Signal<'b>); 2],
    is_wide: bool,
}

impl<'b> Writer<'b> {
    pub fn new(around: &Around<'_, 'b>, bases: Bases<'b>) -> Writer<'b> {
        let Around { m, inputs, .. } = *around;
        let offers = [
            around.vertex(bases),
            around.node(bases),
            around.bounds(bases),
        ];
        m.comment("A word is registered. The second word of a wide record follows the first.");
        let valid = m.reg_reset("is_write_valid", 1, 0);
        let address = m.reg("stored_address", ADDRESS_BITS);
        let data = m.reg("stored_data", WORD_BITS);
        let strobes = m.reg("stored_strobes", WORD_BYTES);
        let room = (!valid.q | inputs.write_ready).named("has_room");
        let any: Vec<_> = offers.iter().map(|offer| offer.valid).collect();
        let loads = (m.or_all(&any) & room).named("loads_write");
        valid.next(loads | (valid.q & !inputs.write_ready));

        let wide: Vec<_> = (offers.iter())
            .filter(|offer| offer.is_wide)
            .map(|offer| offer.valid)
            .collect();
        let second = (!wide.is_empty()).then(|| {
            let second = m.reg_reset("is_second", 1, 0);
            second.next_when(loads, m.or_all(&wide) & !second.q);
            second
        });
        let place = second.map_or(m.zero(1), |second| second.q);
        let word_of = |offer: &Offer<'b>| {
            let [first, last] = offer.words;
            let (upper, data, strobes) = match offer.is_wide {
                false => (m.zero(1), first.0, first.1),
                true => (
                    place,
                    place.mux(last.0, first.0),
                    place.mux(last.1, first.1),
                ),
            };
            let upper = upper.concat(m.zero(WORD_BYTES.ilog2()));
            let address = match offer.is_wide {
                false => offer.address,
                true => offer.address | upper.extend(ADDRESS_BITS),
            };
            Word {
                address,
                data,
                strobes,
            }
        };
        let [vertex, node, bounds] = offers;
        let of_update = (node.valid).choose(word_of(&node), word_of(&bounds));
        let word = (vertex.valid).choose(word_of(&vertex), of_update);
        address.next_when(loads, word.address);
        data.next_when(loads, word.data);
        strobes.next_when(loads, word.strobes);
        let takes = |offer: &Offer<'b>| match offer.is_wide {
            false => room,
            true => room & place,
        };
        Writer {
            word: Word {
                address: address.q,
                data: data.q,
                strobes: strobes.q,
            },
            valid,
            takes_vertex: takes(&offers[0]),
            takes_node: takes(&offers[1]) & !offers[0].valid,
            takes_box: takes(&offers[2]) & !offers[0].valid & !offers[1].valid,
            loads,
            second,
        }
    }
}

impl<'b> Around<'_, 'b> {
    /// A skinned vertex.
    fn vertex(&self, bases: Bases<'b>) -> Offer<'b> {
        self.m.comment("A skinned vertex.");
        let layout = ByteRecord::vertex(self.plan.format);
        let write = self.inputs.units.skinned;
        let bytes = bytes_of(&layout.parts, layout.bytes, write.payload.data);
        let address = record_address(bases.vertices, write.payload.address, layout.bytes);
        let address = address.named("vertex_place");
        let strobes = self.m.ones(layout.bytes);
        placed(write.valid, address, bytes, strobes)
    }

    /// The numbers of a node; its link word stays as it is.
    fn node(&self, bases: Bases<'b>) -> Offer<'b> {
        let m = self.m;
        m.comment("The numbers of a node.");
        let layout = ByteRecord::node(self.plan.format);
        let write = self.inputs.units.node;
        let bytes = bytes_of(&layout.parts, layout.bytes, write.payload.data);
        let address = record_address(bases.nodes, write.payload.address, layout.bytes);
        let lanes = (layout.parts.iter().enumerate())
            .map(|(lane, part)| write.payload.mask.bit(lane as u32).repeat(part.bytes()));
        let mut lanes: Vec<_> = lanes.collect();
        let used: u32 = layout.parts.iter().map(Part::bytes).sum();
        if used < layout.bytes {
            lanes.push(m.zero(layout.bytes - used));
        }
        lanes.reverse();
        let strobes = m.concat(&lanes);
        placed(write.valid, address.named("node_place"), bytes, strobes)
    }

    /// The box: two vertex records.
    fn bounds(&self, bases: Bases<'b>) -> Offer<'b> {
        let m = self.m;
        m.comment("The box: its least corner, then its greatest.");
        let layout = ByteRecord::vertex(self.plan.format);
        let bits = layout.record.width;
        let numbers = self.inputs.units.bounds;
        let corner = |k: u32| bytes_of(&layout.parts, layout.bytes, numbers.field(k * bits, bits));
        let bytes = corner(1).concat(corner(0));
        let strobes = m.ones(2 * layout.bytes);
        placed(self.inputs.units.bounds_valid, bases.bounds, bytes, strobes)
    }
}

/// The address of a record of an array.
fn record_address<'b>(base: Signal<'b>, index: Signal<'b>, bytes: u32) -> Signal<'b> {
    let offset = index.concat(index.module().zero(bytes.ilog2()));
    base + fitted(offset, ADDRESS_BITS)
}

/// The bytes of a record.
fn bytes_of<'b>(parts: &[Part], bytes: u32, record: Signal<'b>) -> Signal<'b> {
    let of_part = |part: &Part| record.field(part.lsb, part.width).extend(8 * part.bytes());
    let mut all: Vec<_> = parts.iter().map(of_part).collect();
    let used: u32 = parts.iter().map(Part::bytes).sum();
    if used < bytes {
        all.push(record.module().zero(8 * (bytes - used)));
    }
    all.reverse();
    record.module().concat(&all)
}

/// A record at its place in words: a short one may be in any part of a word.
fn placed<'b>(
    valid: Signal<'b>,
    address: Signal<'b>,
    bytes: Signal<'b>,
    strobes: Signal<'b>,
) -> Offer<'b> {
    let m = address.module();
    let length = strobes.width();
    let offset = WORD_BYTES.ilog2();
    let word_address = address.high(ADDRESS_BITS - offset).concat(m.zero(offset));
    let words = match length > WORD_BYTES {
        true => {
            let word = |k: u32| {
                (
                    bytes.field(k * WORD_BITS, WORD_BITS),
                    strobes.field(k * WORD_BYTES, WORD_BYTES),
                )
            };
            [word(0), word(1)]
        }
        false => {
            let places = WORD_BYTES / length;
            let strobes = match places {
                1 => strobes,
                _ => {
                    let place = address.field(length.ilog2(), places.ilog2());
                    let lanes = (0..places).rev();
                    let lanes = lanes
                        .map(|k| place.equals(k.into()).repeat(length) & strobes)
                        .collect::<Vec<_>>();
                    m.concat(&lanes)
                }
            };
            let word = (bytes.repeat(places), strobes);
            [word, word]
        }
    };
    Offer {
        valid,
        address: word_address,
        words,
        is_wide: length > WORD_BYTES,
    }
}
