//! Balancing of pipelines.

use super::simulation::Verilated;
use dynrt_hdl::{Builder, Module, Signal, named};
use std::sync::Arc;

#[test]
fn operands_are_aligned_and_latencies_add_up() {
    let m = Builder::new("aligned", "sums.");
    let p = m.pipeline();
    let (a, b) = (p.input("a", 8), p.input("b", 8));
    assert_eq!(a.staged(), Some(0));
    let late = a.delay(3);
    assert_eq!((late + b).staged(), Some(3));
    assert_eq!(b.mux_stage(late), Some(3));
    assert_eq!(m.concat(&[a, b.delay(2), late]).staged(), Some(3));
    assert_eq!(late.at(5).staged(), Some(5));
    assert_eq!(late.at(3).staged(), Some(3));
    // Literals can be combined with any stage and are never delayed.
    let five = m.lit(5u8, 8);
    assert_eq!((late + five).staged(), Some(3));
    assert_eq!((five + a).staged(), Some(0));
    assert_eq!((five.delay(9) + five).staged(), None);
    assert_eq!(five.at(7).staged(), None);
    // A signal outside pipelines can be used in one at any stage, and a signal of a pipeline can be used outside.
    let outside = m.input("outside", 8);
    assert_eq!((late + p.enter_at(outside, 3)).staged(), Some(3));
    assert_eq!((late + p.enter(outside)).staged(), Some(3));
    assert_eq!((late.untimed() + outside).staged(), None);
    m.output("y", late + b);
    m.output("z", b);
    let module = m.finish().unwrap();
    assert_eq!(module.port("y").unwrap().stage, Some(3));
    assert_eq!(module.port("z").unwrap().stage, Some(0));
    assert_eq!(module.latency(), None, "the outputs differ in theirs");
}

trait MuxStage {
    fn mux_stage(self, late: Self) -> Option<u32>;
}

impl MuxStage for Signal<'_> {
    fn mux_stage(self, late: Self) -> Option<u32> {
        self.bit(0).mux(self, late).staged()
    }
}

/// y = a * b + c, with c at stage 2; `next` is 1 if y belongs to valid inputs.
pub fn multiply_add() -> Arc<Module> {
    let m = Builder::new("multiply_add", "y = a * b + c.");
    let p = m.pipeline();
    m.group("Factors");
    let (a, b) = (p.input("a", 8), p.input("b", 8));
    let valid = p.valid_input("valid");
    m.group("What is added, two clocks after the factors");
    let c = p.input_at("c", 16, 2);
    m.group("Result");
    named! {
        let product = a.mul(b);
        let sum = product.delay(2) + c;
    }
    m.output("y", sum.register());
    m.output("y_valid", valid.at(3));
    m.finish().unwrap()
}

/// (a * b + c) * d + e, with all inputs at stage 0, and their tag.
pub fn horner() -> Arc<Module> {
    let m = Builder::new("horner", "y = (a * b + c) * d + e.");
    let p = m.pipeline();
    let [a, b, d] = ["a", "b", "d"].map(|name| p.input(name, 8));
    let [c, e] = ["c", "e"].map(|name| p.input(name, 16));
    let (tag, valid) = (p.input("tag", 5), p.valid_input("valid"));
    let inputs = [("a", a), ("b", b), ("c", c), ("valid", valid)];
    let first = m.instance("first", &multiply_add(), &inputs);
    let inner = first.get("y");
    assert_eq!(inner.staged(), Some(3));
    let inputs = [
        ("a", inner.low(8)),
        ("b", d),
        ("c", e),
        ("valid", first.get("y_valid")),
    ];
    let second = m.instance("second", &multiply_add(), &inputs);
    let y = second.get("y");
    assert_eq!(y.staged(), Some(6));
    m.output("y", y);
    m.output("valid_out", second.get("y_valid"));
    m.output("tag_out", tag.at(y.stage()));
    m.finish().unwrap()
}

#[test]
fn nested_pipelines_balance() {
    let module = horner();
    assert_eq!(module.latency(), Some(6));
    assert_eq!(multiply_add().latency(), Some(3));
    let mut model = Verilated::new(module);
    let mut rng = fastrand::Rng::with_seed(7);
    model.set("rst", 1);
    for _ in 0..3 {
        model.set("valid", 1);
        model.clock();
    }
    model.set("rst", 0);
    let mut sent: Vec<[u64; 7]> = vec![];
    let mut checked = 0;
    for _ in 0..2000 {
        let names = ["a", "b", "c", "d", "e", "tag", "valid"];
        let inputs = [8, 8, 16, 8, 16, 5, 1].map(|bits| rng.u64(..1 << bits));
        for (name, value) in names.iter().zip(inputs) {
            model.set(name, value);
        }
        sent.push(inputs);
        model.clock();
        let Some(entered) = sent.len().checked_sub(6) else {
            // Results of inputs before and during reset are not valid.
            assert_eq!(model.get("valid_out"), 0);
            continue;
        };
        let [a, b, c, d, e, tag, valid] = sent[entered];
        let inner = (a * b + c) & 0xff;
        assert_eq!(model.get("y"), (inner * d + e) & 0xffff);
        assert_eq!(model.get("tag_out"), tag);
        assert_eq!(model.get("valid_out"), valid);
        checked += 1;
    }
    assert_eq!(checked, 1995);
}

#[test]
fn reset_clears_a_valid_chain_and_nothing_else() {
    let text = multiply_add().verilog().to_string();
    for n in 1..=2 {
        assert!(text.contains(&format!("if (rst) valid_s{n} <= 1'b0; else valid_s{n} <= ")));
    }
    assert!(text.contains("if (rst) y_valid <= 1'b0; else y_valid <= valid_s2;"));
    assert_eq!(text.matches("if (rst)").count(), 3);

    let m = Builder::new("long_chain", "delays.");
    let p = m.pipeline();
    let (valid, data) = (p.valid_input("valid"), p.input("data", 8));
    m.output("valid_out", valid.delay(9));
    m.output("data_out", data.delay(9));
    let module = m.finish().unwrap();
    let text = module.verilog();
    assert!(
        text.contains(
            "if (rst) valid_delay <= 9'd0; else valid_delay <= {valid_delay[7:0], valid};"
        )
    );
    assert_eq!(text.matches("if (rst)").count(), 1);
    assert_eq!(module.latency(), Some(9));
}

#[test]
fn equal_delays_are_one() {
    let m = Builder::new("shared", "delays the same thing in several ways.");
    let p = m.pipeline();
    let x = p.input("x", 8);
    let first = (x + p.enter(x.untimed())).register();
    let second = p.enter(x.untimed() + x.untimed()).register();
    m.output("y", first ^ x.register());
    m.output("z", second & x.register());
    m.output("low", x.low(4).register());
    let module = m.finish().unwrap();
    let text = module.verilog();
    let registers = text.lines().filter(|l| l.contains("<=")).count();
    assert_eq!(registers, 2, "x + x and x, of which low is a part:\n{text}");
}
