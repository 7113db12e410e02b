//! The hardware-construction layer: what it says of mistakes, how pipelines balance, what it prints, and that what it
//! prints computes what was described.

#[path = "common/seed.rs"]
mod seed;

use dynrt::config::Config;
use dynrt::cosim::model::{BuildOptions, Model, Port, PortHandle, Sources, build, lint};
use dynrt::hdl::{
    Builder, Compared, Design, Direction, HdlError, Kind, Module, Mutation, Prefix, Select, Signal,
    Specs, Style,
};
use dynrt::hw;
use dynrt::named;
use seed::seed;
use std::cell::Cell;
use std::panic::Location;
use std::sync::Arc;

// ---------------------------------------------------------------------------------------------------------------
// Mistakes

thread_local! {
    static LINE: Cell<u32> = const { Cell::new(0) };
}

/// Says that the mistake is made in the line after this one.
#[track_caller]
fn next_line() {
    LINE.set(Location::caller().line() + 1);
}

/// What is said of a module with a mistake, word for word.
#[track_caller]
fn mistake(expected: &str, describe: impl FnOnce(&Builder)) {
    let m = Builder::new("broken", "has a mistake.");
    describe(&m);
    let error = m.finish().expect_err("the mistake was not seen");
    said(&error, "broken", expected);
}

#[track_caller]
fn said(error: &HdlError, module: &str, expected: &str) {
    let line = LINE.get();
    assert_eq!(
        error.to_string(),
        format!("{}:{line}: module {module}: {expected}", file!())
    );
}

/// A module whose only output follows its input without a register.
fn follower() -> Arc<Module> {
    let m = Builder::new("follower", "y = !x.");
    let x = m.input("x", 4);
    m.output("y", !x);
    m.finish().unwrap()
}

#[test]
fn widths_must_match() {
    type Operator = fn(Signal, Signal);
    let operators: [(&str, Operator); 9] = [
        ("And", |a, b| {
            next_line();
            let _ = a & b;
        }),
        ("Or", |a, b| {
            next_line();
            let _ = a | b;
        }),
        ("Xor", |a, b| {
            next_line();
            let _ = a ^ b;
        }),
        ("Add", |a, b| {
            next_line();
            let _ = a + b;
        }),
        ("Sub", |a, b| {
            next_line();
            let _ = a - b;
        }),
        ("Equal", |a, b| {
            next_line();
            let _ = a.eq(b);
        }),
        ("NotEqual", |a, b| {
            next_line();
            let _ = a.ne(b);
        }),
        ("Less", |a, b| {
            next_line();
            let _ = a.lt(b);
        }),
        ("LessEqual", |a, b| {
            next_line();
            let _ = a.le(b);
        }),
    ];
    for (name, operator) in operators {
        let text = format!("width mismatch: {name} of 8 bits (\"a\") and 7 bits (\"b\")");
        mistake(&text, |m| operator(m.input("a", 8), m.input("b", 7)));
    }
    mistake(
        "width mismatch: Or of 8 bits (\"a\") and 3 bits (literal 5)",
        |m| {
            let (a, five) = (m.input("a", 8), m.lit(5u8, 3));
            next_line();
            let _ = m.or_all(&[a, five]);
        },
    );
    mistake("width mismatch: a choice by 2 bits (\"c\")", |m| {
        let (c, a) = (m.input("c", 2), m.input("a", 8));
        next_line();
        let _ = c.mux(a, !a);
    });
    mistake(
        "width mismatch: a choice of 8 bits (\"a\") or 7 bits (\"b\")",
        |m| {
            let (c, a, b) = (m.input("c", 1), m.input("a", 8), m.input("b", 7));
            next_line();
            let _ = c.mux(a, b);
        },
    );
    mistake("width mismatch: \"w\" has 8 bits, \"b\" has 7", |m| {
        let (w, b) = (m.wire("w", 8), m.input("b", 7));
        next_line();
        w.drive(b);
    });
    mistake("width mismatch: \"r\" has 8 bits, \"b\" has 7", |m| {
        let (r, b) = (m.reg("r", 8), m.input("b", 7));
        next_line();
        r.next(b);
    });
    mistake("width mismatch: an enable of 2 bits (\"e\")", |m| {
        let (r, e) = (m.reg("r", 8), m.input("e", 2));
        next_line();
        r.next_when(e, r.q);
    });
    mistake(
        "width mismatch: instance i of follower: port x has 4 bits, \"b\" has 7",
        |m| {
            let (module, b) = (follower(), m.input("b", 7));
            next_line();
            m.instance("i", &module, &[("x", b)]);
        },
    );
}

#[test]
fn bits_must_exist() {
    mistake("\"a\" has no bits 8 to 1: it has 8", |m| {
        let a = m.input("a", 8);
        next_line();
        a.bits(8, 1);
    });
    mistake("\"a\" has no bits 1 to 2: it has 8", |m| {
        let a = m.input("a", 8);
        next_line();
        a.bits(1, 2);
    });
    mistake("\"a\" has no 4 bits from 6: it has 8", |m| {
        let a = m.input("a", 8);
        next_line();
        a.field(6, 4);
    });
    mistake("\"a\" has no 9 bits from 0: it has 8", |m| {
        let a = m.input("a", 8);
        next_line();
        a.high(9);
    });
    mistake("\"a\" has more than 7 bits", |m| {
        let a = m.input("a", 8);
        next_line();
        a.extend(7);
    });
    mistake("a signal of no bits", |m| {
        next_line();
        m.input("a", 0).msb();
    });
    mistake("16 does not fit 4 bits", |m| {
        next_line();
        m.lit(16u8, 4);
    });
    mistake("reset of \"r\": 16 does not fit 4 bits", |m| {
        next_line();
        m.reg_reset("r", 4, 16);
    });
    mistake("a reduction of no signals", |m| {
        next_line();
        m.and_all(&[]);
    });
    mistake("a selection among no signals", |m| {
        let index = m.input("index", 2);
        next_line();
        m.select(index, &[]);
    });
}

#[test]
fn memories_are_checked() {
    mistake(
        "width mismatch: memory \"store\" of 48 words takes 6 address bits, \"a\" has 5",
        |m| {
            let (store, a) = (m.memory("store", 48, 8, Style::Block), m.input("a", 5));
            next_line();
            store.read(a);
        },
    );
    mistake(
        "width mismatch: memory \"store\" of 48 words takes 6 address bits, \"a\" has 7",
        |m| {
            let store = m.memory("store", 48, 8, Style::Block);
            let (a, d) = (m.input("a", 7), m.input("d", 8));
            next_line();
            store.write(m.ones(1), a, d);
        },
    );
    mistake(
        "width mismatch: memory \"store\" has words of 8 bits, \"d\" has 9",
        |m| {
            let store = m.memory("store", 48, 8, Style::Block);
            let (a, d) = (m.input("a", 6), m.input("d", 9));
            next_line();
            store.write(m.ones(1), a, d);
        },
    );
    mistake("width mismatch: a write enable of 2 bits (\"e\")", |m| {
        let store = m.memory("store", 48, 8, Style::Block);
        let (e, a, d) = (m.input("e", 2), m.input("a", 6), m.input("d", 8));
        next_line();
        store.write(e, a, d);
    });
    mistake("memory \"store\" has 0 words of 8 bits", |m| {
        next_line();
        m.memory("store", 0, 8, Style::Block);
    });
    mistake("block RAM cannot be read combinationally", |m| {
        let (store, a) = (m.memory("store", 48, 8, Style::Block), m.input("a", 6));
        next_line();
        store.read_now(a);
    });
}

#[test]
fn loops_are_found() {
    mistake("combinational loop: a <- b <- a", |m| {
        let (a, b) = (m.wire("a", 4), m.wire("b", 4));
        let x = m.input("x", 4);
        next_line();
        a.drive(b.get() + x);
        b.drive(a.get() ^ x);
        m.output("y", b.get());
    });
    mistake("combinational loop: a <- a", |m| {
        let a = m.wire("a", 4);
        next_line();
        a.drive(!a.get());
    });
    // Through an instance, and through a module in that instance.
    mistake("combinational loop: a <- i_y <- a", |m| {
        let a = m.wire("a", 4);
        let out = m.instance("i", &nested(), &[("x", a.get()), ("other", m.zero(4))]);
        next_line();
        a.drive(out.get("y"));
    });
    mistake("combinational loop: a <- store_word <- a", |m| {
        let a = m.wire("a", 4);
        let store = m.memory("store", 16, 4, Style::Distributed);
        store.write(m.ones(1), m.input("at", 4), m.input("data", 4));
        let word = store.read_now(a.get()).named("store_word");
        next_line();
        a.drive(word);
    });
    mistake("combinational loop: a <- chosen <- a", |m| {
        let a = m.wire("a", 1);
        let (x, y) = (m.input("x", 4), m.input("y", 4));
        let chosen = a.get().mux(x, y).named("chosen");
        next_line();
        a.drive(chosen.concat(x).all());
    });
}

/// Its output y follows x, through an instance, its output z follows other, and r is a register of x.
fn nested() -> Arc<Module> {
    let m = Builder::new("nested", "y = x, z = other.");
    let (x, other) = (m.input("x", 4), m.input("other", 4));
    let first = m.instance("first", &follower(), &[("x", x)]);
    m.output("y", !first.get("y"));
    m.output("z", other);
    m.output("r", x.register());
    m.finish().unwrap()
}

#[test]
fn registers_and_unrelated_ports_make_no_loop() {
    let m = Builder::new("sound", "feeds outputs back.");
    let (a, b) = (m.wire("a", 4), m.wire("b", 4));
    let i = m.instance("i", &nested(), &[("x", a.get()), ("other", b.get())]);
    b.drive(i.get("y"));
    a.drive(i.get("r"));
    let c = m.wire("c", 4);
    let store = m.memory("store", 16, 4, Style::Block);
    store.write(m.ones(1), c.get(), i.get("z"));
    c.drive(store.read(c.get()));
    let q = m.reg("q", 4);
    q.next(!q.q);
    m.output("y", c.get() ^ q.q);
    m.finish().unwrap();
}

#[test]
fn everything_is_driven_once() {
    mistake("\"w\" is undriven", |m| {
        next_line();
        m.wire("w", 4);
    });
    mistake("\"r\" is undriven", |m| {
        next_line();
        m.reg_reset("r", 4, 0);
    });
    mistake("memory \"store\" is undriven: it is never written", |m| {
        next_line();
        let store = m.memory("store", 16, 4, Style::Block);
        m.output("y", store.read(m.input("a", 4)));
    });
    mistake("memory \"store\" is never read", |m| {
        next_line();
        let store = m.memory("store", 16, 4, Style::Block);
        store.write(m.ones(1), m.input("a", 4), m.input("d", 4));
    });
    mistake("instance i of follower: input x is undriven", |m| {
        let module = follower();
        next_line();
        m.instance("i", &module, &[]);
    });
    mistake("instance i: module follower has no input z", |m| {
        let (module, x) = (follower(), m.input("x", 4));
        next_line();
        m.instance("i", &module, &[("x", x), ("z", x)]);
    });
    let line = line!() + 6;
    let first = format!("first at {}:{line}", file!());
    mistake(&format!("\"w\" is doubly driven: {first}"), |m| {
        let x = m.input("x", 4);
        let w = m.wire("w", 4);

        w.drive(x);
        next_line();
        w.drive(!x);
    });
    let line = line!() + 6;
    let first = format!("first at {}:{line}", file!());
    mistake(&format!("\"r\" is doubly driven: {first}"), |m| {
        let x = m.input("x", 4);
        let r = m.reg("r", 4);

        r.next(x);
        next_line();
        r.next_when(x.bit(0), x);
    });
    let line = line!() + 7;
    let first = format!("it has one write port, used at {}:{line}", file!());
    mistake(
        &format!("memory \"store\" is doubly driven: {first}"),
        |m| {
            let (a, e) = (m.input("a", 4), m.input("e", 1));
            let store = m.memory("store", 16, 4, Style::Block);
            store.write(e, a, a);
            next_line();
            store.write(!e, a, a);
        },
    );
    mistake("instance i: input x is doubly driven", |m| {
        let (module, x) = (follower(), m.input("x", 4));
        next_line();
        m.instance("i", &module, &[("x", x), ("x", !x)]);
    });
    let made = line!() + 4;
    let text = format!("module follower has no output z (instance made at line {made})");
    mistake(&text, |m| {
        let (module, x) = (follower(), m.input("x", 4));
        let i = m.instance("i", &module, &[("x", x)]);
        next_line();
        i.get("z");
    });
}

#[test]
fn names_are_good_and_free() {
    let taken = |name: &str, line: u32| {
        format!(
            "name clash: \"{name}\" is already taken at {}:{line}",
            file!()
        )
    };
    let line = line!() + 2;
    mistake(&taken("a", line), |m| {
        m.input("a", 4);
        next_line();
        m.wire("a", 4);
    });
    let line = line!() + 2;
    mistake(&taken("total", line), |m| {
        let total = (m.input("a", 4) + m.input("b", 4)).named("total");
        next_line();
        m.output("total", total);
    });
    let line = line!() + 3;
    mistake(&taken("i", line), |m| {
        let (module, x) = (follower(), m.input("x", 4));
        m.reg("i", 1);
        next_line();
        m.instance("i", &module, &[("x", x)]);
    });
    // The wires of an instance's outputs are called after both.
    let line = line!() + 3;
    mistake(&taken("i_y", line), |m| {
        let (module, x) = (follower(), m.input("x", 4));
        m.reg("i_y", 1);
        next_line();
        m.instance("i", &module, &[("x", x)]);
    });
    for name in [
        "",
        "Upper",
        "9lives",
        "_x",
        "a-b",
        "a b",
        "größe",
        "reg",
        "logic",
        "always_ff",
        "clk",
        "rst",
    ] {
        let text =
            format!("\"{name}\" is no name for Verilog: use lower case, digits, _, and no keyword");
        mistake(&text, |m| {
            next_line();
            m.input(name, 4);
        });
        next_line();
        let m = Builder::new(name, "is badly named.");
        m.output("y", m.input("x", 1));
        said(&m.finish().unwrap_err(), name, &text);
    }
}

#[test]
fn modules_of_one_name_must_be_one() {
    let inner = |invert: bool| {
        next_line();
        let m = Builder::new("inner", "y = x, or not.");
        let x = m.input("x", 4);
        m.output("y", if invert { !x } else { x });
        m.finish().unwrap()
    };
    let outer = |second: bool| {
        let m = Builder::new("outer", "has two.");
        let x = m.input("x", 4);
        let a = m.instance("a", &inner(false), &[("x", x)]);
        let b = m.instance("b", &inner(second), &[("x", x)]);
        m.output("y", a.get("y") ^ b.get("y"));
        m.finish().unwrap()
    };
    // Made twice in the same words it is the same module.
    let design = Design::new(outer(false)).unwrap();
    let names: Vec<_> = design.modules().iter().map(|m| m.name()).collect();
    assert_eq!(names, ["inner", "outer"]);
    let error = Design::new(outer(true)).unwrap_err();
    let place = format!("{}:{}", file!(), LINE.get());
    said(
        &error,
        "inner",
        &format!("name clash: a different module of this name was made at {place}"),
    );
}

#[test]
fn stages_do_not_mix() {
    mistake(
        "\"a1\" and \"b\" are in two pipelines: bring one into the other's with untimed and enter_at",
        |m| {
            // At different stages, either way round.
            let a = m.pipeline().input("a", 4).register();
            let b = m.pipeline().input("b", 4);
            next_line();
            let _ = a.named("a1") + b;
        },
    );
}

#[test]
fn staged_and_unstaged_do_not_mix() {
    mistake(
        "\"a\" has a stage, \"b\" has none: bring it in with enter_at, or use untimed",
        |m| {
            let (a, b) = (m.pipeline().input("a", 4), m.input("b", 4));
            next_line();
            let _ = b + a;
        },
    );
    mistake("\"w\" has no stage, \"a\" has one: use untimed", |m| {
        let (a, w) = (m.pipeline().input("a", 4), m.wire("w", 4));
        next_line();
        w.drive(a);
    });
    mistake("\"b\" has no stage: it is in no pipeline", |m| {
        let (a, b) = (m.pipeline().input("a", 4), m.input("b", 4));
        next_line();
        m.output("y", a.at(b.stage()));
    });
    let child = Builder::new("child", "has no pipeline.");
    child.output("y", !child.input("x", 4));
    let child = child.finish().unwrap();
    let stage = child.stage("x").unwrap_err();
    assert!(stage.place.file().ends_with("hdl.rs"));
    assert_eq!(stage.message, "port x has no stage");
    mistake(
        "instance i: input x has no stage, \"a\" has one: use untimed",
        |m| {
            let a = m.pipeline().input("a", 4);
            next_line();
            m.output("y", m.instance("i", &child, &[("x", a)]).get("y"));
        },
    );
    mistake("\"r\" has no stage, \"a\" has one: use untimed", |m| {
        let (a, r) = (m.pipeline().input("a", 4), m.reg("r", 4));
        next_line();
        r.next(a);
    });
    mistake(
        "\"r\" has no stage, its enable (\"a\") has one: use untimed",
        |m| {
            let (a, r) = (m.pipeline().input("a", 1), m.reg("r", 4));
            next_line();
            r.next_when(a, r.q);
        },
    );
    mistake("\"b\" is in no pipeline", |m| {
        let b = m.input("b", 4);
        next_line();
        b.at(3);
    });
    mistake("\"late\" is at stage 4, past 3", |m| {
        let late = m.pipeline().input("a", 4).delay(4).named("late");
        next_line();
        late.at(3);
    });
    let adder = || {
        let m = Builder::new("adder", "y = a + b.");
        let p = m.pipeline();
        m.output("y", (p.input("a", 4) + p.input("b", 4)).register());
        m.finish().unwrap()
    };
    mistake(
        "instance i of adder: \"b\" has no stage, other inputs have",
        |m| {
            let (a, b) = (m.pipeline().input("a", 4), m.input("b", 4));
            let adder = adder();
            next_line();
            m.instance("i", &adder, &[("a", a), ("b", b)]);
        },
    );
    mistake("instance i: inputs come from two pipelines", |m| {
        let a = m.pipeline().input("a", 4);
        let b = m.pipeline().input("b", 4);
        let adder = adder();
        next_line();
        m.instance("i", &adder, &[("a", a), ("b", b)]);
    });
}

#[test]
fn signals_stay_in_their_module() {
    let other = Builder::new("other", "is another module.");
    let x = other.input("x", 4);
    let e = other.input("e", 1);
    type Use = for<'b> fn(&'b Builder, Signal<'b>, Signal<'b>, Signal<'b>);
    let uses: [(&str, Use); 10] = [
        (
            "\"x\" of module other is used in another module",
            |_, a, x, _| {
                next_line();
                let _ = a + x;
            },
        ),
        (
            "\"x\" of module other is used in another module",
            |m, a, x, _| {
                next_line();
                m.concat(&[a, x]);
            },
        ),
        (
            "\"a\" of module broken is used in another module",
            |m, a, _, e| {
                next_line();
                m.priority(&[(e, a)], a);
            },
        ),
        (
            "\"w\" is driven by a signal of module other",
            |m, _, x, _| {
                let w = m.wire("w", 4);
                next_line();
                w.drive(x);
            },
        ),
        (
            "\"r\" is driven by a signal of module other",
            |m, _, x, _| {
                let r = m.reg("r", 4);
                next_line();
                r.next(x);
            },
        ),
        (
            "\"r\" is enabled by a signal of module other",
            |m, a, _, e| {
                let r = m.reg("r", 4);
                next_line();
                r.next_when(e, a);
            },
        ),
        (
            "port \"y\" is given a signal of module other",
            |m, _, x, _| {
                next_line();
                m.output("y", x);
            },
        ),
        (
            "instance i: input x is given a signal of module other",
            |m, _, x, _| {
                let module = follower();
                next_line();
                m.instance("i", &module, &[("x", x)]);
            },
        ),
        (
            "memory \"store\" is addressed by a signal of module other",
            |m, _, x, _| {
                let store = m.memory("store", 16, 4, Style::Block);
                next_line();
                store.read(x);
            },
        ),
        (
            "\"x\" of module other is used in another module",
            |m, a, x, _| {
                let store = m.memory("store", 16, 4, Style::Block);
                next_line();
                store.write(m.ones(1), a, x);
            },
        ),
    ];
    for (text, make) in uses {
        let m = Builder::new("broken", "has a mistake.");
        make(&m, m.input("a", 4), x, e);
        said(&m.finish().unwrap_err(), "broken", text);
    }
}

// ---------------------------------------------------------------------------------------------------------------
// Pipelines

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
    // Literals go with any stage and are never delayed.
    let five = m.lit(5u8, 8);
    assert_eq!((late + five).staged(), Some(3));
    assert_eq!((five + a).staged(), Some(0));
    assert_eq!((five.delay(9) + five).staged(), None);
    assert_eq!(five.at(7).staged(), None);
    // A signal outside pipelines can be brought in anywhere, and one inside be taken out.
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

/// y = a * b + c, where c comes at stage 2; `next` is 1 where y is of a set of inputs that was valid.
fn multiply_add() -> Arc<Module> {
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

/// (a * b + c) * d + e of inputs that all come at stage 0, and the tag that came with them.
fn horner() -> Arc<Module> {
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
            // What came before and during reset is not valid.
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

// ---------------------------------------------------------------------------------------------------------------
// The text

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

/// What the expectation files hold is what is printed; each is clean in all three tools.
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
        lint(&sources(&Design::new(module).unwrap())).unwrap();
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
    lint(&sources(&design)).unwrap();
}

/// Names follow from fields, parts and hints, also behind registers; what is left is told with its place.
#[test]
fn names_follow_from_the_description() {
    dynrt::bundle! {
        struct Interval() { near: 8, far: 8 }
    }
    dynrt::bundle! {
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
    lint(&sources(&Design::new(module.clone()).unwrap())).unwrap();
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

/// A module that counts, with an output more, and perhaps with a fault.
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
    assert_eq!(error, "watched: only one has output watch_store");
    let error = reduced.compare_outputs(&watched(true, true)).unwrap_err();
    assert_eq!(error, "watched: memory store differs");
    let faulty = whole.signal("count").unwrap().fault().inverted();
    let faulty = whole.with(&faulty).unwrap();
    reduced.compare_outputs(&faulty).unwrap_err();
}

#[test]
fn the_text_is_the_same_every_time() {
    let emit = || {
        let config = dynrt::config::Config::load("tiny").unwrap();
        let plan = hw::Plan::new(&config).unwrap();
        let mut files = hw::emit(&plan).unwrap().design.files();
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
    assert!(here.len() > 10);
    assert!(here == emit(), "emitting twice gives two texts");
    let threads: Vec<_> = (0..4).map(|_| std::thread::spawn(emit)).collect();
    for thread in threads {
        assert!(
            here == thread.join().unwrap(),
            "another thread gives another text"
        );
    }
}

/// A design of modules one within another.
fn placed_twice() -> Design {
    let inner = Builder::new("inner", "adds.");
    inner.output("y", inner.input("x", 4) + inner.ones(4));
    let inner = inner.finish().unwrap();
    let outer = Builder::new("outer", "places inner twice.");
    // A signal that is called as a module is stays as it is.
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
        // The headline, the module, and what it places.
        let placed = if before.contains("module outer") {
            2
        } else {
            0
        };
        assert_eq!(changed, 2 + placed, "{after}");
        assert!(!after.contains("wire [3:0] big_2"), "{after}");
    }
    lint(&sources(&prefixed)).unwrap();
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

/// Two machines of different configurations stand in one design: the three tools take all of it without a word.
#[test]
fn two_machines_elaborate_together() {
    let machine = |name: &str, prefix: &str| {
        let plan = hw::Plan::new(&Config::load(name).unwrap()).unwrap();
        let design = hw::core::emit(&plan).unwrap().design;
        design.with_prefix(prefix.parse().unwrap())
    };
    let designs = [
        machine("tiny", "small_"),
        machine("virtex4-lx160", "dynrt_"),
    ];
    let (mut files, mut declared, mut placed, mut ports) = (vec![], vec![], vec![], vec![]);
    for design in &designs {
        files.extend(design.files());
        let (name, prefix) = (design.emitted("core"), design.prefix().as_str());
        let mut pins = vec![];
        for port in design.top().ports() {
            let outside = format!("{prefix}{}", port.name);
            pins.push(format!(".{}({outside})", port.name));
            let input = port.direction == Direction::Input;
            let direction = if input { "input" } else { "output" };
            declared.push(format!("{direction} wire [{}:0] {outside}", port.width - 1));
            ports.push(Port {
                name: outside,
                width: port.width,
                input,
            });
        }
        placed.push(format!("  {name} {prefix}machine ({});\n", pins.join(", ")));
    }
    let both = format!(
        "module both ({});\n{}endmodule\n",
        declared.join(",\n"),
        placed.concat()
    );
    files.push(("both.v".into(), both));
    let together = Sources {
        top: "both".into(),
        files: files.clone(),
        ports,
    };
    lint(&together).unwrap();

    // One module under the other machine's name: what is declared twice is noticed.
    let twice = Sources {
        files: (files.into_iter())
            .map(|(name, text)| (name, text.replace("small_fp_add", "dynrt_fp_add")))
            .collect(),
        ..together
    };
    assert!(lint(&twice).is_err());
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

// ---------------------------------------------------------------------------------------------------------------
// What the text computes

fn sources(design: &Design) -> Sources {
    let ports = design.top().ports().iter().map(|port| Port {
        name: port.name.clone(),
        width: port.width,
        input: port.direction == Direction::Input,
    });
    Sources {
        top: design.emitted(design.top().name()),
        ports: ports.collect(),
        files: design.files(),
    }
}

/// A module run by Verilator, its ports by name.
struct Verilated {
    model: Model,
}

impl Verilated {
    fn new(module: Arc<Module>) -> Verilated {
        lint(&sources(&Design::new(module.clone()).unwrap())).unwrap();
        Verilated::new_without_lint(&module)
    }

    fn new_without_lint(module: &Arc<Module>) -> Verilated {
        let sources = sources(&Design::new(module.clone()).unwrap());
        let options = BuildOptions {
            opt: "-O0".into(),
            ..BuildOptions::default()
        };
        let built = build(&sources, &options, &|_| ()).unwrap();
        let model = Model::load(&built, &sources.ports).unwrap();
        Verilated { model }
    }

    fn port(&self, name: &str) -> PortHandle {
        self.model.port(name).unwrap()
    }

    fn set(&mut self, name: &str, value: u64) {
        let port = self.port(name);
        self.model.set(port, value);
    }

    fn get(&self, name: &str) -> u64 {
        self.model.get(self.port(name))
    }

    fn clock(&mut self) {
        self.model.clock();
    }

    fn set_wide(&mut self, port: PortHandle, value: u128) {
        let words = [0, 32, 64, 96].map(|shift| (value >> shift) as u32);
        self.model.set_words(port, &words);
    }

    fn get_wide(&self, port: PortHandle) -> u128 {
        let mut words = [0; 4];
        self.model.get_words(port, &mut words);
        words
            .iter()
            .rev()
            .fold(0, |all, word| all << 32 | u128::from(*word))
    }
}

/// What a net of a random module is, for the interpreter: operands are earlier nets.
#[derive(Debug)]
enum Net {
    Input(usize),
    Literal(u128),
    /// The same value, whatever registers are between.
    Same(usize),
    Not(usize),
    Two(Two, usize, usize),
    Mux(usize, usize, usize),
    /// Most significant first.
    Concat(Vec<usize>),
    Part(usize, u32),
    Any(usize),
    All(usize),
    Parity(usize),
    State(usize),
    ReadNow(usize, usize),
    Instance(usize, usize),
}

#[derive(Clone, Copy, Debug)]
enum Two {
    And,
    Or,
    Xor,
    Add,
    Sub,
    Mul,
    Eq,
    Ne,
    Lt,
    Le,
    Gt,
    Ge,
    Shl,
    Shr,
}

const TWO: [Two; 14] = [
    Two::And,
    Two::Or,
    Two::Xor,
    Two::Add,
    Two::Sub,
    Two::Mul,
    Two::Eq,
    Two::Ne,
    Two::Lt,
    Two::Le,
    Two::Gt,
    Two::Ge,
    Two::Shl,
    Two::Shr,
];

enum State {
    Register {
        next: usize,
        enable: Option<usize>,
        reset: Option<u128>,
    },
    Read {
        memory: usize,
        address: usize,
    },
}

struct Stored {
    depth: u32,
    write: [usize; 3],
}

/// A random module: as it was described to the layer, and for the interpreter.
struct Random {
    module: Arc<Module>,
    nets: Vec<(Net, u32)>,
    states: Vec<State>,
    memories: Vec<Stored>,
    instances: Vec<(Arc<Random>, Vec<usize>)>,
    /// Name, width, and stage in a pipeline.
    inputs: Vec<(String, u32, u32)>,
    outputs: Vec<(String, usize)>,
}

fn mask(width: u32) -> u128 {
    u128::MAX >> (128 - width)
}

/// Makes a random module by telling the layer and the interpreter the same.
struct Maker<'b, 'r> {
    m: &'b Builder,
    rng: &'r mut fastrand::Rng,
    signals: Vec<Signal<'b>>,
    /// Nets that are in both descriptions, and no constants: these would breed.
    pool: Vec<usize>,
    nets: Vec<(Net, u32)>,
    states: Vec<State>,
    memories: Vec<Stored>,
    instances: Vec<(Arc<Random>, Vec<usize>)>,
    names: usize,
}

impl<'b> Maker<'b, '_> {
    fn add(&mut self, net: Net, signal: Signal<'b>) -> usize {
        let signal = if self.rng.u32(..6) == 0 {
            self.names += 1;
            signal.named(format!("n{}", self.names))
        } else {
            signal
        };
        self.plain(net, signal)
    }

    fn plain(&mut self, net: Net, signal: Signal<'b>) -> usize {
        if signal.literal().is_none() {
            self.pool.push(self.nets.len());
        }
        self.nets.push((net, signal.width()));
        self.signals.push(signal);
        self.nets.len() - 1
    }

    fn width(&self, net: usize) -> u32 {
        self.nets[net].1
    }

    /// Any net, the later the likelier.
    fn any(&mut self) -> usize {
        let n = self.pool.len();
        self.pool[self.rng.usize(..n).max(self.rng.usize(..n))]
    }

    fn part(&mut self, net: usize, width: u32) -> usize {
        let low = self.rng.u32(..=self.width(net) - width);
        self.add(Net::Part(net, low), self.signals[net].field(low, width))
    }

    fn literal(&mut self, width: u32) -> usize {
        let value = match self.rng.u32(..4) {
            0 => 0,
            1 => mask(width),
            2 => self.rng.u128(..4) & mask(width),
            _ => self.rng.u128(..) & mask(width),
        };
        self.plain(Net::Literal(value), self.m.lit(value, width))
    }

    /// A net of a width.
    fn of(&mut self, width: u32) -> usize {
        if self.rng.u32(..12) == 0 {
            return self.literal(width);
        }
        let net = self.any();
        let have = self.width(net);
        if have > width {
            return self.part(net, width);
        }
        if have == width {
            return net;
        }
        match self.rng.u32(..3) {
            0 => {
                let zeros = self.literal_zero(width - have);
                let signal = self.signals[net].extend(width);
                self.add(Net::Concat(vec![zeros, net]), signal)
            }
            1 => {
                let times = width.div_ceil(have);
                if times * have > 128 {
                    return self.input_bit(width);
                }
                let signal = self.signals[net].repeat(times);
                let repeated = self.add(Net::Concat(vec![net; times as usize]), signal);
                self.part(repeated, width)
            }
            _ => {
                let rest = self.of(width - have);
                let signal = self.m.concat(&[self.signals[rest], self.signals[net]]);
                self.add(Net::Concat(vec![rest, net]), signal)
            }
        }
    }

    fn literal_zero(&mut self, width: u32) -> usize {
        self.plain(Net::Literal(0), self.m.zero(width))
    }

    /// Of the operations without state, one.
    fn operation(&mut self) {
        let a = self.any();
        let (x, width) = (self.signals[a], self.width(a));
        match self.rng.u32(..22) {
            0..12 => {
                let op = TWO[self.rng.usize(..TWO.len())];
                let (a, b) = match op {
                    Two::Mul => {
                        let widths = [self.rng.u32(1..=64), self.rng.u32(1..=36)];
                        (self.of(widths[0]), self.of(widths[1]))
                    }
                    Two::Shl | Two::Shr => {
                        let width = self.rng.u32(1..=9);
                        (a, self.of(width))
                    }
                    Two::Lt | Two::Le | Two::Gt | Two::Ge => {
                        let b = match self.rng.u32(..4) {
                            0 => self.literal(width),
                            _ => self.varied(width),
                        };
                        (self.varied(width), b)
                    }
                    _ => (a, self.of(width)),
                };
                let (x, y) = (self.signals[a], self.signals[b]);
                let signal = match op {
                    Two::And => x & y,
                    Two::Or => x | y,
                    Two::Xor => x ^ y,
                    Two::Add => x + y,
                    Two::Sub => x - y,
                    Two::Mul => x.mul(y),
                    Two::Eq => x.eq(y),
                    Two::Ne => x.ne(y),
                    Two::Lt => x.lt(y),
                    Two::Le => x.le(y),
                    Two::Gt => x.gt(y),
                    Two::Ge => x.ge(y),
                    Two::Shl => x.shl(y),
                    Two::Shr => x.shr(y),
                };
                self.add(Net::Two(op, a, b), signal);
            }
            12 | 13 => {
                self.add(Net::Not(a), !x);
            }
            14 => {
                self.add(Net::Any(a), x.any());
            }
            15 => {
                self.add(Net::All(a), x.all());
            }
            16 => {
                self.add(Net::Parity(a), x.parity());
            }
            17 => {
                let width = self.rng.u32(1..=width);
                self.part(a, width);
            }
            18 => {
                let mut parts = vec![];
                let mut total = 0;
                for _ in 0..self.rng.u32(2..6) {
                    let part = self.any();
                    if total + self.width(part) <= 120 {
                        total += self.width(part);
                        parts.push(part);
                    }
                }
                if parts.len() > 1 {
                    let signals: Vec<_> = parts.iter().map(|p| self.signals[*p]).collect();
                    let signal = self.m.concat(&signals);
                    self.add(Net::Concat(parts), signal);
                }
            }
            _ => {
                let (condition, b) = (self.of(1), self.of(width));
                let signal = self.signals[condition].mux(x, self.signals[b]);
                self.add(Net::Mux(condition, a, b), signal);
            }
        }
    }

    fn state(&mut self, state: State, signal: Signal<'b>) -> usize {
        self.states.push(state);
        self.add(Net::State(self.states.len() - 1), signal)
    }

    /// An operation with state, or a choice of the layer's composite ones.
    fn stateful(&mut self) {
        match self.rng.u32(..6) {
            0 => {
                let mut net = self.any();
                if self.signals[net].literal().is_some() {
                    return; // the layer knows no time at which a constant is not one
                }
                let clocks = self.rng.u32(1..8);
                let delayed = self.signals[net].delay(clocks);
                for clock in 1..=clocks {
                    let state = State::Register {
                        next: net,
                        enable: None,
                        reset: None,
                    };
                    self.states.push(state);
                    let signal = self.signals[net].delay(1);
                    if clock < clocks {
                        net = self.plain(Net::State(self.states.len() - 1), signal);
                    } else {
                        net = self.add(Net::State(self.states.len() - 1), delayed);
                    }
                }
            }
            1 => {
                let driver = self.any();
                self.names += 1;
                let wire = self.m.wire(format!("w{}", self.names), self.width(driver));
                self.add(Net::Same(driver), wire.get());
                wire.drive(self.signals[driver]);
            }
            2 => {
                let count = self.rng.u32(2..6);
                let width = self.rng.u32(1..=40);
                let choices: Vec<usize> = (0..count).map(|_| self.of(width)).collect();
                let index = self.of(3);
                let signals: Vec<_> = choices.iter().map(|c| self.signals[*c]).collect();
                let signal = self.m.select(self.signals[index], &signals);
                // The interpreter's own: the last choice, then the others from it back to the first.
                let mut chosen = choices[choices.len() - 1];
                for (i, choice) in choices.iter().enumerate().rev().skip(1) {
                    let number = Net::Literal(i as u128);
                    let number = self.silent(number, 3);
                    let same = self.silent(Net::Two(Two::Eq, index, number), 1);
                    chosen = self.silent(Net::Mux(same, *choice, chosen), width);
                }
                self.add(Net::Same(chosen), signal);
            }
            3 => {
                // One memory; 2 to the power of its address bits deep, for what is past the depth is undefined.
                let (bits, width) = (self.rng.u32(1..6), self.rng.u32(1..=70));
                let now = self.rng.bool();
                let style = if now {
                    Style::Distributed
                } else {
                    Style::Block
                };
                self.names += 1;
                let memory = self
                    .m
                    .memory(format!("m{}", self.names), 1 << bits, width, style);
                let write = [self.of(1), self.variable(bits), self.of(width)];
                let [e, a, d] = write.map(|net| self.signals[net]);
                memory.write(e, a, d);
                self.memories.push(Stored {
                    depth: 1 << bits,
                    write,
                });
                let index = self.memories.len() - 1;
                for _ in 0..self.rng.u32(1..4) {
                    let address = self.variable(bits);
                    let at = self.signals[address];
                    if now && self.rng.bool() {
                        self.add(Net::ReadNow(index, address), memory.read_now(at));
                    } else {
                        let state = State::Read {
                            memory: index,
                            address,
                        };
                        self.state(state, memory.read(at));
                    }
                }
            }
            _ => self.operation(),
        }
    }

    /// A net of a width that is no constant, and in a pipeline has a stage: one bit of an input, repeated.
    fn input_bit(&mut self, width: u32) -> usize {
        let bit = self.part(0, 1);
        let signal = self.signals[bit].repeat(width);
        self.add(Net::Concat(vec![bit; width as usize]), signal)
    }

    /// A net of which no bit is a register's own: tools rightly object to a register that only ever keeps itself,
    /// and to a comparison that never changes.
    fn varied(&mut self, width: u32) -> usize {
        let (value, changes) = (self.of(width), self.input_bit(width));
        let signal = self.signals[value] ^ self.signals[changes];
        match signal.literal() {
            Some(_) => changes,
            None => self.add(Net::Two(Two::Xor, value, changes), signal),
        }
    }

    /// A net of a width that is no constant: an address that is one is no memory's, and an instance must be told
    /// its stage.
    fn variable(&mut self, width: u32) -> usize {
        let net = self.of(width);
        match self.signals[net].literal() {
            Some(_) => self.input_bit(width),
            None => net,
        }
    }

    fn instance(&mut self, child: &Arc<Random>, staged: bool) {
        let mut inputs = vec![];
        for (i, (_, width, _)) in child.inputs.iter().enumerate() {
            // One input says at which stage the instance is.
            let net = if staged && i == 0 {
                self.variable(*width)
            } else {
                self.of(*width)
            };
            inputs.push(net);
        }
        let ports: Vec<_> = child
            .inputs
            .iter()
            .map(|(name, ..)| name.as_str())
            .collect();
        let signals = inputs.iter().map(|net| self.signals[*net]);
        let given: Vec<_> = ports.into_iter().zip(signals).collect();
        self.names += 1;
        let out = self
            .m
            .instance(format!("i{}", self.names), &child.module, &given);
        self.instances.push((child.clone(), inputs));
        for (index, (name, _)) in child.outputs.iter().enumerate() {
            let net = Net::Instance(self.instances.len() - 1, index);
            self.plain(net, out.get(name));
        }
    }

    /// A net of the interpreter alone.
    fn silent(&mut self, net: Net, width: u32) -> usize {
        self.nets.push((net, width));
        self.signals.push(self.m.zero(width));
        self.nets.len() - 1
    }
}

fn random_module(
    name: &str,
    rng: &mut fastrand::Rng,
    pipelined: bool,
    below: &[Arc<Random>],
) -> Arc<Random> {
    let m = Builder::new(name, "a random module.");
    let mut maker = Maker {
        m: &m,
        signals: vec![],
        pool: vec![],
        nets: vec![],
        states: vec![],
        memories: vec![],
        instances: vec![],
        names: 0,
        rng,
    };
    let p = m.pipeline();
    let mut inputs = vec![];
    for i in 0..maker.rng.u32(2..6) {
        let width = maker.rng.u32(1..=70);
        let name = format!("x{i}");
        let stage = if pipelined && i > 0 {
            maker.rng.u32(..4)
        } else {
            0
        };
        let signal = if pipelined {
            p.input_at(&name, width, stage)
        } else {
            m.input(&name, width)
        };
        inputs.push((name, width, stage));
        maker.plain(Net::Input(i as usize), signal);
    }
    let mut registers = vec![];
    if !pipelined {
        for i in 0..maker.rng.u32(..5) {
            let width = maker.rng.u32(1..=70);
            let reset = maker.rng.bool().then(|| maker.rng.u128(..) & mask(width));
            let name = format!("r{i}");
            let register = match reset {
                Some(value) => m.reg_reset(name, width, value),
                None => m.reg(name, width),
            };
            registers.push((register, maker.states.len()));
            maker.states.push(State::Register {
                next: 0,
                enable: None,
                reset,
            });
            maker.plain(Net::State(maker.states.len() - 1), register.q);
        }
    }
    let steps = maker.rng.u32(10..50);
    for _ in 0..steps {
        match maker.rng.u32(..8) {
            0 | 1 if !pipelined => maker.stateful(),
            0 | 1 => {
                let net = maker.any();
                let clocks = maker.rng.u32(1..7);
                maker.add(Net::Same(net), maker.signals[net].delay(clocks));
            }
            2 if !below.is_empty() && maker.rng.u32(..4) == 0 => {
                let child = &below[maker.rng.usize(..below.len())];
                maker.instance(child, pipelined);
            }
            _ => maker.operation(),
        }
    }
    for (register, state) in registers {
        let width = register.q.width();
        let value = maker.varied(width);
        let enabled = maker.rng.bool().then(|| maker.varied(1));
        match enabled {
            Some(net) => register.next_when(maker.signals[net], maker.signals[value]),
            None => register.next(maker.signals[value]),
        }
        if let State::Register { next, enable, .. } = &mut maker.states[state] {
            (*next, *enable) = (value, enabled);
        }
    }
    let mut outputs = vec![];
    while outputs.len() < 4 {
        let net = maker.any();
        if !pipelined || maker.signals[net].staged().is_some() {
            let name = format!("y{}", outputs.len());
            m.output(&name, maker.signals[net]);
            outputs.push((name, net));
        }
    }
    let Maker {
        nets,
        states,
        memories,
        instances,
        ..
    } = maker;
    Arc::new(Random {
        module: m.finish().unwrap(),
        nets,
        states,
        memories,
        instances,
        inputs,
        outputs,
    })
}

/// Runs a random module clock by clock; registers and memories begin as zero.
struct Interpreter {
    random: Arc<Random>,
    values: Vec<u128>,
    states: Vec<u128>,
    memories: Vec<Vec<u128>>,
    instances: Vec<Interpreter>,
}

impl Interpreter {
    fn new(random: &Arc<Random>) -> Interpreter {
        let memories = random.memories.iter();
        Interpreter {
            values: vec![0; random.nets.len()],
            states: vec![0; random.states.len()],
            memories: memories.map(|m| vec![0; m.depth as usize]).collect(),
            instances: random
                .instances
                .iter()
                .map(|(child, _)| Interpreter::new(child))
                .collect(),
            random: random.clone(),
        }
    }

    /// The outputs that follow from the inputs and the state.
    fn outputs(&mut self, inputs: &[u128]) -> Vec<u128> {
        let random = self.random.clone();
        for (net, (kind, width)) in random.nets.iter().enumerate() {
            let v = &self.values;
            let value = match kind {
                Net::Input(i) => inputs[*i],
                Net::Literal(value) => *value,
                Net::Same(a) => v[*a],
                Net::Not(a) => !v[*a],
                Net::Two(op, a, b) => {
                    let (a, b) = (v[*a], v[*b]);
                    match op {
                        Two::And => a & b,
                        Two::Or => a | b,
                        Two::Xor => a ^ b,
                        Two::Add => a.wrapping_add(b),
                        Two::Sub => a.wrapping_sub(b),
                        Two::Mul => a.wrapping_mul(b),
                        Two::Eq => (a == b).into(),
                        Two::Ne => (a != b).into(),
                        Two::Lt => (a < b).into(),
                        Two::Le => (a <= b).into(),
                        Two::Gt => (a > b).into(),
                        Two::Ge => (a >= b).into(),
                        Two::Shl => a.checked_shl(b as u32).unwrap_or(0),
                        Two::Shr => a.checked_shr(b as u32).unwrap_or(0),
                    }
                }
                Net::Mux(c, a, b) => v[if v[*c] == 1 { *a } else { *b }],
                Net::Concat(parts) => parts
                    .iter()
                    .fold(0, |all, part| all << random.nets[*part].1 | v[*part]),
                Net::Part(a, low) => v[*a] >> low,
                Net::Any(a) => (v[*a] != 0).into(),
                Net::All(a) => (v[*a] == mask(random.nets[*a].1)).into(),
                Net::Parity(a) => u128::from(v[*a].count_ones() % 2),
                Net::State(state) => self.states[*state],
                Net::ReadNow(memory, address) => self.memories[*memory][v[*address] as usize],
                Net::Instance(instance, output) => {
                    let (child, inputs) = &random.instances[*instance];
                    let interpreter = &mut self.instances[*instance];
                    if *output == 0 {
                        let given: Vec<u128> = inputs.iter().map(|net| v[*net]).collect();
                        interpreter.outputs(&given);
                    }
                    interpreter.values[child.outputs[*output].1]
                }
            };
            self.values[net] = value & mask(*width);
        }
        let outputs = random.outputs.iter();
        outputs.map(|(_, net)| self.values[*net]).collect()
    }

    /// A clock edge, with the inputs that [`Interpreter::outputs`] was given last.
    fn clock(&mut self, rst: bool) {
        let v = &self.values;
        let random = self.random.clone();
        for (state, kind) in self.states.iter_mut().zip(&random.states) {
            match kind {
                State::Register {
                    reset: Some(value), ..
                } if rst => *state = *value,
                State::Register { next, enable, .. } => {
                    if enable.is_none_or(|enable| v[enable] == 1) {
                        *state = v[*next];
                    }
                }
                State::Read { memory, address } => {
                    *state = self.memories[*memory][v[*address] as usize];
                }
            }
        }
        for (words, memory) in self.memories.iter_mut().zip(&random.memories) {
            let [enable, address, data] = memory.write.map(|net| v[net]);
            if enable == 1 {
                words[address as usize] = data;
            }
        }
        for instance in &mut self.instances {
            instance.clock(rst);
        }
    }
}

/// Random modules, all operators and kinds of state, with modules in modules: Verilator computes in every clock and
/// every bit what an interpreter computes that knows neither pipelines nor Verilog.
#[test]
fn random_modules_compute_what_was_described() {
    const STATEFUL: usize = 40;
    const PIPELINED: usize = 24;
    const CLOCKS: usize = 600;
    const BUSES: usize = 8;
    const BUS: u32 = 72;
    let mut rng = fastrand::Rng::with_seed(seed());
    let (mut stateful, mut pipelined) = (vec![], vec![]);
    for i in 0..STATEFUL {
        let random = random_module(&format!("stateful{i}"), &mut rng, false, &stateful);
        stateful.push(random);
    }
    for i in 0..PIPELINED {
        let random = random_module(&format!("pipelined{i}"), &mut rng, true, &pipelined);
        pipelined.push(random);
    }

    let top = Builder::new("random_modules", "all of them, side by side.");
    let buses: Vec<_> = (0..BUSES)
        .map(|i| top.input(format!("bus{i}"), BUS))
        .collect();
    // For each module the bus that each of its inputs has, and from which bit on.
    let mut wiring: Vec<Vec<(usize, u32)>> = vec![];
    for random in stateful.iter().chain(&pipelined) {
        let mut inputs = vec![];
        let mut from = vec![];
        for (port, width, _) in &random.inputs {
            let (bus, low) = (rng.usize(..BUSES), rng.u32(..=BUS - width));
            inputs.push((port.as_str(), buses[bus].field(low, *width)));
            from.push((bus, low));
        }
        wiring.push(from);
        let name = random.module.name();
        let out = top.instance(format!("the_{name}"), &random.module, &inputs);
        for (port, _) in &random.outputs {
            top.output(format!("{name}_{port}"), out.get(port));
        }
    }
    let mut model = Verilated::new(top.finish().unwrap());
    let ports: Vec<_> = (0..BUSES).map(|i| model.port(&format!("bus{i}"))).collect();
    let all: Vec<_> = stateful.iter().chain(&pipelined).collect();
    let outputs: Vec<Vec<_>> = all
        .iter()
        .map(|random| {
            let name = random.module.name();
            let ports = random.outputs.iter();
            ports
                .map(|(port, _)| model.port(&format!("{name}_{port}")))
                .collect()
        })
        .collect();

    let mut interpreters: Vec<_> = all.iter().map(|random| Interpreter::new(random)).collect();
    let mut history: Vec<[u128; BUSES]> = vec![];
    let mut compared = 0u64;
    let mut ones = 0u64;
    for clock in 0..CLOCKS {
        let rst = clock < 3 || rng.u32(..60) == 0;
        model.set("rst", rst.into());
        let mut values = [0; BUSES];
        for (value, port) in values.iter_mut().zip(&ports) {
            *value = mask(BUS)
                & match rng.u32(..8) {
                    0 => 0,
                    1 => u128::MAX,
                    2 => 1 << rng.u32(..BUS),
                    3 => history.last().map_or(0, |last| last[0]),
                    _ => rng.u128(..),
                };
            model.set_wide(*port, *value);
        }
        history.push(values);
        model.model.eval();
        for (index, random) in all.iter().enumerate() {
            let input = |port: usize, at: usize| {
                let (bus, low) = wiring[index][port];
                let width = random.inputs[port].1;
                let then = history.get(at).map_or(0, |buses| buses[bus]);
                then >> low & mask(width)
            };
            let ports = 0..random.inputs.len();
            let interpreter = &mut interpreters[index];
            for (output, (name, _)) in random.outputs.iter().enumerate() {
                // A pipeline's output is of inputs that came as much earlier as its stage is later than theirs.
                let latency = random.module.port(name).unwrap().stage;
                let entered = match latency {
                    Some(latency) => match clock.checked_sub(latency as usize) {
                        Some(entered) => entered,
                        None => continue,
                    },
                    None => clock,
                };
                let inputs: Vec<u128> = ports
                    .clone()
                    .map(|port| input(port, entered + random.inputs[port].2 as usize))
                    .collect();
                let expected = interpreter.outputs(&inputs)[output];
                let computed = model.get_wide(outputs[index][output]);
                assert_eq!(
                    computed,
                    expected,
                    "{}.{name} in clock {clock}: {computed:x}, not {expected:x}\n{}\n{:?}",
                    random.module.name(),
                    random.module.verilog(),
                    random.nets.iter().enumerate().collect::<Vec<_>>()
                );
                compared += 1;
                ones += u64::from(expected.count_ones());
            }
            interpreter.clock(rst);
        }
        model.clock();
    }
    let nets: usize = all.iter().map(|random| random.nets.len()).sum();
    eprintln!(
        "{} random modules of {nets} nets: {compared} outputs compared, {ones} bits of them 1",
        all.len()
    );
    let least = (all.len() * CLOCKS * 3) as u64;
    assert!(compared > least && ones > least, "too little was compared");
}

// ---------------------------------------------------------------------------------------------------------------
// Changes

/// Has a place for every kind of change.
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

/// The lines that a change brings, but for what gathers the bits that nothing reads.
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
        // Of an instance, and of two clocks before.
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
        // Behind named signals, of which whoever else reads them sees nothing.
        (
            kept.reads(a).as_value(7),
            "wire [3:0] sum_2 = {3'd3, 1'b0} + 4'd5; \
             if (rst) kept <= 4'd2; else if (~sum_2[0] ? (4'd7 < 4'd3) : (|4'd7)) kept <= sum_d2;",
        ),
        // Wherever it is read.
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
        // What is made later is declared where it is read.
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

/// A description's changes are those of the finished module, and mistakes in them are its mistakes.
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

    let not_read = "what is to be changed is not read there";
    mistake(not_read, |m| {
        let (a, b) = (m.input("a", 4), m.input("b", 4));
        let (sum, c) = ((a + b).named("sum"), m.input("c", 4));
        m.output("y", sum ^ c);
        next_line();
        sum.reads(c).as_value(0);
    });
    mistake("16 does not fit 4 bits", |m| {
        let a = m.input("a", 4);
        m.output("y", !a);
        next_line();
        a.fault().as_value(16);
    });
    mistake("what is read there is no delay", |m| {
        let a = m.input("a", 4);
        m.output("y", !a);
        next_line();
        a.fault().one_clock_early();
    });
    mistake("2 bits cannot be read for 4", |m| {
        let (a, b) = (m.input("a", 4), m.input("b", 2));
        m.output("y", !a);
        next_line();
        a.fault().as_signal(b);
    });
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
        "it has no signal \"choosen\"; it has chosen",
    );
    let below = module.instances_of("follower")[0];
    has(
        below.input("y").map(drop).unwrap_err(),
        "instance below has no input \"y\"",
    );
    has(
        design.module("followers").unwrap_err(),
        "below it is no module \"followers\"; it has follower",
    );
    let sum = module.signal("sum").unwrap();
    let chosen = module.signal("chosen").unwrap();
    // It would be made of itself.
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
        "what is read is a signal of another module",
    );
}

/// With a change selected by its number a design does what the design with this change alone does, in every clock and every bit.
#[test]
fn a_selected_change_is_the_change() {
    const CLOCKS: usize = 1000;
    let mut rng = fastrand::Rng::with_seed(seed());
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
        // Where an input selects, registers begin as what the reset does not give that they have without changes.
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
                // A change may be that nothing is reset.
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
