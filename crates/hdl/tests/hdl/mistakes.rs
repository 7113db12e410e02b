//! The exact error messages of mistakes.

use dynrt_hdl::{Builder, Design, HdlError, Module, Signal, Style};
use std::cell::Cell;
use std::panic::Location;
use std::sync::Arc;

thread_local! {
    static PLACE: Cell<(&str, u32)> = const { Cell::new(("", 0)) };
}

/// The place of a mistake in the line after this call.
#[track_caller]
pub fn next_line() {
    let place = Location::caller();
    PLACE.set((place.file(), place.line() + 1));
}

/// The exact message of a module with a mistake.
#[track_caller]
pub fn mistake(expected: &str, describe: impl FnOnce(&Builder)) {
    let m = Builder::new("broken", "has a mistake.");
    describe(&m);
    let error = m.finish().expect_err("the mistake was not seen");
    said(&error, "broken", expected);
}

#[track_caller]
pub fn said(error: &HdlError, module: &str, expected: &str) {
    let (file, line) = PLACE.get();
    assert_eq!(
        error.to_string(),
        format!("{file}:{line}: module {module}: {expected}")
    );
}

/// A module whose only output follows its input without a register.
pub fn follower() -> Arc<Module> {
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
    mistake(
        "width mismatch: a multiplexer is selected by 1 bit, \"c\" has 2",
        |m| {
            let (c, a) = (m.input("c", 2), m.input("a", 8));
            next_line();
            let _ = c.mux(a, !a);
        },
    );
    mistake(
        "width mismatch: a multiplexer of 8 bits (\"a\") and 7 bits (\"b\")",
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
    mistake("width mismatch: an enable has 1 bit, \"e\" has 2", |m| {
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
    mistake("\"a\" has no bits 8 to 1: it has 8 bits", |m| {
        let a = m.input("a", 8);
        next_line();
        a.bits(8, 1);
    });
    mistake("\"a\" has no bits 1 to 2: it has 8 bits", |m| {
        let a = m.input("a", 8);
        next_line();
        a.bits(1, 2);
    });
    mistake("\"a\" has no 4 bits from bit 6: it has 8 bits", |m| {
        let a = m.input("a", 8);
        next_line();
        a.field(6, 4);
    });
    mistake("\"a\" has no 9 bits from bit 0: it has 8 bits", |m| {
        let a = m.input("a", 8);
        next_line();
        a.high(9);
    });
    mistake("\"a\" has 8 bits, cannot be extended to 7", |m| {
        let a = m.input("a", 8);
        next_line();
        a.extend(7);
    });
    mistake("a signal must have at least 1 bit", |m| {
        next_line();
        m.input("a", 0).msb();
    });
    mistake("16 does not fit in 4 bits", |m| {
        next_line();
        m.lit(16u8, 4);
    });
    mistake("reset of \"r\": 16 does not fit in 4 bits", |m| {
        next_line();
        m.reg_reset("r", 4, 16);
    });
    mistake("a reduction needs at least one signal", |m| {
        next_line();
        m.and_all(&[]);
    });
    mistake("a selection needs at least one choice", |m| {
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
    mistake(
        "width mismatch: a write enable has 1 bit, \"e\" has 2",
        |m| {
            let store = m.memory("store", 48, 8, Style::Block);
            let (e, a, d) = (m.input("e", 2), m.input("a", 6), m.input("d", 8));
            next_line();
            store.write(e, a, d);
        },
    );
    mistake(
        "memory \"store\" has 0 words of 8 bits; both must be at least 1",
        |m| {
            next_line();
            m.memory("store", 0, 8, Style::Block);
        },
    );
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

/// A module whose output y follows x through an instance, whose output z follows other, and whose r is a register of x.
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
    mistake(&format!("\"w\" is driven twice: {first}"), |m| {
        let x = m.input("x", 4);
        let w = m.wire("w", 4);

        w.drive(x);
        next_line();
        w.drive(!x);
    });
    let line = line!() + 6;
    let first = format!("first at {}:{line}", file!());
    mistake(&format!("\"r\" is driven twice: {first}"), |m| {
        let x = m.input("x", 4);
        let r = m.reg("r", 4);

        r.next(x);
        next_line();
        r.next_when(x.bit(0), x);
    });
    let line = line!() + 7;
    let first = format!("it has one write port, used at {}:{line}", file!());
    mistake(
        &format!("memory \"store\" is written twice: {first}"),
        |m| {
            let (a, e) = (m.input("a", 4), m.input("e", 1));
            let store = m.memory("store", 16, 4, Style::Block);
            store.write(e, a, a);
            next_line();
            store.write(!e, a, a);
        },
    );
    mistake("instance i: input x is driven twice", |m| {
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
    // The wires of an instance's outputs are named after the instance and the port.
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
        let text = format!(
            "\"{name}\" is not a valid name: use lower-case letters, digits and _, and no Verilog keyword"
        );
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
    // Two identical descriptions give the same module.
    let design = Design::new(outer(false)).unwrap();
    let names: Vec<_> = design.modules().iter().map(|m| m.name()).collect();
    assert_eq!(names, ["inner", "outer"]);
    let error = Design::new(outer(true)).unwrap_err();
    let place = format!("{}:{}", file!(), PLACE.get().1);
    said(
        &error,
        "inner",
        &format!("name clash: a different module of this name was made at {place}"),
    );
}

#[test]
fn stages_do_not_mix() {
    mistake(
        "\"a1\" and \"b\" are in different pipelines: move one to the other with untimed and enter_at",
        |m| {
            // At different stages, in both orders.
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
        "\"a\" has a stage, \"b\" has none: give it one with enter_at, or use untimed",
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
    mistake("\"b\" has no stage: it is not in a pipeline", |m| {
        let (a, b) = (m.pipeline().input("a", 4), m.input("b", 4));
        next_line();
        m.output("y", a.at(b.stage()));
    });
    let child = Builder::new("child", "has no pipeline.");
    child.output("y", !child.input("x", 4));
    let child = child.finish().unwrap();
    let stage = child.stage("x").unwrap_err();
    assert!(stage.place.file().ends_with("mistakes.rs"));
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
    mistake("\"b\" is not in a pipeline", |m| {
        let b = m.input("b", 4);
        next_line();
        b.at(3);
    });
    mistake("\"late\" is at stage 4, after stage 3", |m| {
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
        "instance i of adder: \"b\" has no stage, but other inputs have one",
        |m| {
            let (a, b) = (m.pipeline().input("a", 4), m.input("b", 4));
            let adder = adder();
            next_line();
            m.instance("i", &adder, &[("a", a), ("b", b)]);
        },
    );
    mistake("instance i: inputs are from different pipelines", |m| {
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
            "port \"y\" is connected to a signal of module other",
            |m, _, x, _| {
                next_line();
                m.output("y", x);
            },
        ),
        (
            "instance i: input x is connected to a signal of module other",
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
