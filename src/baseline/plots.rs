//! Plots of a baseline, as SVG.

use super::{Baseline, ChipFigures, Depth, FrameFigures};
use crate::scene::RayKind;
use anyhow::{Context, Result, anyhow, ensure};
use plotters::coord::Shift;
use plotters::prelude::*;

const SIZE: (u32, u32) = (860, 440);

/// Colours that also differ in lightness.
const COLOURS: [RGBColor; 5] = [
    RGBColor(31, 90, 166),
    RGBColor(214, 110, 30),
    RGBColor(44, 140, 80),
    RGBColor(150, 60, 140),
    RGBColor(110, 110, 110),
];

const LABEL: (&str, u32) = ("sans-serif", 13);
const CAPTION: (&str, u32) = ("sans-serif", 16);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn svg(draw: impl FnOnce(&Area<'_>) -> Result<()>) -> Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(fault)?;
        draw(&area)?;
        area.present().map_err(fault)?;
    }
    text.push('\n');
    Ok(text)
}

fn fault(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("cannot draw a plot: {error}")
}

/// Minimum LUT4 of a module in the plot.
const LEAST_LUT4: u64 = 1000;

/// LUT4 of the larger modules, in descending order.
pub(super) fn area_by_unit(baseline: &Baseline) -> Result<String> {
    let large = (baseline.area.iter()).filter(|unit| unit.area.lut4 >= LEAST_LUT4);
    let mut units: Vec<(&str, u64)> = large.map(|unit| (&*unit.name, unit.area.lut4)).collect();
    units.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
    let most = units.first().context("the baseline has no area")?.1 as f64 / 1000.0;
    let rows = units.len();
    svg(|area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .caption("LUT4 per module, including everything below it", CAPTION)
            .x_label_area_size(36)
            .y_label_area_size(150)
            .build_cartesian_2d(0.0..most * 1.1, (0..rows).into_segmented())
            .map_err(fault)?;
        let name = |at: &SegmentValue<usize>| match at {
            SegmentValue::CenterOf(row) => units.get(*row).map_or("", |unit| unit.0).to_string(),
            _ => String::new(),
        };
        chart
            .configure_mesh()
            .disable_y_mesh()
            .y_labels(rows + 1)
            .y_label_formatter(&name)
            .x_desc("1,000 LUT4 of a Virtex-4")
            .label_style(LABEL)
            .draw()
            .map_err(fault)?;
        let bars = units.iter().enumerate().map(|(row, (_, lut4))| {
            let corners = [
                (0.0, SegmentValue::Exact(row)),
                (*lut4 as f64 / 1000.0, SegmentValue::Exact(row + 1)),
            ];
            let mut bar = Rectangle::new(corners, COLOURS[0].filled());
            bar.set_margin(2, 2, 0, 0);
            bar
        });
        chart.draw_series(bars).map_err(fault)?;
        Ok(())
    })
}

/// Clock reached by pipelines of several depths, one line per unit.
pub(super) fn clock_by_depth(baseline: &Baseline) -> Result<String> {
    let depths = &baseline.depths;
    ensure!(!depths.is_empty(), "the baseline has no table of depths");
    let deepest = depths.iter().map(|d| d.depth).max().unwrap_or(1) + 1;
    let fastest = depths.iter().map(|d| d.mhz).fold(0.0, f64::max);
    let mut units: Vec<&str> = vec![];
    for depth in depths {
        if !units.contains(&&*depth.unit) {
            units.push(&depth.unit);
        }
    }
    svg(|area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .caption("Clock reached on an ECP5-85F by pipeline depth", CAPTION)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0u32..deepest, 0.0..fastest * 1.1)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc("pipeline registers from input to output")
            .y_desc("MHz")
            .label_style(LABEL)
            .draw()
            .map_err(fault)?;
        for (unit, colour) in units.into_iter().zip(COLOURS) {
            let of: Vec<&Depth> = depths.iter().filter(|d| d.unit == unit).collect();
            let mut points: Vec<(u32, f64)> = of.iter().map(|d| (d.depth, d.mhz)).collect();
            points.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            points.dedup();
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(3))
                .map_err(fault)?
                .label(unit)
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(3))
                });
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(LABEL)
            .draw()
            .map_err(fault)
    })
}

/// Hit rates of the caches by their size: a colour per cache, and a line per kind of rays, the widest for primary rays.
pub(super) fn hit_rates(baseline: &Baseline) -> Result<String> {
    let runs = &baseline.chip_caches;
    ensure!(!runs.is_empty(), "the baseline has no table of caches");
    let sizes = || runs.iter().map(|run| run.nodes_kib);
    let least = sizes().min().unwrap_or(1).ilog2();
    let most = sizes().max().unwrap_or(1).ilog2();
    type Rate = fn(&ChipFigures) -> f64;
    let caches: [(&str, Rate); 3] = [
        ("nodes", |run| run.node_hit_rate),
        ("records", |run| run.record_hit_rate),
        ("vertices", |run| run.vertex_hit_rate),
    ];
    svg(|area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .caption("Hit rate by the size of the cache", CAPTION)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(f64::from(least)..f64::from(most), 0.0..100.0)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_labels((most - least + 1) as usize)
            .x_label_formatter(&|power| format!("{}", 1u32 << power.round() as u32))
            .x_desc("KiB")
            .y_desc("% hits")
            .label_style(LABEL)
            .draw()
            .map_err(fault)?;
        for ((cache, rate), colour) in caches.into_iter().zip(COLOURS) {
            for (kind, width) in RayKind::ALL.into_iter().zip([3, 2, 1]) {
                let of = runs.iter().filter(|run| run.ray_kind == kind.name());
                let points = of.map(|run| (f64::from(run.nodes_kib.ilog2()), 100.0 * rate(run)));
                let style = colour.stroke_width(width);
                chart
                    .draw_series(LineSeries::new(points, style).point_size(width + 1))
                    .map_err(fault)?
                    .label(format!("{cache}, {} rays", kind.name()))
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(LABEL)
            .draw()
            .map_err(fault)
    })
}

/// Utilisation of the traversal and the geometry unit over the cycles of a frame.
pub(super) fn utilisation(frame: &FrameFigures) -> Result<String> {
    let last = frame.tpu_by_interval.len() as f64 * frame.interval_cycles as f64 / 1000.0;
    svg(|area| {
        let caption = format!(
            "Utilisation over a frame: {} {}, {}",
            frame.scene, frame.view, frame.size
        );
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .caption(caption, CAPTION)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..last, 0.0..1.05)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc("thousands of cycles")
            .y_desc("share of the peak")
            .label_style(LABEL)
            .draw()
            .map_err(fault)?;
        let series = [
            ("packet steps per cycle", &frame.tpu_by_interval),
            (
                "slots of the triangle test per cycle",
                &frame.gu_by_interval,
            ),
        ];
        for ((name, values), colour) in series.into_iter().zip(COLOURS) {
            let middle = |at: usize| (at as f64 + 0.5) * frame.interval_cycles as f64 / 1000.0;
            let points = values.iter().enumerate().map(|(at, &v)| (middle(at), v));
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(2)))
                .map_err(fault)?
                .label(name)
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(3))
                });
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::MiddleRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .label_font(LABEL)
            .draw()
            .map_err(fault)
    })
}
