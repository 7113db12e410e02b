//! Memories that infer as block or distributed RAM: one write port, any number of read ports.

use super::builder::{Builder, Id, Item, Op, Place};
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

pub(super) struct MemoryData {
    pub name: String,
    pub depth: u32,
    pub width: u32,
    pub style: Style,
    /// Enable, address, data.
    pub write: Option<(Id, Id, Id)>,
    /// One copy of the memory a read port, since no RAM has more than one beside its write port.
    pub reads: usize,
    pub place: Place,
}

/// A memory of `depth` words. A synchronous read of the word that is being written is undefined: synthesis is told
/// that it does not matter.
#[derive(Clone, Copy)]
pub struct Memory<'b> {
    builder: &'b Builder,
    index: usize,
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
        self.claim(name.as_ref(), place);
        let mut inner = self.inner.borrow_mut();
        let index = inner.memories.len();
        inner.memories.push(MemoryData {
            name: name.as_ref().to_string(),
            depth,
            width,
            style,
            write: None,
            reads: 0,
            place,
        });
        inner.items.push(Item::Memory(index));
        Memory {
            builder: self,
            index,
        }
    }
}

impl<'b> Memory<'b> {
    fn check_address(&self, address: Signal<'b>, place: Place) {
        let (depth, name) = {
            let inner = self.builder.inner.borrow();
            (
                inner.memories[self.index].depth,
                inner.memories[self.index].name.clone(),
            )
        };
        let expected = super::bits_for(u64::from(depth));
        if address.width() != expected {
            self.builder.fail(place, format!("width mismatch: memory \"{name}\" of {depth} words takes {expected} address bits, not {}", address.width()));
        }
    }

    /// The write port. It may be set once.
    #[track_caller]
    pub fn write(&self, enable: Signal<'b>, address: Signal<'b>, data: Signal<'b>) {
        let place = Location::caller();
        self.check_address(address, place);
        let (aligned, _) = self.builder.align(&[enable, address, data], place);
        let mut inner = self.builder.inner.borrow_mut();
        let memory = &mut inner.memories[self.index];
        let (width, name) = (memory.width, memory.name.clone());
        let twice = memory
            .write
            .replace((aligned[0].id, aligned[1].id, aligned[2].id))
            .is_some();
        drop(inner);
        if data.width() != width || enable.width() != 1 {
            self.builder.fail(
                place,
                format!(
                    "width mismatch: memory \"{name}\" has words of {width} bits, not {}",
                    data.width()
                ),
            );
        }
        if twice {
            self.builder.fail(
                place,
                format!("memory \"{name}\" is doubly driven: it has one write port"),
            );
        }
    }

    /// The word at `address`, a clock later.
    #[track_caller]
    pub fn read(&self, address: Signal<'b>) -> Signal<'b> {
        self.port(address, true, Location::caller())
    }

    /// The word at `address`, combinationally. Only for distributed RAM.
    #[track_caller]
    pub fn read_now(&self, address: Signal<'b>) -> Signal<'b> {
        let place = Location::caller();
        if self.builder.inner.borrow().memories[self.index].style == Style::Block {
            self.builder
                .fail(place, "block RAM cannot be read combinationally");
        }
        self.port(address, false, place)
    }

    fn port(&self, address: Signal<'b>, synchronous: bool, place: Place) -> Signal<'b> {
        self.check_address(address, place);
        let (width, copy, name) = {
            let mut inner = self.builder.inner.borrow_mut();
            let memory = &mut inner.memories[self.index];
            memory.reads += 1;
            (
                memory.width,
                memory.reads - 1,
                format!("{}_read{}", memory.name, memory.reads - 1),
            )
        };
        let stage = address.stage_data().map(|s| Stage {
            at: s.at + u32::from(synchronous),
            ..s
        });
        let read = Op::Read(self.index, copy, address.id, synchronous);
        let signal = self.builder.named_node(read, width, &name, stage, place);
        if synchronous {
            self.builder
                .inner
                .borrow_mut()
                .items
                .push(Item::Drive(signal.id));
        }
        signal
    }
}
