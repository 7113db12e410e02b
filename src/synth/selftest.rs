//! A self-test for a board: the core, a small scene and rays in ROM, and a checksum of the hits, which is compared with that of
//! the golden model.

use crate::bkd::layout::{MemoryImage, Record, check_capacity};
use crate::bkd::{BuildOptions, build};
use crate::config::Config;
use crate::float::Format;
use crate::golden::Caster;
use crate::hdl::{Design, Direction, bits_for};
use crate::port::{Hit, Ray};
use crate::scene::{self, Camera, Frame, ImageSize, MachineMesh};
use anyhow::{Context, Result, ensure};
use std::fmt::Write as _;

/// The module of the self-test, without the core's prefix: see [`Design::emitted`].
pub const TOP: &str = "selftest";
/// Its test bench.
pub const BENCH: &str = "selftest_tb";

/// The scene of its rays: primary rays of a picture of a built-in scene, and one shadow ray for each.
const SCENE: &str = "builtin:cornell";
const PICTURE: (u32, u32) = (16, 16);
/// Number of bits by which the hash is rotated before each field of a hit.
const ROTATION: u32 = 7;
/// Number of consecutive cycles without a hit after which the bench stops.
const PATIENCE: u32 = 10_000;

/// The self-test of one machine.
pub struct SelfTest {
    rays: Vec<Ray>,
    /// Rays per packet.
    packet: usize,
    hits: Vec<Hit>,
    image: MemoryImage,
    tag_bits: u32,
}

impl SelfTest {
    /// Loads the scene, generates the rays and casts them in the golden model.
    ///
    /// # Errors
    /// If the scene does not fit the configuration's addresses.
    pub fn new(config: &Config) -> Result<SelfTest> {
        let context = || format!("self-test on {SCENE}");
        let scene = scene::load(SCENE)?;
        let mesh = MachineMesh::new(&scene, config.format())?;
        check_capacity(0, mesh.triangles.len() as u64, config.address_bits)
            .with_context(context)?;
        let most = 1u64 << config.address_bits;
        let vertices = mesh.vertices.len();
        ensure!(
            vertices as u64 <= most,
            "self-test on {SCENE}: it has {vertices} vertices, but {} address bits name {most}; set tree.address_bits higher",
            config.address_bits
        );
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = build(&mesh.vertices, &mesh.triangles, &options).with_context(context)?;
        let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree)?;
        image.check(config.stack_depth).with_context(context)?;

        let packet = config.rays_per_packet as usize;
        let camera = Camera::framing(scene.bounds());
        let frame = Frame::new(ImageSize::new(PICTURE.0, PICTURE.1)?, packet)?;
        let mut packets = frame.primary_rays(&camera, &mesh)?;
        let caster = Caster::new(&image, config.triangle_test, packet);
        let rays_of = |packets: &[scene::RayPacket]| -> Vec<Ray> {
            packets
                .iter()
                .flat_map(|p| p.rays.iter().copied())
                .collect()
        };
        let primary = caster.cast_packets(&rays_of(&packets)).hits;
        let light = scene::default_light(scene.bounds(), &camera);
        packets.extend(scene::shadow_rays(&packets, &primary, &mesh, light)?);
        let rays = rays_of(&packets);
        let hits = caster.cast_packets(&rays).hits;
        Ok(SelfTest {
            rays,
            packet,
            hits,
            image,
            tag_bits: config.tag_bits,
        })
    }

    /// Number of rays cast, which is also the number of results.
    pub fn rays(&self) -> usize {
        self.rays.len()
    }

    /// The checksum of the hits in the golden model.
    ///
    /// A hit's hash starts at 0. For each of its fields (t, u, v, instance, triangle, tag, slot in the packet) it is rotated left by 7
    /// and combined with the field by exclusive or, all in 64 bits. The checksum is the sum of all hashes, so it does not depend on the
    /// order in which packets return.
    pub fn checksum(&self) -> u64 {
        let format = self.image.format;
        let hashes = self.hits.iter().enumerate().map(|(index, hit)| {
            let bits = |x: f64| format.to_bits(x);
            let fields = [
                bits(hit.t),
                bits(hit.u),
                bits(hit.v),
                u64::from(hit.instance),
                u64::from(hit.triangle),
                self.tag(index / self.packet),
                (index % self.packet) as u64,
            ];
            (fields.iter()).fold(0u64, |hash, field| hash.rotate_left(ROTATION) ^ field)
        });
        hashes.fold(0, u64::wrapping_add)
    }

    fn tag(&self, packet: usize) -> u64 {
        packet as u64 & ((1 << self.tag_bits) - 1)
    }

    /// The Verilog of the self-test and its bench, by file, without the core of `design`.
    pub fn files(&self, design: &Design) -> Vec<(String, String)> {
        let format = self.image.format;
        let scene = &self.image;
        let mut files = vec![];
        let mut roms = vec![];
        for (name, record, words) in [
            ("node", Record::node(format), scene.node_words()),
            ("record", Record::triangle(), scene.record_words()),
            ("vertex", Record::vertex(format), scene.vertex_words()),
        ] {
            let lines: Vec<String> = record
                .hex_lines(&words)
                .lines()
                .map(str::to_string)
                .collect();
            let rom = Rom::new(design, name, record.width, lines);
            files.push(rom.file());
            roms.push(rom);
        }
        let rays = Rom::new(design, "ray", ray_width(format), self.ray_lines());
        files.push(rays.file());
        files.push((design.emitted(TOP) + ".v", self.top(design, &roms, &rays)));
        files.push((design.emitted(BENCH) + ".v", self.bench(design)));
        files
    }

    fn ray_lines(&self) -> Vec<String> {
        let format = self.image.format;
        let line = |ray: &Ray| {
            let numbers = [ray.tmax, ray.tmin].into_iter();
            let numbers = numbers.chain(ray.direction.into_iter().rev());
            let numbers = numbers.chain(ray.origin.into_iter().rev());
            let mut bits = format!("{}{}", u8::from(ray.any_hit), u8::from(ray.active));
            for number in numbers {
                let _ = write!(
                    bits,
                    "{:0width$b}",
                    format.to_bits(number),
                    width = format.width() as usize
                );
            }
            hex(&bits)
        };
        self.rays.iter().map(line).collect()
    }

    fn top(&self, design: &Design, roms: &[Rom], rays: &Rom) -> String {
        let top = design.emitted(TOP);
        let format = self.image.format;
        let w = format.width();
        let count_bits = bits_for(self.rays.len() as u64 + 1);
        let slot_bits = bits_for(self.packet as u64);
        let tag_bits = self.tag_bits;
        let mut text = format!(
            "// SPDX-License-Identifier: MIT OR Apache-2.0\n\
             // {top}: the core casts {} rays from a ROM into a scene in ROMs ({SCENE}) and adds up its hits.\n\
             // done says that all have returned, pass that their checksum is the golden model's; select chooses the byte of it that\n\
             // checksum_byte shows, 0 the least. rst_n starts it over.\n\n\
             `default_nettype none\n\n\
             module {top} (\n\
             \x20 input  wire       clk,\n\
             \x20 input  wire       rst_n,\n\
             \x20 input  wire [2:0] select,\n\
             \x20 output reg        done,\n\
             \x20 output reg        pass,\n\
             \x20 output reg  [7:0] checksum_byte\n\
             );\n\n\
             \x20 localparam [63:0] EXPECTED = 64'h{:016x};\n\
             \x20 localparam [{}:0] RAYS = {count_bits}'d{};\n\n\
             \x20 // Reset for several cycles after configuration, and while rst_n is low.\n\
             \x20 reg  [1:0] rst_n_synchronised;\n\
             \x20 reg  [3:0] startup;\n\
             \x20 reg        rst;\n\
             \x20 initial rst_n_synchronised = 2'd0;\n\
             \x20 initial startup = 4'd0;\n\
             \x20 initial rst = 1'b1;\n\
             \x20 always @(posedge clk) begin\n\
             \x20   rst_n_synchronised <= {{rst_n_synchronised[0], rst_n}};\n\
             \x20   if (!rst_n_synchronised[1]) startup <= 4'd0; else if (!(&startup)) startup <= startup + 4'd1;\n\
             \x20   rst <= !(&startup);\n\
             \x20 end\n\n\
             \x20 // A ray is read, then offered until the core accepts it.\n\
             \x20 reg  [{}:0] ray_index;\n\
             \x20 reg  ray_read;\n\
             \x20 reg  ray_valid;\n\
             \x20 wire ray_ready;\n\
             \x20 wire [{}:0] ray;\n",
            self.rays.len(),
            self.checksum(),
            count_bits - 1,
            self.rays.len(),
            count_bits - 1,
            rays.width - 1,
        );
        let ray_tag = slice_of_index(count_bits, slot_bits * u32::from(self.packet > 1), tag_bits);
        let _ = write!(
            text,
            "  wire [{}:0] ray_tag = {ray_tag};\n\
             \x20 always @(posedge clk) begin\n\
             \x20   if (rst) begin\n\
             \x20     ray_index <= {count_bits}'d0;\n\
             \x20     ray_read <= 1'b0;\n\
             \x20     ray_valid <= 1'b0;\n\
             \x20   end else if (ray_valid) begin\n\
             \x20     if (ray_ready) begin\n\
             \x20       ray_index <= ray_index + {count_bits}'d1;\n\
             \x20       ray_read <= 1'b0;\n\
             \x20       ray_valid <= 1'b0;\n\
             \x20     end\n\
             \x20   end else begin\n\
             \x20     ray_read <= 1'b1;\n\
             \x20     ray_valid <= ray_read & (ray_index != RAYS);\n\
             \x20   end\n\
             \x20 end\n\
             \x20 {} ray_rom (.clk(clk), .address(ray_index[{}:0]), .word(ray));\n\n",
            tag_bits - 1,
            rays.module,
            rays.address_bits() - 1,
        );

        // The connections of the core's ports by name. Other inputs are 0, other outputs are not connected.
        let mut connected: Vec<(String, String)> = vec![
            ("clk".into(), "clk".into()),
            ("rst".into(), "rst".into()),
            ("ray_valid".into(), "ray_valid".into()),
            ("ray_ready".into(), "ray_ready".into()),
            ("ray_tag".into(), "ray_tag".into()),
            ("hit_ready".into(), "1'b1".into()),
            (
                "scene_root".into(),
                format!("32'h{:08x}", self.image.root.pack()),
            ),
        ];
        let mut least = 0;
        for field in ["origin", "direction"] {
            for axis in ["x", "y", "z"] {
                connected.push((
                    format!("ray_{field}_{axis}"),
                    format!("ray[{}:{least}]", least + w - 1),
                ));
                least += w;
            }
        }
        for field in ["tmin", "tmax"] {
            connected.push((
                format!("ray_{field}"),
                format!("ray[{}:{least}]", least + w - 1),
            ));
            least += w;
        }
        connected.push(("ray_active".into(), format!("ray[{least}]")));
        connected.push(("ray_any_hit".into(), format!("ray[{}]", least + 1)));
        for (side, corner) in [("lo", self.image.bounds.0), ("hi", self.image.bounds.1)] {
            for (axis, x) in ["x", "y", "z"].into_iter().zip(corner) {
                let bits = format.to_bits(x);
                connected.push((format!("scene_{side}_{axis}"), format!("{w}'h{bits:x}")));
            }
        }

        let mut unread: Vec<String> = vec![];
        for rom in roms {
            let name = &rom.name;
            let width = |port: &str| {
                let port = design.top().port(&format!("{name}_{port}"));
                port.map_or(1, |port| port.width)
            };
            let (address, tag) = (width("request_address"), width("request_tag"));
            let used = rom.address_bits().min(address);
            let _ = write!(
                text,
                "  // The {name} memory responds two cycles after a request.\n\
                 \x20 wire {name}_request_valid;\n\
                 \x20 wire [{}:0] {name}_request_address;\n\
                 \x20 wire [{tag_high}:0] {name}_request_tag;\n\
                 \x20 reg  {name}_read;\n\
                 \x20 reg  {name}_response_valid;\n\
                 \x20 reg  [{tag_high}:0] {name}_read_tag;\n\
                 \x20 reg  [{tag_high}:0] {name}_response_tag;\n\
                 \x20 wire [{}:0] {name}_word;\n\
                 \x20 reg  [{}:0] {name}_response_data;\n\
                 \x20 always @(posedge clk) begin\n\
                 \x20   {name}_read <= {name}_request_valid & !rst;\n\
                 \x20   {name}_read_tag <= {name}_request_tag;\n\
                 \x20   {name}_response_valid <= {name}_read & !rst;\n\
                 \x20   {name}_response_tag <= {name}_read_tag;\n\
                 \x20   {name}_response_data <= {name}_word;\n\
                 \x20 end\n\
                 \x20 {} {name}_rom (.clk(clk), .address({name}_request_address[{}:0]), .word({name}_word));\n\n",
                address - 1,
                rom.width - 1,
                rom.width - 1,
                rom.module,
                used - 1,
                tag_high = tag - 1,
            );
            if used < address {
                unread.push(format!("{name}_request_address[{}:{used}]", address - 1));
            }
            connected.push((format!("{name}_request_ready"), "1'b1".into()));
            for port in [
                "request_valid",
                "request_address",
                "request_tag",
                "response_valid",
                "response_tag",
                "response_data",
            ] {
                let port = format!("{name}_{port}");
                connected.push((port.clone(), port));
            }
        }

        let _ = write!(
            text,
            "  // The hash of a hit, and the sum of all hashes: packets return in any order, the rays of a packet in order.\n\
             \x20 wire hit_valid;\n\
             \x20 wire [{tag_high}:0] hit_tag;\n\
             \x20 wire [{high}:0] hit_t;\n\
             \x20 wire [{high}:0] hit_u;\n\
             \x20 wire [{high}:0] hit_v;\n\
             \x20 wire [31:0] hit_instance;\n\
             \x20 wire [31:0] hit_triangle;\n\
             \x20 reg  [{}:0] slot;\n\
             \x20 wire [63:0] hash_0 = {};\n",
            slot_bits - 1,
            extended("hit_t", w),
            tag_high = tag_bits - 1,
            high = w - 1,
        );
        let fields = [
            ("hit_u", w),
            ("hit_v", w),
            ("hit_instance", 32),
            ("hit_triangle", 32),
            ("hit_tag", tag_bits),
            ("slot", slot_bits),
        ];
        for (step, (field, width)) in fields.into_iter().enumerate() {
            let _ = writeln!(
                text,
                "  wire [63:0] hash_{} = {{hash_{step}[{}:0], hash_{step}[63:{}]}} ^ {};",
                step + 1,
                63 - ROTATION,
                64 - ROTATION,
                extended(field, width),
            );
        }
        let last_slot = self.packet - 1;
        let _ = write!(
            text,
            "  reg  hashed;\n\
             \x20 reg  [63:0] hash;\n\
             \x20 reg  [63:0] checksum;\n\
             \x20 reg  [{}:0] hits;\n\
             \x20 always @(posedge clk) begin\n\
             \x20   hash <= hash_{};\n\
             \x20   hashed <= hit_valid & !rst;\n\
             \x20   if (rst) begin\n\
             \x20     slot <= {slot_bits}'d0;\n\
             \x20     checksum <= 64'd0;\n\
             \x20     hits <= {count_bits}'d0;\n\
             \x20     done <= 1'b0;\n\
             \x20     pass <= 1'b0;\n\
             \x20   end else begin\n\
             \x20     if (hit_valid) slot <= (slot == {slot_bits}'d{last_slot}) ? {slot_bits}'d0 : (slot + {slot_bits}'d1);\n\
             \x20     if (hashed) begin\n\
             \x20       checksum <= checksum + hash;\n\
             \x20       hits <= hits + {count_bits}'d1;\n\
             \x20     end\n\
             \x20     done <= hits == RAYS;\n\
             \x20     pass <= (hits == RAYS) & (checksum == EXPECTED);\n\
             \x20   end\n\
             \x20   case (select)\n",
            count_bits - 1,
            fields.len(),
        );
        for byte in 0..8 {
            let _ = writeln!(
                text,
                "      3'd{byte}: checksum_byte <= checksum[{}:{}];",
                8 * byte + 7,
                8 * byte
            );
        }
        text += "    endcase\n  end\n\n";
        for port in ["valid", "tag", "t", "u", "v", "instance", "triangle"] {
            connected.push((format!("hit_{port}"), format!("hit_{port}")));
        }

        let mut connections = vec![];
        let mut unread_bits = 0;
        for port in design.top().ports() {
            let to = connected.iter().find(|(name, _)| *name == port.name);
            let to = match (to, port.direction) {
                (Some((_, to)), _) => to.clone(),
                (None, Direction::Input) => format!("{}'d0", port.width),
                (None, Direction::Output) => {
                    let least = unread_bits;
                    unread_bits += port.width;
                    format!("unread[{}:{least}]", unread_bits - 1)
                }
            };
            connections.push(format!("    .{}({to})", port.name));
        }
        if unread_bits > 0 {
            let _ = writeln!(text, "  wire [{}:0] unread;", unread_bits - 1);
            unread.push("unread".into());
        }
        let _ = write!(
            text,
            "  {} core (\n{}\n  );\n\n\
             \x20 // Unused bits.\n\
             \x20 wire unused = &{{1'b0, {}}};\n\n\
             endmodule\n\n\
             `default_nettype wire\n",
            design.emitted(design.top().name()),
            connections.join(",\n"),
            unread.join(", "),
        );
        text
    }

    fn bench(&self, design: &Design) -> String {
        let (top, bench) = (design.emitted(TOP), design.emitted(BENCH));
        format!(
            "// SPDX-License-Identifier: MIT OR Apache-2.0\n\
             // {bench}: runs the self-test and prints PASS or FAIL with the checksum.\n\n\
             `timescale 1ns / 1ps\n\
             `default_nettype none\n\n\
             module {bench};\n\
             \x20 reg  clk;\n\
             \x20 reg  [2:0] select;\n\
             \x20 wire done, pass;\n\
             \x20 wire [7:0] checksum_byte;\n\
             \x20 {top} dut (.clk(clk), .rst_n(1'b1), .select(select), .done(done), .pass(pass), .checksum_byte(checksum_byte));\n\
             \x20 always #5 clk = !clk;\n\n\
             \x20 integer quiet, cycles, number;\n\
             \x20 reg  [{high}:0] hits_before;\n\
             \x20 reg  [63:0] checksum;\n\
             \x20 initial begin\n\
             \x20   clk = 1'b0;\n\
             \x20   select = 3'd0;\n\
             \x20   quiet = 0;\n\
             \x20   cycles = 0;\n\
             \x20   hits_before = 0;\n\
             \x20   while (done !== 1'b1 && quiet < {PATIENCE}) begin\n\
             \x20     @(negedge clk);\n\
             \x20     cycles = cycles + 1;\n\
             \x20     quiet = (dut.hits === hits_before) ? quiet + 1 : 0;\n\
             \x20     hits_before = dut.hits;\n\
             \x20   end\n\
             \x20   if (done !== 1'b1) begin\n\
             \x20     $display(\"FAIL no hit for {PATIENCE} clocks, %0d of {rays} have returned\", dut.hits);\n\
             \x20     $finish;\n\
             \x20   end\n\
             \x20   for (number = 0; number < 8; number = number + 1) begin\n\
             \x20     select = number;\n\
             \x20     @(negedge clk);\n\
             \x20     @(negedge clk);\n\
             \x20     checksum[8*number +: 8] = checksum_byte;\n\
             \x20   end\n\
             \x20   if (pass === 1'b1) $display(\"PASS {rays} rays in %0d clocks, checksum %h\", cycles, checksum);\n\
             \x20   else $display(\"FAIL checksum %h, expected %h\", checksum, 64'h{expected:016x});\n\
             \x20   $finish;\n\
             \x20 end\n\
             endmodule\n\n\
             `default_nettype wire\n",
            high = bits_for(self.rays.len() as u64 + 1) - 1,
            rays = self.rays.len(),
            expected = self.checksum(),
        )
    }
}

/// Width of a ray's word in bits: eight numbers and two flags.
fn ray_width(format: Format) -> u32 {
    8 * format.width() + 2
}

/// `name`, of `width` bits, extended to 64 bits.
fn extended(name: &str, width: u32) -> String {
    format!("{{{}'d0, {name}}}", 64 - width)
}

/// The bits of `ray_index` from `least` on, as a number of `width` bits.
fn slice_of_index(index_bits: u32, least: u32, width: u32) -> String {
    let taken = (index_bits - least).min(width);
    let bits = format!("ray_index[{}:{least}]", least + taken - 1);
    match width - taken {
        0 => bits,
        more => format!("{{{more}'d0, {bits}}}"),
    }
}

/// Converts binary digits to hexadecimal.
fn hex(bits: &str) -> String {
    let width = bits.len().div_ceil(4) * 4;
    let padded = format!("{bits:0>width$}");
    let digit = |four: &[u8]| {
        let value = four.iter().fold(0, |v, bit| 2 * v + u32::from(bit - b'0'));
        char::from_digit(value, 16).expect("four bits")
    };
    padded.as_bytes().chunks(4).map(digit).collect()
}

/// A ROM with one line of hexadecimal digits per word. It is a case statement followed by a register, which every tool recognises as a
/// block RAM with contents, and which needs no data file.
struct Rom {
    name: String,
    /// Its emitted name.
    module: String,
    width: u32,
    lines: Vec<String>,
}

impl Rom {
    fn new(design: &Design, name: &str, width: u32, lines: Vec<String>) -> Rom {
        Rom {
            name: name.to_string(),
            module: design.emitted(&format!("{TOP}_{name}_rom")),
            width,
            lines,
        }
    }

    fn address_bits(&self) -> u32 {
        bits_for(self.lines.len() as u64)
    }

    fn file(&self) -> (String, String) {
        let (width, address) = (self.width, self.address_bits());
        let module = &self.module;
        let mut text = format!(
            "// SPDX-License-Identifier: MIT OR Apache-2.0\n\
             // {module}: {} words of {width} bits; a word a clock after its address.\n\n\
             `default_nettype none\n\n\
             module {module} (\n\
             \x20 input  wire clk,\n\
             \x20 input  wire [{}:0] address,\n\
             \x20 (* rom_style = \"block\" *)\n\
             \x20 output reg  [{}:0] word\n\
             );\n\n\
             \x20 always @(posedge clk) begin\n\
             \x20   case (address)\n",
            self.lines.len(),
            address - 1,
            width - 1,
        );
        for (index, line) in self.lines.iter().enumerate() {
            let _ = writeln!(text, "      {address}'d{index}: word <= {width}'h{line};");
        }
        let _ = write!(
            text,
            "      default: word <= {width}'d0;\n\
             \x20   endcase\n\
             \x20 end\n\n\
             endmodule\n\n\
             `default_nettype wire\n"
        );
        (format!("{module}.v"), text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binary_digits_become_hexadecimal() {
        assert_eq!(hex("1"), "1");
        assert_eq!(hex("110100"), "34");
    }

    #[test]
    fn every_bit_of_a_hit_changes_the_checksum() {
        let mut test = SelfTest::new(&Config::reference()).unwrap();
        assert!(test.hits.iter().any(Hit::is_hit));
        assert!(test.hits.iter().any(|hit| !hit.is_hit()));
        let right = test.checksum();
        let hit = test.hits.iter().position(Hit::is_hit).unwrap();
        test.hits[hit].triangle ^= 1;
        assert_ne!(test.checksum(), right);
        test.hits[hit].triangle ^= 1;
        let format = test.image.format;
        test.hits[hit].t = format.to_f64(format.to_bits(test.hits[hit].t) ^ 1);
        assert_ne!(test.checksum(), right);
    }
}
