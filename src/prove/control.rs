//! Queues, credits, the stack and ports, by induction.
//!
//! Laws are added to the text of an emitted module before its `endmodule`, which is the only thing that is changed of
//! it: so they can speak of what is inside, of memories too, and through `hierconn` wires of the queues that it places.
//! Yosys makes a transition system, `yosys-smtbmc` with z3 shows that no law fails in the first clocks after reset, and
//! that if all hold for that many clocks they hold in the next: so they hold for ever. What the laws do not depend on is
//! removed. Arithmetic inside a module is replaced by outputs of any value.

use super::tools::{self, Ended};
use super::{Edit, Outcome, Plant, edited};
use crate::config::Config;
use crate::emit;
use crate::hdl::{Direction, Module, bits_for};
use anyhow::{Context, Result, bail, ensure};
use std::fmt::Write as _;
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;

/// What z3 may take for each of base and step.
const LIMIT: Duration = Duration::from_secs(240);

/// Packets of the machine on which their conservation is proved. The sum of what is in nine queues is hard for a solver
/// where they are deep; the description is the same for any number of packets.
const FEW_PACKETS: u32 = 4;

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
    depth: u32,
    /// Whether memories stay arrays for the solver; else each word is a register.
    arrays: bool,
    pub plants: Vec<Plant>,
}

fn plant(what: &str, line: &str, from: &str, to: &str) -> Plant {
    Plant {
        what: what.into(),
        edit: Edit {
            line: line.into(),
            from: from.into(),
            to: to.into(),
        },
    }
}

/// All inductions of a unit of the given name; none if it is no unit of control.
///
/// # Errors
/// A mistake in the machine's description; a module that no longer has what the laws speak of.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Induction>> {
    if !["fifo", "prefetch", "credit", "tpu", "stack"].contains(&unit) {
        return Ok(vec![]);
    }
    let modules = |config: &Config| anyhow::Ok(emit::generate(config)?.0.design.modules().to_vec());
    let all = modules(config)?;
    let find = |all: &[Rc<Module>], name: &str| {
        let found = all.iter().find(|m| m.name() == name).cloned();
        found.with_context(|| format!("the machine has no module {name}"))
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
                true => block_fifo(module),
                false => fifo(module),
            };
            named("fifo_")?.iter().map(prove).collect()
        }
        "prefetch" => named("_prefetch")?.iter().map(prefetch).collect(),
        "credit" => Ok(vec![credit(&find(&all, "update_processor")?)?]),
        "tpu" => {
            let mut few = config.clone();
            few.set("packets.in_flight", &FEW_PACKETS.to_string())?;
            Ok(vec![
                packets(&find(&modules(&few)?, "tpu")?, FEW_PACKETS)?,
                choices(&find(&all, "tpu")?)?,
            ])
        }
        _ => Ok(vec![stack(&find(&all, "tpu")?, config)?]),
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
}

/// What the names of queues' modules begin with.
const QUEUES: [&str; 2] = ["fifo_", "block_fifo_"];

fn is_queue(module: &str) -> bool {
    QUEUES.iter().any(|prefix| module.starts_with(prefix))
}

fn is_block_queue(module: &Rc<Module>) -> bool {
    module.name().starts_with(QUEUES[1])
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

fn queue<'q>(queues: &'q [Queue], name: &str) -> Result<&'q Queue> {
    let found = queues.iter().find(|q| q.name == name);
    found.with_context(|| format!("no queue is called {name}; the laws must follow the unit"))
}

/// The module's text and those of its children, arithmetic replaced by outputs of any value.
fn texts(module: &Rc<Module>) -> Vec<String> {
    let mut texts = vec![module.verilog().to_string()];
    for child in module.children() {
        let name = child.name();
        if is_queue(name) || name.ends_with("_prefetch") {
            texts.extend(self::texts(child));
        } else {
            texts.push(of_any_value(child));
        }
    }
    let mut seen = std::collections::HashSet::new();
    texts.retain(|text| seen.insert(text.clone()));
    texts
}

/// The module's text, its children replaced by outputs of any value.
fn alone(module: &Rc<Module>) -> Vec<String> {
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

/// Of a queue: what comes out is what went in, in order, once; nothing is lost and nothing overflows, given that it is
/// popped only where it shows a word and pushed only where a word is missing. One word, any, is watched.
fn fifo(module: &Rc<Module>) -> Result<Induction> {
    let (width, depth) = (port_width(module, "data")?, words(module, "words")?);
    let bits = bits_for(u64::from(depth)) + 2;
    let observer = format!(
        "{START}
  always @* assume (!pop | valid);
  always @* assume (!push | count < {depth});
  (* anyseq *) wire f_choose;
  reg f_watching;
  reg [{width}-1:0] f_word;
  reg [{bits}-1:0] f_ahead;
  always @(posedge clk)
    if (rst) f_watching <= 1'b0;
    else if (!f_watching) begin
      if (push & f_choose) begin
        f_watching <= 1'b1;
        f_word <= data;
        f_ahead <= count - pop;
      end
    end else if (pop) begin
      f_ahead <= f_ahead - 1'b1;
      if (f_ahead == 0) f_watching <= 1'b0;
    end
  wire [{bits}-1:0] f_end = head + count;
  wire [{bits}-1:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire [{bits}-1:0] f_at = head + f_ahead;
  wire [{bits}-1:0] f_slot = f_at >= {depth} ? f_at - {depth} : f_at;
  wire [{width}-1:0] f_stored = words[f_slot];
  reg f_stays;
  reg [{width}-1:0] f_front;
  always @(posedge clk) begin
    f_stays <= !rst & valid & !pop;
    f_front <= front;
  end
"
    );
    Ok(Induction {
        module: module.name().into(),
        what: "words come out in order, each once; none is lost; no overflow; the front stays"
            .into(),
        texts: texts(module),
        observer,
        laws: vec![
            law(
                "the queue never holds more words than it has room for",
                format!("count <= {depth}"),
            ),
            law("the head is a slot", format!("head < {depth}")),
            law(
                "the tail is as far from the head as there are words",
                "tail == f_tail",
            ),
            law(
                "it shows a word where it holds one",
                "valid == (count != 0)",
            ),
            law(
                "a watched word is held until it is popped",
                "!f_watching | f_ahead < count",
            ),
            law(
                "a watched word keeps its slot",
                "!f_watching | f_stored == f_word",
            ),
            law(
                "a watched word comes out in its turn",
                "!(f_watching & f_ahead == 0) | (valid & front == f_word)",
            ),
            law(
                "a front word that is not popped stays",
                "!f_stays | (valid & front == f_front)",
            ),
        ],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a push and a pop at once count as a push",
                "if (push ^ pop)",
                "push ^ pop",
                "push | pop",
            ),
            plant(
                "a word is written beside its slot",
                "words[tail] <=",
                "tail",
                "head",
            ),
        ],
    })
}

/// The same of a queue in block RAM, whose front word has a register of its own.
fn block_fifo(module: &Rc<Module>) -> Result<Induction> {
    let (width, depth) = (port_width(module, "data")?, words(module, "words")?);
    let bits = bits_for(u64::from(depth)) + 2;
    let settling = settling(module);
    let observer = format!(
        "{START}
  always @* assume (!pop | valid);
  always @* assume (!push | count + front_valid < {depth});
  (* anyseq *) wire f_choose;
  reg f_watching;
  reg [{width}-1:0] f_word;
  reg [{bits}-1:0] f_ahead;
  always @(posedge clk)
    if (rst) f_watching <= 1'b0;
    else if (!f_watching) begin
      if (push & f_choose) begin
        f_watching <= 1'b1;
        f_word <= data;
        f_ahead <= count + front_valid - pop;
      end
    end else if (pop) begin
      f_ahead <= f_ahead - 1'b1;
      if (f_ahead == 0) f_watching <= 1'b0;
    end
  wire [{bits}-1:0] f_end = head + count;
  wire [{bits}-1:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire f_in_front = front_valid & f_ahead == 0;
  wire [{bits}-1:0] f_at = head + f_ahead - front_valid;
  wire [{bits}-1:0] f_slot = f_at >= {depth} ? f_at - {depth} : f_at;
  wire [{width}-1:0] f_stored = words[f_slot];
  wire [{width}-1:0] f_first = words[head];
  reg f_stays;
  reg [{width}-1:0] f_front;
  always @(posedge clk) begin
    f_stays <= !rst & valid & !pop;
    f_front <= front;
  end
"
    );
    let mut laws = vec![
        law(
            "the queue never holds more words than it has room for",
            format!("count + front_valid <= {depth}"),
        ),
        law("the head is a slot", format!("head < {depth}")),
        law(
            "the tail is as far from the head as there are words",
            "tail == f_tail",
        ),
        law(
            "a watched word is held until it is popped",
            "!f_watching | f_ahead < count + front_valid",
        ),
        law(
            "a watched word keeps its slot",
            "!f_watching | (f_in_front ? front_word == f_word : f_stored == f_word)",
        ),
        law(
            "a watched word comes out in its turn",
            "!(f_watching & f_ahead == 0 & valid) | front == f_word",
        ),
        law(
            "a front word that is not popped stays",
            "!f_stays | (valid & front == f_front)",
        ),
    ];
    for (k, word) in ["words_read", "words_read_d1"]
        .iter()
        .take(settling)
        .enumerate()
    {
        laws.push(law(
            "the word read is the head's once that has stood still",
            format!("!settled{k} | (count != 0 & {word} == f_first)"),
        ));
    }
    Ok(Induction {
        module: module.name().into(),
        what: "words come out in order, each once; none is lost; no overflow; the front stays"
            .into(),
        texts: texts(module),
        observer,
        laws,
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a push and a pop at once count as a push",
                "if (push ^ load)",
                "push ^ load",
                "push | load",
            ),
            plant(
                "a word is written beside its slot",
                "words[tail] <=",
                "tail",
                "head",
            ),
        ],
    })
}

/// Of words read ahead: each comes out in the order of the requests, as memory answered it. Memory answers each request once,
/// in any order.
fn prefetch(module: &Rc<Module>) -> Result<Induction> {
    let depth = words(module, "words")?;
    let (width, tag) = (
        port_width(module, "front")?,
        port_width(module, "request_tag")?,
    );
    let address = port_width(module, "request_address")?;
    let bits = tag + 2;
    let observer = format!(
        "{START}
  reg [{depth}-1:0] f_owed;
  wire f_request = request_valid & request_ready;
  always @(posedge clk)
    if (rst) f_owed <= 0;
    else f_owed <= (f_owed | ({{{{({depth}-1){{1'b0}}}}, f_request}} << request_tag))
      & ~({{{{({depth}-1){{1'b0}}}}, response_valid}} << response_tag);
  always @* assume (!response_valid | (response_tag < {depth} & f_owed[response_tag]));
  always @* assume (!pop | valid);
  reg f_refused, f_waits;
  reg [{address}-1:0] f_address;
  reg [{tag}-1:0] f_shown_tag;
  always @(posedge clk) begin
    f_refused <= !rst & fetch_valid & !fetch_ready;
    f_waits <= !rst & request_valid & !request_ready;
    f_address <= fetch_address;
    f_shown_tag <= request_tag;
  end
  always @* assume (!f_refused | (fetch_valid & fetch_address == f_address));
  (* anyseq *) wire f_choose;
  reg f_watching, f_answered;
  reg [{width}-1:0] f_word;
  reg [{tag}-1:0] f_tag;
  reg [{bits}-1:0] f_ahead;
  always @(posedge clk)
    if (rst) f_watching <= 1'b0;
    else if (!f_watching) begin
      if (f_request & f_choose) begin
        f_watching <= 1'b1;
        f_answered <= 1'b0;
        f_tag <= request_tag;
        f_ahead <= count + front_valid - pop;
      end
    end else begin
      if (response_valid & response_tag == f_tag & !f_answered) begin
        f_answered <= 1'b1;
        f_word <= response_data;
      end
      if (pop) begin
        f_ahead <= f_ahead - 1'b1;
        if (f_ahead == 0) f_watching <= 1'b0;
      end
    end
  wire [{bits}-1:0] f_end = head + count;
  wire [{bits}-1:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire f_in_front = f_ahead == 0 & front_valid;
  wire f_behind = f_watching & !f_in_front;
  wire [{bits}-1:0] f_at = head + f_ahead - front_valid;
  wire [{bits}-1:0] f_slot = f_at >= {depth} ? f_at - {depth} : f_at;
  wire [{width}-1:0] f_stored = words[f_tag];
  wire [{depth}-1:0] f_used;
  genvar f_i;
  generate
    for (f_i = 0; f_i < {depth}; f_i = f_i + 1) begin : f_slots
      wire [{bits}-1:0] f_from_head = head > f_i ? f_i + {depth} - head : f_i - head;
      assign f_used[f_i] = f_from_head < count;
    end
  endgenerate
"
    );
    Ok(Induction {
        module: module.name().into(),
        what: "words come out in the order of requests, whatever the answers' order; requests shown stay".into(),
        texts: texts(module),
        observer,
        laws: vec![
            law("no more words are under way than there are slots", format!("count <= {depth}")),
            law("the head is a slot", format!("head < {depth}")),
            law("the tail is as far from the head as slots are taken", "tail == f_tail"),
            law("every slot taken is owed by memory or has its word", "(f_owed | arrived) == f_used"),
            law("no slot is both owed and has its word", "(f_owed & arrived) == 0"),
            law(
                "a request that is not taken stays, its address and tag too",
                "!f_waits | (request_valid & request_address == f_address & request_tag == f_shown_tag)",
            ),
            law("a watched word comes out in its turn", "!(f_watching & f_in_front) | (f_answered & front == f_word)"),
            law("a watched word is there until it is popped", "!f_watching | f_ahead < count + front_valid"),
            law("a watched word keeps its slot", "!f_behind | f_slot == f_tag"),
            law("a watched word has arrived when memory answered", "!f_behind | f_answered == arrived[f_tag]"),
            law("a watched word is stored as memory answered", "!(f_behind & f_answered) | f_stored == f_word"),
            law("it waits for nothing but the memory", "valid | head_arrived | count == 0 | f_owed[head]"),
            law("it is empty where nothing is under way", "empty == (count == 0 & !valid)"),
        ],
        depth: 1,
        arrays: false,
        plants: vec![
            plant("a word is forgotten when another arrives", "wire advance =", "| pop", "| 1'b1"),
            plant("it requests without room", "wire room =", "!=", "!= 1 +"),
        ],
    })
}

/// Of the update processor: its credits are exactly what they stand for, so none is lost and no queue overflows, and what it
/// shows at its ports stays until it is taken. Its queues' own laws are proved of them.
fn credit(module: &Rc<Module>) -> Result<Induction> {
    let queues = queues(module)?;
    let instructions = queue(&queues, "instruction_queue")?;
    let indices = queue(&queues, "vertex_indices")?;
    let nodes = queue(&queues, "node_queue")?;
    let to_node_queue = pipeline_bits(module, &nodes.push)?;
    let in_merge = to_node_queue.len();
    // The box is read behind as many registers as a node's bounds.
    let shown = between(module, "assign box_write_data = {", "}")?;
    let (_, read) = shown
        .rsplit_once("_s")
        .context("the box is read through registers")?;
    let read: usize = read
        .trim()
        .parse()
        .context("the registers behind a box's read")?;
    let history = |name: &str, of: &str, length: usize| {
        format!(
            "  reg [{length}-1:0] {name};\n  always @(posedge clk) if (rst) {name} <= 0; else {name} <= {{{name}, {of}}};\n"
        )
    };
    let mut observer = START.to_string();
    for queue in [instructions, indices, nodes] {
        observer += &queue.view();
    }
    observer += &history("f_nodes", "node_goes", in_merge);
    observer += &history("f_ends", "end_waits", read);
    let sum: Vec<String> = (0..in_merge).map(|i| format!("f_nodes[{i}]")).collect();
    let mut laws = vec![];
    let _ = write!(observer, "  wire [7:0] f_merging = {};\n", sum.join(" + "));
    // Programs have instructions of one kind each and end with their end; what comes out of the queue is what went in.
    observer += "  always @* assume (!(is_reload & is_end));
  always @* assume (!current_valid | (current_load + current_leaf + current_node + current_end <= 3'd1));
";
    let _ = writeln!(
        observer,
        "  always @* assume (!end_waits | !(decoding | decoded | {} != 0));",
        instructions.count()
    );
    laws.extend([
        law(
            "nothing is decoded after an end",
            "!(decoded & decoded_end & decoding)",
        ),
        law(
            "an update runs while anything of it is left",
            format!(
                "running | !(decoding | decoded | {} != 0 | current_valid | nodes_under_way != 0)",
                instructions.count()
            ),
        ),
    ]);
    laws.push(law(
        "a decoded instruction is of one kind",
        "!decoded | (decoded_load + decoded_leaf + decoded_node + decoded_end <= 3'd1)",
    ));
    for (name, valid, ready, stays) in [
        (
            "program row",
            "any_rows_left",
            "rows_fetch_ready",
            "fetch_row",
        ),
        (
            "vertex",
            "vertex_indices_valid",
            "vertices_fetch_ready",
            "1'b0",
        ),
        (
            "node write",
            "node_write_valid",
            "node_write_ready",
            "{node_write_address, node_write_mask}",
        ),
        (
            "box write",
            "box_write_valid",
            "box_write_ready",
            "box_write_address",
        ),
    ] {
        let id = name.replace(' ', "_");
        let _ = write!(
            observer,
            "  reg f_refused_{id};
  reg [63:0] f_shown_{id};
  wire [63:0] f_shows_{id} = {stays};
  always @(posedge clk) begin
    f_refused_{id} <= !rst & {valid} & !{ready};
    f_shown_{id} <= f_shows_{id};
  end
"
        );
        laws.push(law(
            &format!("a {name} that is not taken stays"),
            format!("!f_refused_{id} | ({valid} & f_shown_{id} == f_shows_{id})"),
        ));
    }
    let most = |queue: &Queue| queue.depth;
    laws.extend([
        law(
            "an instruction's credit is in the queue or just decoded",
            format!("instructions_waiting == {} + decoded", instructions.count()),
        ),
        law(
            "no more instructions have credits than there is room",
            format!("instructions_waiting <= {}", most(instructions)),
        ),
        law(
            "a vertex index's credit is in the queue or just decoded",
            format!(
                "indices_under_way == {} + (decoded & decoded_load)",
                indices.count()
            ),
        ),
        law(
            "no more vertex indices have credits than there is room",
            format!("indices_under_way <= {}", most(indices)),
        ),
        law(
            "a node leaves the merge as long after it entered as it should",
            format!("{} == f_nodes[{}]", nodes.push, in_merge - 1),
        ),
        law(
            "a node's credit is in the queue or in the merge",
            format!("nodes_under_way == {} + f_merging", nodes.count()),
        ),
        law(
            "no more nodes have credits than there is room",
            format!("nodes_under_way <= {}", most(nodes)),
        ),
        law(
            "nothing is pushed to a full instruction queue",
            format!(
                "!decoded | {} < {}",
                instructions.count(),
                most(instructions)
            ),
        ),
        law(
            "nothing is pushed to a full node queue",
            format!("!{} | {} < {}", nodes.push, nodes.count(), most(nodes)),
        ),
        law(
            "no update starts while rows are left",
            "!any_rows_left | !start",
        ),
        law(
            "a box is shown at an update's end only",
            "!box_shown | end_waits",
        ),
        law(
            "a box is shown when all else is complete",
            "!box_shown | all_complete",
        ),
        law(
            "the box that is shown was read since the end came",
            "!box_shown | &f_ends",
        ),
    ]);
    Ok(Induction {
        module: module.name().into(),
        what: "no credit is lost or invented, no queue overflows, what is shown at a port stays"
            .into(),
        texts: texts(module),
        observer,
        laws,
        depth: in_merge.max(read) as u32 + 2,
        arrays: false,
        plants: vec![
            plant(
                "a credit comes back twice",
                "if (decode ^ take_instruction)",
                "decode ^ take_instruction",
                "take_instruction",
            ),
            plant(
                "a node goes without room",
                "wire node_goes =",
                "& node_room",
                "",
            ),
        ],
    })
}

/// Of the traversal unit: every packet that it was given is in exactly one place, or is finished: so no queue ever holds more than
/// there are packets. It is given no more packets than it has numbers for; memory and geometry unit answer what they were asked.
fn packets(module: &Rc<Module>, packets: u32) -> Result<Induction> {
    let queues = queues(module)?;
    let stepping = pipeline_bits(module, "step_valid")?;
    let popping = pipeline_bits(module, "pop_done")?;
    let bits = bits_for(u64::from(packets) + 1) + 4;
    let pops = popping.len();
    let mut observer = START.to_string();
    queues.iter().for_each(|queue| observer += &queue.view());
    let _ = write!(
        observer,
        "
  reg [{pops}-1:0] f_soon;
  reg [{bits}-1:0] f_total, f_memory, f_geometry, f_stepping, f_popping;
  wire f_start = setup_valid & setup_last & !setup_object;
  // A packet that was handed over at an instance comes back as rays set up in the object's space.
  wire f_enters = setup_valid & setup_last & setup_object;
  wire f_request = node_request_valid & node_request_ready;
  wire f_leaf = leaf_valid & leaf_ready;
  always @(posedge clk)
    if (rst) begin
      f_soon <= 0;
      f_total <= 0; f_memory <= 0; f_geometry <= 0; f_stepping <= 0; f_popping <= 0;
    end else begin
      f_soon <= {{f_soon, setup_soon}};
      f_total <= f_total + f_start - finished_valid;
      f_memory <= f_memory + f_request - node_response_valid;
      f_geometry <= f_geometry + f_leaf - done_valid - f_enters;
      f_stepping <= f_stepping + node_response_valid - step_valid;
      f_popping <= f_popping + pop_valid - pop_done;
    end
  always @* begin
    assume (setup_valid == f_soon[{pops}-1]);
    assume (!f_start | f_total < {packets});
    assume (!node_response_valid | f_memory != 0);
    assume (f_geometry >= done_valid + f_enters);
  end
  wire [{bits}-1:0] f_step_bits = {steps};
  wire [{bits}-1:0] f_pop_bits = {pop_bits};
",
        steps = stepping.join(" + "),
        pop_bits = popping.join(" + "),
    );
    // Partial sums, each kept by itself: that the last is the total is then easy to see, clock by clock.
    let mut places: Vec<(String, String, String)> = queues
        .iter()
        .map(|queue| (queue.count(), queue.push.clone(), queue.pop.clone()))
        .collect();
    let place = |a: &str, b: &str, c: &str| (a.to_string(), b.to_string(), c.to_string());
    places.insert(3, place("f_popping", "pop_valid", "pop_done"));
    places.extend([
        place("f_memory", "f_request", "node_response_valid"),
        place("f_stepping", "node_response_valid", "step_valid"),
        place("f_geometry", "f_leaf", "done_valid + f_enters"),
    ]);
    let zero = format!("{bits}'d0");
    let mut laws = vec![
        law(
            "as many packets are in the step pipeline as bits say",
            "f_stepping == f_step_bits",
        ),
        law(
            "as many packets are in the pop pipeline as bits say",
            "f_popping == f_pop_bits",
        ),
        law(
            "no pop ends where a ray arrives",
            format!(
                "(f_soon & {{{}}}) == 0",
                popping.iter().rev().cloned().collect::<Vec<_>>().join(", ")
            ),
        ),
    ];
    for (i, (count, comes, goes)) in places.iter().enumerate() {
        let before = |name: &str| {
            if i == 0 {
                zero.clone()
            } else {
                format!("{name}{}", i - 1)
            }
        };
        let _ = write!(
            observer,
            "  wire [{bits}-1:0] f_change{i} = {change} + ({comes}) - ({goes});
  reg [{bits}-1:0] f_sum{i};
  always @(posedge clk) if (rst) f_sum{i} <= 0; else f_sum{i} <= f_sum{i} + f_change{i};
",
            change = before("f_change"),
        );
        laws.push(law(
            &format!(
                "packets are neither lost nor doubled up to {}",
                count.trim()
            ),
            format!("f_sum{i} == {} + {count}", before("f_sum")),
        ));
        laws.push(law(
            &format!("{} holds no more than there are packets", count.trim()),
            format!("{count} <= {packets}"),
        ));
    }
    laws.push(law(
        "every packet is in one place or finished",
        format!("f_sum{} == f_total", places.len() - 1),
    ));
    laws.push(law(
        "no more packets are under way than there are",
        format!("f_total <= {packets}"),
    ));
    for queue in &queues {
        laws.push(law(
            &format!("{} is popped only where it shows a word", queue.name),
            format!("!({}) | {}", queue.pop, queue.shows()),
        ));
        laws.push(law(
            &format!("nothing is pushed to a full {}", queue.name),
            format!("!({}) | {} < {packets}", queue.push, queue.count()),
        ));
        laws.extend(queue.settles());
    }
    for (name, waits, choice) in held(&queues)? {
        laws.push(law(
            &format!("the {name} that waits is still in its queue"),
            format!("!{waits} | {choice}"),
        ));
    }
    Ok(Induction {
        module: module.name().into(),
        what: format!(
            "every packet is in one place, no queue overflows; a machine of {packets} packets"
        ),
        texts: texts(module),
        observer,
        laws,
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a dropped entry's packet is lost",
                "assign retry_push =",
                "pop_dropped",
                "pop_dropped & ~pop_done",
            ),
            plant(
                "a packet goes on and ends",
                "wire step_goes_nowhere =",
                "& ~",
                "| ",
            ),
        ],
    })
}

/// For node requests and leaves: whether one waits, and the state in which the queue that it is from has it.
fn held(queues: &[Queue]) -> Result<[(&'static str, &'static str, String); 2]> {
    let in_queue = |choice: &str, preferred: &str, other: &str| {
        let (preferred, other) = (queue(queues, preferred)?, queue(queues, other)?);
        Ok::<_, anyhow::Error>(format!(
            "({choice} ? {} : {})",
            preferred.shows(),
            other.shows()
        ))
    };
    Ok([
        (
            "node request",
            "request_waits",
            in_queue("request_waiting_choice", "step_queue", "entered_queue")?,
        ),
        (
            "leaf",
            "leaf_waits",
            in_queue(
                "leaf_waiting_choice",
                "step_leaf_queue",
                "entered_leaf_queue",
            )?,
        ),
    ])
}

/// Of the choices between two queues: what is offered and not taken is offered again, from the same queue, which keeps it at its
/// front (a law of the queue). What feeds a queue finds room in it, which [`packets`] shows.
fn choices(module: &Rc<Module>) -> Result<Induction> {
    let queues = queues(module)?;
    let mut observer = START.to_string();
    for queue in &queues {
        observer += &queue.view();
        let (push, count, depth) = (&queue.push, queue.count(), queue.depth);
        let _ = writeln!(
            observer,
            "  always @* assume (!({push}) | {count} < {depth});"
        );
    }
    let mut laws: Vec<Law> = (queues.iter())
        .map(|q| {
            law(
                &format!("{} holds no more than it has room for", q.name),
                format!("{} <= {}", q.count(), q.depth),
            )
        })
        .collect();
    laws.extend(queues.iter().filter_map(Queue::settles));
    for (name, waits, choice) in held(&queues)? {
        laws.push(law(
            &format!("the {name} that waits is still in its queue"),
            format!("!{waits} | {choice}"),
        ));
    }
    for (name, valid, ready, choice, takes) in [
        (
            "node request",
            "node_request_valid",
            "node_request_ready",
            "request_choice",
            ["take_step_item", "take_pop_item"],
        ),
        (
            "leaf",
            "leaf_valid",
            "leaf_ready",
            "leaf_choice",
            ["take_step_leaf", "take_pop_leaf"],
        ),
    ] {
        let id = name.replace(' ', "_");
        let _ = write!(
            observer,
            "  reg f_refused_{id}, f_choice_{id};
  always @(posedge clk) begin
    f_refused_{id} <= !rst & {valid} & !{ready};
    f_choice_{id} <= {choice};
  end
"
        );
        let [first, second] = takes;
        laws.extend([
            law(
                &format!("a {name} that is not taken stays, from the same queue"),
                format!("!f_refused_{id} | ({valid} & {choice} == f_choice_{id})"),
            ),
            law(
                &format!("one queue is popped where a {name} is taken, none elsewhere"),
                format!("({first} ^ {second}) == ({valid} & {ready})"),
            ),
            law(
                &format!("no two queues are popped for a {name}"),
                format!("!({first} & {second})"),
            ),
        ]);
    }
    Ok(Induction {
        module: module.name().into(),
        what: "node requests and leaves shown stay until taken, each taken from one queue".into(),
        texts: texts(module),
        observer,
        laws,
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a waiting request gives way",
                "wire request_choice =",
                "request_waits ?",
                "1'b0 ?",
            ),
            plant(
                "a waiting leaf gives way",
                "wire leaf_choice =",
                "leaf_waits ?",
                "1'b0 ?",
            ),
        ],
    })
}

/// Of the stack: what a pop reads is what was last pushed for that packet at that level. One packet and level, any, are
/// watched. A packet's level goes up by 1 with a push and down by 1 with a pop. It is assumed to be at most the stack's depth:
/// beyond it the unit has long flagged an overflow.
fn stack(module: &Rc<Module>, config: &Config) -> Result<Induction> {
    let (packets, levels) = (config.packets_in_flight, config.stack_depth);
    let pb = bits_for(u64::from(packets));
    let lb = bits_for(u64::from(levels) + 1);
    let width = between(module, "  reg  [", ":0] stack_read;")
        .map(|t| t.rsplit("reg  [").next().unwrap_or(t))?;
    let level = between(module, "wire stack_full = ", " == ")?;
    let address = between(module, "if (stack_write) stack[", "] <=")?;
    let data = between(module, "if (stack_write) stack[", ";")?
        .rsplit("<= ")
        .next();
    let data = data.context("the stack is written")?;
    let (packet_bits, level_bits) = address
        .trim_matches(['{', '}'])
        .split_once(", ")
        .context("the stack's address is packet and level")?;
    let part = |bits: &str, of: &str| match bits.split_once('[') {
        Some((_, range)) => format!("{of}[{range}"),
        None => of.to_string(),
    };
    let observer = format!(
        "{START}
  (* anyconst *) wire [{pb}-1:0] f_packet;
  (* anyconst *) wire [{lb}-1:0] f_level;
  always @* assume (f_packet < {packets} & f_level < {levels});
  always @* assume (!pushes_last | (step_packet < {packets} & {level} <= {levels}));
  wire f_push = pushes_last & step_packet == f_packet & {level} == f_level & f_level != {levels};
  wire f_pop = pop_valid & !stack_empty & pop[{pb}-1:0] == f_packet & level_below == f_level;
  reg f_pushed, f_popped;
  reg [{width}:0] f_word, f_expected;
  always @(posedge clk) begin
    if (rst) f_pushed <= 1'b0;
    else if (f_push) begin
      f_pushed <= 1'b1;
      f_word <= {data};
    end
    f_popped <= !rst & f_pop & f_pushed;
    f_expected <= f_word;
  end
  wire [{width}:0] f_stored = stack[{{{packet}, {level_low}}}];
",
        packet = part(packet_bits, "f_packet"),
        level_low = part(level_bits, "f_level"),
    );
    let push = between(module, "wire stack_write = ", " & ")?;
    Ok(Induction {
        module: module.name().into(),
        what: format!(
            "a pop reads what the packet's push at its level wrote; {packets} packets, {levels} levels"
        ),
        texts: alone(module),
        observer: observer.replace("pushes_last", push),
        laws: vec![
            law(
                "what was pushed stays until it is overwritten at its level",
                "!f_pushed | f_stored == f_word",
            ),
            law(
                "a pop reads what was pushed",
                "!f_popped | stack_read == f_expected",
            ),
            law(
                "a push to a full stack is not written",
                format!("!stack_write | {level} < {levels}"),
            ),
        ],
        depth: 1,
        arrays: true,
        plants: vec![
            plant(
                "a pop reads another level",
                "stack_read <= stack[",
                "level_below",
                "~level_below",
            ),
            plant(
                "a full stack is written",
                "wire stack_write =",
                "& ~stack_full",
                "",
            ),
        ],
    })
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
        tools::yosys(
            folder,
            &format!(
                "read_verilog -formal -sv laws.sv; hierarchy -check -top {}; proc; flatten; delete -output o:*; \
                 opt -purge -nodffe -nosdff; {memory}; opt -purge -nodffe -nosdff; dffunmap; opt_clean -purge; \
                 {write} laws.smt2",
                self.module
            ),
        )?;
        // The base must cover as many clocks as a step assumes, and what a planted fault needs to show.
        let base = (self.depth + 1).to_string();
        let depth = self.depth.to_string();
        for induction in [false, true] {
            let mut args = vec!["--noprogress", "-s", "z3"];
            args.extend(match induction {
                false => ["-t", &base],
                true => ["-t", &depth],
            });
            if induction {
                args.push("-i");
            }
            if !self.arrays {
                args.push("--unroll");
            }
            args.push("laws.smt2");
            let stage = if induction {
                "a step of the induction"
            } else {
                "after reset"
            };
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
            Some(plant) => edited(top, &plant.edit).with_context(|| self.module.clone())?,
            None => top.clone(),
        };
        let end = edited.rfind("endmodule").context("a module has an end")?;
        let mut text = format!("{}{}", &edited[..end], self.observer);
        text += "  always @* if (f_started) begin\n";
        let first_law = text.lines().count() + 1;
        for law in &self.laws {
            let _ = writeln!(text, "    assert ({}); // {}", law.holds, law.what);
        }
        text += "  end\n";
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
