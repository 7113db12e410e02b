//! Queues and words read ahead.

use super::*;

/// Of a queue: what comes out is what went in, in order, once; nothing is lost and nothing overflows, given that it is
/// popped only where it shows a word and pushed only where a word is missing. One word, any, is watched.
pub(super) fn fifo(module: &Arc<Module>) -> Result<Induction> {
    let (width, depth) = (port_width(module, "data")?, words(module, "words")?);
    let bits = bits_for(u64::from(depth)) + 2;
    // Where the front is a register, what is kept is the slot behind it.
    let (slot, head) = match is_front_registered(module) {
        false => ("head", "head".to_string()),
        true => (
            "behind",
            format!("behind == 0 ? {} : behind - 1", depth - 1),
        ),
    };
    let observer = format!(
        "{START}
  always @* assume (!pop | valid);
  always @* assume (!push | count < {depth});
  wire [{bits}-1:0] f_head = {head};
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
  wire [{bits}-1:0] f_end = f_head + count;
  wire [{bits}-1:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire [{bits}-1:0] f_at = f_head + f_ahead;
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
    let registered = is_front_registered(module).then(|| {
        law(
            "it knows whether there is a word behind the front",
            "more == (count > 1)",
        )
    });
    let forgets = is_front_registered(module).then(|| {
        plant(
            "a word that is pushed as the last one is popped is not its successor",
            "front_word <= more ? words_read : data",
            ": data",
            ": words_read",
        )
    });
    let mut proof = Induction {
        module: module.name().into(),
        what: "words come out in order, each once; none is lost; no overflow; the front stays"
            .into(),
        texts: texts(module, &[]),
        observer,
        laws: vec![
            law(
                "the queue never holds more words than it has room for",
                format!("count <= {depth}"),
            ),
            law("the head is a slot", format!("{slot} < {depth}")),
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
        happens: "f_watching & pop".into(),
        cut: vec![],
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
                slot,
            ),
            plant(
                "a reset leaves words in it",
                "if (rst) count <= ",
                "if (rst)",
                "if (1'b0)",
            ),
        ],
    };
    proof.laws.extend(registered);
    proof.plants.extend(forgets);
    Ok(proof)
}

/// The same of a queue in block RAM, whose front word has a register of its own.
pub(super) fn block_fifo(module: &Arc<Module>) -> Result<Induction> {
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
    for k in 0..settling {
        let word = match k {
            0 => "words_read".into(),
            _ => format!("words_read_d{k}"),
        };
        laws.push(law(
            "the word read is the head's once that has stood still",
            format!("!settled{k} | (count != 0 & {word} == f_first)"),
        ));
    }
    Ok(Induction {
        module: module.name().into(),
        what: "words come out in order, each once; none is lost; no overflow; the front stays"
            .into(),
        texts: texts(module, &[]),
        observer,
        laws,
        happens: "f_watching & pop".into(),
        cut: vec![],
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
            plant(
                "a reset leaves its front word settled",
                &format!("if (rst) settled{} <= ", settling - 1),
                "if (rst)",
                "if (1'b0)",
            ),
        ],
    })
}

/// Of words read ahead: each comes out in the order of the requests, as memory answered it. Memory answers each request once,
/// in any order.
pub(super) fn prefetch(module: &Arc<Module>) -> Result<Induction> {
    let depth = words(module, "words")?;
    let (width, tag) = (
        port_width(module, "front")?,
        port_width(module, "request_tag")?,
    );
    let address = port_width(module, "request_address")?;
    let bits = tag + 2;
    let registered = module.verilog().contains("\n  reg  head_is_there;");
    // The slots that are taken: the count, less one that it has yet to give back.
    let taken = match registered {
        true => "count - slot_freed",
        false => "count",
    };
    let observer = format!(
        "{START}
  wire [{bits}-1:0] f_count = {taken};
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
        f_ahead <= f_count + front_valid - pop;
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
  reg [{bits}-1:0] f_inside;
  always @(posedge clk)
    if (rst) f_inside <= 0;
    else f_inside <= f_inside + (fetch_valid & fetch_ready) - pop;
  wire [{bits}-1:0] f_end = head + f_count;
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
      assign f_used[f_i] = f_from_head < f_count;
    end
  endgenerate
"
    );
    let mut proof = Induction {
        module: module.name().into(),
        what: "words come out in the order of requests, whatever the answers' order; requests shown stay".into(),
        texts: texts(module, &[]),
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
            law("a watched word is there until it is popped", "!f_watching | f_ahead < f_count + front_valid"),
            law("a watched word keeps its slot", "!f_behind | f_slot == f_tag"),
            law("a watched word has arrived when memory answered", "!f_behind | f_answered == arrived[f_tag]"),
            law("a watched word is stored as memory answered", "!(f_behind & f_answered) | f_stored == f_word"),
            law("it waits for nothing but the memory", "valid | head_arrived | f_count == 0 | f_owed[head]"),
            law("as many words are under way as were asked for and not popped", "f_inside == f_count + front_valid"),
            law("it is empty where nothing is under way", "empty == (f_inside == 0)"),
        ],
        happens: "f_watching & f_in_front & pop".into(),
        cut: vec![],
        depth: 1,
        arrays: false,
        plants: vec![
            plant("a word is forgotten when another arrives", "wire advance =", "| pop", "| 1'b1"),
            plant("it requests without room", "wire room =", "!=", "!= 1 +"),
        ],
    };
    if registered {
        proof.laws.extend([
            law(
                "a slot that has just been freed is counted, and its word is the front",
                "!slot_freed | (count != 0 & front_valid)",
            ),
            law(
                "a word that is said to be there has arrived",
                "!head_is_there | arrived[head]",
            ),
            law(
                "the second slot is behind the head",
                format!("second == (head == {} ? 0 : head + 1'b1)", depth - 1),
            ),
        ]);
        proof.plants.push(plant(
            "the head's word is said to be there again when the next one's turn comes",
            "else head_is_there <=",
            "second_arrived",
            "head_arrived",
        ));
    }
    Ok(proof)
}
