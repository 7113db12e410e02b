//! Changes of a module: mutants and seeded faults.

use super::mistakes::{follower, mistake, next_line};
use super::simulation::{Verilated, mask, random_module};
use dynrt_hdl::{
    Builder, Design, Direction, HdlError, Kind, Module, Mutation, Select, Style, named,
};
use dynrt_verilated::seed;
use std::sync::Arc;

fn changeable() -> Arc<Module> {
    let m = Builder::new("changeable", "a choice, registers and a memory.");
    let (a, write) = (m.input("a", 4), m.input("write", 1));
    named! {
        let sum = a.bits(3, 1).concat(m.zero(1)) + m.lit(5u8, 4);
        let chosen = (!sum.bit(0)).mux(a.lt(m.lit(3u8, 4)), a.any());
    }
    let kept = m.reg_reset("kept", 4, 2);
    kept.next_when(chosen, sum.register().register());
    let words = m.memory("words", 16, 4, Style::Distributed);
    words.write(write, a, sum);
    let below = m.instance("below", &follower(), &[("x", a & sum)]);
    m.output("b", kept.q);
    m.output("word", words.read_now(kept.q));
    m.output("y", below.get("y"));
    m.finish().unwrap()
}

/// The lines that a change adds, without the wire for unused bits.
fn brought(module: &Module, mutation: &Mutation) -> String {
    let changed = module.with(mutation);
    let changed = changed.unwrap_or_else(|error| panic!("{mutation:?}: {error}"));
    let before: Vec<&str> = module.verilog().lines().collect();
    let after = changed
        .verilog()
        .lines()
        .filter(|line| !before.contains(line));
    let lines = after.filter(|line| !line.contains("unused") && !line.contains("//"));
    lines.map(str::trim).collect::<Vec<_>>().join(" ")
}

#[test]
fn every_kind_of_change_is_found_and_nothing_else() {
    let module = changeable();
    let sites = module.mutations();
    for site in &sites {
        let line = module.verilog().lines().nth(site.line - 1).unwrap();
        assert!(line.contains(&site.before), "{line}: {}", site.before);
        let lines = brought(&module, &site.mutation);
        assert!(
            lines.contains(&site.after) || site.after == "1'b0",
            "{lines}: {}",
            site.after
        );
    }
    let found = |kind: Kind| -> Vec<(&str, &str)> {
        let sites = sites.iter().filter(|site| site.kind == kind);
        sites
            .map(|site| (site.before.as_str(), site.after.as_str()))
            .collect()
    };
    let (sum, chosen) = ("{a[3:1], 1'b0} + 4'd5", "~sum[0] ? (a < 4'd3) : (|a)");
    let operators = [
        (sum, "{a[3:1], 1'b0} - 4'd5"),
        (chosen, "sum[0] ? (a < 4'd3) : (|a)"),
        (chosen, "~sum[0] ? (a <= 4'd3) : (|a)"),
        (chosen, "~sum[0] ? (a < 4'd3) : (&a)"),
        ("a & sum", "a | sum"),
    ];
    let constants = [
        (sum, "{a[3:1], 1'b1} + 4'd5"),
        (sum, "{a[3:1], 1'b0} + 4'd4"),
        (chosen, "~sum[0] ? (a < 4'd2) : (|a)"),
    ];
    let conditions = [
        (chosen, "~(~sum[0]) ? (a < 4'd3) : (|a)"),
        ("write", "1'b0"),
        ("write", "1'b1"),
        ("chosen", "1'b0"),
        ("chosen", "1'b1"),
    ];
    let widths = [
        (sum, "{1'b0, a[2:1], 1'b0} + 4'd5"),
        (sum, "{a[2:0], 1'b0} + 4'd5"),
    ];
    assert_eq!(found(Kind::Operator), operators);
    assert_eq!(found(Kind::Constant), constants);
    assert_eq!(found(Kind::Condition), conditions);
    assert_eq!(found(Kind::Width), widths);
    assert_eq!(found(Kind::Reset), [("rst", "1'b0"), ("4'd2", "4'd3")]);
    assert_eq!(
        found(Kind::Register),
        [("sum_d2", "sum_d1"), ("sum_d1", "sum")]
    );
}

#[test]
fn a_change_is_seen_in_its_place_alone() {
    let module = changeable();
    let signal = |name: &str| module.signal(name).unwrap();
    let [a, sum, chosen, kept] = ["a", "sum", "chosen", "kept"].map(signal);
    let below = module.instances_of("follower")[0];
    let memory = module.memory("words").unwrap();
    let cases = [
        (
            chosen.reads(a).inverted(),
            "wire chosen = ~sum[0] ? (~a < 4'd3) : (|(~a));",
        ),
        (
            chosen.reads(sum).as_signal(a),
            "wire chosen = ~a[0] ? (a < 4'd3) : (|a);",
        ),
        (
            chosen.literal_of(3).as_value(2),
            "wire chosen = ~sum[0] ? (a < 4'd2) : (|a);",
        ),
        // The output of an instance, and the value of two cycles before.
        (
            signal("y").reads(below.output("y").unwrap()).as_value(3),
            "wire [3:0] below_y; .x(a & sum), .y(below_y) assign y = 4'd3;",
        ),
        (
            kept.reads(sum).as_value(7),
            "if (rst) kept <= 4'd2; else if (chosen) kept <= 4'd7;",
        ),
        (
            kept.reads(sum).one_clock_early(),
            "reg  [3:0] sum_d1; if (rst) kept <= 4'd2; else if (chosen) kept <= sum_d1;",
        ),
        (
            kept.reads(sum).one_clock_late(),
            "reg  [3:0] sum_d1, sum_d2, sum_d3; \
             if (rst) kept <= 4'd2; else if (chosen) kept <= sum_d3; sum_d3 <= sum_d2;",
        ),
        // Behind named signals, whose other readers are not affected.
        (
            kept.reads(a).as_value(7),
            "wire [3:0] sum_2 = {3'd3, 1'b0} + 4'd5; \
             if (rst) kept <= 4'd2; else if (~sum_2[0] ? (4'd7 < 4'd3) : (|4'd7)) kept <= sum_d2;",
        ),
        // For all readers.
        (
            sum.fault().inverted(),
            "wire [3:0] sum = ~({a[3:1], 1'b0} + 4'd5);",
        ),
        (
            a.fault().as_value(0),
            "wire [3:0] sum = {3'd0, 1'b0} + 4'd5; wire chosen = ~sum[0] ? (4'd0 < 4'd3) : (|4'd0); \
             if (write) words[4'd0] <= sum; .x(4'd0 & sum), .y(y)",
        ),
        (
            kept.fault().as_signal(a),
            "assign word = words[a]; assign b = a;",
        ),
        (signal("word").fault().as_signal(a), "assign word = a;"),
        // A node that is made later is declared where it is read.
        (
            sum.reads(a).as_signal(kept),
            "wire [3:0] sum = {kept[3:1], 1'b0} + 4'd5;",
        ),
        (
            kept.enable().as_value(1),
            "if (rst) kept <= 4'd2; else if (1'b1) kept <= sum_d2;",
        ),
        (kept.without_reset(), "if (chosen) kept <= sum_d2;"),
        (
            memory.write_enable().inverted(),
            "if (~write) words[a] <= sum;",
        ),
        (
            memory.write_address().as_signal(sum),
            "if (write) words[sum] <= sum;",
        ),
        (below.input("x").unwrap().as_signal(a), ".x(a), .y(y)"),
    ];
    for (mutation, expected) in cases {
        assert_eq!(brought(&module, &mutation), expected, "{mutation:?}");
    }
}

/// Changes of a description are those of the finished module, and mistakes in them are mistakes of the description.
#[test]
fn changes_are_part_of_a_description() {
    let m = Builder::new("described", "a sum.");
    let (a, b) = (m.input("a", 4), m.input("b", 4));
    let sum = (a + b).named("sum");
    let late = m.reg_reset("late", 4, 1);
    late.next(sum);
    m.output("y", late.q);
    let of_signals = [
        sum.reads(b).as_value(0),
        late.q.fault().as_signal(a),
        late.q.without_reset(),
    ];
    let module = m.finish().unwrap();
    let [a, b, sum, late] = ["a", "b", "sum", "late"].map(|name| module.signal(name).unwrap());
    let by_name = [
        sum.reads(b).as_value(0),
        late.fault().as_signal(a),
        late.without_reset(),
    ];
    assert_eq!(of_signals, by_name);

    let not_read = "the signal is not read there";
    mistake(not_read, |m| {
        let (a, b) = (m.input("a", 4), m.input("b", 4));
        let (sum, c) = ((a + b).named("sum"), m.input("c", 4));
        m.output("y", sum ^ c);
        next_line();
        sum.reads(c).as_value(0);
    });
    mistake("16 does not fit in 4 bits", |m| {
        let a = m.input("a", 4);
        m.output("y", !a);
        next_line();
        a.fault().as_value(16);
    });
    mistake("the signal read there is not a pipeline register", |m| {
        let a = m.input("a", 4);
        m.output("y", !a);
        next_line();
        a.fault().one_clock_early();
    });
    mistake(
        "width mismatch: 4 bits are read, the other signal has 2",
        |m| {
            let (a, b) = (m.input("a", 4), m.input("b", 2));
            m.output("y", !a);
            next_line();
            a.fault().as_signal(b);
        },
    );
    mistake("module follower has no input z", |m| {
        let below = m.instance("below", &follower(), &[("x", m.input("a", 4))]);
        m.output("y", below.get("y"));
        next_line();
        below.input("z").inverted();
    });
}

#[test]
fn what_a_change_needs_must_be_there() {
    let module = changeable();
    let design = Design::new(module.clone()).unwrap();
    let has = |error: HdlError, expected: &str| {
        assert_eq!(error.module, "changeable");
        assert_eq!(error.message, expected);
    };
    has(
        module.signal("choosen").unwrap_err(),
        "it has no signal \"choosen\"; similar names: chosen",
    );
    let below = module.instances_of("follower")[0];
    has(
        below.input("y").map(drop).unwrap_err(),
        "instance below has no input \"y\"",
    );
    has(
        design.module("followers").unwrap_err(),
        "the design has no module \"followers\"; similar names: follower",
    );
    let sum = module.signal("sum").unwrap();
    let chosen = module.signal("chosen").unwrap();
    // The signal would depend on itself.
    let looped = module.with(
        &sum.reads(module.signal("a").unwrap())
            .as_signal(below.output("y").unwrap()),
    );
    let message = looped.unwrap_err().message;
    assert!(message.starts_with("combinational loop: "), "{message}");
    assert!(module.with(&chosen.literal_of(3).as_value(3)).is_err());
    let elsewhere = changeable();
    let change = sum.reads(elsewhere.signal("a").unwrap()).inverted();
    has(
        module.with(&change).unwrap_err(),
        "the signal that is read is of another module",
    );
}

/// A design with a change selected by its number behaves like the design with only this change, in every cycle and every bit.
#[test]
fn a_selected_change_is_the_change() {
    const CLOCKS: usize = 1000;
    let mut rng = fastrand::Rng::with_seed(seed::of_run());
    let mut below = vec![];
    for i in 0..8 {
        let pipelined = i % 2 == 1;
        below.push(random_module(
            &format!("below{i}"),
            &mut rng,
            pipelined,
            &[],
        ));
    }
    let top = Builder::new("changed", "modules, side by side.");
    let mut inputs = vec![];
    for (random, i) in below.iter().zip(0..) {
        let of_module: Vec<_> = (random.inputs.iter())
            .map(|(port, width, _)| {
                let name = format!("i{i}_{port}");
                inputs.push((name.clone(), *width));
                (port.as_str(), top.input(name, *width))
            })
            .collect();
        let out = top.instance(format!("the{i}"), &random.module, &of_module);
        for (port, _) in &random.outputs {
            top.output(format!("o{i}_{port}"), out.get(port));
        }
    }
    let top = top.finish().unwrap();
    let design = Design::new(top.clone()).unwrap();
    let mut drawn = vec![];
    for kind in Kind::ALL {
        let modules = design.modules().iter();
        let sites = modules.flat_map(|module| module.mutations());
        let mut sites: Vec<_> = sites.filter(|site| site.kind == kind).collect();
        if !sites.is_empty() {
            drawn.push(sites.swap_remove(rng.usize(..sites.len())));
        }
    }
    assert!(drawn.len() > Kind::ALL.len() / 2);
    let changes: Vec<_> = (1..).zip(drawn.iter().map(|site| &site.mutation)).collect();
    let by_port = design.selectable(&changes, Select::Port("mutant")).unwrap();
    let (mut noticed, mut same) = (0, 0);
    for (site, &(number, change)) in drawn.iter().zip(&changes) {
        let alone = design.with(change).unwrap();
        // If an input selects, registers start with the complement of the reset value that they have without changes.
        let designs = match site.kind {
            Kind::Reset => [
                design
                    .selectable(&changes, Select::Constant(number))
                    .unwrap(),
                alone,
                design.selectable(&changes, Select::Constant(0)).unwrap(),
            ],
            _ => [
                &by_port,
                &alone.selectable(&[], Select::Port("mutant")).unwrap(),
                &by_port,
            ]
            .map(|design| Design::new(design.top().clone()).unwrap()),
        };
        let mut models = designs.map(|design| Verilated::new_without_lint(design.top()));
        if site.kind != Kind::Reset {
            models[0].set("mutant", number.into());
        }
        let mut differs = false;
        for clock in 0..CLOCKS {
            let reset = u64::from(clock < 3 || rng.u32(..50) == 0);
            for (name, width) in &inputs {
                let value = mask(*width) & if rng.bool() { rng.u128(..) } else { 0 };
                for model in &mut models {
                    let port = model.port(name);
                    model.set_wide(port, value);
                }
            }
            for model in &mut models {
                // A change can remove the last reset.
                if let Ok(port) = model.model.port("rst") {
                    model.model.set(port, reset);
                }
                model.model.eval();
            }
            for port in top
                .ports()
                .iter()
                .filter(|p| p.direction == Direction::Output)
            {
                let [selected, alone, plain] =
                    [0, 1, 2].map(|i: usize| models[i].get_wide(models[i].port(&port.name)));
                assert_eq!(selected, alone, "{}, clock {clock}: {change:?}", port.name);
                same += 1;
                differs |= alone != plain;
            }
            for model in &mut models {
                model.clock();
            }
        }
        noticed += usize::from(differs);
    }
    assert!(
        noticed > 0 && same > CLOCKS,
        "{noticed} of {}",
        changes.len()
    );
}
