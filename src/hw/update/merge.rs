//! Merge: the union of two boxes, or of three vertices (each a degenerate box).

use super::execute::Execute;
use super::fetch::Vertices;
use super::{Around, Instruction, box_bits, vertex_bits};
use crate::bkd::layout::fields;
use crate::hdl::{Builder, Memory, Signal, Signals, Specs, Style};
use crate::hw::fp::{Knowing, Known, is_nan, less};
use crate::hw::plan::{AXES, Plan};

/// The operands of a merge, at one stage.
pub(super) struct Operands<'b> {
    pub first: fields::Box<Signal<'b>>,
    pub second: fields::Box<Signal<'b>>,
    /// The third vertex of a leaf.
    third: [Signal<'b>; 3],
    of_leaf: Signal<'b>,
    box_registers: Memory<'b>,
}

impl<'b> Operands<'b> {
    /// Writes the vertex of a load to its register, and reads the operands of the current instruction: three vertices for a leaf, two
    /// boxes for other instructions.
    pub fn read(
        &Around { plan, m, p, .. }: &Around<'b>,
        execute: &Execute<'b>,
        vertices: &Vertices<'b>,
    ) -> Operands<'b> {
        m.comment(
            "The registers. A load is written when it is issued; the next instruction can read it.",
        );
        let (config, f) = (&plan.config, plan.format);
        let (of_vertex, of_box) = (fields::Vertex::of(f), fields::Box::of(f));
        let block = |name, registers, width| m.memory(name, registers, width, Style::Block);
        let registers = config.update_vertex_registers;
        let vertex_registers = block("vertex_registers", registers, of_vertex.width());
        let Instruction { x, y, z, leaf, .. } = execute.current;
        let vertex_number = |of: Signal<'b>| of.low(vertex_bits(plan));
        let vertex = vertices.reader.front;
        vertex_registers.write(execute.load_goes, vertex_number(x), vertex);
        let vertices = [x, y, z].map(|of| read(plan, vertex_registers, p.enter(vertex_number(of))));
        let registers = config.update_box_registers;
        let box_registers = block("box_registers", registers, of_box.width());
        let boxes = [x, y].map(|of| p.enter(of.low(box_bits(plan))));
        let boxes = boxes.map(|number| of_box.unpack(read(plan, box_registers, number)));

        let of_leaf = p.enter(leaf).named("of_leaf");
        let [first, second, third] = vertices.map(|word| of_vertex.unpack(word).position);
        let operand = |position, bounds, name: &str| {
            let [lo, hi] = [position; 2];
            let point = fields::Box { lo, hi };
            of_leaf.choose(point, bounds).named(name).register()
        };
        let mut axes = AXES.iter();
        Operands {
            first: operand(first, boxes[0], "first"),
            second: operand(second, boxes[1], "second"),
            third: third.map(|number| {
                let axis = axes.next().expect("three axes");
                number.named(format!("third_{axis}")).register()
            }),
            of_leaf,
            box_registers,
        }
    }

    /// The stage of the operands.
    pub fn stage(&self) -> u32 {
        self.first.lo[0].stage()
    }
}

/// The merge in progress.
pub(super) struct Merge<'b> {
    /// Whether a merge is in the pipeline, from stage 0 on.
    pub goes: Signal<'b>,
    /// The stage at which the box is written to its register.
    pub written: u32,
}

impl<'b> Merge<'b> {
    /// Merges the operands of the issued instruction, and writes the box to its target register. A NaN loses against any number.
    pub fn new(
        &Around { plan, m, p, .. }: &Around<'b>,
        execute: &Execute<'b>,
        operands: &Operands<'b>,
    ) -> Merge<'b> {
        m.comment("Merge of two boxes, or of three vertices (each a degenerate box). A NaN loses against any number.");
        // The state after a reset is overwritten before the first merge of an update.
        let goes = p.enter(execute.merge_goes);
        let target = p.enter(execute.current.target).named("merge_target");
        let bounds = |least| [0, 1, 2].map(|axis| bound(plan, m, operands, least, axis));
        let [lo, hi] = [true, false].map(bounds);
        let merged = fields::Box { lo, hi };
        let merged = fields::Box::of(plan.format).pack(merged);
        let written = merged.stage();
        operands.box_registers.write(
            goes.at(written).untimed(),
            target.at(written).untimed(),
            merged.untimed(),
        );
        Merge { goes, written }
    }
}

/// One of the six numbers of the merged box: the least or the greatest of two or three numbers. If all of them are NaN, it is an
/// infinity such that the interval is empty.
fn bound<'b>(
    plan: &Plan,
    m: &'b Builder,
    operands: &Operands<'b>,
    least: bool,
    axis: usize,
) -> Signal<'b> {
    let (f, of_leaf, axis_name) = (plan.format, operands.of_leaf, AXES[axis]);
    let (end_name, [first, second]) = match least {
        true => ("lo", [operands.first.lo, operands.second.lo]),
        false => ("hi", [operands.first.hi, operands.second.hi]),
    };
    let [first, second, third] = [first, second, operands.third].map(|of| of[axis]);
    let name = |of: &str| format!("{of}_{end_name}_{axis_name}");
    let beats = |who: &str, challenger: Signal<'b>, holder: Signal<'b>| {
        // The check for a NaN bound is parallel to the comparison.
        let (x, bound) = (challenger.known(Known::Nothing), holder.known(Known::NoNan));
        let (a, b) = if least { (x, bound) } else { (bound, x) };
        less(f, name(&format!("{who}_beats")), a, b)
    };
    let [nan_1, nan_2, nan_3] = [first, second, third].map(|x| is_nan(f, x));
    let nan_1 = nan_1.named(name("nan_first"));
    let nan_2 = nan_2.named(name("nan_second"));
    let nan_3 = nan_3.named(format!("nan_third_{axis_name}"));
    let two = beats("second", second, first) | (nan_1 & !nan_2);
    let two = split_comparison(plan, two.named(name("take_second")));
    let best = two.mux(second, first).named(name("best")).register();
    let none = (nan_1 & nan_2).named(name("nan_both")).register();
    let only_third = (none & !nan_3).hinted(name("only_third"));
    let beats_two = beats("third", third, best) | only_third;
    let three = of_leaf & beats_two.hinted(name("third_is_better"));
    let three = split_comparison(plan, three.named(name("take_third")));
    let nothing = match least {
        true => plan.infinity(m),
        false => plan.minus_infinity(m),
    };
    let all_nan = (none & nan_3).hinted(name("nan_all"));
    let bound = all_nan.mux(nothing, three.mux(third, best));
    plan.settle(bound.named(name("merged")))
}

/// The content of a register, one or two cycles later.
fn read<'b>(plan: &Plan, registers: Memory<'b>, number: Signal<'b>) -> Signal<'b> {
    let word = registers.read(number);
    if plan.timing.merge_register {
        word.register()
    } else {
        word
    }
}

/// Adds a register between a comparison and the multiplexer that it controls, if the target clock requires it.
fn split_comparison<'b>(plan: &Plan, choice: Signal<'b>) -> Signal<'b> {
    if plan.timing.merge_comparison {
        choice.register()
    } else {
        choice
    }
}
