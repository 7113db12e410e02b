//! `dynrt compare`: comparison of the project's software with Embree 3.

use super::files::{Kind, Output};
use super::frame::{Loaded, SIZE, SceneArgs, active};
use super::{ConfigArgs, counted, grouped, print};
use anyhow::{Context, Result};
use dynrt::compare::{self, Agreement, Comparison, Task, Timing};
use dynrt::report;
use dynrt::scene::ImageSize;
use serde_json::{Value, json};
use std::fmt::Write as _;

const HELP: &str = "\
Both sides run alternately in one process on the same mesh, rounded to the machine's number format, and on the same rays. Embree 3
runs in robust mode (Debian: apt-get install libembree-dev and a C compiler, because benches/embree.c is compiled at each start).

The hits are those of the golden model, which equal the machine's in all bits. A ray with different hits must pass within ε of an
edge, or hit both triangles at distances within ε; ε is 32 rounding errors at the magnitude of distances in the scene. At most one
ray in 1000 may differ. Otherwise the exit status is 1. The comparison is repeated with moved vertices and both trees refitted.

The times are those of this project's software (tree builder, refit, golden model), not of the generated hardware.

In the picture each ray with different hits has a frame: blue for equal distances, orange near an edge, magenta for an unexplained
difference.

Examples:
  dynrt compare builtin:interior --view inside
  dynrt compare model.obj --view outside --out differences.png --json model.json";

/// Compare build, refit, ray casting and hits with Embree 3, on the same mesh and rays
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = SIZE)]
    size: ImageSize,
    #[command(flatten)]
    config: ConfigArgs,
    /// Number of measurements; the reported times are medians
    #[arg(long, value_name = "N", default_value_t = compare::ROUNDS, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Write a PNG picture that marks the rays with different hits
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    out: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let loaded = args.scene.load(args.size, &args.config)?;
    let rays = Loaded::rays(&loaded.packets);
    active(&rays)?;
    let bar = report::progress(args.rounds.into(), "rounds");
    let found = compare::run(&loaded.config, &loaded.mesh, &rays, args.rounds, &|done| {
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let found = found.with_context(|| format!("scene {}", loaded.scene.name))?;
    let verdict = found
        .verdict()
        .with_context(|| format!("scene {}", loaded.scene.name));
    let mut text = to_text(args, &loaded, &found);
    let mut files = vec![];
    if let Some(out) = &args.out {
        let Agreement { account, hits, .. } = &found.built;
        let mut picture = report::shade(args.size, &loaded.packets, hits, &loaded.mesh, None);
        compare::mark_differences(&mut picture, &loaded.packets, account);
        files.push(out.png(&picture)?);
        let _ = writeln!(text, "picture: {out}");
    }
    if let Some(json) = &args.json {
        let mut value = to_json(args, &loaded, &found);
        value["agrees"] = verdict.is_ok().into();
        files.push(json.json(&value)?);
    }
    report::publish_all(files)?;
    print(&text)?;
    verdict
}

fn to_json(args: &Args, loaded: &Loaded, found: &Comparison) -> Value {
    let agreement = |agreement: &Agreement| {
        let account = &agreement.account;
        json!({
            "hits": account.hits,
            "different": account.different(),
            "same_distance": account.same_distance,
            "near_edge": account.near_edge,
            "lost": account.lost,
            "unexplained": account.unexplained,
            "f64_as_machine": agreement.machine_exact,
            "f64_as_embree": agreement.embree_exact,
        })
    };
    let timing = |timing: &Timing| {
        let (task, together) = match timing.task {
            Task::Build => ("build", None),
            Task::Refit => ("refit", None),
            Task::Cast { together } => ("cast", Some(together)),
        };
        json!({
            "task": task,
            "rays_together": together,
            "cores": timing.cores,
            "work": timing.work,
            "ours_s": timing.ours(),
            "embree_s": timing.embree(),
            "embree_times_as_fast": timing.ratio(),
            "ours_rounds_s": timing.ours_s,
            "embree_rounds_s": timing.embree_s,
        })
    };
    json!({
        "scene": loaded.scene.name,
        "config": loaded.config.name,
        "overrides": args.config.overrides(&loaded.config),
        "view": loaded.view,
        "width": args.size.width,
        "height": args.size.height,
        "triangles": loaded.mesh.triangles.len(),
        "rays": found.built.account.rays,
        "embree": found.version,
        "cores": found.cores,
        "rounds": found.rounds,
        "built": agreement(&found.built),
        "refitted": agreement(&found.refitted),
        "embree_differs_by_four": found.embree_differs_by_four,
        "timings": found.timings.iter().map(timing).collect::<Vec<_>>(),
    })
}

fn to_text(args: &Args, loaded: &Loaded, found: &Comparison) -> String {
    let rays = found.built.account.rays as u64;
    let mut text = format!(
        "scene {}, {}, configuration {}{}, view {}, {}, {}\n\
         {}; {} a side\n\n\
         {:28} {:>12} {:>12} {:>16}\n",
        loaded.scene.name,
        counted(loaded.mesh.triangles.len() as u64, "triangle"),
        loaded.config.name,
        args.config.settings(),
        loaded.view,
        args.size,
        counted(rays, "ray"),
        counted(found.cores as u64, "core"),
        counted(found.rounds.into(), "measurement"),
        "median",
        "DynRT",
        format!("Embree {}", found.version),
        "Embree is faster",
    );
    for timing in &found.timings {
        let cores = counted(timing.cores as u64, "core");
        let (what, [ours, embree]) = match timing.task {
            Task::Build => (format!("build, {cores}"), times(timing)),
            Task::Refit => (format!("refit, {cores}"), times(timing)),
            Task::Cast { together: 1 } => (format!("single rays, {cores}"), rates(timing)),
            Task::Cast { together } => (format!("packets of {together}, {cores}"), rates(timing)),
        };
        let ratio = format!("{:.2} times", timing.ratio());
        let _ = writeln!(text, "{what:28} {ours:>12} {embree:>12} {ratio:>16}");
    }
    let _ = writeln!(text, "\n{:28} {:>12} {:>12}", "rays", "built", "refitted");
    let both = [&found.built, &found.refitted];
    let mut row = |what: &str, count: fn(&Agreement) -> usize| {
        let [built, refitted] = both.map(|agreement| grouped(count(agreement) as u64));
        let _ = writeln!(text, "{what:28} {built:>12} {refitted:>12}");
    };
    row("with a hit", |a| a.account.hits);
    row("different triangle", |a| a.account.different());
    row("  at equal distance", |a| a.account.same_distance);
    row("  near an edge", |a| a.account.near_edge);
    row("    no hit in the machine", |a| a.account.lost);
    row("  unexplained", |a| a.account.unexplained);
    row("  f64 as the machine", |a| a.machine_exact);
    row("  f64 as Embree", |a| a.embree_exact);
    let _ = writeln!(
        text,
        "Embree's packets of 4 hit a different triangle than its single rays in {}",
        counted(found.embree_differs_by_four as u64, "ray")
    );
    text
}

/// The times of both sides in milliseconds.
fn times(timing: &Timing) -> [String; 2] {
    [timing.ours(), timing.embree()].map(|seconds| format!("{:.2} ms", seconds * 1e3))
}

/// The rates of both sides in millions of rays per second.
fn rates(timing: &Timing) -> [String; 2] {
    [timing.ours(), timing.embree()]
        .map(|seconds| format!("{:.2} M/s", timing.work as f64 / seconds / 1e6))
}
