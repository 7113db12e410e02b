//! Queues, credits, the stack and ports, by induction.
//!
//! Laws are added to the text of an emitted module before its `endmodule`, which is the only thing that is changed of
//! it: so they can speak of what is inside, of memories too, and through `hierconn` wires of the queues that it places.
//! Yosys makes a transition system, `yosys-smtbmc` with z3 shows that no law fails in the first clocks after reset, and
//! that if all hold for that many clocks they hold in the next: so they hold for ever. What the laws do not depend on is
//! removed. Arithmetic inside a module is replaced by outputs of any value.

mod geometry;
mod queues;
mod raycast;
mod skinning;
mod traversal;
mod update;

use super::Outcome;
use super::tools::{self, Ended};
use crate::config::Config;
use crate::emit;
use crate::hdl::{Direction, Module, bits_for};
use anyhow::{Context, Result, bail, ensure};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// What z3 may take for each of base and step.
const LIMIT: Duration = Duration::from_secs(240);

/// Packets of the machine on which their conservation is proved. The sum of what is in nine queues is hard for a solver
/// where they are deep; the description is the same for any number of packets.
const FEW_PACKETS: u32 = 4;

/// The last stage of a proof: that it is not about nothing.
const HAPPENS: &str = "what can happen";

/// Clocks after reset in which what a proof is about must be seen to happen.
const SOON: u32 = 40;

/// An edit of an emitted module: in the one line that contains `line`, what follows it first as `from` becomes `to`.
#[derive(Clone, Debug)]
pub struct Edit {
    pub line: String,
    pub from: String,
    pub to: String,
}

type Plant = super::Plant<Edit>;

/// Makes an edit.
///
/// # Errors
/// If the text has no such line, or several.
fn edited(text: &str, edit: &Edit) -> Result<String> {
    let found: Vec<usize> = text.match_indices(&edit.line).map(|(at, _)| at).collect();
    let &[start] = &found[..] else {
        bail!(
            "{} lines contain {:?}, where a fault should be planted",
            found.len(),
            edit.line
        );
    };
    let end = text[start..].find(';').map_or(text.len(), |n| start + n);
    let at = text[start..end].find(&edit.from);
    let at =
        start + at.with_context(|| format!("{:?} is not behind {:?}", edit.from, edit.line))?;
    Ok([&text[..at], &edit.to, &text[at + edit.from.len()..]].concat())
}

/// A law: what it says, and a Verilog expression that is true at every clock after the first.
struct Law {
    what: String,
    holds: String,
}

fn law(what: &str, holds: impl Into<String>) -> Law {
    Law {
        what: what.into(),
        holds: holds.into(),
    }
}

/// A module, what is assumed of what surrounds it, and its laws.
pub struct Induction {
    pub module: String,
    pub what: String,
    /// The module, then those that it places.
    texts: Vec<String>,
    /// What the laws need: assumptions on inputs, and what is remembered of the past.
    observer: String,
    laws: Vec<Law>,
    /// What happens at some clock soon after reset under all that is assumed: else the laws are about nothing.
    happens: String,
    /// Signals that are given any value at every clock, whatever drives them: what is proved of any holds of theirs.
    cut: Vec<String>,
    depth: u32,
    /// Whether memories stay arrays for the solver; else each word is a register.
    arrays: bool,
    pub plants: Vec<Plant>,
}

fn plant(what: &str, line: &str, from: &str, to: &str) -> Plant {
    Plant {
        what: what.into(),
        change: Edit {
            line: line.into(),
            from: from.into(),
            to: to.into(),
        },
    }
}

/// Of [`super::UNITS`], those that are proved by induction.
const CONTROL: [&str; 8] = [
    "fifo", "prefetch", "credit", "skin", "geometry", "tpu", "stack", "share",
];

/// All inductions of a unit of the given name; none if it is no unit of control.
///
/// # Errors
/// A mistake in the machine's description; a module that no longer has what the laws speak of.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Induction>> {
    if !CONTROL.contains(&unit) {
        return Ok(vec![]);
    }
    let modules = |config: &Config| anyhow::Ok(emit::machine(config)?.design.modules().to_vec());
    let all = modules(config)?;
    let find = |all: &[Arc<Module>], name: &str| {
        let found = all.iter().find(|m| m.name() == name).cloned();
        found.with_context(|| format!("the machine has no module {name}"))
    };
    let few = |key: &str, value: u32| {
        let mut few = config.clone();
        few.set(key, &value.to_string())?;
        modules(&few)
    };
    let named = |part: &str| {
        let found: Vec<_> = all
            .iter()
            .filter(|m| m.name().contains(part))
            .cloned()
            .collect();
        ensure!(!found.is_empty(), "the machine has no module called {part}");
        Ok(found)
    };
    match unit {
        "fifo" => {
            let prove = |module| match is_block_queue(module) {
                true => queues::block_fifo(module),
                false => queues::fifo(module),
            };
            named("fifo_")?.iter().map(prove).collect()
        }
        "prefetch" => named("_prefetch")?.iter().map(queues::prefetch).collect(),
        "credit" => Ok(vec![update::credit(&find(&all, "update_processor")?)?]),
        "skin" => {
            let few = few("skinning.vertices_waiting", skinning::FEW_VERTICES)?;
            const NAME: &str = "skinning_processor";
            Ok(vec![
                skinning::conserves(&find(&all, NAME)?)?,
                skinning::write_queue(&find(&few, NAME)?)?,
            ])
        }
        "tpu" => {
            let few = few("packets.in_flight", FEW_PACKETS)?;
            Ok(vec![
                traversal::packets(&find(&few, "tpu")?, FEW_PACKETS)?,
                traversal::choices(&find(&all, "tpu")?)?,
            ])
        }
        "geometry" => {
            let few = few("packets.in_flight", FEW_PACKETS)?;
            Ok(vec![geometry::conserves(
                &find(&few, "geometry_unit")?,
                FEW_PACKETS,
            )?])
        }
        "share" => {
            let few = few("packets.in_flight", FEW_PACKETS)?;
            Ok(vec![raycast::shares(
                &find(&few, "raycast_unit")?,
                FEW_PACKETS,
            )?])
        }
        _ => Ok(vec![traversal::stack(&find(&all, "tpu")?, config)?]),
    }
}

/// What every observer begins with: reset in the first clock, at any time later too.
const START: &str = "
  reg f_started = 1'b0;
  always @(posedge clk) f_started <= 1'b1;
  always @* if (!f_started) assume (rst);
";

fn port_width(module: &Module, name: &str) -> Result<u32> {
    let port = module.port(name);
    Ok(port
        .with_context(|| format!("{} has no port {name}", module.name()))?
        .width)
}

/// The text between `before` and `after` where it first stands in an emitted module.
fn between<'t>(module: &'t Module, before: &str, after: &str) -> Result<&'t str> {
    let text = module.verilog();
    let found = text
        .split_once(before)
        .and_then(|(_, rest)| rest.split_once(after));
    let (inner, _) = found.with_context(|| {
        format!(
            "{}: its Verilog has no {before:?}; the laws must follow the unit",
            module.name()
        )
    })?;
    Ok(inner)
}

/// The words of an emitted memory `words [0:N]`.
fn words(module: &Module, memory: &str) -> Result<u32> {
    let last = between(module, &format!(" {memory} [0:"), "]")?;
    Ok(last.parse::<u32>().context("a memory's depth")? + 1)
}

/// The registers behind a bit that enters a pipeline, up to the wire called `last`.
fn pipeline_bits(module: &Module, last: &str) -> Result<Vec<String>> {
    // The last may be a register by its own name.
    let numbered = last
        .rsplit_once("_s")
        .is_some_and(|(_, n)| n.parse::<u32>().is_ok());
    let before = between(module, &format!("else {last} <= "), ";");
    if let (false, Ok(before)) = (numbered, before) {
        let before = pipeline_bits(module, before)?;
        return Ok(before.into_iter().chain([last.to_string()]).collect());
    }
    let text = between(module, &format!("wire {last} = "), ";").unwrap_or(last);
    if let Some((line, place)) = text.strip_suffix(']').and_then(|t| t.split_once("_delay[")) {
        let place: u32 = place.parse().with_context(|| format!("{last} = {text}"))?;
        return Ok((0..=place).map(|i| format!("{line}_delay[{i}]")).collect());
    }
    let (name, stage) = text
        .rsplit_once("_s")
        .with_context(|| format!("{last} = {text}"))?;
    let stage: u32 = stage.parse().with_context(|| format!("{last} = {text}"))?;
    Ok((1..=stage).map(|i| format!("{name}_s{i}")).collect())
}

/// A queue that a module places.
struct Queue {
    name: String,
    depth: u32,
    push: String,
    pop: String,
    /// Of a queue in block RAM, the registers that say that its head has stood still: their number.
    settling: Option<usize>,
    /// Of a queue in distributed RAM: whether its front word stands in a register (see `hw::fifo`).
    front_registered: bool,
}

/// What the names of queues' modules begin with.
const QUEUES: [&str; 2] = ["fifo_", "block_fifo_"];

fn is_queue(module: &str) -> bool {
    QUEUES.iter().any(|prefix| module.starts_with(prefix))
}

fn is_block_queue(module: &Arc<Module>) -> bool {
    module.name().starts_with(QUEUES[1])
}

/// Whether a queue in distributed RAM keeps its front word, and how many words it has, in registers.
fn is_front_registered(module: &Module) -> bool {
    module.verilog().contains("\n  reg  more;")
}

fn queues(module: &Module) -> Result<Vec<Queue>> {
    let text = module.verilog();
    let mut found = vec![];
    let places = (QUEUES.iter()).flat_map(|name| {
        text.match_indices(&format!("\n  {name}"))
            .map(|(at, _)| at)
            .collect::<Vec<_>>()
    });
    let mut places: Vec<usize> = places.collect();
    places.sort_unstable();
    for at in places {
        let instance = &text[at..at
            + text[at..]
                .find("\n  );")
                .context("an instance has an end")?];
        let connection = |port: &str| {
            let rest = instance
                .split_once(&format!("    .{port}("))
                .map(|(_, rest)| rest);
            let line = rest
                .and_then(|r| r.lines().next())
                .map(|l| l.trim_end_matches(','));
            let inner = line.and_then(|l| l.strip_suffix(')'));
            inner
                .map(str::to_string)
                .with_context(|| format!("no .{port} in {instance:?}"))
        };
        let head: Vec<&str> = instance.split_whitespace().collect();
        let depth = head[0]
            .rsplit_once('x')
            .and_then(|(_, depth)| depth.parse().ok());
        let child = module.children().iter().find(|m| m.name() == head[0]);
        let child = child.with_context(|| format!("{} is placed", head[0]))?;
        found.push(Queue {
            settling: is_block_queue(child).then(|| settling(child)),
            front_registered: is_front_registered(child),
            name: head[1].to_string(),
            depth: depth.with_context(|| format!("the depth of {}", head[0]))?,
            push: connection("push")?,
            pop: connection("pop")?,
        });
    }
    ensure!(!found.is_empty(), "{} places no queue", module.name());
    Ok(found)
}

/// The registers of a queue in block RAM that say that its head has stood still.
fn settling(module: &Module) -> usize {
    module.verilog().matches("\n  reg  settled").count()
}

impl Queue {
    fn register(&self, name: &str) -> String {
        format!("\\{}.{name} ", self.name)
    }

    /// How many words it holds.
    fn count(&self) -> String {
        match self.settling {
            None => self.register("count"),
            Some(_) => format!(
                "({} + {})",
                self.register("count"),
                self.register("front_valid")
            ),
        }
    }

    /// Whether it shows a word.
    fn shows(&self) -> String {
        match self.settling {
            None => format!("({} != 0)", self.register("count")),
            Some(_) => self.register("front_valid"),
        }
    }

    /// Wires through which its registers can be read.
    fn view(&self) -> String {
        let bits = bits_for(u64::from(self.depth) + 1);
        let mut wires = format!(
            "  (* hierconn *) wire [{}:0] {};\n",
            bits - 1,
            self.register("count")
        );
        if let Some(settling) = self.settling {
            let names = (0..settling)
                .map(|k| format!("settled{k}"))
                .chain(["front_valid".into()]);
            for name in names {
                let _ = writeln!(wires, "  (* hierconn *) wire {};", self.register(&name));
            }
        }
        if self.front_registered {
            // Laws of the queue itself, which its user may rely on.
            let [valid, more] = ["front_valid", "more"].map(|name| self.register(name));
            let count = self.register("count");
            let _ = writeln!(
                wires,
                "  (* hierconn *) wire {valid};\n  (* hierconn *) wire {more};\n  \
                 always @* assume ({valid} == ({count} != 0) & {more} == ({count} > 1));"
            );
        }
        wires
    }

    /// Of a queue in block RAM: its head stands still only while it names a word.
    fn settles(&self) -> Option<Law> {
        let settled: Vec<_> = (0..self.settling?)
            .map(|k| self.register(&format!("settled{k}")))
            .collect();
        Some(law(
            &format!("the head of {} stands still at a word", self.name),
            format!(
                "!({}) | {} != 0",
                settled.join(" | "),
                self.register("count")
            ),
        ))
    }
}

/// Where whether there is room is a register (see `hw::prefetch::occupancy`): that it says so.
fn room(module: &Module, count: &str, most: u32) -> Option<Law> {
    let register = format!("{count}_room");
    let registered = module.verilog().contains(&format!("\n  reg  {register};"));
    registered.then(|| {
        law(
            &format!("{register} says whether there is room"),
            format!("{register} == ({count} != {most})"),
        )
    })
}

fn queue<'q>(queues: &'q [Queue], name: &str) -> Result<&'q Queue> {
    let found = queues.iter().find(|q| q.name == name);
    found.with_context(|| format!("no queue is called {name}; the laws must follow the unit"))
}

/// A reader ahead that a module places, of which is assumed what is proved of it: it has a word only if it was given an address
/// for it, and it takes no more than it has room for.
struct Ahead<'n> {
    name: &'n str,
    /// The wires that say that it takes an address, and that its word is popped.
    takes: &'n str,
    pops: &'n str,
    /// Words that have a place; the front word has one more.
    room: u32,
}

impl Ahead<'_> {
    /// Counts what is in it, as `f_NAME_ahead`.
    fn observer(&self) -> String {
        let Ahead {
            name,
            takes,
            pops,
            room,
        } = self;
        format!(
            "
  reg [9:0] f_{name}_ahead;
  always @(posedge clk) if (rst) f_{name}_ahead <= 0; else f_{name}_ahead <= f_{name}_ahead + ({takes}) - ({pops});
  always @* assume (!{name}_valid | f_{name}_ahead != 0);
  always @* assume ({name}_empty == (f_{name}_ahead == 0));
  always @* assume (!{name}_fetch_ready | f_{name}_ahead <= {room});
"
        )
    }

    /// That what is counted is no more than can be in it.
    fn law(&self) -> Law {
        law(
            &format!("no more words are in {} than it has room for", self.name),
            format!("f_{}_ahead <= {}", self.name, self.room + 1),
        )
    }
}

/// The words that a reader ahead has room for, beside its front word.
fn ahead_room(module: &Module, name: &str) -> Result<u32> {
    let child = (module.children().iter()).find(|child| {
        let place = format!("\n  {} {name} (", child.name());
        module.verilog().contains(&place)
    });
    words(
        child.with_context(|| format!("{} places no {name}", module.name()))?,
        "words",
    )
}

/// That what is shown at a port and not taken is shown again.
fn shown_stays(observer: &mut String, name: &str, valid: &str, ready: &str, shown: &str) -> Law {
    let id = name.replace(' ', "_");
    let _ = write!(
        observer,
        "
  reg f_refused_{id};
  reg [127:0] f_shown_{id};
  wire [127:0] f_shows_{id} = {shown};
  always @(posedge clk) begin
    f_refused_{id} <= !rst & {valid} & !{ready};
    f_shown_{id} <= f_shows_{id};
  end
"
    );
    law(
        &format!("a {name} that is not taken stays"),
        format!("!f_refused_{id} | ({valid} & f_shown_{id} == f_shows_{id})"),
    )
}

/// The module's text, then those of its children: as they are where they are queues, unless their names end as said; all others replaced
/// by outputs of any value.
fn texts(module: &Arc<Module>, any: &[&str]) -> Vec<String> {
    let mut texts = vec![module.verilog().to_string()];
    for child in module.children() {
        let name = child.name();
        let kept = is_queue(name) || name.ends_with("_prefetch");
        let text = match kept && !any.iter().any(|end| name.ends_with(end)) {
            true => child.verilog().to_string(),
            false => of_any_value(child),
        };
        if !texts.contains(&text) {
            texts.push(text);
        }
    }
    texts
}

/// The module's text, its children replaced by outputs of any value.
fn alone(module: &Arc<Module>) -> Vec<String> {
    let mut texts = vec![module.verilog().to_string()];
    for child in module.children() {
        let text = of_any_value(child);
        if !texts.contains(&text) {
            texts.push(text);
        }
    }
    texts
}

fn of_any_value(module: &Module) -> String {
    let mut ports = vec![];
    let mut body = String::new();
    for port in module.ports() {
        let range = format!("[{}:0]", port.width - 1);
        let name = &port.name;
        if port.direction == Direction::Input {
            ports.push(format!("  input wire {range} {name}"));
        } else {
            ports.push(format!("  output wire {range} {name}"));
            let _ = writeln!(
                body,
                "  (* anyseq *) wire {range} any_{name};\n  assign {name} = any_{name};"
            );
        }
    }
    format!(
        "module {} (\n{}\n);\n{body}endmodule\n",
        module.name(),
        ports.join(",\n")
    )
}

impl Induction {
    /// How it is proved, as the report says it.
    pub fn how(&self) -> String {
        format!("z3, induction, depth {}", self.depth)
    }

    /// Shows all laws by induction, or finds one that fails.
    ///
    /// # Errors
    /// A tool that fails; a plant that does not fit the emitted text.
    pub fn prove(&self, folder: &Path, plant: Option<&Plant>) -> Result<(usize, Outcome)> {
        let (text, first_law) = self.text(plant)?;
        std::fs::write(folder.join("laws.sv"), text).context("laws.sv")?;
        let memory = if self.arrays {
            "memory_collect"
        } else {
            "memory -nordff"
        };
        let write = if self.arrays {
            "write_smt2"
        } else {
            "write_smt2 -nomem"
        };
        let cut = match &self.cut[..] {
            [] => String::new(),
            signals => {
                let signals: Vec<_> = signals.iter().map(|name| format!("w:{name}")).collect();
                format!("cutpoint {};", signals.join(" "))
            }
        };
        tools::yosys(
            folder,
            &format!(
                "read_verilog -formal -sv laws.sv; hierarchy -check -top {}; proc; flatten; {cut} delete -output o:*; \
                 opt -purge -nodffe -nosdff; {memory}; opt -purge -nodffe -nosdff; dffunmap; opt_clean -purge; \
                 {write} laws.smt2",
                self.module
            ),
        )?;
        // The base must cover as many clocks as a step assumes, and what a planted fault needs to show.
        let base = (self.depth + 1).to_string();
        let depth = self.depth.to_string();
        let soon = SOON.to_string();
        for (stage, stage_args) in [
            ("after reset", &["-t", &base][..]),
            ("a step of the induction", &["-t", &depth, "-i"]),
            (HAPPENS, &["-t", &soon, "-c"]),
        ] {
            let mut args = vec!["--noprogress", "-s", "z3"];
            args.extend(stage_args);
            if stage == HAPPENS {
                // Asked anew each clock: z3 then simplifies before it searches, twenty times as fast with a stack's arrays.
                args.extend(["--noincr", "--unroll"]);
            } else if !self.arrays {
                args.push("--unroll");
            }
            args.push("laws.smt2");
            let text = match tools::run(folder, LIMIT, "yosys-smtbmc", &args)? {
                Ended::With { text, .. } => text,
                Ended::OutOfTime => {
                    let limit = LIMIT.as_secs();
                    return Ok((
                        0,
                        Outcome::Undecided(format!("{stage}: z3 takes more than {limit} s")),
                    ));
                }
            };
            let last = text
                .lines()
                .rev()
                .find(|line| line.contains("Status:"))
                .unwrap_or_default();
            if last.ends_with("FAILED") && stage == HAPPENS {
                return Ok((
                    0,
                    Outcome::Undecided(format!(
                        "{} never happens within {SOON} clocks of reset: the laws are about nothing",
                        self.happens
                    )),
                ));
            }
            if last.ends_with("FAILED") {
                return Ok((
                    0,
                    Outcome::Refuted(format!("{stage}: {}", self.broken(&text, first_law))),
                ));
            }
            if !last.ends_with("PASSED") {
                let line = text.lines().last().unwrap_or("smtbmc says nothing").trim();
                return Ok((0, Outcome::Undecided(format!("{stage}: {line}"))));
            }
        }
        Ok((self.laws.len(), Outcome::Proved))
    }

    /// The Verilog with the laws, and the line of the first of them.
    fn text(&self, plant: Option<&Plant>) -> Result<(String, usize)> {
        let [top, children @ ..] = &self.texts[..] else {
            bail!("{}: no text", self.module);
        };
        let edited = match plant {
            Some(plant) => edited(top, &plant.change).with_context(|| self.module.clone())?,
            None => top.clone(),
        };
        let end = edited.rfind("endmodule").context("a module has an end")?;
        let mut text = format!("{}{}", &edited[..end], self.observer);
        text += "  always @* if (f_started) begin\n";
        let first_law = text.lines().count() + 1;
        for law in &self.laws {
            let _ = writeln!(text, "    assert ({}); // {}", law.holds, law.what);
        }
        let _ = write!(text, "    cover ({});\n  end\n", self.happens);
        text += &edited[end..];
        children.iter().for_each(|child| text += child);
        Ok((text, first_law))
    }

    /// The laws that smtbmc says fail, by their lines, and at which clock.
    fn broken(&self, text: &str, first_law: usize) -> String {
        let mut broken: Vec<&str> = vec![];
        for line in text.lines().filter(|line| line.contains("Assert failed")) {
            let number = line
                .split_once("laws.sv:")
                .and_then(|(_, rest)| rest.split(['.', '-']).nth(2));
            let law = number
                .and_then(|n| n.parse::<usize>().ok())
                .and_then(|n| n.checked_sub(first_law));
            if let Some(law) = law.and_then(|n| self.laws.get(n)) {
                broken.push(&law.what);
            }
        }
        broken.dedup();
        let step = text
            .lines()
            .rev()
            .find_map(|line| line.split_once(" in step ").map(|(_, n)| n));
        let clock = step.map_or(String::new(), |step| {
            format!(" at clock {}", step.trim_end_matches('.'))
        });
        match broken.is_empty() {
            true => format!("a law fails{clock}"),
            false => format!("not so{clock}: {}", broken.join("; ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edit_changes_one_place() {
        let edit = |line: &str| Edit {
            line: line.into(),
            from: "+".into(),
            to: "-".into(),
        };
        let text = "wire a = b + c + d;\nwire e = f;\n";
        assert_eq!(
            edited(text, &edit("wire a")).unwrap(),
            "wire a = b - c + d;\nwire e = f;\n"
        );
        assert!(edited(text, &edit("wire")).is_err());
        assert!(edited(text, &edit("wire e")).is_err());
    }
}
