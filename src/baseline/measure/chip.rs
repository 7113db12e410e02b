//! Measures the chip: pictures whose rays it casts from memory.

use super::{Picture, rays_of, rounded};
use crate::baseline::ChipFigures;
use crate::chip::image::{Builder, Still, still};
use crate::config::{Config, MemoryModel};
use crate::cosim::chip::{Chip, Options};
use crate::emit::{self, Top};
use crate::golden::Caster;
use crate::hw::{self, Plan};
use crate::scene::{RayKind, View, sort_along_morton_curve};
use crate::synth;
use anyhow::{Result, ensure};

/// The picture of the gate, and the larger one of the tables: a room whose tree is much larger than every cache.
const SCENE: (&str, Option<View>) = ("builtin:interior", Some(View::Inside));
const SMALL: &str = "128x96";
const LARGE: &str = "256x192";

/// Sizes of the caches in the table.
const KIB: [u32; 7] = [1, 2, 4, 8, 16, 32, 64];

/// The address of the memory, and its greatest size.
const BASE: u32 = 0;
const MOST_BYTES: u64 = 1 << 30;

/// The seed of the directions of diffuse rays.
const SEED: u64 = 1;

/// The fingerprint of the chip's Verilog.
pub fn verilog(config: &Config) -> Result<String> {
    let plan = Plan::new(config)?;
    let machine = emit::machine_with(&plan, hw::core::default_prefix(), Top::Chip)?;
    synth::fingerprint(machine.design.top())
}

/// The pictures of the gate.
pub fn frames(config: &Config, progress: &dyn Fn(&str)) -> Result<Vec<ChipFigures>> {
    let rays = Rays::new(config, SMALL)?;
    let mut chip = chip(config)?;
    cast_all(&mut chip, config, &rays, progress)
}

/// The table of memories, and the table of caches.
pub fn sweep(
    config: &Config,
    progress: &dyn Fn(&str),
) -> Result<(Vec<ChipFigures>, Vec<ChipFigures>)> {
    let rays = Rays::new(config, LARGE)?;
    let (mut memories, mut caches) = (vec![], vec![]);
    for model in MemoryModel::NAMES {
        let mut config = config.clone();
        config.set("memory.model", model)?;
        memories.extend(cast_all(&mut chip(&config)?, &config, &rays, progress)?);
    }
    for kib in KIB {
        let mut config = config.clone();
        for cache in ["nodes", "records", "vertices"] {
            config.set(&format!("cache.{cache}_kib"), &kib.to_string())?;
        }
        caches.extend(cast_all(&mut chip(&config)?, &config, &rays, progress)?);
    }
    Ok((memories, caches))
}

fn chip(config: &Config) -> Result<Chip> {
    Chip::new(config, &Options::default(), &|_| ())
}

/// The rays of all kinds of a picture, in the order in which a host that knows of caches writes them.
struct Rays {
    picture: Picture,
    size: &'static str,
    kinds: Vec<(RayKind, Vec<crate::port::Ray>)>,
}

impl Rays {
    fn new(config: &Config, size: &'static str) -> Result<Rays> {
        let mut picture = Picture::new(config, SCENE.0, SCENE.1, size)?;
        sort_along_morton_curve(&mut picture.packets);
        let Picture {
            image,
            mesh,
            packets,
            light,
            ..
        } = &picture;
        let per_packet = config.rays_per_packet as usize;
        let caster = Caster::new(image, config.triangle_test, per_packet);
        let hits = caster.cast_packets(&rays_of(packets)).hits;
        let kinds = RayKind::ALL.map(|kind| {
            let packets = kind.rays(packets, &hits, mesh, *light, SEED)?;
            Ok((kind, rays_of(&packets)))
        });
        let kinds = kinds.into_iter().collect::<Result<_>>()?;
        Ok(Rays {
            picture,
            size,
            kinds,
        })
    }
}

/// Casts the rays of all kinds.
fn cast_all(
    chip: &mut Chip,
    config: &Config,
    rays: &Rays,
    progress: &dyn Fn(&str),
) -> Result<Vec<ChipFigures>> {
    let Rays {
        picture,
        size,
        kinds,
    } = rays;
    let all = kinds.iter().map(|(kind, rays)| {
        let (nodes_kib, memory) = (config.cache_nodes_kib, config.memory_model.name());
        let name = kind.name();
        progress(&format!(
            "casting {name} rays of {} at {size} in the chip: {nodes_kib} KiB for nodes, {memory}",
            SCENE.0
        ));
        let Still {
            mut memory, list, ..
        } = still(config, Builder::new(BASE, MOST_BYTES), &picture.image, rays)?;
        let report = chip.run(&mut memory, list, &|_| ())?;
        report.outcome.check()?;
        ensure!(report.checked > 0, "nothing was checked");
        let hit_rate = |cache: &str| {
            let of = |what: &str| report.counter(&format!("{cache}_{what}")) as f64;
            rounded(of("hits") / of("requests").max(1.0))
        };
        Ok(ChipFigures {
            scene: SCENE.0.into(),
            view: picture.view.into(),
            size: (*size).into(),
            ray_kind: name.into(),
            memory: config.memory_model.name().into(),
            nodes_kib,
            records_kib: config.cache_records_kib,
            vertices_kib: config.cache_vertices_kib,
            rays: rays.iter().filter(|ray| ray.active).count() as u64,
            hits: report.outcome.hits,
            cycles: report.counter("cast_cycles"),
            bytes_read: report.traffic.bytes_read,
            bytes_written: report.traffic.bytes_written,
            node_hit_rate: hit_rate("node"),
            record_hit_rate: hit_rate("record"),
            vertex_hit_rate: hit_rate("vertex"),
        })
    });
    all.collect()
}
