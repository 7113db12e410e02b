//! `dynrt compare`: the project's software beside Embree 3.

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
Both sides get the same mesh, rounded to the machine's numbers, and the same rays, and take turns in one process. Embree 3 runs
in robust mode (Debian: apt-get install libembree-dev, and a C compiler, since benches/embree.c is compiled at each start).

The hits are the golden model's, which are the machine's bit for bit. A ray that sees another triangle must pass within ε of an edge,
or meet both triangles equally far within ε, ε being 32 rounding errors of numbers as great as distances in the scene; at most one
ray in 1000 may differ at all. Otherwise the exit status is 1. The same is done with the vertices moved and both trees refitted.

Times are of this project's software, not of the hardware it emits: the tree's builder, its refit, the golden model.

In the picture a frame around a ray that differs is blue where triangles are equally far, orange near an edge, and magenta where
nothing explains it.

Examples:
  dynrt compare builtin:interior --view inside
  dynrt compare model.obj --view outside --out differences.png --json model.json";

/// Compare build, refit, casting and hits with Embree 3, in one run on the same mesh and rays
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
    /// How many times everything is measured; times are medians
    #[arg(long, value_name = "N", default_value_t = compare::ROUNDS, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// The picture with the rays marked that see another triangle, as PNG
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    out: Option<Output>,
    /// The figures, as JSON
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
    row("hit something", |a| a.account.hits);
    row("see another triangle", |a| a.account.different());
    row("  equally far", |a| a.account.same_distance);
    row("  near an edge", |a| a.account.near_edge);
    row("    nothing in the machine", |a| a.account.lost);
    row("  unexplained", |a| a.account.unexplained);
    row("  f64 as the machine", |a| a.machine_exact);
    row("  f64 as Embree", |a| a.embree_exact);
    let _ = writeln!(
        text,
        "Embree's own packets of 4 see another triangle than its single rays in {}",
        counted(found.embree_differs_by_four as u64, "ray")
    );
    text
}

/// Milliseconds of both sides.
fn times(timing: &Timing) -> [String; 2] {
    [timing.ours(), timing.embree()].map(|seconds| format!("{:.2} ms", seconds * 1e3))
}

/// Millions of rays a second of both sides.
fn rates(timing: &Timing) -> [String; 2] {
    [timing.ours(), timing.embree()]
        .map(|seconds| format!("{:.2} M/s", timing.work as f64 / seconds / 1e6))
}
