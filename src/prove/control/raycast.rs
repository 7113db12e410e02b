//! The ray casting unit: who is in which packet's place, and who uses what is shared.

use super::*;

/// Of the ray casting unit: every packet number is in one place, so no queue overflows and hits leave under the tag that their rays
/// came with; rays of the world give way to those of an object's space, and none is lost; and of rays and skinning only one has the
/// geometry unit and its port to vertex memory, whose answers reach who asked. It is assumed of the units within what is proved of them:
/// the traversal unit finishes each packet that it was given once, the geometry unit asks for nothing between packets, the skinning processor
/// for nothing between meshes, and what they show at a port stays.
pub(super) fn shares(module: &Arc<Module>, packets: u32) -> Result<Induction> {
    let queues = queues(module)?;
    let (free, finished) = (
        queue(&queues, "free_queue")?,
        queue(&queues, "finished_queue")?,
    );
    let pb = bits_for(u64::from(packets));
    let tag = port_width(module, "hit_tag")?;
    let may_start = between(module, ".may_start(", "),\n")?;
    let tags = match module.verilog().contains(" tag_memory [") {
        true => "tag_memory",
        false => "tag_memory_copy0",
    };
    let mut observer = START.to_string();
    observer += &free.view();
    observer += &finished.view();
    let _ = write!(
        observer,
        "
  reg [15:0] f_traversing, f_owed_geometry, f_owed_skinner;
  wire f_asks = vertex_request_valid & vertex_request_ready;
  always @(posedge clk)
    if (rst) begin
      f_traversing <= 0; f_owed_geometry <= 0; f_owed_skinner <= 0;
    end else begin
      f_traversing <= f_traversing + packet_enters - traversal_finished_valid;
      f_owed_geometry <= f_owed_geometry + (f_asks & !skinning_now) - intersection_vertex_response_valid;
      f_owed_skinner <= f_owed_skinner + (f_asks & skinning_now) - skinner_vertex_response_valid;
    end
  wire [15:0] f_free = {free_count};
  wire [15:0] f_finished = {finished_count};
  // Memory answers what it was asked.
  always @* assume (!vertex_response_valid | f_owed_geometry + f_owed_skinner != 0);
  always @* assume (f_owed_geometry + f_asks < 16'd1024 & f_owed_skinner + f_asks < 16'd1024);
  // The units.
  always @* assume (!traversal_finished_valid | f_traversing != 0);
  always @* assume (f_traversing != 0 | (!intersection_vertex_request_valid & !intersection_object_valid & f_owed_geometry == 0));
  always @* assume (skinner_skinning | (!skinner_vertex_request_valid & f_owed_skinner == 0));
  always @* assume (!skinner_start_ready | (!skinner_skinning & ({may_start})));
  reg f_mesh, f_refused_geometry, f_refused_skinner;
  reg [63:0] f_shown_geometry, f_shown_skinner;
  wire [63:0] f_shows_geometry = {{intersection_vertex_request_address, intersection_vertex_request_tag}};
  wire [63:0] f_shows_skinner = {{skinner_vertex_request_address, skinner_vertex_request_tag}};
  always @(posedge clk) begin
    f_mesh <= !rst & (skinner_skinning | (skin_start_valid & skinner_start_ready));
    f_refused_geometry <= !rst & intersection_vertex_request_valid & !vertex_request_ready;
    f_refused_skinner <= !rst & skinner_vertex_request_valid & !vertex_request_ready;
    f_shown_geometry <= f_shows_geometry;
    f_shown_skinner <= f_shows_skinner;
  end
  always @* if (f_started) begin
    assume (f_mesh | !skinner_skinning);
    assume (!f_refused_geometry | (intersection_vertex_request_valid & f_shows_geometry == f_shown_geometry));
    assume (!f_refused_skinner | (skinner_vertex_request_valid & f_shows_skinner == f_shown_skinner));
  end
  // One packet number, any: where it is, and the tag that its first ray came with.
  (* anyconst *) wire [{pb}-1:0] f_packet;
  always @* assume (f_packet < {packets});
  reg f_is_free, f_is_traversing, f_is_finished, f_front_stays;
  reg [{pb}-1:0] f_front;
  reg [{tag}-1:0] f_tag;
  wire f_is_out = out_valid & out_packet == f_packet;
  wire f_enters = packet_enters & free_queue_front == f_packet;
  wire f_finishes = traversal_finished_valid & traversal_finished_packet == f_packet;
  always @(posedge clk) begin
    if (rst) begin
      f_is_free <= 1'b0; f_is_traversing <= 1'b0; f_is_finished <= 1'b0;
    end else begin
      f_is_free <= (f_is_free & !f_enters) | (sweeping ? sweep_packet == f_packet : freed & freed_packet == f_packet);
      f_is_traversing <= (f_is_traversing & !f_finishes) | f_enters;
      f_is_finished <= (f_is_finished & !(load & finished_packet == f_packet)) | f_finishes;
    end
    if (f_enters) f_tag <= first_ray ? ray_tag : {tags}[f_packet];
    f_front_stays <= !rst & free_queue_valid & !take_free;
    f_front <= free_queue_front;
  end
  wire [{pb}-1:0] finished_packet = finished_queue_front[{pb}-1:0];
  always @* begin
    assume (!f_finishes | f_is_traversing);
    assume (!(free_queue_valid & free_queue_front == f_packet) | f_is_free);
    assume (!(finished_queue_valid & finished_packet == f_packet) | f_is_finished);
    assume (!f_started | !f_front_stays | (free_queue_valid & free_queue_front == f_front));
  end
",
        free_count = free.count(),
        finished_count = finished.count(),
    );
    let mut laws = vec![
        shown_stays(
            &mut observer,
            "hit",
            "hit_valid",
            "hit_ready",
            "{out, out_ray}",
        ),
        shown_stays(
            &mut observer,
            "vertex request",
            "vertex_request_valid",
            "vertex_request_ready",
            "{vertex_request_address, vertex_request_tag}",
        ),
    ];
    laws.extend([
        law(
            "every packet under way is traversing, finished or leaving",
            "under_way == f_traversing + f_finished + out_valid",
        ),
        law(
            "every packet number is free or under way",
            format!("sweeping ? (f_free == sweep_packet & under_way == 0) : f_free + under_way == {packets}"),
        ),
        law(
            "no more packets are under way than there are",
            format!("under_way <= {packets} & f_traversing <= {packets} & f_finished <= {packets}"),
        ),
        law(
            "packets are swept once each",
            format!("!sweeping | sweep_packet < {packets}"),
        ),
        law(
            "nothing is pushed to a full queue of free packets",
            format!("!({}) | f_free < {packets}", free.push),
        ),
        law(
            "nothing is pushed to a full queue of finished packets",
            format!("!({}) | f_finished < {packets}", finished.push),
        ),
        law(
            "queues are popped only where they show a word",
            format!(
                "(!({}) | {}) & (!({}) | {})",
                free.pop,
                free.shows(),
                finished.pop,
                finished.shows()
            ),
        ),
        law(
            "a packet number is in one place",
            "f_is_free + f_is_traversing + f_is_finished + f_is_out == ((sweeping & f_packet >= sweep_packet) ? 3'd0 : 3'd1)",
        ),
        law(
            "a packet's hits leave under the tag that its first ray came with",
            "!f_is_out | hit_tag == f_tag",
        ),
        law(
            "a packet's tag stays while it is under way",
            format!("!(f_is_traversing | f_is_finished | f_is_out) | {tags}[f_packet] == f_tag"),
        ),
        law(
            "a ray of the world is taken only where none of an object's space comes",
            "!(take_ray & object_valid)",
        ),
        law(
            "a ray waits for nothing but a packet under way, an object's ray or a mesh",
            "sweeping | ready | object_valid | paused | under_way != 0",
        ),
        law(
            "no packet is under way while a mesh is skinned",
            "!(skinner_skinning | f_mesh) | (under_way == 0 & !sweeping)",
        ),
        law(
            "no ray is taken while a mesh is skinned",
            "!(skinning_now & take_ray)",
        ),
        law(
            "only one unit is owed vertices",
            "f_owed_geometry == 0 | f_owed_skinner == 0",
        ),
        law(
            "a vertex reaches the unit that asked",
            "(!intersection_vertex_response_valid | f_owed_geometry != 0) & (!skinner_vertex_response_valid | f_owed_skinner != 0)",
        ),
        law(
            "a vertex reaches one unit",
            "vertex_response_valid == (intersection_vertex_response_valid ^ skinner_vertex_response_valid)",
        ),
        law(
            "what a unit asks for is asked",
            "vertex_request_valid == (intersection_vertex_request_valid | skinner_vertex_request_valid)",
        ),
    ]);
    Ok(Induction {
        module: module.name().into(),
        what: "packet numbers are in one place, hits keep their tag, the geometry unit and its port serve one, answers reach who asked"
            .into(),
        texts: texts(module, &["_processor"]),
        observer,
        laws,
        happens: "packet_leaves".into(),
        cut: vec![],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a ray is taken where an object's comes",
                "wire ready =",
                "& ~object_valid",
                "",
            ),
            plant(
                "a packet starts while a mesh is skinned",
                "wire paused =",
                "| skinning_now",
                "",
            ),
            plant(
                "skinning's vertices go to the geometry unit too",
                "wire intersection_vertex_response_valid =",
                "& ~skinning_now",
                "",
            ),
            plant(
                "a packet is free before its last hit is taken",
                "wire packet_leaves =",
                "hit_taken",
                "shown",
            ),
            plant(
                "skinning's requests reach no memory",
                "assign vertex_request_valid =",
                "skinning_now ?",
                "1'b0 ?",
            ),
        ],
    })
}
