//! The README contains the examples and their output.

#[path = "../../examples/counter.rs"]
mod counter;
#[path = "../../examples/fifo.rs"]
mod fifo;
#[path = "../../examples/multiply_add.rs"]
mod multiply_add;

use dynrt_hdl::{Design, HdlError};
use dynrt_verilated::model::{Sources, lint};

/// An example's name, its source, and the function that returns its output.
type Example = (&'static str, &'static str, fn() -> Result<String, HdlError>);

const EXAMPLES: [Example; 3] = [
    (
        "counter",
        include_str!("../../examples/counter.rs"),
        counter::verilog,
    ),
    (
        "multiply_add",
        include_str!("../../examples/multiply_add.rs"),
        multiply_add::verilog,
    ),
    (
        "fifo",
        include_str!("../../examples/fifo.rs"),
        fifo::verilog,
    ),
];

#[test]
fn the_readme_shows_the_examples_and_what_they_print() {
    let readme = include_str!("../../README.md");
    for (name, source, verilog) in EXAMPLES {
        let (_, code) = source.split_at(source.find("use ").unwrap());
        let printed = verilog().unwrap();
        let shown = format!("```rust\n{code}```\n\nIt prints:\n\n```verilog\n{printed}```\n");
        assert!(
            readme.contains(&shown),
            "README.md must show example {name} so:\n{shown}"
        );
    }
}

#[test]
fn the_examples_pass_lint() {
    let modules = [
        counter::counter(8),
        multiply_add::multiply_add(8),
        fifo::two(),
    ];
    for module in modules {
        lint(&Sources::of(&Design::new(module.unwrap()).unwrap())).unwrap();
    }
}

#[test]
fn the_fifo_has_a_proof_and_a_fault_of_it() {
    let fifo = fifo::fifo(4, 8).unwrap();
    let proof = &fifo.proofs()[0];
    assert_eq!((proof.asserts.len(), proof.covers.len()), (3, 1));
    let formal = fifo.formal("order", &str::to_string).unwrap();
    assert_eq!(formal.asserts.len(), 3);
    let (_, fault) = &proof.faults[0];
    fifo.with(fault).unwrap();
}
