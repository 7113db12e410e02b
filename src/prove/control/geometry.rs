//! The geometry unit.

use super::*;

/// Places in which a leaf can be, in their order: its record asked for, its vertices being asked for, owed, all there, its rays
/// in the test's entrance, all of them in the test.
const PLACES: [&str; 6] = ["record", "job", "owed", "ready", "now", "out"];

/// Of the geometry unit: a leaf that it takes is in one place and leaves once, under its own packet's number, as a triangle or as an
/// instance as it came; its rays go into the test once each, and not before every one of its vertices is there; no queue overflows;
/// what is asked for stays asked for until it is taken, once; and a leaf that is here moves, or waits for memory. It is assumed that
/// a packet has one leaf here at a time, with a ray in its mask, that skinning borrows the unit when none is here, and that memory
/// answers what it was asked, once. Every packet is watched: there are few.
pub(super) fn conserves(module: &Arc<Module>, packets: u32) -> Result<Induction> {
    let queues = queues(module)?;
    let (jobs, ready) = (
        queue(&queues, "vertex_queue")?,
        queue(&queues, "ready_queue")?,
    );
    ensure!(
        jobs.settling.is_some() && ready.settling.is_none(),
        "the laws must follow the geometry unit's queues"
    );
    let pb = bits_for(u64::from(packets));
    let rays = port_width(module, "leaf_mask")?;
    let corner = port_width(module, "vertex_request_tag")? - pb;
    let stages = |valid: &str| -> Result<u32> {
        let (line, last) = between(module, &format!("assign {valid} = "), "];")?
            .split_once('[')
            .with_context(|| format!("{valid} comes from a delay line"))?;
        ensure!(line.ends_with("_delay"), "{valid} comes from {line}");
        Ok(last.parse::<u32>().context("a delay line's last")? + 1)
    };
    let (tests, moves) = (stages("watch_test_valid")?, stages("object_valid")?);
    let mut observer = START.to_string();
    observer += &jobs.view();
    observer += &ready.view();
    let _ = write!(
        observer,
        "
  wire [{pb}-1:0] f_record_packet = record_response_tag[{pb}-1:0];
  wire [{pb}-1:0] f_job_packet = vertex_queue_front[{pb}-1:0];
  wire [{pb}-1:0] f_vertex_packet = vertex_response_tag[{corner} +: {pb}];
  wire [{pb}-1:0] f_ready_packet = ready_queue_front[{pb}-1:0];
  wire f_issued_last = busy & now_last;
  wire f_moved = object_valid & object_last;
  reg [{packets}-1:0] f_record, f_job, f_owed, f_ready, f_now, f_out;
  wire [{packets}-1:0] f_here = f_record | f_job | f_owed | f_ready | f_now | f_out;
  reg [{packets}*{owed}-1:0] f_owed_vertices;
  reg [{rays}-1:0] f_issued;
  always @(posedge clk)
    if (rst) begin
      f_record <= 0; f_job <= 0; f_owed <= 0; f_ready <= 0; f_now <= 0; f_out <= 0; f_owed_vertices <= 0;
    end else begin
      f_record <= (f_record | (take_leaf << leaf_packet)) & ~(record_response_valid << f_record_packet);
      f_job <= (f_job | (record_response_valid << f_record_packet)) & ~(job_done << f_job_packet);
      f_owed <= (f_owed | (job_done << f_job_packet)) & ~(leaf_complete << f_vertex_packet);
      f_ready <= (f_ready | (leaf_complete << f_vertex_packet)) & ~(takes << f_ready_packet);
      f_now <= (f_now & ~(f_issued_last << now_packet)) | (takes << f_ready_packet);
      f_out <= (f_out & ~(done_valid << done_packet) & ~(f_moved << object_packet)) | (f_issued_last << now_packet);
      f_owed_vertices <= (f_owed_vertices | (vertex_fire << vertex_request_tag)) & ~(vertex_response_valid << vertex_response_tag);
    end
  always @(posedge clk)
    if (takes) f_issued <= 0;
    else if (busy & last_slot) f_issued <= f_issued | (1'b1 << issue_ray);
  // What counts by packet is cleared after reset, before anything comes.
  reg f_sweeping;
  reg [{pb}-1:0] f_swept;
  always @(posedge clk)
    if (rst) begin
      f_sweeping <= 1'b1; f_swept <= 0;
    end else if (f_sweeping) begin
      f_sweeping <= f_swept != {last}; f_swept <= f_swept + 1'b1;
    end
  reg f_refused_leaf;
  reg [127:0] f_shown_leaf;
  wire [127:0] f_shows_leaf = {{leaf_packet, leaf_address, leaf_context}};
  always @(posedge clk) begin
    f_refused_leaf <= !rst & leaf_valid & !leaf_ready;
    f_shown_leaf <= f_shows_leaf;
  end
  reg f_instanced;
  always @(posedge clk) f_instanced <= instanced;
  wire f_moves = takes | busy | f_out != 0 | ({jobs_held} != 0 & !vertex_queue_valid);
  wire f_memory = f_record != 0 | f_owed_vertices != 0 | vertex_request_valid;
",
        owed = 1 << corner,
        last = packets - 1,
        jobs_held = jobs.count(),
    );
    let mut laws = vec![
        shown_stays(
            &mut observer,
            "record request",
            "record_request_valid",
            "record_request_ready",
            "{record_request_address, record_request_tag}",
        ),
        shown_stays(
            &mut observer,
            "vertex request",
            "vertex_request_valid",
            "vertex_request_ready",
            "{vertex_request_address, vertex_request_tag}",
        ),
        law(
            "as many leaves are in the vertex queue as it holds",
            format!("{} == {}", jobs.count(), bits_of("f_job", packets)),
        ),
        law(
            "as many leaves are in the ready queue as it holds",
            format!("{} == {}", ready.count(), bits_of("f_ready", packets)),
        ),
        law(
            "vertices are asked for from the first on",
            "vertex_queue_valid | corner == 0",
        ),
        law(
            "one leaf is in the test's entrance, as it came",
            "f_now == (busy << now_packet) & (!busy | now_instance == f_instance[now_packet])",
        ),
        law(
            "a ray takes three slots, or one",
            "!busy | slot <= (now_instance ? 2'd2 : 2'd0)",
        ),
        law(
            "each ray of the mask is issued or to be issued",
            format!(
                "!busy | (now_mask != 0 & (f_issued & now_mask) == 0 & (f_issued | now_mask) == f_masks[{rays}*now_packet +: {rays}])"
            ),
        ),
        law(
            "a leaf that leaves was here, as a triangle",
            "!done_valid | (f_out[done_packet] & !f_instance[done_packet])",
        ),
        law(
            "a packet that goes on in an object was here, at an instance",
            "!f_moved | (f_out[object_packet] & f_instance[object_packet])",
        ),
        law(
            "nothing is here until what counts by packet is clear",
            "!f_sweeping | f_here == 0",
        ),
        law(
            "a leaf that is here moves, or waits for memory",
            "f_here == 0 | f_moves | f_memory",
        ),
    ];
    laws.extend(jobs.settles());
    let (mut instance, mut masks) = (vec![], vec![]);
    for p in 0..packets {
        let (slots, n) = (1 << corner, format!("f_vertices_{p}"));
        let _ = write!(
            observer,
            "
  reg [{corner}:0] f_asked_{p}, f_arrived_{p};
  reg [{rays}-1:0] f_mask_{p};
  reg f_instance_{p};
  reg [7:0] f_age_{p};
  wire [{corner}:0] {n} = f_instance_{p} ? 6 : 3;
  wire [{slots}-1:0] f_owed_{p} = f_owed_vertices[{p}*{slots} +: {slots}];
  always @(posedge clk) begin
    if (take_leaf & leaf_packet == {p}) begin
      f_instance_{p} <= leaf_is_instance;
      f_mask_{p} <= leaf_mask;
    end
    if (record_response_valid & f_record_packet == {p}) begin
      f_asked_{p} <= 0;
      f_arrived_{p} <= 0;
    end else begin
      f_asked_{p} <= f_asked_{p} + (vertex_fire & f_job_packet == {p});
      f_arrived_{p} <= f_arrived_{p} + (vertex_response_valid & f_vertex_packet == {p});
    end
    f_age_{p} <= f_issued_last & now_packet == {p} ? 0 : f_age_{p} + 1'b1;
  end
  wire f_front_{p} = vertex_queue_valid & f_job_packet == {p};
  wire f_leaves_{p} = f_instance_{p}
    ? f_age_{p} < {moves} & in_origin_slot_delay[f_age_{p}] & now_last_delay[f_age_{p}] & packet_or_joint_delay[{pb}*f_age_{p} +: {pb}] == {p}
    : f_age_{p} < {tests} & test_issued_delay[f_age_{p}] & now_last_delay[f_age_{p}] & packet_or_joint_delay[{pb}*f_age_{p} +: {pb}] == {p};
"
        );
        instance.push(format!("f_instance_{p}"));
        masks.push(format!("f_mask_{p}"));
        let sum: Vec<String> = PLACES.iter().map(|set| format!("f_{set}[{p}]")).collect();
        let fetching = format!("(f_job[{p}] | f_owed[{p}])");
        let of = |what: &str| format!("{what}, packet {p}");
        laws.extend([
            law(
                &of("a leaf is in one place"),
                format!("{} <= 3'd1", sum.join(" + ")),
            ),
            law(
                &of("vertices are asked for in turn, by the leaf at the front"),
                format!("!f_job[{p}] | (f_asked_{p} == (f_front_{p} ? corner : 0) & f_asked_{p} < {n})"),
            ),
            law(
                &of("a leaf leaves the queue when all its vertices are asked for"),
                format!("!f_owed[{p}] | (f_asked_{p} == {n} & f_arrived_{p} < {n})"),
            ),
            law(
                &of("every vertex asked for is owed or has arrived"),
                format!("!{fetching} | {} + f_arrived_{p} == f_asked_{p}", bits_of(&format!("f_owed_{p}"), slots)),
            ),
            law(
                &of("no vertex is owed that was not asked for"),
                format!("{fetching} ? (f_owed_{p} >> f_asked_{p}) == 0 : f_owed_{p} == 0"),
            ),
            law(
                &of("arrivals are counted"),
                format!("f_sweeping & f_swept <= {p} | arrival_memory[{p}] == ({fetching} ? f_arrived_{p} : 0)"),
            ),
            law(
                &of("its kind and its mask are kept"),
                format!("!f_here[{p}] | (f_mask_{p} != 0 & instance_leaf_memory[{p}] == f_instance_{p} & mask_memory[{p}] == f_mask_{p})"),
            ),
            law(
                &of("a leaf is complete when all its vertices are there"),
                format!("!(leaf_complete & f_vertex_packet == {p}) | (f_owed[{p}] & f_arrived_{p} + 1'b1 == {n})"),
            ),
            law(
                &of("all of whose rays are issued is in the test until it leaves"),
                format!("!f_out[{p}] | f_leaves_{p}"),
            ),
        ]);
    }
    let concatenated = |of: &[String]| of.iter().rev().cloned().collect::<Vec<_>>().join(", ");
    let ages: Vec<String> = (0..packets).map(|p| format!("f_age_{p}")).collect();
    let _ = write!(
        observer,
        "
  wire [{packets}-1:0] f_instance = {{{}}};
  wire [{packets}*{rays}-1:0] f_masks = {{{}}};
  wire [{packets}*8-1:0] f_ages = {{{}}};
",
        concatenated(&instance),
        concatenated(&masks),
        concatenated(&ages),
    );
    // The last of a leaf's slots, in the stages of the test.
    for (line, length, is_instance) in [
        ("test_issued_delay", tests, "!"),
        ("in_origin_slot_delay", moves, ""),
    ] {
        let strays = format!("f_strays_{line}");
        let _ = writeln!(observer, "  wire [{length}-1:0] {strays};");
        for stage in 0..length {
            let packet = format!("packet_or_joint_delay[{} +: {pb}]", stage * pb);
            let _ = writeln!(
                observer,
                "  assign {strays}[{stage}] = {line}[{stage}] & now_last_delay[{stage}] & \
                 !(f_out[{packet}] & {is_instance}f_instance[{packet}] & f_ages[8*{packet} +: 8] == {stage});"
            );
        }
        laws.push(law(
            "the last slot of a leaf in the test is of one that is there",
            format!("{strays} == 0"),
        ));
    }
    // Behind what it speaks of.
    let _ = write!(
        observer,
        "
  always @* if (f_started) begin
    assume (f_instanced == instanced);
    assume (sweep == f_sweeping & sweep_packet == f_swept);
    assume (!(sweep & (leaf_valid | vertex_response_valid)));
    assume (!(skinning & (leaf_valid | f_here != 0)));
    assume (!leaf_valid | (!f_here[leaf_packet] & leaf_mask != 0));
    assume (!f_refused_leaf | (leaf_valid & f_shows_leaf == f_shown_leaf));
    assume (!record_response_valid | (f_record[f_record_packet] & record_response_tag[{pb}] == f_instance[f_record_packet]));
    assume (!vertex_response_valid | f_owed_vertices[vertex_response_tag]);
    // What comes out of the queues went in.
    assume (!vertex_queue_valid | (f_job[f_job_packet] & vertex_queue_front[{pb}] == f_instance[f_job_packet]));
    assume (!ready_queue_valid | (f_ready[f_ready_packet] & ready_queue_front[{pb}] == f_instance[f_ready_packet]));
  end
"
    );
    Ok(Induction {
        module: module.name().into(),
        what: format!(
            "a leaf is in one place and leaves once, its rays tested once each when all is there, ports, nothing locks up; {packets} packets"
        ),
        texts: texts(module, &[]),
        observer,
        laws,
        happens: "f_out != 0".into(),
        cut: vec![],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a leaf is complete before its last vertex comes",
                "wire last_arrives =",
                "3'd2",
                "3'd1",
            ),
            plant(
                "the last vertex is not asked for",
                "wire last_corner =",
                "3'd5",
                "3'd4",
            ),
            plant(
                "a vertex counts as asked for before it is taken",
                "wire vertex_fire =",
                "vertex_queue_valid & vertex_request_ready",
                "vertex_queue_valid",
            ),
            plant(
                "a leaf is taken while another's rays are issued",
                "wire takes_next =",
                "~busy | now_last",
                "1'b1",
            ),
            plant(
                "an instance leaves as a triangle",
                "assign test_issued =",
                "& ~now_instance",
                "",
            ),
        ],
    })
}

/// How many of the lowest bits of a word are set.
fn bits_of(word: &str, bits: u32) -> String {
    let bits: Vec<String> = (0..bits).map(|i| format!("{word}[{i}]")).collect();
    format!("(8'd0 + {})", bits.join(" + "))
}
