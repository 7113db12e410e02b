//! Memories that infer as block or distributed RAM: one write port, any number of read ports.

use super::builder::Builder;
use super::ir::{Id, Item, Op, Place};
use super::pipeline::Stage;
use super::signal::Signal;
use std::panic::Location;

/// The kind of RAM that a memory is implemented in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Block RAM: reads are synchronous and take one cycle.
    Block,
    /// Distributed RAM: reads are combinational ([`Memory::read_now`]) or synchronous.
    Distributed,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct MemoryData {
    pub name: String,
    pub depth: u32,
    pub width: u32,
    pub style: Style,
    /// Enable, address, data.
    pub write: Option<(Id, Id, Id)>,
    pub written_at: Option<Place>,
    /// Read ports.
    pub reads: usize,
    pub place: Place,
}

/// A memory with one write port and any number of read ports. Each read port has a copy of the
/// memory, because a RAM has one read port in addition to its write port; two reads at the same
/// address signal share a port.
///
/// # Read during write
///
/// A synchronous read ([`Memory::read`]) of the word that is written in the same cycle has an
/// undefined value: RAMs differ (old word, new word, neither). The attribute `no_rw_check` tells
/// synthesis not to add a bypass. Simulation returns the old word, on which a description must not
/// rely. A combinational read ([`Memory::read_now`]) returns the old word until the clock edge and
/// the new one after it, in hardware too.
///
/// The value of a word that was never written, or whose address is not less than the depth, is
/// undefined.
#[derive(Clone, Copy)]
pub struct Memory<'b> {
    pub(super) builder: &'b Builder,
    pub(super) index: usize,
}

impl Builder {
    /// Declares a memory of `depth` words of `width` bits, both at least 1. Its addresses have
    /// [`bits_for`](super::bits_for)`(depth)` bits. It must be written and read.
    #[track_caller]
    pub fn memory(
        &self,
        name: impl AsRef<str>,
        depth: u32,
        width: u32,
        style: Style,
    ) -> Memory<'_> {
        let place = Location::caller();
        self.must_be_open("memory", name.as_ref(), place);
        self.claim(name.as_ref(), place);
        if depth == 0 || width == 0 {
            self.fail(
                place,
                format!(
                    "memory \"{}\" has {depth} words of {width} bits; both must be at least 1",
                    name.as_ref()
                ),
            );
        }
        let mut inner = self.inner.borrow_mut();
        let index = inner.ir.memories.len();
        inner.ir.memories.push(MemoryData {
            name: name.as_ref().to_string(),
            depth,
            width,
            style,
            write: None,
            written_at: None,
            reads: 0,
            place,
        });
        inner.ir.items.push(Item::Memory(index));
        Memory {
            builder: self,
            index,
        }
    }
}

impl<'b> Memory<'b> {
    /// Checks an address and reports a mistake; returns whether it is valid.
    fn check_address(&self, address: Signal<'b>, place: Place) -> bool {
        let (depth, name) = {
            let inner = self.builder.inner.borrow();
            (
                inner.ir.memories[self.index].depth,
                inner.ir.memories[self.index].name.clone(),
            )
        };
        if !std::ptr::eq(address.builder, self.builder) {
            self.builder.fail(
                place,
                format!(
                    "memory \"{name}\" is addressed by a signal of module {}",
                    address.builder.name
                ),
            );
            return false;
        }
        let expected = super::bits_for(u64::from(depth));
        if address.width() != expected {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: memory \"{name}\" of {depth} words takes {expected} address \
                     bits, {} has {}",
                    address.describe(),
                    address.width()
                ),
            );
        }
        true
    }

    /// Sets the write port. It can be set once. In every cycle in which `enable` (one bit) is 1,
    /// the word at `address` becomes `data`. Signals of a pipeline are aligned to the latest stage
    /// among them. A write to an address that is not less than the depth has no effect.
    #[track_caller]
    pub fn write(&self, enable: Signal<'b>, address: Signal<'b>, data: Signal<'b>) {
        let place = Location::caller();
        if !self.check_address(address, place) {
            return;
        }
        let (width, name) = {
            let inner = self.builder.inner.borrow();
            let memory = &inner.ir.memories[self.index];
            (memory.width, memory.name.clone())
        };
        let (aligned, _) = self.builder.align(&[enable, address, data], place);
        if enable.width() != 1 {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: a write enable has 1 bit, {} has {}",
                    enable.describe(),
                    enable.width()
                ),
            );
        }
        if data.width() != width {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: memory \"{name}\" has words of {width} bits, {} has {}",
                    data.describe(),
                    data.width()
                ),
            );
        }
        let earlier = {
            let mut inner = self.builder.inner.borrow_mut();
            let memory = &mut inner.ir.memories[self.index];
            let ids = (aligned[0].id, aligned[1].id, aligned[2].id);
            let earlier = memory.write.replace(ids).and(memory.written_at);
            memory.written_at = Some(place);
            earlier
        };
        if let Some(earlier) = earlier {
            self.builder.fail(
                place,
                format!(
                    "memory \"{name}\" is written twice: it has one write port, used at {}:{}",
                    earlier.file(),
                    earlier.line()
                ),
            );
        }
    }

    /// Returns the name of the memory.
    pub fn name(&self) -> String {
        self.builder.inner.borrow().ir.memories[self.index]
            .name
            .clone()
    }

    /// Returns the word at `address`, one cycle later. The output register of the read port is part
    /// of the RAM; an address is read every cycle. If the address is in a pipeline, the word is at
    /// the next stage.
    #[track_caller]
    pub fn read(&self, address: Signal<'b>) -> Signal<'b> {
        self.port(address, true, Location::caller())
    }

    /// Returns the word at `address` combinationally, at the stage of the address. The memory must
    /// be distributed RAM. While a word is being written, its old value is returned until the clock
    /// edge.
    #[track_caller]
    pub fn read_now(&self, address: Signal<'b>) -> Signal<'b> {
        let place = Location::caller();
        if self.builder.inner.borrow().ir.memories[self.index].style == Style::Block {
            self.builder
                .fail(place, "block RAM cannot be read combinationally");
        }
        self.port(address, false, place)
    }

    pub(super) fn stored(&self, address: Signal<'b>, place: Place) -> Signal<'b> {
        if !self.check_address(address, place) {
            return self.builder.zero(1);
        }
        let width = self.builder.inner.borrow().ir.memories[self.index].width;
        let word = Op::Peek(self.index, address.id);
        self.builder.node(word, width, address.stage_data(), place)
    }

    fn port(&self, address: Signal<'b>, synchronous: bool, place: Place) -> Signal<'b> {
        if !self.check_address(address, place) {
            return self.builder.zero(1);
        }
        let (width, formal) = {
            let inner = self.builder.inner.borrow();
            (inner.ir.memories[self.index].width, inner.formal)
        };
        let key = (self.index, address.id, synchronous);
        let known = self.builder.inner.borrow().reads.get(&key).copied();
        if let Some(id) = known {
            return Signal {
                builder: self.builder,
                id,
            };
        }
        if formal {
            let message =
                "properties must read a memory with peek: a read port would change the module";
            self.builder.fail(place, message);
        }
        let stage = address.stage_data().map(|s| Stage {
            at: s.at + u32::from(synchronous),
            ..s
        });
        let copy = {
            let mut inner = self.builder.inner.borrow_mut();
            let memory = &mut inner.ir.memories[self.index];
            memory.reads += 1;
            memory.reads - 1
        };
        let read = Op::Read(self.index, copy, address.id, synchronous);
        let signal = self.builder.node(read, width, stage, place);
        self.builder.inner.borrow_mut().reads.insert(key, signal.id);
        signal
    }
}
