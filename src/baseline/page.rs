//! The page of numbers: figures of the original and of DynRT, and the cost of each unit.

mod chip;

use super::{Baseline, FAST, FrameFigures, UnitClock, plots};
use crate::config::{Config, NAMED};
use crate::synth::{Area, Target};
use anyhow::{Context, Result};
use std::fmt::Write as _;

/// The page's file name; its plots are in the same folder.
pub const PAGE: &str = "numbers.md";

/// The page and its plots, by file name. The same baseline gives the same bytes.
///
/// # Errors
/// If the baseline lacks a figure that the page shows.
pub fn files(baseline: &Baseline) -> Result<Vec<(String, String)>> {
    let shown = (baseline.frames.last())
        .context("the baseline has no frame: make one with dynrt baseline --accept")?;
    Ok(vec![
        (PAGE.into(), page(baseline, shown)?),
        ("area.svg".into(), plots::area_by_unit(baseline)?),
        ("caches.svg".into(), plots::hit_rates(baseline)?),
        ("clock.svg".into(), plots::clock_by_depth(baseline)?),
        ("utilisation.svg".into(), plots::utilisation(shown)?),
    ])
}

fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let groups = digits.as_bytes().rchunks(3).rev();
    let groups: Vec<&str> = groups
        .map(|g| std::str::from_utf8(g).expect("digits"))
        .collect();
    groups.join(",")
}

fn percent(part: u64, whole: u64) -> String {
    format!("{:.1} %", part as f64 * 100.0 / whole as f64)
}

/// The area of a module as table columns.
fn area_columns(area: Area) -> String {
    format!(
        "{} | {} | {} | {}",
        grouped(area.lut4),
        grouped(area.ff),
        area.dsp,
        area.ram
    )
}

fn slowest(clocks: &[UnitClock]) -> Option<&UnitClock> {
    clocks.iter().min_by(|a, b| a.mhz.total_cmp(&b.mhz))
}

fn page(baseline: &Baseline, shown: &FrameFigures) -> Result<String> {
    let mut text = String::from(HEAD);
    original_and_ours(&mut text, baseline)?;
    frames(&mut text, baseline);
    units(&mut text, baseline);
    chip::section(&mut text, baseline);
    configurations(&mut text, baseline)?;
    depths(&mut text, baseline);
    let _ = write!(
        text,
        "## Utilisation over a frame\n\n![Utilisation over a frame](utilisation.svg)\n\n\
         `{}` at {}, {} cycles per point. \
         The values are `tpu_by_interval` and `gu_by_interval` in `docs/baseline.json`.\n",
        shown.scene,
        shown.size,
        grouped(shown.interval_cycles)
    );
    Ok(text)
}

const HEAD: &str = "\
# Numbers

`dynrt numbers` generates this page from [`baseline.json`](baseline.json).
`dynrt baseline` measures the figures again and fails if one is worse: `make test` checks the cycles and the area of the smaller modules, `make evidence` checks all figures.
[`baseline.log.md`](baseline.log.md) records every accepted change and its reason.

";

/// The table that compares the original with DynRT.
fn original_and_ours(text: &mut String, baseline: &Baseline) -> Result<()> {
    let device = Target::Virtex4Lx160.holds();
    let config = Config::reference();
    let whole = baseline.area.last().context("no area is known")?.area;
    let film = |name: &str| {
        let films = &baseline.films;
        films
            .iter()
            .find(|film| film.scene.ends_with(name))
            .with_context(|| format!("no film of {name}"))
    };
    let (figure, water) = (film("figure")?, film("water")?);
    let rays = |frame: &FrameFigures| frame.rays as f64 / frame.cycles as f64;
    let least = baseline
        .frames
        .iter()
        .map(rays)
        .fold(f64::INFINITY, f64::min);
    let most = baseline.frames.iter().map(rays).fold(0.0, f64::max);
    let busiest = baseline
        .frames
        .iter()
        .map(|f| f.tpu_utilisation)
        .fold(0.0, f64::max);
    let busiest_gu = (baseline.frames.iter())
        .map(|f| f.gu_utilisation)
        .fold(0.0, f64::max);
    let clocks = figure.skinning_cycles + figure.update_cycles + figure.raycast_cycles;
    let clock = match slowest(&baseline.clock) {
        Some(unit) => format!(
            "{:.0} MHz, the slowest of the {} units (`{}`), ECP5-85F grade 6",
            unit.mhz,
            baseline.clock.len(),
            unit.name
        ),
        None => "not measured".into(),
    };
    let _ = write!(
        text,
        "## The original and DynRT\n\n\
         The figures of the original are from Woop, Marmitt and Slusallek, 2006, for a Virtex-4 LX160.\n\n\
         | figure | original | DynRT | command |\n|---|---|---|---|\n\
         | clock, placed and routed | 66 MHz, Virtex-4 | {clock} | `dynrt baseline --clock` |\n\
         | traversal, packet steps per cycle | 1, peak | {busiest:.3} on a whole frame, peak 1 | `dynrt baseline` |\n\
         | geometry, ray–triangle tests per cycle | about 1, peak | {busiest_gu:.3} on a whole frame, peak 1 | `dynrt baseline` |\n\
         | primary rays per cycle | 0.03–0.12 | {least:.3}–{most:.3} for the frames below | `dynrt baseline` |\n\
         | update, triangles per cycle | 0.24 | {:.3} (`{}`) | `dynrt baseline` |\n\
         | update, instructions per cycle | 1, peak | {:.4}, peak 1 | `dynrt baseline` |\n\
         | skinning, influences per cycle | not published | {:.3} (`{}`), peak 1 | `dynrt baseline` |\n\
         | update, share of a frame | 1–15 % | {} (`{}`, {}) | `dynrt baseline` |\n\
         | update program, bytes per triangle | not published | 5.0 on closed meshes | `dynrt program` |\n\
         | packets in flight × rays | 32 × 4 | {} × {} | [`configs/`](../configs) |\n\
         | LUT4 of an LX160 | not published | {} ({}) | `dynrt synth` |\n\
         | DSP48 | not published | {} ({}) | `dynrt synth` |\n\
         | RAMB16 | not published | {} ({}) | `dynrt synth` |\n\n",
        water.triangles as f64 / water.update_cycles as f64,
        water.scene,
        water.instructions as f64 / water.update_cycles as f64,
        figure.influences as f64 / figure.skinning_cycles as f64,
        figure.scene,
        percent(figure.update_cycles, clocks),
        figure.scene,
        figure.size,
        config.packets_in_flight,
        config.rays_per_packet,
        grouped(whole.lut4),
        percent(whole.lut4, device.lut4),
        whole.dsp,
        percent(whole.dsp, device.dsp),
        whole.ram,
        percent(whole.ram, device.ram),
    );
    Ok(())
}

fn frames(text: &mut String, baseline: &Baseline) {
    *text += "## Cycles of frames and films\n\n`cargo test --test tools baseline::` fails if one of these cycle counts changes.\nAll results of these runs equal those of the golden model in all bits.\n\n\
              | machine | frame | rays | cycles | packet steps | ray–triangle tests | rays per cycle | TPU | GU |\n|---|---|---|---|---|---|---|---|---|\n";
    let machines = [baseline.machine.as_str(), FAST];
    for (machine, frames) in std::iter::zip(machines, [&baseline.frames, &baseline.fast_frames]) {
        for frame in frames {
            let _ = writeln!(
                text,
                "| {machine} | `{}` {}, {} | {} | {} | {} | {} | {:.3} | {:.3} | {:.3} |",
                frame.scene,
                frame.view,
                frame.size,
                grouped(frame.rays),
                grouped(frame.cycles),
                grouped(frame.packet_steps),
                grouped(frame.ray_triangle_tests),
                frame.rays as f64 / frame.cycles as f64,
                frame.tpu_utilisation,
                frame.gu_utilisation,
            );
        }
    }
    *text += "\n| machine | film | frames | skinning, cycles | influences | update, cycles | instructions | triangles | ray casting, cycles |\n|---|---|---|---|---|---|---|---|---|\n";
    for (machine, films) in std::iter::zip(machines, [&baseline.films, &baseline.fast_films]) {
        for film in films {
            let _ = writeln!(
                text,
                "| {machine} | `{}` {} | {} | {} | {} | {} | {} | {} | {} |",
                film.scene,
                film.size,
                film.frames,
                grouped(film.skinning_cycles),
                grouped(film.influences),
                grouped(film.update_cycles),
                grouped(film.instructions),
                grouped(film.triangles),
                grouped(film.raycast_cycles),
            );
        }
    }
    text.push('\n');
}

fn units(text: &mut String, baseline: &Baseline) {
    let _ = write!(
        text,
        "## Area and clock by module\n\n![Area by module](area.svg)\n\n\
         Each module is synthesised alone, with everything below it.\n\
         The area is for a Virtex-4 LX160, by {} (`dynrt synth`).\n\
         MHz and slowest path are given for the {} units that make up the machine without its glue logic.\n\
         They are for an ECP5-85F, speed grade 6, the worst of {} seeds, by {} (`dynrt synth --target ecp5-85f --unit NAME --route --seeds {}`).\n\
         The whole machine with its self-test has more logic and more wires, and reaches 55 MHz \
         (see [synthesis](synthesis.md#from-verilog-to-a-bitstream)).\n\n\
         | module | LUT4 | FF | DSP48 | RAMB16 | MHz | slowest path |\n|---|---|---|---|---|---|---|\n",
        baseline.area_tools.join(", "),
        baseline.clock.len(),
        super::SEEDS,
        baseline.clock_tools.join(", "),
        super::SEEDS,
    );
    for unit in &baseline.area {
        let clock = baseline.clock.iter().find(|clock| clock.name == unit.name);
        let (mhz, path) = clock.map_or(("–".into(), "–".into()), |clock| {
            (
                format!("{:.1}", clock.mhz),
                format!("`{}`", clock.critical_path),
            )
        });
        let _ = writeln!(
            text,
            "| `{}` | {} | {mhz} | {path} |",
            unit.name,
            area_columns(unit.area)
        );
    }
    text.push('\n');
}

fn configurations(text: &mut String, baseline: &Baseline) -> Result<()> {
    let device = Target::Virtex4Lx160.holds();
    *text += "## Configurations\n\n\
              | configuration | parameters | clock target | LUT4 | FF | DSP48 | RAMB16 | LUT4 share of an LX160 | slowest unit on an ECP5-85F | verified by |\n|---|---|---|---|---|---|---|---|---|---|\n";
    for &(name, _) in NAMED {
        let config = Config::load(name)?;
        let known = baseline.configurations.iter().find(|c| c.name == name);
        let area = known.map_or("– | – | – | –".into(), |known| {
            area_columns(known.area)
        });
        let share = known.map_or("–".into(), |known| percent(known.area.lut4, device.lut4));
        let clocks: &[UnitClock] = match name {
            _ if name == baseline.machine => &baseline.clock,
            FAST => &baseline.fast_clock,
            _ => &[],
        };
        let clock = slowest(clocks).map_or("–".into(), |unit| {
            format!("{:.1} MHz (`{}`)", unit.mhz, unit.name)
        });
        let verified = match name == baseline.machine {
            true => "all tests, proofs and mutants",
            false => "`cargo test --test machine machines::`: lint, units and a scene in all bits",
        };
        let _ = writeln!(
            text,
            "| {name} | {} × {} packets, {:?}, {} per node | {} MHz | {area} | {share} | {clock} | {verified} |",
            config.rays_per_packet,
            config.packets_in_flight,
            config.triangle_test,
            match config.axes_per_node {
                1 => "1 axis".to_string(),
                axes => format!("{axes} axes"),
            },
            config.clock_mhz,
        );
    }
    *text += "\n`dynrt synth --config NAME` measures the area; `dynrt baseline --clock` measures the clock of the units listed above.\n\n";
    Ok(())
}

fn depths(text: &mut String, baseline: &Baseline) {
    *text += "## Depth, area and clock by clock target\n\n![Clock by depth](clock.svg)\n\n\
              `dynrt synth --route --clocks 50,66,75,100,125,150 --unit UNIT` measures these figures for an ECP5-85F, speed grade 6, with one seed.\n\
              A column is a clock target; an entry has the pipeline depth in cycles, then LUT4 / flip-flops, and the clock reached in MHz.\n\n";
    let mut clocks: Vec<u32> = baseline.depths.iter().map(|d| d.asked_mhz).collect();
    clocks.sort_unstable();
    clocks.dedup();
    let mut units: Vec<&str> = vec![];
    for depth in &baseline.depths {
        if !units.contains(&&*depth.unit) {
            units.push(&depth.unit);
        }
    }
    *text += "| unit |";
    for clock in &clocks {
        let _ = write!(text, " {clock} MHz |");
    }
    *text += "\n|---|";
    *text += &"---|".repeat(clocks.len());
    text.push('\n');
    for unit in units {
        let _ = write!(text, "| `{unit}` |");
        for clock in &clocks {
            let at = |d: &&super::Depth| d.unit == unit && d.asked_mhz == *clock;
            let _ = match baseline.depths.iter().find(at) {
                Some(d) => write!(
                    text,
                    " {}: {} / {}, {:.0} |",
                    d.depth,
                    grouped(d.area.lut4),
                    grouped(d.area.ff),
                    d.mhz
                ),
                None => write!(text, " – |"),
            };
        }
        text.push('\n');
    }
    text.push('\n');
}
