//! Writes the properties as files for other tools: SystemVerilog for Yosys, and one SymbiYosys task per proof.

use super::UNITS;
use super::induction::{self, Induction};
use crate::config::Config;
use crate::hdl::Prefix;
use anyhow::Result;
use serde_json::{Value, json};
use std::fmt::Write as _;

use crate::emit::FORMAL as FOLDER;

/// Every proof by induction of a machine as two files, and their description in the manifest.
///
/// # Errors
/// If the description of a unit is rejected.
pub fn files(config: &Config, prefix: &Prefix) -> Result<(Vec<(String, String)>, Value)> {
    let emitted = |name: &str| format!("{}{name}", prefix.as_str());
    let mut files: Vec<(String, String)> = vec![];
    let mut proofs = vec![];
    // The cache is not part of a machine yet.
    for (unit, _) in UNITS.iter().filter(|(unit, _)| *unit != induction::CACHE) {
        for proof in induction::proofs(unit, config)? {
            let module = emitted(proof.module.name());
            let name = format!("{module}_{}", proof.proof.name);
            // Another instance of the same module has files of its own.
            let same = |name: &str| files.iter().any(|(file, _)| *file == source_of(name));
            let numbered = (2..).map(|number| format!("{name}_{number}"));
            let mut names = std::iter::once(name.clone()).chain(numbered);
            let name = names.find(|name| !same(name)).expect("a free name");
            let formal = proof.module.formal(&proof.proof.name, &emitted)?;
            let (source, task) = (source_of(&name), format!("{FOLDER}/{name}.sby"));
            let mut head = format!(
                "// The module {module} with its properties: {}.\n",
                proof.proof.what
            );
            for (key, value) in proof.few {
                let _ = writeln!(
                    head,
                    "// For a machine with {key} = {value}: larger values are hard for the solver."
                );
            }
            files.push((source.clone(), format!("{head}{}", formal.text)));
            files.push((task.clone(), task_of(&proof, &name, &module, &formal.cut)));
            proofs.push(json!({
                "unit": unit,
                "module": module,
                "proof": proof.proof.name,
                "what": proof.proof.what,
                "source": source,
                "task": task,
                "assumes": proof.proof.assumes,
                "asserts": proof.proof.asserts,
                "covers": proof.proof.covers,
            }));
        }
    }
    let names: Vec<&String> = files.iter().map(|(name, _)| name).collect();
    let described = json!({"files": names, "proofs": proofs});
    Ok((files, described))
}

/// The file of a proof.
fn source_of(name: &str) -> String {
    format!("{FOLDER}/{name}.sv")
}

/// One task that proves by induction, and one that shows the covers.
fn task_of(proof: &Induction, name: &str, module: &str, cut: &[String]) -> String {
    let script = proof
        .script(&format!("{name}.sv"), module, cut)
        .replace("; ", "\n");
    // As in the proofs here: z3 is minutes slower on wide registers without --unroll.
    let options = match proof.proof.arrays {
        true => "--nopresat",
        false => "--nomem --nopresat --unroll",
    };
    format!(
        "# SymbiYosys: sby -f {name}.sby\n\
         [tasks]\nprove\ncover\n\n\
         [options]\nprove: mode prove\nprove: depth {}\ncover: mode cover\ncover: depth {}\n\n\
         [engines]\nsmtbmc {options} z3\n\n\
         [script]\n{script}\n\n\
         [files]\n{name}.sv\n",
        proof.proof.depth + 1,
        induction::SOON,
    )
}
