//! Memories that infer as block or distributed RAM: one write port, any number of read ports.

use super::builder::Builder;
use super::ir::{Id, Item, Op, Place};
use super::pipeline::Stage;
use super::signal::Signal;
use std::panic::Location;

/// What a memory should become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Block RAM: reads take a clock.
    Block,
    /// Distributed RAM: reads are combinational ([`Memory::read_now`]) or take a clock.
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

/// A memory of `depth` words with one write port and any number of read ports, each with a copy of the memory of its
/// own, since no RAM has more than one beside its write port. Reads at the same signal share a port.
///
/// # Reading what is being written
///
/// A synchronous read ([`Memory::read`]) of the word that is written in the same clock gives no defined value: RAMs
/// differ (old word, new word, neither), and synthesis is told by `no_rw_check` that it does not matter, or it would
/// add a bypass. Simulation gives the old word; nothing may rely on it. A combinational read
/// ([`Memory::read_now`]) gives the old word up to the clock edge and the new one after it, in hardware too.
///
/// A word that was never written, or that lies past the depth, is undefined as well.
#[derive(Clone, Copy)]
pub struct Memory<'b> {
    pub(super) builder: &'b Builder,
    pub(super) index: usize,
}

impl Builder {
    /// A memory. Its addresses have [`super::bits_for`]`(depth)` bits.
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
    /// Whether an address can be the memory's; what is wrong with it is reported.
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

    /// The write port. It may be set once. `enable` (1 bit), `address` and `data` of a pipeline are aligned.
    /// A write at an address past the depth is lost.
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

    /// The word at `address`, a clock later: it is in a register of the RAM's own, which is part of block RAM. The
    /// address is taken every clock. Of a staged address, the word is a stage later.
    pub fn name(&self) -> String {
        self.builder.inner.borrow().ir.memories[self.index]
            .name
            .clone()
    }

    #[track_caller]
    pub fn read(&self, address: Signal<'b>) -> Signal<'b> {
        self.port(address, true, Location::caller())
    }

    /// The word at `address`, combinationally, at the address's stage. Only for distributed RAM. While a word is
    /// being written, its old value is read until the clock edge.
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
