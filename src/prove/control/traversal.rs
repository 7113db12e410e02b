//! The traversal unit: packets, choices, stack.

use super::*;

/// Of the traversal unit: every packet that it was given is in exactly one place, or is finished: so no queue ever holds more than
/// there are packets. It is given no more packets than it has numbers for; memory and geometry unit answer what they were asked.
pub(super) fn packets(module: &Arc<Module>, packets: u32) -> Result<Induction> {
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
    // Where a packet goes may have a register of its own.
    if module.verilog().contains("\n  reg  entered_s1;") {
        places.push(place("entered_s1", "entered", "entered_s1"));
    }
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
        texts: texts(module, &[]),
        observer,
        laws,
        happens: "finished_valid & f_total != 0".into(),
        // Which way a packet goes.
        cut: ["goes_left", "goes_right", "stay_mask", "stack_read"]
            .map(String::from)
            .to_vec(),
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
pub(super) fn choices(module: &Arc<Module>) -> Result<Induction> {
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
        texts: texts(module, &[]),
        observer,
        laws,
        happens: "f_refused_leaf & leaf_ready".into(),
        // What is pushed, and when.
        cut: [
            "stepped_write",
            "entered",
            "retry_push",
            "step_goes_nowhere",
        ]
        .map(String::from)
        .into_iter()
        .chain(Stored::of(module)?.reads())
        .collect(),
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

/// Of the stack: what a pop reads is what was last pushed for that packet at that level, and a packet's level goes up by 1 with a
/// push and down by 1 with a pop. One packet and level, any, are watched. What is pushed, who pops and which level a node's answer
/// brings back may be anything; but a level is assumed to be at most the stack's depth: beyond it the unit has long flagged an overflow.
pub(super) fn stack(module: &Arc<Module>, config: &Config) -> Result<Induction> {
    let (packets, levels) = (config.packets_in_flight, config.stack_depth);
    let pb = bits_for(u64::from(packets));
    let lb = bits_for(u64::from(levels) + 1);
    let level = between(module, "wire stack_full = ", " == ")?;
    let level_after = between(module, "(high_water < ", ")")?;
    let stored = Stored::of(module)?;
    let (address, data) = (&stored.address, &stored.data);
    let (packet_bits, level_bits) = address
        .trim_matches(['{', '}'])
        .split_once(", ")
        .context("the stack's address is packet and level")?;
    let part = |bits: &str, of: &str| match bits.split_once('[') {
        Some((_, range)) => format!("{of}[{range}"),
        None => of.to_string(),
    };
    // What pops may pass a register before it addresses the stack; its valid bit passes as many.
    let valid_bits = pipeline_bits(module, "pop_done")?;
    let pop_stage = usize::from(module.verilog().contains("] pop_chosen ="));
    let pop_valid = match pop_stage {
        0 => "pop_valid",
        stage => &valid_bits[stage - 1],
    };
    let pops = valid_bits.len() - pop_stage;
    let level_out = between(module, "pop_out_context = {", "}")?
        .rsplit(", ")
        .next();
    let level_out = level_out.context("a pop's context has a level")?;
    let push = between(module, "wire stack_write = ", " & ")?;
    let observer = format!(
        "{START}
  (* anyconst *) wire [{pb}-1:0] f_packet;
  (* anyconst *) wire [{lb}-1:0] f_level;
  always @* assume (f_packet < {packets} & f_level < {levels});
  always @* assume (!{push} | (step_packet < {packets} & {level} <= {levels}));
  wire [{lb}-1:0] f_pop_level = pop[{pb} +: {lb}];
  wire f_push = {push} & step_packet == f_packet & {level} == f_level & f_level != {levels};
  wire f_pop = {pop_valid} & !stack_empty & pop[{pb}-1:0] == f_packet & f_pop_level == f_level + 1'b1;
  reg f_pushed, f_popped, f_was_reset;
  reg [{width}-1:0] f_word, f_expected;
  reg [{pops}*{lb}-1:0] f_popped_levels;
  always @(posedge clk) begin
    f_was_reset <= rst;
    if (rst) f_pushed <= 1'b0;
    else if (f_push) begin
      f_pushed <= 1'b1;
      f_word <= {data};
    end
    f_popped <= !rst & f_pop & f_pushed;
    f_expected <= f_word;
    f_popped_levels <= {{f_popped_levels, f_pop_level}};
  end
  wire [{place_bits}-1:0] f_place = {{{packet}, {level_low}}};
{memory}  wire [{lb}-1:0] f_level_popped = f_popped_levels[{pops}*{lb}-1 -: {lb}];
  wire [{lb}-1:0] f_level_before = {level};
  wire [{lb}-1:0] f_level_out = pop_out_context[{lb}-1:0];
",
        packet = part(packet_bits, "f_packet"),
        level_low = part(level_bits, "f_level"),
        width = stored.width,
        place_bits = pb + lb - 1,
        memory = stored.observer(),
    );
    let cut = [
        "pop",
        "goes_both",
        "level_before",
        "stack_write_data",
        "step_packet",
    ];
    let mut proof = Induction {
        module: module.name().into(),
        what: format!(
            "a pop reads what the packet's push at its level wrote; levels count; {packets} packets, {levels} levels"
        ),
        texts: alone(module),
        observer,
        laws: vec![
            law(
                "a clock of reset is enough: nothing is pushed after it, nor counted",
                "!f_was_reset | (!stack_write & high_water == 0 & !overflow)",
            ),
            law(
                "a push to a full stack is not written",
                format!("!stack_write | {level} < {levels}"),
            ),
            law(
                "a packet's level goes up by 1 where it pushes, else stays",
                format!("!step_valid | {level_after} == f_level_before + {push}"),
            ),
            law(
                "a packet's level goes down by 1 where it pops",
                "!(pop_done & f_level_popped != 0) | f_level_out == f_level_popped - 1'b1",
            ),
        ],
        happens: "f_popped".into(),
        cut: cut.map(String::from).to_vec(),
        depth: pops as u32 + 1,
        arrays: true,
        plants: vec![
            plant(
                "a full stack is written",
                "wire stack_write =",
                "& ~stack_full",
                "",
            ),
            plant(
                "a push leaves the packet's level as it was",
                "next_level =",
                "goes_both",
                "1'b0",
            ),
            plant(
                "a pop leaves the packet two levels down",
                "pop_out_context =",
                level_out,
                &format!("{level_out} - 1'b1"),
            ),
        ],
    };
    proof.laws.extend(stored.laws());
    proof.plants.extend(stored.plants());
    Ok(proof)
}

/// How a unit keeps its stack, read from its text: as one memory, or in banks (see `hw::banks`).
struct Stored {
    /// Bits of a word.
    width: u32,
    /// Where a push writes, and what, in the clock in which it decides to.
    address: String,
    data: String,
    /// The address that a pop reads, as it is named.
    read_address: String,
    banks: Vec<Bank>,
    /// The choice between the banks' words.
    choice: Option<String>,
}

/// A bank: a memory, and the registers with which it is written.
struct Bank {
    name: String,
    enable: String,
    address: String,
    data: String,
}

/// Bits of an address inside a bank.
const BANK_BITS: u32 = 9;

impl Stored {
    fn of(module: &Module) -> Result<Stored> {
        let name_of = |i: usize, banked: bool| match banked {
            true => format!("stack_bank{i}"),
            false => "stack".into(),
        };
        let banked = module.verilog().contains("] stack_bank0 [");
        let count = match banked {
            true => (0..)
                .take_while(|i| module.verilog().contains(&format!("] stack_bank{i} [")))
                .count(),
            false => 1,
        };
        let mut banks = vec![];
        for i in 0..count {
            let name = name_of(i, banked);
            let write = (module.verilog().lines())
                .find(|line| line.contains("if (") && line.contains(&format!(") {name}[")))
                .with_context(|| format!("{name} is written"))?;
            let part = |before: &str, after: &str| {
                let found = write
                    .split_once(before)
                    .and_then(|(_, rest)| rest.split_once(after));
                let (inner, _) = found.with_context(|| format!("how {name} is written"))?;
                Ok::<_, anyhow::Error>(inner.to_string())
            };
            banks.push(Bank {
                enable: part("if (", ")")?,
                address: part(&format!(" {name}["), "] <=")?,
                data: part("<= ", ";")?,
                name,
            });
        }
        let first = &banks[0];
        let width = (module.verilog().lines())
            .find_map(|line| {
                let rest = line.trim().strip_prefix("reg  [")?;
                let (high, rest) = rest.split_once(":0] ")?;
                (rest == format!("{}_read;", first.name)).then(|| high.parse::<u32>().ok())?
            })
            .context("the stack's words have a width")?
            + 1;
        let read = between(module, &format!("{0}_read <= {0}[", first.name), ";")?;
        let joined = |name: &str| {
            let name = name.split('[').next().unwrap_or(name);
            between(module, &format!("] {name} = "), ";").map(str::to_string)
        };
        let before = |register: &str| {
            between(module, &format!("    {register} <= "), ";").map(str::to_string)
        };
        let (address, data, read_address, choice) = match banked {
            false => (
                first.address.clone(),
                first.data.clone(),
                read.trim_end_matches(']').to_string(),
                None,
            ),
            true => {
                let choice = (module.verilog().split(';'))
                    .find(|text| text.contains(" ? ") && text.contains("stack_bank0_read"))
                    .and_then(|text| text.split_once("<=")?.0.split_whitespace().last())
                    .context("a choice between the stack's banks")?;
                (
                    joined(&before(&first.address)?)?,
                    before(&first.data)?,
                    (before(read.trim_end_matches(']'))?.split('[').next())
                        .context("where a pop reads")?
                        .to_string(),
                    Some(choice.to_string()),
                )
            }
        };
        Ok(Stored {
            width,
            address,
            data,
            read_address,
            banks,
            choice,
        })
    }

    /// `what` of the bank that the watched place is in.
    fn of_bank(&self, what: impl Fn(&Bank) -> String) -> String {
        let (first, others) = self.banks.split_first().expect("a stack has a bank");
        (1..).zip(others).fold(what(first), |otherwise, (i, bank)| {
            format!(
                "f_place >> {BANK_BITS} == {i} ? {} : {otherwise}",
                what(bank)
            )
        })
    }

    fn observer(&self) -> String {
        let w = self.width;
        if self.choice.is_none() {
            return format!(
                "  wire [{w}-1:0] f_stored = {0}[f_place];
  wire [{w}-1:0] f_read = {0}_read;
",
                self.banks[0].name
            );
        }
        let enable = self.of_bank(|bank| bank.enable.clone());
        let low = format!("f_place[{BANK_BITS}-1:0]");
        let written = self.of_bank(|bank| format!("{} == {low}", bank.address));
        format!(
            "  wire [{w}-1:0] f_stored = {stored};
  wire [{w}-1:0] f_read = {read};
  // A push is written a clock later, as a pop reads. Its packet cannot pop in the clocks until then: it has yet to ask for its next node.
  reg f_flies;
  always @(posedge clk) f_flies <= f_push;
  always @* assume (!(f_pop & (f_push | f_flies)));
  wire f_writes = ({enable}) & ({written});
  wire [{w}-1:0] f_written = {data};
  reg [2:0] f_then;
  reg [{w}-1:0] f_then_expected0, f_then_expected1, f_then_expected2;
  always @(posedge clk) begin
    f_then <= rst ? 3'b0 : {{f_then[1:0], f_popped}};
    f_then_expected0 <= f_expected;
    f_then_expected1 <= f_then_expected0;
    f_then_expected2 <= f_then_expected1;
  end
",
            stored = self.of_bank(|bank| format!("{}[{low}]", bank.name)),
            read = self.of_bank(|bank| format!("{}_read", bank.name)),
            data = self.of_bank(|bank| bank.data.clone()),
        )
    }

    /// The registers that hold what was read.
    fn reads(&self) -> impl Iterator<Item = String> {
        (self.banks.iter()).map(|bank| format!("{}_read", bank.name))
    }

    fn laws(&self) -> Vec<Law> {
        let read = "a pop reads what was pushed";
        let stays = "what was pushed stays until it is overwritten at its level";
        match &self.choice {
            None => vec![
                law(stays, "!f_pushed | f_stored == f_word"),
                law(read, "!f_popped | f_read == f_expected"),
            ],
            Some(choice) => vec![
                law(
                    stays,
                    "!f_pushed | (f_flies ? f_writes & f_written == f_word : f_stored == f_word)",
                ),
                law(
                    "only a push at its level overwrites it",
                    "f_writes == f_flies",
                ),
                law(read, "!f_then[0] | f_read == f_then_expected0"),
                law(
                    "the word of its bank is chosen",
                    format!("!f_then[2] | {choice} == f_then_expected2"),
                ),
            ],
        }
    }

    fn plants(&self) -> Vec<Plant> {
        let another = "a pop reads another level";
        let Some(choice) = &self.choice else {
            return vec![plant(
                another,
                "stack_read <= stack[",
                "level_below",
                "~level_below",
            )];
        };
        let line = format!("] {} = ", self.read_address);
        vec![
            plant(another, &line, "level_below", "~level_below"),
            plant(
                &format!("{choice} takes another bank's word"),
                "? stack_bank1_read",
                "stack_bank1_read",
                "stack_bank0_read",
            ),
        ]
    }
}
