//! The chip's motion unit alone: the command processor, the burst reader, both processors and the write combiner are played at random.
//!
//! A motion asks for rows under random tags and writes random records; which rows and words that must give follows from
//! `docs/chip.md` and `docs/layout.md`.

use super::mismatch::Field;
use super::model::PortHandle;
use super::scoreboard::{Bench, Category, RESET_CYCLES, UnitOptions, UnitReport};
use crate::bkd::bytes::ByteRecord;
use crate::chip::Limits;
use crate::config::Config;
use crate::hdl::{self, Bundle};
use crate::hw::Plan;
use crate::hw::chip::motion::{Inputs, Outputs, module, ports};
use anyhow::Result;
use std::collections::VecDeque;

/// What the unit can meet.
pub const CATEGORIES: &[Category] = &[
    Category::SkinCommand,
    Category::UpdateCommand,
    Category::RowAnswered,
    Category::VertexWritten,
    Category::NodeWritten,
    Category::BoxWritten,
    Category::WaitingWord,
    Category::WaitingTag,
    // A cycle in which a write waits.
    Category::WaitingWrite,
    Category::CutShort,
];

/// Bytes of a word.
const WORD: usize = 16;

/// Cycles within which a row is answered when its word and its tag are there.
const SOON: u32 = 4;

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// A 16-byte word to write.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Word {
    address: u32,
    bytes: [u8; WORD],
    strobes: u64,
}

/// A record that a processor writes.
#[derive(Clone, Debug)]
enum Written {
    Vertex { index: u32, words: Vec<u32> },
    Node { index: u32, words: Vec<u32> },
    Bounds { words: Vec<u32> },
}

/// A mesh or an object.
#[derive(Clone, Debug)]
struct Asked {
    is_update: bool,
    vertices: u32,
    nodes: u32,
    bounds: u32,
    rows_address: u32,
    rows: u32,
    /// Indices and counts that are handed on: palette, joints, rest, count, target, first vertex, first node.
    others: [u32; 7],
}

/// A motion that runs.
struct Running {
    asked: Asked,
    /// The words of its rows that are yet to be taken, and the rows that are yet to be answered.
    words: VecDeque<[u32; 4]>,
    rows: VecDeque<Vec<u32>>,
    /// Rows that are yet to be requested, and the tags of those that are under way.
    to_request: u32,
    tags: VecDeque<u32>,
    /// Records that are yet to be accepted, and whether the second word of the first one is next.
    records: VecDeque<Written>,
    second: bool,
    /// Cycles in which a row could have been answered.
    waited: u32,
}

impl Running {
    /// Whether the processor has nothing left to do.
    fn is_complete(&self) -> bool {
        self.rows.is_empty() && self.records.is_empty()
    }
}

/// What the bench gives in a cycle.
struct Given {
    start: bool,
    sequence_ready: bool,
    word: bool,
    unit_ready: [bool; 2],
    done: bool,
    tag: Option<u32>,
    record: bool,
    write_ready: bool,
}

/// Probabilities of pauses, and the greatest numbers of rows and records.
struct Pace {
    start: f64,
    word: f64,
    request: f64,
    record: f64,
    write: f64,
    rows: u32,
    records: u32,
}

impl Pace {
    fn random(rng: &mut fastrand::Rng) -> Pace {
        let mut pause = || [0.0, 0.0, 0.4, 0.9][rng.usize(..4)];
        Pace {
            start: pause(),
            word: pause(),
            request: pause(),
            record: pause(),
            write: pause(),
            rows: [1, 5, 60][rng.usize(..3)],
            records: [0, 6, 60][rng.usize(..3)],
        }
    }
}

/// The layouts of records.
struct Layouts {
    vertex: ByteRecord,
    node: ByteRecord,
    row: ByteRecord,
}

struct Run {
    bench: Bench,
    ports: Ports,
    rng: fastrand::Rng,
    limits: Limits,
    layouts: Layouts,
    /// Tags of rows of influences and of programs.
    tags: [u32; 2],
    pace: Pace,
    /// The motion that is asked for, and the one that runs.
    start: Option<Asked>,
    running: Option<Running>,
    /// Which processor ran last.
    is_update: bool,
    /// The word that waits to be accepted.
    stored: Option<Word>,
}

/// Co-simulates the motion unit of a machine with at least `transactions` rows and records.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(config: &Config, transactions: u64, options: &UnitOptions) -> Result<UnitReport> {
    let plan = Plan::new(config)?;
    let mut bench = Bench::new("motion", &module(&plan)?, options)?;
    let ports = bench.model.ports(&ports(&plan))?;
    bench.model.reset(RESET_CYCLES);
    let format = config.format();
    let mut rng = fastrand::Rng::with_seed(options.seed);
    let mut run = Run {
        bench,
        ports,
        limits: Limits::of(config),
        layouts: Layouts {
            vertex: ByteRecord::vertex(format),
            node: ByteRecord::node(format),
            row: ByteRecord::influence_row(format),
        },
        tags: [config.skinning_rows_ahead, config.update_program_rows],
        pace: Pace::random(&mut rng),
        rng,
        start: None,
        running: None,
        is_update: false,
        stored: None,
    };
    let ended = run.all(transactions);
    run.bench.report(ended, CATEGORIES)
}

impl Run {
    fn all(&mut self, transactions: u64) -> Result<()> {
        while self.bench.tally.transactions < transactions {
            if self.rng.u16(..3000) == 0 {
                let given = self.give();
                self.show(&given);
                self.bench.model.reset(RESET_CYCLES);
                self.bench.tally.categories.count(Category::CutShort, true);
                (self.running, self.stored) = (None, None);
            }
            self.cycle()?;
        }
        Ok(())
    }

    fn cycle(&mut self) -> Result<()> {
        let given = self.give();
        self.show(&given);
        self.bench.model.eval();
        self.compare(&given)?;
        let answered = self.answer(&given)?;
        self.follow(&given, answered);
        self.bench.model.clock();
        Ok(())
    }

    fn is_busy(&self) -> bool {
        self.running.is_some() || self.stored.is_some()
    }

    fn index(&mut self) -> u32 {
        self.rng.u32(..=self.limits.greatest_index)
    }

    /// A mesh or an object with any addresses.
    fn asked(&mut self) -> Asked {
        let rows = self
            .rng
            .u32(1..=self.pace.rows.min(self.limits.greatest_index));
        let joints = self.rng.u32(1..=self.limits.joints);
        let mut others = [0; 7].map(|_: u32| self.index());
        others[1] = joints;
        let rng = &mut self.rng;
        Asked {
            is_update: rng.bool(),
            vertices: rng.u32(..) & !63,
            nodes: rng.u32(..) & !63,
            bounds: rng.u32(..) & !(self.limits.box_bytes - 1),
            rows_address: rng.u32(..) & !15,
            rows,
            others,
        }
    }

    /// What the processor of a motion reads and writes.
    fn running(&mut self, asked: Asked) -> Running {
        let row = match asked.is_update {
            true => WORD,
            false => self.layouts.row.bytes as usize,
        };
        let bytes = (asked.rows as usize * row).next_multiple_of(WORD);
        let bytes: Vec<u8> = (0..bytes).map(|_| self.rng.u8(..)).collect();
        let word = |bytes: &[u8]| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let words_of = |bytes: &[u8]| bytes.chunks_exact(4).map(word).collect::<Vec<_>>();
        let rows = bytes.chunks_exact(row).take(asked.rows as usize);
        let rows = rows.map(|bytes| match asked.is_update {
            true => words_of(bytes),
            false => self.layouts.row.read(bytes),
        });
        let rows = rows.collect();
        let words = bytes.chunks_exact(WORD);
        let words = words.map(|bytes| std::array::from_fn(|k| word(&bytes[4 * k..])));
        let words = words.collect();
        let mut records = VecDeque::new();
        for _ in 0..self.rng.u32(..=self.pace.records) {
            let index = self.index();
            let record = match asked.is_update {
                true => &self.layouts.node.record,
                false => &self.layouts.vertex.record,
            };
            let words = random_words(&mut self.rng, record.width);
            records.push_back(match asked.is_update {
                true => Written::Node { index, words },
                false => Written::Vertex { index, words },
            });
        }
        if asked.is_update {
            let width = 2 * self.layouts.vertex.record.width;
            let words = random_words(&mut self.rng, width);
            records.push_back(Written::Bounds { words });
        }
        Running {
            to_request: asked.rows,
            asked,
            words,
            rows,
            tags: VecDeque::new(),
            records,
            second: false,
            waited: 0,
        }
    }

    /// What the neighbours do in this cycle.
    fn give(&mut self) -> Given {
        if self.start.is_none() && self.rng.f64() >= self.pace.start {
            self.start = Some(self.asked());
        }
        let (rng, pace) = (&mut self.rng, &self.pace);
        let running = self.running.as_ref();
        let has_words = running.is_some_and(|running| !running.words.is_empty());
        let count = self.tags[usize::from(self.is_update)];
        let tag = running
            .filter(|running| running.to_request > 0 && rng.f64() >= pace.request)
            .and_then(|running| {
                let free = (0..count).filter(|tag| !running.tags.contains(tag));
                let free: Vec<u32> = free.collect();
                (!free.is_empty()).then(|| free[rng.usize(..free.len())])
            });
        // A record that was refused in the middle stays.
        let half = running.is_some_and(|running| running.second);
        let record = running.is_some_and(|running| !running.records.is_empty())
            && (half || rng.f64() >= pace.record);
        Given {
            start: self.start.is_some(),
            sequence_ready: !has_words && rng.u8(..4) != 0,
            word: has_words && rng.f64() >= pace.word,
            unit_ready: [rng.u8(..4) != 0, rng.u8(..4) != 0],
            done: running.is_some_and(Running::is_complete) && rng.bool(),
            tag,
            record,
            write_ready: rng.f64() >= pace.write,
        }
    }

    /// Sets the inputs for the coming edge.
    fn show(&mut self, given: &Given) {
        let (model, rng, inputs) = (&mut self.bench.model, &mut self.rng, &self.ports.inputs);
        model.garble(inputs.start.payload.leaves(), rng);
        model.set(inputs.start.valid, given.start.into());
        if let Some(asked) = &self.start {
            for (port, value) in fields_of(&inputs.start.payload, asked) {
                model.set(port, value.into());
            }
        }
        model.set(inputs.sequence_ready, given.sequence_ready.into());
        model.set(inputs.word_valid, given.word.into());
        model.garble([inputs.word], rng);
        let units = &inputs.units;
        model.garble(units.leaves(), rng);
        model.set(units.skin_ready, given.unit_ready[0].into());
        model.set(units.update_ready, given.unit_ready[1].into());
        model.set(units.skin_done, (given.done && !self.is_update).into());
        model.set(units.update_done, (given.done && self.is_update).into());
        let requests = [units.influence, units.program];
        for (request, is_update) in requests.iter().zip([false, true]) {
            let tag = given.tag.filter(|_| self.is_update == is_update);
            model.set(request.valid, tag.is_some().into());
            if let Some(tag) = tag {
                model.set(request.payload.tag, tag.into());
            }
        }
        for port in [units.skinned.valid, units.node.valid, units.bounds_valid] {
            model.set(port, 0);
        }
        model.set(inputs.write_ready, given.write_ready.into());
        let Some(running) = &self.running else {
            return;
        };
        if given.word {
            model.set_words(inputs.word, &running.words[0]);
        }
        match running.records.front().filter(|_| given.record) {
            Some(Written::Vertex { index, words }) => {
                model.set(units.skinned.valid, 1);
                model.set(units.skinned.payload.address, (*index).into());
                model.set_words(units.skinned.payload.data, words);
            }
            Some(Written::Node { index, words }) => {
                model.set(units.node.valid, 1);
                model.set(units.node.payload.address, (*index).into());
                model.set(units.node.payload.mask, 0b01111);
                model.set_words(units.node.payload.data, words);
            }
            Some(Written::Bounds { words }) => {
                model.set(units.bounds_valid, 1);
                model.set_words(units.bounds, words);
            }
            None => (),
        }
    }

    /// Compares what does not depend on the answers to rows.
    fn compare(&self, given: &Given) -> Result<()> {
        let (model, out) = (&self.bench.model, &self.ports.outputs);
        let busy = self.is_busy();
        let idle = !busy && given.sequence_ready;
        let asked = self.start.as_ref();
        let ready = asked.map(|asked| idle && given.unit_ready[usize::from(asked.is_update)]);
        let starts = ready == Some(true);
        let is_update = asked.map(|asked| asked.is_update);
        let mut wanted: Vec<(&str, u64, PortHandle)> = vec![
            ("skinning", (busy && !self.is_update).into(), out.skinning),
            ("updating", (busy && self.is_update).into(), out.updating),
            ("sequence", starts.into(), out.sequence.valid),
            (
                "skin",
                (idle && is_update == Some(false)).into(),
                out.units.skin.valid,
            ),
            (
                "update",
                (idle && is_update == Some(true)).into(),
                out.units.update.valid,
            ),
            ("write", self.stored.is_some().into(), out.write.valid),
            ("influences ready", 1, out.units.influence.request_ready),
            ("program ready", 1, out.units.program.request_ready),
        ];
        wanted.extend(ready.map(|ready| ("start ready", u64::from(ready), out.start_ready)));
        if let (true, Some(asked)) = (starts, asked) {
            wanted.extend(self.started(asked));
        }
        if let Some(running) = &self.running {
            wanted.push(("vertices", running.asked.vertices.into(), out.vertices));
            if given.record {
                let port = match &running.records[0] {
                    Written::Vertex { .. } => out.units.skinned_ready,
                    Written::Node { .. } => out.units.node_ready,
                    Written::Bounds { .. } => out.units.bounds_ready,
                };
                wanted.push(("record ready", self.takes(running, given).into(), port));
            }
        }
        self.bench.compare("outputs", &wanted)?;
        let Some(stored) = &self.stored else {
            return Ok(());
        };
        let mut data = [0; 4];
        model.get_words(out.write.payload.data, &mut data);
        let bytes: Vec<u8> = data.into_iter().flat_map(u32::to_le_bytes).collect();
        let mut fields = vec![
            Field::integer(
                "address",
                stored.address.into(),
                model.get(out.write.payload.address),
            ),
            Field::integer(
                "strobes",
                stored.strobes,
                model.get(out.write.payload.strobes),
            ),
        ];
        for (k, (golden, rtl)) in stored.bytes.into_iter().zip(bytes).enumerate() {
            if stored.strobes >> k & 1 == 1 {
                fields.push(Field::integer(
                    format!("byte {k}"),
                    golden.into(),
                    rtl.into(),
                ));
            }
        }
        match fields.iter().any(Field::differs) {
            true => Err(self.bench.mismatch("word of a record", fields)),
            false => Ok(()),
        }
    }

    /// What reader and processor are given at a start.
    fn started(&self, asked: &Asked) -> Vec<(&'static str, u64, PortHandle)> {
        let out = &self.ports.outputs;
        let row = u64::from(self.layouts.row.bytes);
        let words = match asked.is_update {
            true => u64::from(asked.rows),
            false => (u64::from(asked.rows) * row).div_ceil(WORD as u64),
        };
        let [
            palette,
            joints,
            rest,
            count,
            target,
            first_vertex,
            first_node,
        ] = asked.others.map(u64::from);
        let mut wanted = vec![
            (
                "sequence address",
                u64::from(asked.rows_address),
                out.sequence.payload.address,
            ),
            ("words", words, out.sequence.payload.words),
        ];
        match asked.is_update {
            true => {
                let update = &out.units.update.payload;
                wanted.extend([
                    ("rows", asked.rows.into(), update.rows),
                    ("vertex base", first_vertex, update.vertex_base),
                    ("node base", first_node, update.node_base),
                    ("box index", 0, update.box_index),
                    ("program", 0, update.program),
                ]);
            }
            false => {
                let mesh = &out.units.skin.payload;
                wanted.extend([
                    ("palette", palette, mesh.palette),
                    ("joints", joints, mesh.joints),
                    ("influences", 0, mesh.influences),
                    ("rows", asked.rows.into(), mesh.rows),
                    ("rest", rest, mesh.rest),
                    ("count", count, mesh.vertices),
                    ("target", target, mesh.target),
                ]);
            }
        }
        wanted
    }

    /// Whether the last word of the offered record is stored in this cycle.
    fn takes(&self, running: &Running, given: &Given) -> bool {
        let room = self.stored.is_none() || given.write_ready;
        let words = self.words(running, &running.records[0]).len();
        room && (words == 1 || running.second)
    }

    /// The words of a record.
    fn words(&self, running: &Running, written: &Written) -> Vec<Word> {
        let (vertex, node) = (&self.layouts.vertex, &self.layouts.node);
        let at = |base: u32, index: u32, record: &ByteRecord| {
            base.wrapping_add(index.wrapping_mul(record.bytes))
        };
        let (address, bytes, strobes) = match written {
            Written::Vertex { index, words } => {
                let address = at(running.asked.vertices, *index, vertex);
                let all = u64::MAX >> (64 - vertex.bytes);
                (address, vertex.array(words), all)
            }
            Written::Node { index, words } => {
                let address = at(running.asked.nodes, *index, node);
                // The link word, the last part, is not written.
                let link = node.parts.last().map_or(0, |part| part.offset);
                (address, node.array(words), u64::MAX >> (64 - link))
            }
            Written::Bounds { words } => {
                let corners = corners(words, vertex.record.width);
                let bytes = vertex.array(&corners);
                (
                    running.asked.bounds,
                    bytes,
                    u64::MAX >> (64 - 2 * vertex.bytes),
                )
            }
        };
        let first = address as usize % WORD;
        let mut padded = vec![0; first];
        padded.extend(bytes);
        padded.resize(padded.len().next_multiple_of(WORD), 0);
        let strobes = u128::from(strobes) << first;
        let words = padded.chunks_exact(WORD).enumerate();
        let words = words.map(|(k, bytes)| Word {
            address: (address - first as u32).wrapping_add((k * WORD) as u32),
            bytes: std::array::from_fn(|k| bytes[k]),
            strobes: (strobes >> (k * WORD) & 0xffff) as u64,
        });
        words.collect()
    }

    /// Compares an answer; whether there is one.
    fn answer(&mut self, given: &Given) -> Result<bool> {
        let (model, out) = (&self.bench.model, &self.ports.outputs);
        let responses = [&out.units.influence.response, &out.units.program.response];
        let valid = responses.map(|response| model.get(response.valid) != 0);
        let own = usize::from(self.is_update);
        let running = self.running.as_ref();
        let can = running.is_some_and(|running| !running.tags.is_empty());
        if valid[1 - own] || (valid[own] && !can) {
            return Err(self.bench.mismatch("a row that was not requested", vec![]));
        }
        let Some(running) = running.filter(|_| valid[own]) else {
            let late = running.is_some_and(|running| running.waited > SOON);
            return match late {
                true => Err(self.bench.mismatch("a row that is not answered", vec![])),
                false => Ok(false),
            };
        };
        let response = &responses[own].payload;
        let (tag, row) = (running.tags[0], &running.rows[0]);
        let mut rtl = vec![0; row.len()];
        model.get_words(response.data, &mut rtl);
        let mut fields = vec![Field::integer("tag", tag.into(), model.get(response.tag))];
        for (k, (golden, rtl)) in row.iter().zip(&rtl).enumerate() {
            fields.push(Field::integer(
                format!("word {k}"),
                (*golden).into(),
                (*rtl).into(),
            ));
        }
        if fields.iter().any(Field::differs) {
            return Err(self.bench.mismatch("row", fields));
        }
        // A row has the words that have been taken, with this cycle's.
        let taken = usize::from(given.word && model.get(out.word_ready) != 0);
        let row_bytes = match self.is_update {
            true => WORD,
            false => self.layouts.row.bytes as usize,
        };
        let rows = running.asked.rows as usize;
        let all = (rows * row_bytes).div_ceil(WORD);
        let arrived = (all - running.words.len() + taken) * WORD;
        let needed = (rows - running.rows.len() + 1) * row_bytes;
        match arrived >= needed {
            true => Ok(true),
            false => Err(self.bench.mismatch("a row before its words", vec![])),
        }
    }

    /// Follows what happens in this cycle.
    fn follow(&mut self, given: &Given, answered: bool) {
        let accepted = self.stored.is_some() && given.write_ready;
        let waits = self.stored.is_some() && !given.write_ready;
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::WaitingWrite, waits);
        let loaded = match &self.running {
            Some(running) if given.record && (self.stored.is_none() || accepted) => {
                let words = self.words(running, &running.records[0]);
                Some((words[usize::from(running.second)].clone(), words.len() == 2))
            }
            _ => None,
        };
        if accepted {
            self.stored = None;
        }
        let word_taken = given.word && self.bench.model.get(self.ports.outputs.word_ready) != 0;
        let tally = &mut self.bench.tally;
        if let Some(running) = &mut self.running {
            tally.categories.count(Category::RowAnswered, answered);
            if answered {
                running.tags.pop_front();
                running.rows.pop_front();
                running.waited = 0;
                tally.transactions += 1;
                tally.checked += 1;
            } else {
                let could = !running.tags.is_empty() && given.word && !word_taken;
                running.waited += u32::from(could);
                let lacks_word = !running.tags.is_empty() && !given.word;
                let lacks_tag = running.tags.is_empty() && given.word;
                tally.categories.count(Category::WaitingWord, lacks_word);
                tally.categories.count(Category::WaitingTag, lacks_tag);
            }
            if word_taken {
                running.words.pop_front();
            }
            if let Some(tag) = given.tag {
                running.tags.push_back(tag);
                running.to_request -= 1;
            }
            if let Some((word, is_wide)) = loaded {
                self.stored = Some(word);
                running.second = is_wide && !running.second;
                tally.checked += 1;
                if !running.second {
                    tally.transactions += 1;
                    let category = match running.records.pop_front() {
                        Some(Written::Vertex { .. }) => Category::VertexWritten,
                        Some(Written::Node { .. }) => Category::NodeWritten,
                        _ => Category::BoxWritten,
                    };
                    tally.categories.count(category, true);
                }
            }
            if given.done {
                self.running = None;
                tally.packets += 1;
            }
            return;
        }
        let idle = !waits && !accepted && given.sequence_ready;
        let starts = |asked: &Asked| idle && given.unit_ready[usize::from(asked.is_update)];
        if let Some(asked) = self.start.take_if(|asked| starts(asked)) {
            self.is_update = asked.is_update;
            let category = match asked.is_update {
                true => Category::UpdateCommand,
                false => Category::SkinCommand,
            };
            self.bench.tally.categories.count(category, true);
            self.pace = Pace::random(&mut self.rng);
            self.running = Some(self.running(asked));
        }
    }
}

/// The fields of a start, in the ports or anywhere else.
fn fields_of<T: Copy>(ports: &crate::hw::chip::motion::Motion<T>, asked: &Asked) -> [(T, u32); 13] {
    let [
        palette,
        joints,
        rest,
        count,
        target,
        first_vertex,
        first_node,
    ] = asked.others;
    [
        (ports.is_update, asked.is_update.into()),
        (ports.vertices, asked.vertices),
        (ports.nodes, asked.nodes),
        (ports.bounds, asked.bounds),
        (ports.rows_address, asked.rows_address),
        (ports.rows, asked.rows),
        (ports.palette, palette),
        (ports.joints, joints),
        (ports.rest, rest),
        (ports.count, count),
        (ports.target, target),
        (ports.first_vertex, first_vertex),
        (ports.first_node, first_node),
    ]
}

/// Random bits of a record in 32-bit words.
fn random_words(rng: &mut fastrand::Rng, width: u32) -> Vec<u32> {
    let mut words: Vec<u32> = (0..width.div_ceil(32)).map(|_| rng.u32(..)).collect();
    if let (Some(last), rest @ 1..) = (words.last_mut(), width % 32) {
        *last &= u32::MAX >> (32 - rest);
    }
    words
}

/// The two vertex records of a box: each half of its bits, in words of its own.
fn corners(words: &[u32], width: u32) -> Vec<u32> {
    let bit = |k: u32| words[k as usize / 32] >> (k % 32) & 1;
    let corner = |first: u32| {
        let mut corner = vec![0; width.div_ceil(32) as usize];
        for k in 0..width {
            corner[k as usize / 32] |= bit(first + k) << (k % 32);
        }
        corner
    };
    [corner(0), corner(width)].concat()
}
