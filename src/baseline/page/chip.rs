//! The section of the page that is about the chip.

use super::{area_columns, grouped, percent};
use crate::baseline::{Baseline, ChipFigures};
use crate::scene::RayKind;
use crate::synth::Target;
use std::fmt::Write as _;

fn rays_per_cycle(run: &ChipFigures) -> f64 {
    run.rays as f64 / run.cycles as f64
}

/// Area by block, rays per cycle by memory, hit rates by the size of the caches.
pub fn section(text: &mut String, baseline: &Baseline) {
    *text += "## The chip\n\n";
    area(text, baseline);
    frames(text, baseline);
    memories(text, baseline);
    caches(text, baseline);
}

fn area(text: &mut String, baseline: &Baseline) {
    let Some(whole) = baseline.chip_area.last() else {
        return;
    };
    let holds = Target::Virtex4Lx160.holds();
    let _ = write!(
        text,
        "The whole chip, core and caches included, takes {} LUT4 ({} of an LX160), {} DSP48 ({}) and {} RAMB16 ({}).\n\
         `dynrt synth --top chip` measures the modules around the core, each with everything below it:\n\n\
         | module | LUT4 | FF | DSP48 | RAMB16 |\n|---|---|---|---|---|\n",
        grouped(whole.area.lut4),
        percent(whole.area.lut4, holds.lut4),
        whole.area.dsp,
        percent(whole.area.dsp, holds.dsp),
        whole.area.ram,
        percent(whole.area.ram, holds.ram),
    );
    for unit in &baseline.chip_area {
        let _ = writeln!(text, "| `{}` | {} |", unit.name, area_columns(unit.area));
    }
    text.push('\n');
}

fn frames(text: &mut String, baseline: &Baseline) {
    let Some(first) = baseline.chip_frames.first() else {
        return;
    };
    let _ = write!(
        text,
        "`make test` casts these pictures of `{}` {} at {} in the chip, behind `{}`, and fails if a figure changes:\n\n\
         | rays | active rays | hits | cycles | rays per cycle | bytes per ray |\n|---|---|---|---|---|---|\n",
        first.scene, first.view, first.size, first.memory,
    );
    for run in &baseline.chip_frames {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {:.4} | {:.1} |",
            run.ray_kind,
            grouped(run.rays),
            grouped(run.hits),
            grouped(run.cycles),
            rays_per_cycle(run),
            (run.bytes_read + run.bytes_written) as f64 / run.rays as f64,
        );
    }
    text.push('\n');
}

/// The run of a kind of rays among some.
fn of_kind(runs: &[&ChipFigures], kind: RayKind) -> Option<ChipFigures> {
    let run = runs.iter().find(|run| run.ray_kind == kind.name());
    run.map(|run| (*run).clone())
}

fn heading(columns: &[String]) -> String {
    let line = "|---".repeat(columns.len());
    format!("| {} |\n{line}|\n", columns.join(" | "))
}

fn memories(text: &mut String, baseline: &Baseline) {
    let runs = &baseline.chip_memories;
    let Some(first) = runs.first() else { return };
    let _ = write!(
        text,
        "### Memories\n\n\
         Rays per cycle and bytes per ray of `{}` {} at {}, with {}, {} and {} KiB for nodes, records and vertices, by model of memory.\n\
         `dynrt baseline --chip` measures them, and `dynrt run` one at a time.\n\n",
        first.scene, first.view, first.size, first.nodes_kib, first.records_kib, first.vertices_kib,
    );
    let columns = RayKind::ALL.map(|kind| format!("{} rays", kind.name()));
    *text += &heading(&[vec!["memory".to_string()], columns.to_vec()].concat());
    let mut models: Vec<&str> = runs.iter().map(|run| &*run.memory).collect();
    models.dedup();
    for model in models {
        let of: Vec<_> = runs.iter().filter(|run| run.memory == model).collect();
        let _ = write!(text, "| `{model}` |");
        for kind in RayKind::ALL {
            let _ = match of_kind(&of, kind) {
                Some(run) => write!(
                    text,
                    " {:.4}, {:.0} bytes |",
                    rays_per_cycle(&run),
                    (run.bytes_read + run.bytes_written) as f64 / run.rays as f64
                ),
                None => write!(text, " – |"),
            };
        }
        text.push('\n');
    }
    text.push('\n');
}

fn caches(text: &mut String, baseline: &Baseline) {
    let runs = &baseline.chip_caches;
    let Some(first) = runs.first() else { return };
    let _ = write!(
        text,
        "### Sizes of the caches\n\n![Hit rate by size](caches.svg)\n\n\
         Hit rates in percent of the caches of nodes / records / vertices, then rays per cycle, of the same picture behind `{}`.\n\
         All three caches have the size of the row. `dynrt baseline --chip` measures them.\n\n",
        first.memory,
    );
    let columns = RayKind::ALL.map(|kind| format!("{} rays", kind.name()));
    *text += &heading(&[vec!["KiB".to_string()], columns.to_vec()].concat());
    let mut sizes: Vec<u32> = runs.iter().map(|run| run.nodes_kib).collect();
    sizes.dedup();
    for kib in sizes {
        let of: Vec<_> = runs.iter().filter(|run| run.nodes_kib == kib).collect();
        let _ = write!(text, "| {kib} |");
        for kind in RayKind::ALL {
            let _ = match of_kind(&of, kind) {
                Some(run) => write!(
                    text,
                    " {:.1} / {:.1} / {:.1}, {:.4} |",
                    100.0 * run.node_hit_rate,
                    100.0 * run.record_hit_rate,
                    100.0 * run.vertex_hit_rate,
                    rays_per_cycle(&run)
                ),
                None => write!(text, " – |"),
            };
        }
        text.push('\n');
    }
    text.push('\n');
}
