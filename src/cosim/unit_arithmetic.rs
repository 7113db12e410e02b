//! Co-simulation of the floating-point pipelines: compares them with the definition of the arithmetic, for arbitrary operands, all
//! pairs of special operands, and pairs that nearly cancel.

use super::model::{Model, PortHandle, build};
use super::scoreboard::{DISTURBED_CYCLES, UnitOptions, sources_with};
use crate::config::Config;
use crate::float::{Format, plain, specials};
use crate::hdl::{Builder, Design, Module};
use crate::hw::Plan;
use anyhow::{Result, bail, ensure};
use std::sync::Arc;

/// Name of the module that contains all pipelines.
pub const TOP: &str = "arithmetic";

/// Number of ulps by which plane distances are moved.
const SLACK: i32 = 3;

/// A pipeline and its function of the operands, in the order of its inputs.
struct Operation {
    module: Arc<Module>,
    operands: Vec<&'static str>,
    result: &'static str,
    golden: fn(Format, &[u64]) -> u64,
}

fn distance(format: Format, [plane, origin, reciprocal]: [u64; 3], ulps: i32) -> u64 {
    let difference = plain::sub(format, plane, origin);
    plain::step(format, plain::mul(format, difference, reciprocal), ulps)
}

fn operations(plan: &Plan) -> Vec<Operation> {
    let units = &plan.units;
    let operation = |module: &Arc<Module>, operands: &[&'static str], result, golden| Operation {
        module: module.clone(),
        operands: operands.to_vec(),
        result,
        golden,
    };
    let plane = ["plane", "origin", "reciprocal"];
    vec![
        operation(&units.add, &["a", "b"], "y", |f, x| {
            plain::add(f, x[0], x[1])
        }),
        operation(&units.sub, &["a", "b"], "y", |f, x| {
            plain::sub(f, x[0], x[1])
        }),
        operation(&units.mul, &["a", "b"], "y", |f, x| {
            plain::mul(f, x[0], x[1])
        }),
        operation(&units.reciprocal, &["a"], "y", |f, x| {
            plain::reciprocal(f, x[0])
        }),
        operation(&plan.near_distance, &plane, "distance", |f, x| {
            distance(f, [x[0], x[1], x[2]], -SLACK)
        }),
        operation(&plan.far_distance, &plane, "distance", |f, x| {
            distance(f, [x[0], x[1], x[2]], SLACK)
        }),
    ]
}

/// The module that contains all pipelines.
///
/// # Errors
/// If the description has a mistake, which is not known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>> {
    let m = Builder::new(TOP, "the floating-point pipelines, side by side.");
    for operation in operations(plan) {
        let name = operation.module.name();
        let operands = operation.operands.iter();
        let inputs: Vec<_> = operands
            .map(|operand| {
                (
                    *operand,
                    m.input(format!("{name}_{operand}"), plan.format.width()),
                )
            })
            .collect();
        let unit = m.instance(format!("{name}_unit"), &operation.module, &inputs);
        let result = operation.result;
        m.output(format!("{name}_{result}"), unit.get(result));
    }
    Ok(m.finish()?)
}

/// Generates random operands of a format.
struct Operands {
    format: Format,
    specials: Vec<u64>,
    corners: Vec<u64>,
    rng: fastrand::Rng,
}

/// Zeros, infinities, the NaN, ones, the least and the greatest numbers: a set small enough that each pair occurs often.
fn corners(format: Format) -> Vec<u64> {
    let (one, infinity) = (format.one(), format.infinity());
    let magnitudes = [0, 1 << format.fraction_bits(), one, infinity - 1, infinity];
    let signs = [0, format.sign_bit()];
    let numbers = magnitudes.iter().flat_map(|of| signs.map(|sign| of | sign));
    numbers.chain([format.nan()]).collect()
}

impl Operands {
    fn draw(&mut self, count: usize) -> Vec<u64> {
        let width = self.format.width();
        let mask = u64::MAX >> (64 - width);
        let any = |rng: &mut fastrand::Rng| plain::canonical(self.format, rng.u64(..) & mask);
        let kind = self.rng.u32(..5);
        let mut drawn: Vec<u64> = (0..count)
            .map(|_| match kind {
                0 | 1 => any(&mut self.rng),
                2 => self.corners[self.rng.usize(..self.corners.len())],
                _ => self.specials[self.rng.usize(..self.specials.len())],
            })
            .collect();
        if kind == 1 && count > 1 {
            // Close to the first operand or to its negative: sums of a few bits, ties, long carries.
            let near = drawn[0].wrapping_add(self.rng.u64(..9)).wrapping_sub(4);
            let shifted = self.rng.u64(..3) << (self.rng.u32(..=2) * self.format.fraction_bits());
            let sign = self.rng.u64(..2) << (width - 1);
            drawn[1] = plain::canonical(self.format, (near.wrapping_add(shifted) ^ sign) & mask);
        }
        drawn
    }
}

/// Applies one set of operands per cycle to every pipeline, and compares all results.
///
/// # Errors
/// The first result that differs, or an error if a tool is missing.
pub fn run(config: &Config, sets: u64, options: &UnitOptions) -> Result<u64> {
    ensure!(sets > 0, "no operands: nothing would be checked");
    let plan = Plan::new(config)?;
    let design = Design::new(module(&plan)?)?;
    let sources = sources_with(options.mutated.as_ref(), &design);
    let built = build(&sources, &options.build, &|_| ())?;
    let mut model = Model::load(&built, &sources.ports)?;
    model.disturb(options.seed, DISTURBED_CYCLES);
    if let Some(mutated) = &options.mutated {
        mutated.select(&mut model)?;
    }
    let mut operands = Operands {
        format: plan.format,
        specials: specials(plan.format),
        corners: corners(plan.format),
        rng: fastrand::Rng::with_seed(options.seed ^ 0x6f70),
    };
    let mut pipelines = vec![];
    for operation in operations(&plan) {
        let name = operation.module.name().to_string();
        let inputs = (operation.operands.iter())
            .map(|operand| {
                let stage = operation.module.port(operand).and_then(|port| port.stage);
                Ok((
                    model.port(&format!("{name}_{operand}"))?,
                    u64::from(stage.unwrap_or(0)),
                ))
            })
            .collect::<Result<Vec<(PortHandle, u64)>>>()?;
        let output = model.port(&format!("{name}_{}", operation.result))?;
        let latency = u64::from(operation.module.latency().unwrap_or(0));
        let drawn: Vec<Vec<u64>> = vec![];
        pipelines.push((operation, name, inputs, output, latency, drawn));
    }
    let longest = pipelines.iter().map(|p| p.4).max().unwrap_or(0);
    let mut checked = 0;
    for edge in 0..sets + longest {
        for (operation, _, inputs, _, _, drawn) in &mut pipelines {
            drawn.push(operands.draw(operation.operands.len()));
            for (number, &(port, stage)) in inputs.iter().enumerate() {
                if edge >= stage {
                    model.set(port, drawn[(edge - stage) as usize][number]);
                }
            }
        }
        model.clock();
        for (operation, name, _, output, latency, drawn) in &pipelines {
            let Some(set) = (edge + 1).checked_sub(*latency) else {
                continue;
            };
            let set = &drawn[set as usize];
            let golden = (operation.golden)(plan.format, set);
            let rtl = model.get(*output);
            if golden != rtl {
                bail!("mismatch in {name}: of {set:x?} comes {rtl:x}, not {golden:x}");
            }
            checked += 1;
        }
    }
    Ok(checked)
}
