//! The memory system: write combiner, burst reader and two more clients behind the read arbiter, in front of the AXI4 master with its
//! protocol monitor and of a slave that does whatever the protocol allows.
//!
//! Words are written at random and merged; sequences and bursts are read at random. Compared are the bursts of the reader, the order of the
//! clients' bursts, all beats and words with the memory's contents, and after each batch, when all lines are flushed, all bytes of memory.
//! The next batch reads what the last one wrote. In some batches a word is given only after all lines that were closed have been sent; then a
//! model of the combiner says which bursts follow, with their data and strobes.

use super::axi::{Accepted, BEAT_WORDS, Bytes, Data, Edge, Handles, RandomPace, Slave};
use super::mismatch::Field;
use super::model::PortHandle;
use super::scoreboard::{Bench, Category, RESET_CYCLES, UnitOptions, UnitReport};
use super::unit_axi::{BOUNDARY, PATIENCE, STUCK, violated};
use crate::hdl::{self, Builder, Flow, Module, Specs as _, Wires as _};
use crate::hw::memory::arbiter::{self, ClientInputs};
use crate::hw::memory::axi::monitor::{self, Rules};
use crate::hw::memory::axi::{self, Bus, MasterInputs, MasterOutputs};
use crate::hw::memory::combiner::{self, LINE_BYTES, WORD_BYTES, Word};
use crate::hw::memory::reader::{self, BLOCK_BYTES, Datum, Sequence, Word as ReadWord};
use crate::hw::memory::{Beat, Burst};
use crate::interface;
use anyhow::Result;
use std::collections::VecDeque;
use std::sync::Arc;

/// What the memory system can meet.
pub const CATEGORIES: &[Category] = &[
    Category::Overtaking,
    Category::Interleaved,
    Category::BusError,
    Category::FullLine,
    Category::TrimmedLine,
    Category::GapInLine,
    Category::OverwrittenByte,
    Category::EvictedLine,
    Category::Contention,
    Category::ShortBlock,
];

/// Bytes of memory; the halves are read and written in turn.
const MEMORY: u32 = 1 << 14;

/// Bits of the clients' identifiers: the reader, and the two others.
const CLIENT_BITS: [u32; 3] = [1, 2, 3];

/// The sizes of the memory system that is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    pub data_bits: u32,
    /// Lines of the combiner.
    pub lines: u32,
    /// Words of the reader's buffer.
    pub words: u32,
    /// Bursts that may be outstanding.
    pub reads: u32,
    pub writes: u32,
}

impl Sizes {
    /// The memory system that is simulated by default.
    pub fn reference() -> Sizes {
        Sizes {
            data_bits: 128,
            lines: 4,
            words: 16,
            reads: 8,
            writes: 4,
        }
    }

    fn arbiter(&self) -> arbiter::Sizes {
        arbiter::Sizes {
            data_bits: self.data_bits,
            clients: CLIENT_BITS.to_vec(),
        }
    }

    fn combiner(&self) -> combiner::Sizes {
        combiner::Sizes {
            data_bits: self.data_bits,
            lines: self.lines,
            writes: self.writes,
        }
    }

    fn reader(&self) -> reader::Sizes {
        reader::Sizes {
            data_bits: self.data_bits,
            id_bits: CLIENT_BITS[0],
            words: self.words,
            registers_front: false,
        }
    }

    fn bus(&self) -> Bus {
        Bus {
            data_bits: self.data_bits,
            id_bits: self.arbiter().id_bits(),
            reads: self.reads,
            writes: self.writes,
        }
    }
}

interface! {
    pub (sizes: &Sizes) {
        in "Words to write" { word: Flow<Word>(), flush: 1 }
        out "Words to write" { word_ready: 1, empty: 1 }
        in "Sequences to read" { start: Flow<Sequence>() }
        out "Sequences to read" { start_ready: 1 }
        out "Words that were read" { got: Flow<ReadWord>() }
        in "Words that were read" { got_ready: 1 }
        in "Client 1" { a: Flow<Burst>(CLIENT_BITS[1]) }
        out "Client 1" { a_ready: 1, a_beat: Flow<Beat>(CLIENT_BITS[1], sizes.data_bits) }
        in "Client 2" { b: Flow<Burst>(CLIENT_BITS[2]) }
        out "Client 2" { b_ready: 1, b_beat: Flow<Beat>(CLIENT_BITS[2], sizes.data_bits) }
        in "" { m_axi: {MasterInputs}(&sizes.bus()) }
        out "" { m_axi: {MasterOutputs}(&sizes.bus()) }
        out "The monitor" { error: 1, violated: {Rules}() }
    }
}

/// Describes the memory system with its monitor.
///
/// # Errors
/// None is known.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>> {
    let (bus, readers) = (&sizes.bus(), &sizes.arbiter());
    let m = Builder::new(
        "memory_system",
        "a memory system with three readers and a writer, and the protocol monitor of its bus.",
    );
    let ports = ports(sizes);
    let inputs = ports.inputs.inputs(&m);
    m.comment("Signals from the bus to the clients.");
    let wire = |name: &str| m.wire(name, 1);
    let (read_ready, write_ready) = (wire("read_ready"), wire("write_ready"));
    let (datum_ready, written) = (wire("datum_ready"), wire("written"));
    let (reader_ready, reader_beat) = (wire("reader_ready"), wire("reader_beat"));
    let reader_data = m.wire("reader_data", sizes.data_bits);
    let beat = Flow::of(Beat::of(bus.id_bits, bus.data_bits)).wires(&m, "beat");

    let of_reader = sizes.reader();
    let unit = reader::module(&of_reader)?;
    let to_reader = reader::Inputs {
        start: inputs.start,
        read_ready: reader_ready.get(),
        beat: Flow {
            valid: reader_beat.get(),
            payload: Datum {
                data: reader_data.get(),
            },
        },
        word_ready: inputs.got_ready,
    };
    let reading = reader::ports(&of_reader).place("reader", &m, &unit, to_reader);
    let clients = [reading.read, inputs.a, inputs.b].map(|read| ClientInputs { read });
    let to_arbiter = arbiter::Inputs {
        read_ready: read_ready.get(),
        beat: beat.get(),
    };
    let (clients, sent) = arbiter::place("arbiter", &m, readers, &clients, to_arbiter)?;
    reader_ready.drive(clients[0].read_ready);
    reader_beat.drive(clients[0].beat.valid);
    reader_data.drive(clients[0].beat.payload.data);

    let of_combiner = sizes.combiner();
    let unit = combiner::module(&of_combiner)?;
    let to_combiner = combiner::Inputs {
        word: inputs.word,
        flush: inputs.flush,
        write_ready: write_ready.get(),
        datum_ready: datum_ready.get(),
        written: written.get(),
    };
    let writing = combiner::ports(&of_combiner).place("combiner", &m, &unit, to_combiner);
    let to_master = axi::Inputs {
        read: sent.read,
        write: writing.write,
        datum: writing.datum,
        m_axi: inputs.m_axi,
    };
    let master = axi::ports(bus).place("master", &m, &axi::module(bus)?, to_master);
    read_ready.drive(master.read_ready);
    write_ready.drive(master.write_ready);
    datum_ready.drive(master.datum_ready);
    written.drive(master.written);
    beat.drive(master.beat);
    let watched = monitor::Inputs {
        master: master.m_axi,
        slave: inputs.m_axi,
    };
    let unit = monitor::module(&monitor::Sizes {
        bus: *bus,
        patience: PATIENCE,
    })?;
    let seen = monitor::ports(bus).place("monitor", &m, &unit, watched);
    let outputs = Outputs {
        word_ready: writing.word_ready,
        empty: writing.empty,
        start_ready: reading.start_ready,
        got: reading.word,
        a_ready: clients[1].read_ready,
        a_beat: clients[1].beat,
        b_ready: clients[2].read_ready,
        b_beat: clients[2].beat,
        m_axi: master.m_axi,
        error: seen.error,
        violated: seen.rules,
    };
    ports.outputs.outputs(&m, outputs);
    Ok(m.finish()?)
}

/// A word of 16 bytes in words of 32 bits.
type Quad = [u32; 4];

/// A word to write.
#[derive(Clone, Copy, Debug)]
struct Written {
    address: u32,
    data: Quad,
    strobes: u32,
}

/// A line of the model: its address, its bytes with a strobe.
#[derive(Clone, Debug)]
struct Line {
    address: u32,
    bytes: [Option<u8>; LINE_BYTES as usize],
}

/// A model of the combiner whose closed lines are sent at once.
#[derive(Default)]
struct Combiner {
    open: VecDeque<Line>,
    /// Lines that were closed and have not been seen on the bus.
    closed: VecDeque<Line>,
}

impl Combiner {
    /// Whether a line was closed for want of room; whether a byte was overwritten.
    fn write(&mut self, lines: u32, word: &Written) -> [bool; 2] {
        let address = word.address / LINE_BYTES * LINE_BYTES;
        let (mut evicts, mut overwrites) = (false, false);
        if word.strobes == 0 {
            return [false; 2];
        }
        if !self.open.iter().any(|line| line.address == address) {
            self.open.push_back(Line {
                address,
                bytes: [None; LINE_BYTES as usize],
            });
        }
        let place = self.open.iter().position(|line| line.address == address);
        let place = place.expect("it is open");
        let line = &mut self.open[place];
        for i in 0..WORD_BYTES as usize {
            if word.strobes >> i & 1 != 0 {
                let byte = &mut line.bytes[(word.address - address) as usize + i];
                overwrites |= byte.is_some();
                *byte = Some((word.data[i / 4] >> (8 * (i % 4))) as u8);
            }
        }
        if line.bytes.iter().all(Option::is_some) {
            self.closed.extend(self.open.remove(place));
        }
        if self.open.len() == lines as usize {
            evicts = true;
            self.closed.extend(self.open.pop_front());
        }
        [evicts, overwrites]
    }

    fn flush(&mut self) {
        self.closed.extend(self.open.drain(..));
    }
}

/// What words are written in a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Words {
    /// Each only after all closed lines have been sent.
    Paced,
    /// In one line less than there are, none of which fills up: each is accepted at once.
    FewLines,
    /// One after another, all bytes.
    Sequence,
    /// In few lines, again and again.
    Near,
    /// Anywhere.
    Far,
}

/// A client that asks for bursts.
struct Client {
    number: u32,
    item: Option<Given>,
    pauses: f64,
    left: u32,
    /// Bursts of the other of the two clients that were accepted while its own waited.
    passed: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Given {
    id: u32,
    address: u32,
    beats: u32,
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

struct Run<'a> {
    bench: &'a mut Bench,
    sizes: Sizes,
    bytes: u32,
    local_bits: u32,
    ports: Ports,
    slave: Slave,
    pace: RandomPace,
    rng: fastrand::Rng,
    memory: Bytes,
    golden: Bytes,
    half: u32,
    // Words to write.
    words: Words,
    words_left: u32,
    word: Option<Written>,
    word_pauses: f64,
    next_word: u32,
    lines: Vec<u32>,
    combiner: Combiner,
    /// Cycles since the last burst that the model expected.
    settled: u32,
    flush: bool,
    /// The burst whose data come on the bus, its beats so far: data and strobes.
    sent: VecDeque<Accepted>,
    beats: Vec<(Data, u32)>,
    finished: VecDeque<Vec<(Data, u32)>>,
    // Sequences to read.
    start: Option<(u32, u32)>,
    starts_left: u32,
    got_pauses: f64,
    got_ready: bool,
    expected_words: VecDeque<Quad>,
    expected_blocks: VecDeque<Given>,
    clients: [Client; 2],
    given: [VecDeque<Given>; 3],
    /// By identifier on the bus: bursts and beats that have come.
    reading: Vec<VecDeque<(Given, u32)>>,
}

/// Co-simulates a memory system for a number of bursts.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(sizes: &Sizes, bursts: u64, options: &UnitOptions) -> Result<UnitReport> {
    let mut bench = Bench::new("bus", &module(sizes)?, options)?;
    bench.model.reset(RESET_CYCLES);
    let ports = bench.model.ports(&ports(sizes))?;
    let mut rng = fastrand::Rng::with_seed(options.seed);
    let base = [0, u32::MAX - MEMORY + 1, rng.u32(..) / MEMORY * MEMORY][rng.usize(..3)];
    let bytes = std::iter::repeat_with(|| rng.u8(..)).take(MEMORY as usize);
    let memory = Bytes {
        base,
        bytes: bytes.collect(),
    };
    let handles = Handles {
        out: ports.outputs.m_axi,
        into: ports.inputs.m_axi,
    };
    let bus = sizes.bus();
    let client = |number| Client {
        number,
        item: None,
        pauses: 0.0,
        left: 0,
        passed: 0,
    };
    let mut run = Run {
        sizes: *sizes,
        bytes: bus.bytes(),
        local_bits: CLIENT_BITS[2],
        ports,
        slave: Slave::new(&bus, handles),
        pace: RandomPace::new(rng.u64(..)),
        golden: memory.clone(),
        memory,
        half: 0,
        words: Words::Far,
        words_left: 0,
        word: None,
        word_pauses: 0.0,
        next_word: 0,
        lines: vec![],
        combiner: Combiner::default(),
        settled: 0,
        flush: false,
        sent: VecDeque::new(),
        beats: vec![],
        finished: VecDeque::new(),
        start: None,
        starts_left: 0,
        got_pauses: 0.0,
        got_ready: false,
        expected_words: VecDeque::new(),
        expected_blocks: VecDeque::new(),
        clients: [client(1), client(2)],
        given: Default::default(),
        reading: vec![VecDeque::new(); 1 << bus.id_bits],
        rng,
        bench: &mut bench,
    };
    let ended = (|| {
        // Nothing is left of what was before the reset.
        run.check_after(&Edge::default(), false)?;
        let outputs = &run.ports.outputs;
        let left = [
            outputs.got.valid,
            outputs.m_axi.arvalid,
            outputs.m_axi.wvalid,
        ];
        let is_idle = run.bench.model.get(outputs.empty) & run.bench.model.get(outputs.start_ready);
        if is_idle == 0 || left.iter().any(|port| run.bench.model.get(*port) != 0) {
            return Err(run.bench.mismatch("not idle after a reset", vec![]));
        }
        while run.bench.tally.transactions < bursts {
            run.batch()?;
        }
        Ok(())
    })();
    bench.report(ended, CATEGORIES)
}

impl Run<'_> {
    /// Words, sequences and bursts under one pace, until all are complete and flushed; then the memory is compared.
    fn batch(&mut self) -> Result<()> {
        self.pace.draw();
        let rng = &mut self.rng;
        let mut probability = || [0.0, 0.0, 0.2, 0.7][rng.usize(..4)];
        self.word_pauses = probability();
        self.got_pauses = probability();
        for client in &mut self.clients {
            client.pauses = probability();
        }
        self.half = MEMORY / 2 - self.half;
        self.words = [
            Words::Paced,
            Words::FewLines,
            Words::Sequence,
            Words::Near,
            Words::Far,
        ][rng.usize(..5)];
        self.words_left = rng.u32(..150);
        self.starts_left = rng.u32(..6);
        for client in &mut self.clients {
            client.left = rng.u32(..40);
        }
        let base = self.memory.base + self.half;
        self.next_word = base + rng.u32(..MEMORY / 2 / WORD_BYTES / 2) * WORD_BYTES;
        let mut all: Vec<u32> = (0..MEMORY / 2 / LINE_BYTES).collect();
        rng.shuffle(&mut all);
        let spare = usize::from(self.words == Words::FewLines);
        all.truncate(self.sizes.lines as usize - spare);
        self.lines = all.iter().map(|line| base + line * LINE_BYTES).collect();
        let mut idle = 0;
        while !self.is_done() {
            idle = if self.cycle()? { 0 } else { idle + 1 };
            if idle > STUCK {
                let place = format!("nothing happens for {idle} cycles");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        self.flush = false;
        self.bench.tally.packets += 1;
        self.bench.tally.checked += 1;
        let (golden, rtl) = (&self.golden.bytes, &self.memory.bytes);
        if let Some(at) = (0..golden.len()).find(|&i| golden[i] != rtl[i]) {
            let field = Field::integer("byte", golden[at].into(), rtl[at].into());
            let place = format!("memory at {:#x}", self.memory.base as usize + at);
            return Err(self.bench.mismatch(place, vec![field]));
        }
        Ok(())
    }

    fn words_done(&self) -> bool {
        self.words_left == 0 && self.word.is_none()
    }

    fn is_done(&self) -> bool {
        let empty = self.bench.model.get(self.ports.outputs.empty) != 0;
        self.flush
            && empty
            && self.slave.is_empty()
            && self.start.is_none()
            && self.starts_left == 0
            && self.expected_words.is_empty()
            && (self.clients.iter()).all(|client| client.left == 0 && client.item.is_none())
            && self.reading.iter().all(VecDeque::is_empty)
            && self.given.iter().all(VecDeque::is_empty)
    }

    /// The next word to write.
    fn next_written(&mut self) -> Written {
        let rng = &mut self.rng;
        let place = |rng: &mut fastrand::Rng| rng.u32(..LINE_BYTES / WORD_BYTES) * WORD_BYTES;
        let base = self.memory.base + self.half;
        let line = self.lines[rng.usize(..self.lines.len())];
        let (mut address, mut strobes) = (line + place(rng), 0xffff);
        match self.words {
            Words::Sequence => {
                address = self.next_word;
                let end = base.wrapping_add(MEMORY / 2);
                self.next_word = self.next_word.wrapping_add(WORD_BYTES);
                // The last address of all memory is followed by 0.
                if self.next_word == end {
                    self.next_word = base;
                }
            }
            Words::FewLines => strobes = rng.u32(..) & 0xfffe,
            Words::Near | Words::Paced => {
                // One line more than the combiner holds, now and then.
                if rng.u8(..4) == 0 {
                    address = base + place(rng);
                }
                strobes =
                    [0xffff, 0xffff, rng.u32(..) & 0xffff, 1 << rng.u32(..16), 0][rng.usize(..5)];
            }
            Words::Far => {
                address = base + rng.u32(..MEMORY / 2 / WORD_BYTES) * WORD_BYTES;
                strobes = [0xffff, rng.u32(..) & 0xffff][rng.usize(..2)];
            }
        }
        Written {
            address,
            data: std::array::from_fn(|_| rng.u32(..)),
            strobes,
        }
    }

    /// Offers everything for the coming edge.
    fn offer(&mut self) {
        let settled = self.combiner.closed.is_empty() && self.settled > 4;
        let pauses = self.rng.f64() < self.word_pauses;
        let may = self.words != Words::Paced || settled;
        if self.word.is_none() && self.words_left > 0 && may && !pauses {
            self.words_left -= 1;
            self.word = Some(self.next_written());
        }
        let read = self.memory.base + MEMORY / 2 - self.half;
        if self.start.is_none() && self.starts_left > 0 && self.rng.bool() {
            self.starts_left -= 1;
            let first = self.rng.u32(..MEMORY / 2 / WORD_BYTES);
            let most = (MEMORY / 2 / WORD_BYTES - first).min([3, 20, 100][self.rng.usize(..3)]);
            self.start = Some((read + first * WORD_BYTES, self.rng.u32(..=most)));
        }
        for client in &mut self.clients {
            if client.item.is_none() && client.left > 0 && self.rng.f64() >= client.pauses {
                client.left -= 1;
                let rng = &mut self.rng;
                let page = rng.u32(..MEMORY / 2 / BOUNDARY) * BOUNDARY;
                let first = rng.u32(..BOUNDARY / self.bytes);
                // Seldom a long one, as it takes many cycles.
                let most = if rng.u8(..64) == 0 { 256 } else { 8 };
                client.item = Some(Given {
                    id: rng.u32(..1 << CLIENT_BITS[client.number as usize]),
                    address: read + page + first * self.bytes,
                    beats: rng.u32(1..=(BOUNDARY / self.bytes - first).min(most)),
                });
            }
        }
        self.got_ready = self.rng.f64() >= self.got_pauses;
        self.flush |= self.words_done() && self.rng.u8(..8) == 0;
        self.show();
    }

    fn show(&mut self) {
        let (inputs, model) = (&self.ports.inputs, &mut self.bench.model);
        let rng = &mut self.rng;
        model.set(inputs.flush, self.flush.into());
        let payload = inputs.word.payload;
        model.set(inputs.word.valid, self.word.is_some().into());
        match &self.word {
            Some(word) => {
                model.set(payload.address, word.address.into());
                model.set_words(payload.data, &word.data);
                model.set(payload.strobes, word.strobes.into());
            }
            None => model.garble([payload.address, payload.data, payload.strobes], rng),
        }
        let payload = inputs.start.payload;
        model.set(inputs.start.valid, self.start.is_some().into());
        match self.start {
            Some((address, words)) => {
                model.set(payload.address, address.into());
                model.set(payload.words, words.into());
            }
            None => model.garble([payload.address, payload.words], rng),
        }
        model.set(inputs.got_ready, self.got_ready.into());
        for client in &self.clients {
            let port = if client.number == 1 {
                &inputs.a
            } else {
                &inputs.b
            };
            model.set(port.valid, client.item.is_some().into());
            let payload = port.payload;
            match client.item {
                Some(burst) => {
                    model.set(payload.address, burst.address.into());
                    model.set(payload.beats, u64::from(burst.beats) - 1);
                    model.set(payload.id, burst.id.into());
                }
                None => model.garble([payload.address, payload.beats, payload.id], rng),
            }
        }
    }

    /// One cycle; whether anything moves.
    fn cycle(&mut self) -> Result<bool> {
        self.offer();
        let (bench, noise) = (&mut *self.bench, &mut self.rng);
        self.slave
            .show(&mut bench.model, &mut self.pace, &self.memory, noise)?;
        bench.model.eval();
        let writes = self.take_word()?;
        let reads = self.take_reads()?;
        let edge = match self.slave.step(&self.bench.model, &mut self.memory) {
            Ok(edge) => edge,
            Err(error) => return Err(self.bench.mismatch(format!("{error:#}"), vec![])),
        };
        self.check_reads(&edge)?;
        self.check_writes(&edge)?;
        self.bench.model.clock();
        self.check_after(&edge, writes)?;
        Ok(writes || reads || edge.any())
    }

    /// Whether a word is accepted that has a strobe.
    fn take_word(&mut self) -> Result<bool> {
        let ready = self.bench.model.get(self.ports.outputs.word_ready) != 0;
        if self.words == Words::FewLines && self.word.is_some() && !ready {
            let place = "a word in an open line is not accepted at once";
            return Err(self.bench.mismatch(place, vec![]));
        }
        if !ready {
            return Ok(false);
        }
        let Some(word) = self.word.take() else {
            return Ok(false);
        };
        for part in 0..WORD_BYTES / 4 {
            let mut data = Data::default();
            data[0] = word.data[part as usize];
            let strobes = word.strobes >> (4 * part) & 15;
            self.golden
                .write(word.address + 4 * part, 4, &data, strobes)?;
        }
        let [evicts, overwrites] = match self.words {
            Words::Paced => self.combiner.write(self.sizes.lines, &word),
            _ => [false; 2],
        };
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::EvictedLine, evicts);
        categories.count(Category::OverwrittenByte, overwrites);
        Ok(word.strobes != 0)
    }

    /// What the readers give and take.
    fn take_reads(&mut self) -> Result<bool> {
        let outputs = self.ports.outputs;
        let model = &self.bench.model;
        let mut any = false;
        if self.start.is_some() && model.get(outputs.start_ready) != 0 {
            let (address, words) = self.start.take().unwrap_or_default();
            self.expect(address, words)?;
            any = true;
        }
        let model = &self.bench.model;
        if self.got_ready && model.get(outputs.got.valid) != 0 {
            let mut words = [0; BEAT_WORDS];
            model.get_words(outputs.got.payload.data, &mut words);
            let golden = self.expected_words.pop_front();
            self.bench.tally.checked += 1;
            if golden.as_ref().map(|word| &word[..]) != Some(&words[..4]) {
                let place = format!("word that was read: golden {golden:x?}, rtl {words:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
            any = true;
        }
        let model = &self.bench.model;
        let ready = [outputs.a_ready, outputs.b_ready].map(|port| model.get(port) != 0);
        let mut accepted = [false; 2];
        for (i, client) in self.clients.iter_mut().enumerate() {
            if ready[i]
                && let Some(burst) = client.item.take()
            {
                self.given[client.number as usize].push_back(burst);
                (accepted[i], any) = (true, true);
            }
        }
        let waits = [0, 1].map(|i| self.clients[i].item.is_some());
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::Contention, waits == [true; 2]);
        for i in 0..2 {
            let other = accepted[1 - i];
            let client = &mut self.clients[i];
            client.passed = if waits[i] {
                client.passed + u32::from(other)
            } else {
                0
            };
            if client.passed > 1 {
                let place = format!("client {} waits for two bursts of the other", i + 1);
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        Ok(any)
    }

    /// The words and the bursts of a sequence.
    fn expect(&mut self, address: u32, words: u32) -> Result<()> {
        for word in 0..words {
            let quad = self.golden.beat(address + word * WORD_BYTES, WORD_BYTES)?;
            let quad = std::array::from_fn(|i| quad[i]);
            self.expected_words.push_back(quad);
        }
        let mut word = address / WORD_BYTES;
        let end = word + words;
        let in_block = BLOCK_BYTES / WORD_BYTES;
        while word < end {
            let last = (word / in_block * in_block + in_block).min(end);
            let first = word * WORD_BYTES / self.bytes * self.bytes;
            let bytes = (u64::from(last) * u64::from(WORD_BYTES)) - u64::from(first);
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::ShortBlock, last - word < in_block);
            self.expected_blocks.push_back(Given {
                id: 0,
                address: first,
                beats: bytes.div_ceil(u64::from(self.bytes)) as u32,
            });
            word = last;
        }
        Ok(())
    }

    /// Compares read bursts and beats on the bus with what was asked for.
    fn check_reads(&mut self, edge: &Edge) -> Result<()> {
        if let Some(seen) = edge.read {
            let client = seen.id >> self.local_bits;
            let id = seen.id & ((1 << self.local_bits) - 1);
            let queue = match client {
                0 => Some(&mut self.expected_blocks),
                _ => self.given.get_mut(client as usize),
            };
            let golden = queue.and_then(VecDeque::pop_front);
            let (address, beats) = (seen.address, seen.beats);
            self.bench.tally.transactions += 1;
            self.bench.tally.checked += 1;
            if golden != Some(Given { id, address, beats }) {
                let place =
                    format!("read burst of client {client}: golden {golden:x?}, rtl {seen:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
            let burst = Given { id, address, beats };
            self.reading[seen.id as usize].push_back((burst, 0));
        }
        if let Some(beat) = &edge.beat {
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::Overtaking, beat.overtakes);
            categories.count(Category::Interleaved, beat.interleaved);
            categories.count(Category::BusError, beat.error);
            let queue = &mut self.reading[beat.id as usize];
            let (burst, done) = queue.front_mut().expect("the slave has such a burst");
            *done += 1;
            if *done == burst.beats {
                queue.pop_front();
            }
        }
        Ok(())
    }

    /// Checks write bursts on the bus: they are trimmed, within a line, and, if the model says so, the ones that it expects.
    fn check_writes(&mut self, edge: &Edge) -> Result<()> {
        self.sent.extend(edge.write);
        if let Some((data, strobes, last)) = edge.datum {
            self.beats.push((data, strobes));
            if last {
                self.finished.push_back(std::mem::take(&mut self.beats));
            }
        }
        self.settled += 1;
        while !self.sent.is_empty()
            && let Some(beats) = self.finished.pop_front()
        {
            let burst = self.sent.pop_front().expect("there is one");
            self.settled = 0;
            self.check_burst(&burst, &beats)?;
        }
        Ok(())
    }

    fn check_burst(&mut self, burst: &Accepted, beats: &[(Data, u32)]) -> Result<()> {
        let line = burst.address / LINE_BYTES * LINE_BYTES;
        let mut bytes = [None; LINE_BYTES as usize];
        let mut place = (burst.address - line) as usize;
        let (first, end) = (place, place + beats.len() * self.bytes as usize);
        self.bench.tally.transactions += 1;
        self.bench.tally.checked += 1;
        let wrong = |bench: &Bench, what: &str| {
            let place = format!("{what}: {burst:x?}, {beats:x?}");
            Err(bench.mismatch(place, vec![]))
        };
        if burst.beats as usize != beats.len() || end > LINE_BYTES as usize || burst.id != 0 {
            return wrong(self.bench, "a write burst that is not within a line");
        }
        for (data, strobes) in beats {
            for i in 0..self.bytes as usize {
                if strobes >> i & 1 != 0 {
                    bytes[place] = Some((data[i / 4] >> (8 * (i % 4))) as u8);
                }
                place += 1;
            }
        }
        let unit = WORD_BYTES.max(self.bytes) as usize;
        let any = |from: usize| bytes[from..][..unit].iter().any(Option::is_some);
        if !any(first) || !any(end - unit) || !first.is_multiple_of(unit) {
            return wrong(self.bench, "a write burst that is not trimmed");
        }
        let full = bytes.iter().all(Option::is_some);
        let gap = (first..end).step_by(WORD_BYTES as usize);
        let gap = gap.into_iter().any(|word| {
            bytes[word..][..WORD_BYTES as usize]
                .iter()
                .all(Option::is_none)
        });
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::FullLine, full);
        categories.count(Category::TrimmedLine, end - first < LINE_BYTES as usize);
        categories.count(Category::GapInLine, gap);
        if self.words == Words::Paced {
            let golden = self.combiner.closed.pop_front();
            let same = (golden.as_ref())
                .is_some_and(|golden| golden.address == line && golden.bytes == bytes);
            if !same {
                return wrong(
                    self.bench,
                    &format!("golden {golden:x?}, but a write burst is"),
                );
            }
        }
        Ok(())
    }

    /// Checks what is handed on after an edge.
    fn check_after(&mut self, edge: &Edge, word: bool) -> Result<()> {
        let (outputs, model) = (&self.ports.outputs, &self.bench.model);
        if model.get(outputs.error) != 0 {
            let rules = violated(model, &outputs.violated);
            let place = format!("the monitor reports {rules}");
            return Err(self.bench.mismatch(place, vec![]));
        }
        let empty = model.get(outputs.empty) != 0;
        if empty && (word || !self.slave.has_written()) {
            let place = "empty, but words are on their way";
            return Err(self.bench.mismatch(place, vec![]));
        }
        let number = edge.beat.map(|beat| beat.id >> self.local_bits);
        for (i, beat) in [(1, &outputs.a_beat), (2, &outputs.b_beat)] {
            let mine = edge.beat.filter(|_| number == Some(i));
            let mut data = Data::default();
            model.get_words(beat.payload.data, &mut data);
            let same = match mine {
                None => model.get(beat.valid) == 0,
                Some(golden) => {
                    let local = golden.id & ((1 << CLIENT_BITS[i as usize]) - 1);
                    model.get(beat.valid) != 0
                        && model.get(beat.payload.id) == u64::from(local)
                        && model.get(beat.payload.last) == u64::from(golden.last)
                        && model.get(beat.payload.error) == u64::from(golden.error)
                        && data == golden.data
                }
            };
            if !same {
                let place = format!("beat of client {i}: golden {mine:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        if self.flush && self.words == Words::Paced {
            self.combiner.flush();
        }
        Ok(())
    }
}
