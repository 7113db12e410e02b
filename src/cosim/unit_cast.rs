//! The chip's cast unit alone: words of rays in, rays out, hits in, writes out.
//!
//! The ray casting unit is played here: it accepts rays at any pace, and returns random hits, packet by packet in any order. Every ray is
//! compared in all bits with the golden conversion, every write with the bytes that the golden chip leaves in memory; each byte is
//! written once.

use super::mismatch::Field;
use super::model::PortHandle;
use super::scoreboard::{Bench, Categories, Category, RESET_CYCLES, UnitOptions, UnitReport};
use crate::chip::{most_rays, ray};
use crate::config::Config;
use crate::float::{Format, specials};
use crate::golden::chip::bytes_of_hits;
use crate::hdl::{self, Bundle};
use crate::hw::chip::cast::{self, Cast, Inputs, Outputs};
use crate::hw::chip::hits::Hits;
use crate::hw::chip::rays::Rays;
use crate::hw::{Plan, raycast};
use crate::port::{Hit, NONE, Ray};
use anyhow::Result;
use std::collections::{HashMap, VecDeque};

/// What the unit can meet: rays, unless said otherwise.
pub const CATEGORIES: &[Category] = &[
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    Category::AnyHit,
    // A ray of one word; a ray that fills a packet.
    Category::ShortRay,
    Category::InactiveRay,
    // A packet that finishes before an older one.
    Category::Overtakes,
    // A cycle in which a packet waits because the window of answers is full.
    Category::HeldPacket,
    // A write that waits.
    Category::WaitingWrite,
    // A cast in the middle of which a reset comes.
    Category::CutShort,
];

/// The machine that is simulated by default: the reference with so few packets that its window of answers is often full.
pub fn reference() -> Config {
    Config {
        packets_in_flight: 8,
        ..Config::reference()
    }
}

/// Cycles without an event after which the unit has stopped.
const PATIENCE: u64 = 50_000;

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// Co-simulates the cast unit of a machine with at least `rays` rays.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(config: &Config, rays: u64, options: &UnitOptions) -> Result<UnitReport> {
    let plan = Plan::new(config)?;
    let module = cast::module(&plan)?;
    let bench = Bench::new("cast_unit", &module, options)?;
    let ports = bench.model.ports(&cast::ports(&plan))?;
    let mut run = Run {
        config,
        format: config.format(),
        packets: plan.packets() as usize,
        slots: plan.rays() as usize,
        bench,
        ports,
        rng: fastrand::Rng::with_seed(options.seed),
    };
    let ended = run.all(rays);
    run.bench.report(ended, CATEGORIES)
}

struct Run<'a> {
    config: &'a Config,
    format: Format,
    packets: usize,
    slots: usize,
    bench: Bench,
    ports: Ports,
    rng: fastrand::Rng,
}

/// A packet in the ray casting unit.
struct Packet {
    tag: u64,
    /// The cycle from which its hits may leave.
    ready: u64,
}

/// A cast, and what must come of it.
struct Script {
    start: Cast<u64>,
    origin: [u32; 4],
    words: VecDeque<[u32; 4]>,
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// The bytes to be written, by address.
    bytes: HashMap<u32, u8>,
}

/// A cast under way.
struct Casting {
    words: VecDeque<[u32; 4]>,
    rays: Vec<Ray>,
    hits: Vec<Hit>,
    /// The bytes that are still to be written.
    bytes: HashMap<u32, u8>,
    any_hit: u64,
    in_flight: Vec<Packet>,
    /// Rays that the bench has accepted, and hits that it has returned.
    accepted: usize,
    returned: usize,
    /// The packet whose hits leave, and the next of them.
    leaving: Option<(u64, usize)>,
    /// Offers that were refused, and must be there again.
    ray_offer: Option<raycast::Ray<u64>>,
    write_offer: Option<(u32, [u32; 4], u64)>,
}

impl Casting {
    fn new(script: Script) -> Casting {
        Casting {
            words: script.words,
            rays: script.rays,
            hits: script.hits,
            bytes: script.bytes,
            any_hit: script.start.rays.any_hit,
            in_flight: vec![],
            accepted: 0,
            returned: 0,
            leaving: None,
            ray_offer: None,
            write_offer: None,
        }
    }
}

/// What the bench gives and accepts at an edge.
struct Given {
    word: bool,
    hit: bool,
    takes_ray: bool,
    takes_write: bool,
}

/// Probabilities that a neighbour pauses in a cycle.
struct Pauses {
    words: f64,
    rays: f64,
    hits: f64,
    writes: f64,
    /// Greatest number of cycles that a packet takes, and that most packets take.
    longest: u64,
    usual: u64,
}

impl Pauses {
    fn random(rng: &mut fastrand::Rng) -> Pauses {
        let mut pause = || [0.0, 0.0, 0.3, 0.8][rng.usize(..4)];
        let (words, rays, hits, writes) = (pause(), pause(), pause(), pause());
        Pauses {
            words,
            rays,
            hits,
            writes,
            longest: [1, 30, 400, 4000][rng.usize(..4)],
            usual: [1, 30, 400][rng.usize(..3)],
        }
    }
}

impl Run<'_> {
    fn all(&mut self, rays: u64) -> Result<()> {
        self.reset()?;
        while self.bench.tally.transactions < rays {
            let script = self.script();
            let pauses = Pauses::random(&mut self.rng);
            self.cast(script, &pauses)?;
        }
        Ok(())
    }

    /// Resets the unit, which is idle afterwards.
    fn reset(&mut self) -> Result<()> {
        self.bench.model.reset(RESET_CYCLES);
        match self.bench.model.get(self.ports.outputs.casting) {
            0 => Ok(()),
            busy => {
                let fields = vec![Field::integer("casting", 0, busy)];
                Err(self.bench.mismatch("after a reset", fields))
            }
        }
    }

    /// A number in binary32: any bits, special values, and values near the limits of the machine's format.
    fn number(&mut self) -> u32 {
        let rng = &mut self.rng;
        match rng.u8(..8) {
            0 | 1 => rng.u32(..),
            2 => {
                let all = [
                    0,
                    1 << 31,
                    0x7f80_0000,
                    0xff80_0000,
                    0x7fc0_0000,
                    1,
                    0x807f_ffff,
                ];
                all[rng.usize(..all.len())]
            }
            3 => {
                // A number of the format, up to a half of its last place: ties and their neighbours.
                let special = specials(self.format);
                let bits = self
                    .format
                    .to_f32(special[rng.usize(..special.len())])
                    .to_bits();
                let dropped = 23 - self.format.fraction_bits();
                let half = (1u32 << dropped) >> 1;
                bits.wrapping_add(half)
                    .wrapping_add(rng.u32(..3))
                    .wrapping_sub(1)
            }
            _ => rng.f32().to_bits() ^ rng.u32(..2) << 31,
        }
    }

    fn count_number(categories: &mut Categories, number: f32) {
        categories.count(Category::Nan, number.is_nan());
        categories.count(Category::Infinity, number.is_infinite());
        categories.count(
            Category::SignedZero,
            number == 0.0 && number.is_sign_negative(),
        );
    }

    fn script(&mut self) -> Script {
        let any_hit = self.rng.bool();
        let short = self.rng.bool();
        let most = u64::from(most_rays(self.config)).min(match self.rng.u8(..8) {
            0 => 3000,
            _ => 200,
        });
        let count = self.rng.u32(1..=most as u32);
        let address = self.rng.u32(..1 << 24) << 6;
        let origin: [u32; 4] = std::array::from_fn(|_| self.number());
        let mut words = VecDeque::new();
        let mut rays = vec![];
        for _ in 0..count {
            let own: [u32; 4] = match short {
                true => origin,
                false => std::array::from_fn(|_| self.number()),
            };
            let direction: [u32; 4] = std::array::from_fn(|_| self.number());
            if !short {
                words.push_back(own);
            }
            words.push_back(direction);
            let numbers: ray::Numbers = std::array::from_fn(|k| {
                f32::from_bits(if k < 4 { own[k] } else { direction[k - 4] })
            });
            for number in numbers {
                Self::count_number(&mut self.bench.tally.categories, number);
            }
            rays.push(ray::from_numbers(self.format, &numbers, any_hit));
        }
        let hits: Vec<Hit> = rays.iter().map(|_| self.hit(any_hit)).collect();
        let start = Cast {
            rays: Rays {
                count: count.into(),
                any_hit: any_hit.into(),
                short: short.into(),
                origin: 0,
            },
            hits: Hits {
                count: count.into(),
                any_hit: any_hit.into(),
                address: address.into(),
            },
        };
        let bytes = bytes_of_hits(self.format, &hits, any_hit);
        let places = (0u32..).map(|place| address.wrapping_add(place));
        let bytes = places.zip(bytes).collect();
        let categories = &mut self.bench.tally.categories;
        for _ in 0..count {
            categories.count(Category::AnyHit, any_hit);
            categories.count(Category::ShortRay, short);
        }
        Script {
            start,
            origin,
            words,
            rays,
            hits,
            bytes,
        }
    }

    fn hit(&mut self, any_hit: bool) -> Hit {
        let rng = &mut self.rng;
        if rng.u8(..3) == 0 {
            return Hit::MISS;
        }
        let special = specials(self.format);
        let mut number = || self.format.to_f64(special[rng.usize(..special.len())]);
        let t = loop {
            let t = number();
            if t.is_finite() {
                break t.abs();
            }
        };
        if any_hit {
            return Hit::any(t);
        }
        let (u, v) = (number(), number());
        Hit {
            t,
            u,
            v,
            instance: rng.u32(..),
            triangle: rng.u32(..),
        }
    }

    /// Runs a cast, and compares what comes of it.
    fn cast(&mut self, script: Script, pauses: &Pauses) -> Result<()> {
        self.start(&script);
        let mut cast = Casting::new(script);
        let mut quiet = 0;
        let mut until_reset = match self.rng.u8(..16) {
            0 => self.rng.u64(..2000),
            _ => u64::MAX,
        };
        while self.bench.model.get(self.ports.outputs.casting) != 0 {
            if until_reset == 0 {
                self.bench.tally.categories.count(Category::CutShort, true);
                return self.reset();
            }
            until_reset -= 1;
            let given = self.give(&mut cast, pauses);
            self.bench.model.eval();
            let mut happens = self.take(&mut cast, &given);
            happens |= self.ray(&mut cast, &given, pauses)?;
            happens |= self.write(&mut cast, given.takes_write)?;
            self.bench.model.clock();
            quiet = if happens { 0 } else { quiet + 1 };
            if quiet > PATIENCE {
                let place = format!(
                    "the unit has stopped: {} rays accepted, {} hits returned",
                    cast.accepted, cast.returned
                );
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        self.end(&cast)
    }

    fn start(&mut self, script: &Script) {
        let (model, inputs) = (&mut self.bench.model, self.ports.inputs);
        model.drive(&inputs.start.payload, script.start);
        model.set_words(inputs.start.payload.rays.origin, &script.origin);
        model.set(inputs.start.valid, 1);
        for port in [
            inputs.word_valid,
            inputs.ray_ready,
            inputs.hit.valid,
            inputs.write_ready,
        ] {
            model.set(port, 0);
        }
        model.clock();
        model.set(inputs.start.valid, 0);
        model.garble(inputs.start.payload.leaves(), &mut self.rng);
    }

    /// Sets the inputs for the coming edge.
    fn give(&mut self, cast: &mut Casting, pauses: &Pauses) -> Given {
        let now = self.bench.model.cycles();
        let rng = &mut self.rng;
        let word = rng.f64() >= pauses.words && !cast.words.is_empty();
        let takes_ray = rng.f64() >= pauses.rays && cast.in_flight.len() < self.packets;
        let gives_hit = rng.f64() >= pauses.hits;
        let takes_write = rng.f64() >= pauses.writes;
        if cast.leaving.is_none() && gives_hit {
            let ready: Vec<usize> = (0..cast.in_flight.len())
                .filter(|&place| cast.in_flight[place].ready <= now)
                .collect();
            if let Some(place) = rng.choice(ready) {
                let categories = &mut self.bench.tally.categories;
                categories.count(Category::Overtakes, place > 0);
                cast.leaving = Some((cast.in_flight.remove(place).tag, 0));
            }
        }
        let (model, inputs) = (&mut self.bench.model, self.ports.inputs);
        model.set(inputs.word_valid, word.into());
        match cast.words.front() {
            Some(front) if word => model.set_words(inputs.word, front),
            _ => model.garble([inputs.word], rng),
        }
        model.set(inputs.ray_ready, takes_ray.into());
        model.set(inputs.write_ready, takes_write.into());
        let shown = cast.leaving.filter(|_| gives_hit);
        model.set(inputs.hit.valid, shown.is_some().into());
        match shown {
            Some((tag, slot)) => {
                let place = tag as usize * self.slots + slot;
                let hit = cast.hits.get(place).unwrap_or(&Hit::MISS);
                let number = |x: f64| self.format.to_bits(x);
                let hit = raycast::TaggedHit {
                    tag,
                    hit: crate::hw::ray::Hit {
                        t: number(hit.t),
                        u: number(hit.u),
                        v: number(hit.v),
                        instance: hit.instance.into(),
                        triangle: hit.triangle.into(),
                    },
                };
                model.drive(&inputs.hit.payload, hit);
            }
            None => model.garble(inputs.hit.payload.leaves(), rng),
        }
        Given {
            word,
            hit: shown.is_some(),
            takes_ray,
            takes_write,
        }
    }

    /// Removes the word and the hit that the coming edge accepts; whether there is one.
    fn take(&self, cast: &mut Casting, given: &Given) -> bool {
        let (model, outputs) = (&self.bench.model, &self.ports.outputs);
        let word = given.word && model.get(outputs.word_ready) != 0;
        if word {
            cast.words.pop_front();
        }
        let hit = given.hit && model.get(outputs.hit_ready) != 0;
        if hit {
            cast.returned += 1;
            let next = cast.leaving.map(|(tag, slot)| (tag, slot + 1));
            cast.leaving = next.filter(|(_, slot)| *slot < self.slots);
        }
        word || hit
    }

    /// Checks the ray that is offered; whether it is accepted.
    fn ray(&mut self, cast: &mut Casting, given: &Given, pauses: &Pauses) -> Result<bool> {
        let (model, outputs) = (&self.bench.model, &self.ports.outputs);
        let offer = (model.get(outputs.ray.valid) != 0).then(|| model.sample(&outputs.ray.payload));
        let was = cast.ray_offer.take();
        if was.is_some() && was != offer {
            return Err(self.bench.mismatch("a ray that waits changes", vec![]));
        }
        let Some(ray) = offer.filter(|_| given.takes_ray) else {
            // Words are refused although no ray is offered: the ray that is there is held.
            let refused = given.word && model.get(outputs.word_ready) == 0;
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::HeldPacket, offer.is_none() && refused);
            cast.ray_offer = offer;
            return Ok(false);
        };
        self.check_ray(&cast.rays, cast.accepted, &ray, cast.any_hit)?;
        cast.accepted += 1;
        if cast.accepted.is_multiple_of(self.slots) {
            let most = match self.rng.u8(..32) {
                0 => pauses.longest,
                _ => pauses.usual.min(pauses.longest),
            };
            let ready = self.bench.model.cycles() + self.rng.u64(1..=most);
            cast.in_flight.push(Packet {
                tag: ray.tag,
                ready,
            });
        }
        Ok(true)
    }

    /// Checks the write that is offered; whether it is accepted.
    fn write(&mut self, cast: &mut Casting, takes: bool) -> Result<bool> {
        let (model, port) = (&self.bench.model, &self.ports.outputs.write);
        let offer = (model.get(port.valid) != 0).then(|| {
            let mut data = [0u32; 4];
            model.get_words(port.payload.data, &mut data);
            let address = model.get(port.payload.address) as u32;
            (address, data, model.get(port.payload.strobes))
        });
        let was = cast.write_offer.take();
        if was.is_some() && was != offer {
            return Err(self.bench.mismatch("a write that waits changes", vec![]));
        }
        let Some(write) = offer.filter(|_| takes) else {
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::WaitingWrite, offer.is_some());
            cast.write_offer = offer;
            return Ok(false);
        };
        self.check_write(&mut cast.bytes, write)?;
        Ok(true)
    }

    /// Counts a cast that has ended, and checks that nothing is left of it.
    fn end(&mut self, cast: &Casting) -> Result<()> {
        let packets = cast.rays.len().div_ceil(self.slots);
        let places = packets * self.slots;
        let tally = &mut self.bench.tally;
        tally.transactions += cast.rays.len() as u64;
        tally.packets += packets as u64;
        for _ in cast.rays.len()..places {
            tally.categories.count(Category::InactiveRay, true);
        }
        let counts = vec![
            Field::integer("rays of all packets", places as u64, cast.accepted as u64),
            Field::integer("words left", 0, cast.words.len() as u64),
            Field::integer("bytes not written", 0, cast.bytes.len() as u64),
        ];
        if counts.iter().any(Field::differs) {
            return Err(self.bench.mismatch("after a cast", counts));
        }
        Ok(())
    }

    fn check_ray(
        &mut self,
        rays: &[Ray],
        place: usize,
        shown: &raycast::Ray<u64>,
        any_hit: u64,
    ) -> Result<()> {
        let number = |x: f64| self.format.to_bits(x);
        let tag = (place / self.slots) as u64;
        let golden = rays.get(place);
        let mut fields = vec![
            Field::integer("active", golden.is_some().into(), shown.active),
            Field::integer("any hit", any_hit, shown.any_hit),
        ];
        let mut differs = shown.active != u64::from(golden.is_some()) || shown.any_hit != any_hit;
        if place.is_multiple_of(self.slots) {
            differs |= shown.tag != tag;
            fields.push(Field::integer("tag", tag, shown.tag));
        }
        if let Some(ray) = golden {
            let pairs = [
                ("origin", ray.origin, shown.line.origin),
                ("direction", ray.direction, shown.line.direction),
            ];
            for (name, golden, rtl) in pairs {
                for k in 0..3 {
                    differs |= number(golden[k]) != rtl[k];
                    let name = format!("{name} {}", ["x", "y", "z"][k]);
                    fields.push(Field::number(name, self.format, number(golden[k]), rtl[k]));
                }
            }
            let limits = [
                ("tmin", ray.tmin, shown.limits.tmin),
                ("tmax", ray.tmax, shown.limits.tmax),
            ];
            for (name, golden, rtl) in limits {
                differs |= number(golden) != rtl;
                fields.push(Field::number(name, self.format, number(golden), rtl));
            }
        }
        if differs {
            return Err(self.bench.mismatch(format!("ray {place}"), fields));
        }
        self.bench.tally.checked += 1;
        Ok(())
    }

    fn check_write(
        &mut self,
        bytes: &mut HashMap<u32, u8>,
        (address, data, strobes): (u32, [u32; 4], u64),
    ) -> Result<()> {
        for k in (0..16u32).filter(|k| strobes >> k & 1 != 0) {
            let at = address.wrapping_add(k);
            let rtl = u64::from(data[k as usize / 4] >> (8 * (k % 4)) & 0xff);
            let place = || format!("write to {at:#010x}");
            let Some(golden) = bytes.remove(&at) else {
                let fields = vec![Field::integer("byte", u64::from(NONE), rtl)];
                return Err(self
                    .bench
                    .mismatch(format!("{}: unexpected, or a second one", place()), fields));
            };
            if u64::from(golden) != rtl {
                let fields = vec![Field::integer("byte", golden.into(), rtl)];
                return Err(self.bench.mismatch(place(), fields));
            }
            self.bench.tally.checked += 1;
        }
        Ok(())
    }
}
