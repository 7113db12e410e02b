//! The printed Verilog.

use super::pipelines::{horner, multiply_add};
use dynrt_hdl::{Builder, Compared, Design, Module, Prefix, Specs, Style, named};
use dynrt_verilated::model::{Sources, lint};
use std::sync::Arc;

fn counter() -> Arc<Module> {
    let m = Builder::new(
        "counter",
        "counts up to a limit, then begins again. An example of state, enable and reset.",
    );
    m.group("Counts where high");
    let enable = m.input("enable", 1);
    m.group("The greatest count");
    let limit = m.input("limit", 8);
    let count = m.reg_reset("count", 8, 0);
    named! {
        let at_limit = count.q.eq(limit);
    }
    m.comment("After the limit comes zero.");
    let next = at_limit.mux(m.zero(8), count.q + m.lit(1u8, 8));
    count.next_when(enable, next);
    m.group("The count, and whether it is the limit");
    m.output("value", count.q);
    m.output("last", at_limit);
    m.finish().unwrap()
}

fn queue() -> Arc<Module> {
    let m = Builder::new(
        "queue",
        "first in, first out: 16 words of 24 bits, never overfilled by its user.",
    );
    m.group("In");
    let push = m.input("push", 1);
    let data = m.input("data", 24);
    m.group("Out");
    let pop = m.input("pop", 1);
    let (head, tail) = (m.reg_reset("head", 4, 0), m.reg_reset("tail", 4, 0));
    let count = m.reg_reset("count", 5, 0);
    let one = m.lit(1u8, 4);
    head.next_when(pop, head.q + one);
    tail.next_when(push, tail.q + one);
    let one = m.lit(1u8, 5);
    count.next_when(push ^ pop, push.mux(count.q + one, count.q - one));
    let store = m.memory("store", 16, 24, Style::Distributed);
    store.write(push, tail.q, data);
    m.output("valid", count.q.any());
    m.output("front", store.read_now(head.q));
    m.finish().unwrap()
}

fn memories() -> Arc<Module> {
    let m = Builder::new(
        "memories",
        "one memory of each kind, and one with two read ports.",
    );
    let p = m.pipeline();
    let (address, data) = (p.input("address", 6), p.input("data", 12));
    let enable = p.valid_input("enable");
    let block = m.memory("block", 64, 12, Style::Block);
    block.write(enable.register(), address.register(), data);
    let now = m.memory("now", 48, 12, Style::Distributed);
    now.write(enable, address, data);
    let two = m.memory("two", 64, 12, Style::Block);
    two.write(enable, address, data);
    let far = two.read(address ^ data.low(6)).named("far");
    let sum = block.read(address) + now.read_now(address) + (two.read(address) ^ far);
    m.output("y", sum.register());
    m.finish().unwrap()
}

fn choices() -> Arc<Module> {
    let m = Builder::new("choices", "chains of choices, in several places.");
    let (index, urgent) = (m.input("index", 3), m.input("urgent", 4));
    let inputs: Vec<_> = (0..6).map(|i| m.input(format!("x{i}"), 9)).collect();
    m.output("selected", m.select(index, &inputs));
    let cases: Vec<_> = (0..4)
        .map(|i| (urgent.bit(i), inputs[i as usize]))
        .collect();
    let first = m.priority(&cases, inputs[5]);
    m.output("first", first);
    m.output("either", urgent.any().mux(first, inputs[4] + inputs[5]));
    m.output("flag", index.equals(6).mux(m.ones(1), m.zero(1)));
    m.output("none", !index.equals(6));
    m.finish().unwrap()
}

fn wide() -> Arc<Module> {
    let m = Builder::new("wide", "concatenations, parts and reductions.");
    let words: Vec<_> = (0..8)
        .map(|i| m.input(format!("quite_a_long_word{i}"), 32))
        .collect();
    named! {
        let all = m.concat(&words);
    }
    m.output("all_out", all);
    m.output("middle", all.field(100, 40));
    m.output("rejoined", words[0].high(16).concat(words[0].low(16)));
    m.output("nested", words[0].concat(words[1]).concat(words[2].low(3)));
    m.output("sign_extended", words[7].msb().repeat(8).concat(words[7]));
    m.output("parity", words[3].parity());
    m.output("full", words[4].low(7).all() & !words[5].low(7).any());
    m.output("extended", words[6].low(4).extend(12));
    m.output(
        "shifted",
        words[0].shl(words[1].low(5)) - words[0].shr(words[2].low(5)),
    );
    m.finish().unwrap()
}

fn pipelines() -> Arc<Module> {
    let m = Builder::new("pipelines", "short and long delays, and an instance.");
    let p = m.pipeline();
    let (axis, x, y) = (p.input("axis", 2), p.input("x", 16), p.input("y", 16));
    let valid = p.valid_input("valid");
    let is_one = axis.equals(1).hinted("axis_is_one").delay(2);
    let swapped = is_one.mux(x, y);
    let inputs = [
        ("a", swapped.low(8)),
        ("b", swapped.high(8)),
        ("c", x ^ y),
        ("valid", valid),
    ];
    let scaled = m.instance("scale", &multiply_add(), &inputs);
    m.output("scaled", scaled.get("y"));
    m.output("sum", (x + y).at(5));
    m.output("axis_out", axis.at(5));
    m.output("earlier", axis.at(4));
    m.output("valid_out", scaled.get("y_valid"));
    m.finish().unwrap()
}

/// The printed text equals the snapshots, and none of the three tools reports a warning.
#[test]
fn the_text_is_as_expected() {
    for module in [
        counter(),
        queue(),
        multiply_add(),
        memories(),
        choices(),
        wide(),
        pipelines(),
    ] {
        insta::assert_snapshot!(module.name(), module.verilog());
        lint(&Sources::of(&Design::new(module).unwrap())).unwrap();
    }
}

#[test]
fn generated_names_leave_given_ones_alone() {
    let m = Builder::new("crowded", "has names that the layer would like to give.");
    let p = m.pipeline();
    let x = p.input("x", 4);
    for name in [
        "x_s1",
        "x_delay",
        "unused",
        "store_read",
        "store_copy0",
        "not_x",
    ] {
        m.output(name, p.input(format!("{name}_in"), 4));
    }
    let store = m.memory("store", 16, 4, Style::Block);
    store.write(m.ones(1), x, x);
    m.output("y", store.read(x) + store.read(!x) + x.register());
    m.output("late", x.delay(150)); // more than a tool takes in one loop
    m.output("spare", p.input("spare_in", 4).low(2));
    let design = Design::new(m.finish().unwrap()).unwrap();
    lint(&Sources::of(&design)).unwrap();
}

/// Names are derived from fields, parts and hints, also behind registers; the others are listed with their places.
#[test]
fn names_follow_from_the_description() {
    dynrt_hdl::bundle! {
        struct Interval() { near: 8, far: 8 }
    }
    dynrt_hdl::bundle! {
        struct Entry() { leaf: 1, context: 3, interval: {Interval}() }
    }
    let m = Builder::new("named", "has a word of fields.");
    let p = m.pipeline();
    let x = p.input("x", 8);
    let entry = Entry::of();
    let store = m.memory("store", 16, entry.width(), Style::Block);
    store.write(m.ones(1), m.input("at", 4), m.input("word", entry.width()));
    let kept = entry.unpack(store.read(p.input("from", 4)).register());
    let Interval { near, far } = kept.interval;
    let meets = near.le(x).hinted("meets");
    m.output("meets_now", meets.at(4) & kept.leaf.at(4));
    m.output("meets_late", meets.at(5) & far.part("sign", 7, 1).at(5));
    let narrow = (near.low(4) ^ kept.context.extend(4)).hinted_after(near, "mixed");
    m.output("mixed", narrow.concat(narrow));
    let nameless = (x & far) + near;
    m.output(
        "nothing",
        nameless.concat(nameless.register().at(nameless.stage() + 1)),
    );
    let module = m.finish().unwrap();
    lint(&Sources::of(&Design::new(module.clone()).unwrap())).unwrap();
    for part in [
        "wire store_read_leaf_s2 = store_read_s2[0];",
        "wire [2:0] store_read_context_s2 = store_read_s2[3:1];",
        "wire [7:0] store_read_interval_near_s2 = store_read_s2[11:4];",
        "meets_s3 <= (store_read_interval_near_s2 <= x_s2);",
        "store_read_interval_far_sign_s3 <= store_read_interval_far_s2[7];",
        "wire [3:0] store_read_interval_near_mixed_s2 =",
    ] {
        let text = module.verilog();
        assert!(text.contains(part), "{part}\n{text}");
    }
    let made_up: Vec<_> = module.made_up_names().collect();
    let [(name, place)] = made_up[..] else {
        panic!("{made_up:?}\n{}", module.verilog())
    };
    assert_eq!((name, place.file()), ("term", file!()));
}

/// A counter with an additional output, and optionally with a fault.
fn watched(trace: bool, fault: bool) -> Arc<Module> {
    let below = Builder::new("below", "a queue of one word.");
    let word = below.reg("word", 4);
    word.next(below.input("data", 4));
    below.output("front", word.q);
    if trace {
        below.output("watch", word.q.any());
    }
    let m = Builder::new("watched", "counts, stores, and shows.");
    let count = m.reg_reset("count", 4, 0);
    let store = m.memory("store", 16, 4, Style::Block);
    store.write(m.ones(1), count.q, count.q + m.lit(u8::from(fault), 4));
    count.next_when(m.input("go", 1), count.q + m.lit(1u8, 4));
    let stored = store.read(m.input("at", 4));
    let placed = m.instance("queue", &below.finish().unwrap(), &[("data", stored)]);
    m.output("y", placed.get("front") ^ count.q);
    if trace {
        m.output("watch_store", store.read(count.q));
        m.output("watch_queue", placed.get("watch"));
    }
    m.finish().unwrap()
}

#[test]
fn what_an_output_depends_on_is_compared_to_its_end() {
    let (whole, reduced) = (watched(true, false), watched(false, false));
    let compared = reduced.compare_outputs(&whole).unwrap();
    assert_eq!(
        compared,
        Compared {
            outputs: 2,
            registers: 2,
            memories: 1,
            instances: 1
        }
    );
    let error = whole.compare_outputs(&reduced).unwrap_err();
    assert_eq!(error, "watched: only one module has output watch_store");
    let error = reduced.compare_outputs(&watched(true, true)).unwrap_err();
    assert_eq!(error, "watched: memory store differs");
    let faulty = whole.signal("count").unwrap().fault().inverted();
    let faulty = whole.with(&faulty).unwrap();
    reduced.compare_outputs(&faulty).unwrap_err();
}

#[test]
fn the_text_is_the_same_every_time() {
    let emit = || {
        let mut files = vec![];
        for module in [
            counter(),
            memories(),
            choices(),
            wide(),
            pipelines(),
            horner(),
        ] {
            files.extend(Design::new(module).unwrap().files());
        }
        files
    };
    let here = emit();
    assert!(here.len() > 5);
    assert!(here == emit(), "emitting twice gives two texts");
    let threads: Vec<_> = (0..4).map(|_| std::thread::spawn(emit)).collect();
    for thread in threads {
        assert!(
            here == thread.join().unwrap(),
            "another thread gives another text"
        );
    }
}

/// A design of nested modules.
fn placed_twice() -> Design {
    let inner = Builder::new("inner", "adds.");
    inner.output("y", inner.input("x", 4) + inner.ones(4));
    let inner = inner.finish().unwrap();
    let outer = Builder::new("outer", "places inner twice.");
    // A signal with the name of a module keeps its name.
    let x = outer.input("inner", 4);
    let once = outer.instance("once", &inner, &[("x", x)]).get("y");
    let twice = outer.instance("twice", &inner, &[("x", once)]);
    outer.output("y", twice.get("y"));
    Design::new(outer.finish().unwrap()).unwrap()
}

#[test]
fn a_prefix_stands_before_names_of_modules_and_nothing_else() {
    let plain = placed_twice();
    let prefixed = placed_twice().with_prefix("big_2".parse().unwrap());
    let names: Vec<String> = prefixed.files().into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["big_2inner.v", "big_2outer.v"]);
    for ((_, before), (_, after)) in plain.files().iter().zip(prefixed.files()) {
        assert_eq!(before.lines().count(), after.lines().count());
        let mut changed = 0;
        for (before, after) in before.lines().zip(after.lines()) {
            changed += usize::from(before != after);
            let once = before.replacen("inner", "big_2inner", 1);
            let own = before.replacen("outer", "big_2outer", 1);
            assert!(after == before || after == once || after == own, "{after}");
        }
        // The headline, the module, and its instances.
        let placed = if before.contains("module outer") {
            2
        } else {
            0
        };
        assert_eq!(changed, 2 + placed, "{after}");
        assert!(!after.contains("wire [3:0] big_2"), "{after}");
    }
    lint(&Sources::of(&prefixed)).unwrap();
}

#[test]
fn a_prefix_is_of_its_pattern() {
    let longest = "x".repeat(Prefix::MOST);
    for good in ["dynrt_", "a", "small", "z9__", longest.as_str()] {
        assert_eq!(good.parse::<Prefix>().unwrap().as_str(), good);
    }
    let too_long = "x".repeat(Prefix::MOST + 1);
    for bad in [
        "", "_a", "9a", "Big_", "bIg", "a-b", "a b", "ä", "a.", "../a", &too_long,
    ] {
        let said = bad.parse::<Prefix>().unwrap_err();
        assert!(said.starts_with(&format!("prefix `{bad}`: ")), "{said}");
        assert!(said.contains("[a-z][a-z0-9_]*"), "{said}");
    }
    let said = "a\nb".parse::<Prefix>().unwrap_err();
    assert!(said.starts_with("prefix `a\\nb`: "), "{said}");
}

#[test]
fn every_file_is_framed() {
    for (name, text) in Design::new(horner()).unwrap().files() {
        assert!(text.starts_with("// SPDX-License-Identifier: MIT OR Apache-2.0\n"));
        let module = name.strip_suffix(".v").unwrap();
        assert!(text.contains(&format!("\n`default_nettype none\n\nmodule {module} (\n")));
        assert!(text.ends_with("\nendmodule\n\n`default_nettype wire\n"));
        assert!(!text.contains("\n\n\n") && !text.lines().any(|line| line.ends_with(' ')));
    }
}
