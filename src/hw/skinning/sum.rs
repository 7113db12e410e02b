//! Sum: adds the weighted points of each vertex, with the adders of the geometry unit.

use super::{Around, Mark, Operands, Sums, Weighted};
use crate::hdl::{Pipeline, Signal};
use crate::hw::plan::AXES;

/// The sums of a vertex.
pub(super) struct VertexSums<'b> {
    /// The operands for the adders of the geometry unit.
    pub operands: Sums<Signal<'b>>,
    /// High in the cycle in which the vertex sum is complete.
    pub vertex_done: Signal<'b>,
    // For the properties.
    /// Whether a vertex is being summed, for each stage until its end.
    pub summing: Vec<Signal<'b>>,
}

impl<'b> VertexSums<'b> {
    /// Adds up to four weighted points of a vertex: (first + second) + (third + fourth); an absent point is 0. Each sum, of a pair or of
    /// a vertex, is available `latency` cycles after its operands.
    pub fn new(around: &Around<'b>, latency: u32) -> VertexSums<'b> {
        let Around { plan, m, .. } = *around;
        let inputs = &around.inputs;
        m.comment("Accumulation of up to four points: (first + second) + (third + fourth); an absent point is 0.");
        let (p, w) = (m.pipeline(), plan.number());
        let (valid, Weighted { mark, point }) = (inputs.weighted.valid, inputs.weighted.payload);
        let Mark { position, last } = mark;
        let odd = position.bit(0);
        let first_of_pair = (valid & !odd).named("first_of_pair");
        let pair_ends = (valid & (odd | last)).named("pair_ends");
        let ready = p.enter(pair_ends).cleared_by_reset().register();
        let upper = p.enter(position.bit(1)).named("upper_pair").register();
        let complete = p.enter(last).named("completes_vertex").register();
        let start_of_sum = ready.stage();
        let pair = each_axis(|x, i| {
            let first = m.reg(format!("first_{x}"), w);
            first.next_when(first_of_pair, point.axes[i]);
            let other = (first.q & odd.repeat(w)).named(format!("other_{x}"));
            operands(p, point.axes[i], other, 0)
        });
        let at_pair = start_of_sum + latency;
        let pair_done = ready.at(at_pair).untimed().named("pair_done");
        let upper_done = upper.at(at_pair).untimed().named("upper_done");
        let start_of_vertex = at_pair + 1;
        let vertex = each_axis(|x, i| {
            let lower = m.reg(format!("lower_{x}"), w);
            let lower_done = (pair_done & !upper_done).hinted("lower_done");
            lower.next_when(lower_done, inputs.pair_sum[i]);
            let other = (lower.q & upper_done.repeat(w)).named(format!("lower_sum_{x}"));
            operands(p, inputs.pair_sum[i], other, at_pair)
        });
        let vertex_ready = (ready & complete).named("vertex_ready").cleared_by_reset();
        let done_at = start_of_vertex + latency;
        VertexSums {
            operands: Sums { pair, vertex },
            vertex_done: vertex_ready.at(done_at).untimed().named("vertex_done"),
            summing: vertex_ready.stages(start_of_sum..=done_at),
        }
    }
}

/// Calls `of` for each axis, with its name and number.
fn each_axis<'b>(of: impl Fn(&str, usize) -> Operands<Signal<'b>>) -> [Operands<Signal<'b>>; 3] {
    [0, 1, 2].map(|i| of(AXES[i], i))
}

/// The operands of an addition: two numbers at a stage, delayed by one cycle.
fn operands<'b>(p: Pipeline<'b>, a: Signal<'b>, b: Signal<'b>, at: u32) -> Operands<Signal<'b>> {
    let [a, b] = [a, b].map(|number| p.enter_at(number, at).register().untimed());
    Operands { a, b }
}
