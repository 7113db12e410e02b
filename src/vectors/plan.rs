//! Selects the packets to cast and computes the size of the files.

use super::Request;
use super::collect::Packet;
use super::directed;
use super::scenes::DirectedScene;
use super::shape::Shape;
use super::sheet::{PICTURE, Sheet};
use crate::bkd::layout::Record;
use crate::float::Arithmetic;
use crate::golden::{Caster, Counts};
use crate::scene::RayPacket;
use anyhow::{Result, ensure};
use rayon::prelude::*;

/// The maximum size without `force`: 1 GiB.
pub const MOST_BYTES: u64 = 1 << 30;

/// The packets to cast, and the approximate size of all files in bytes.
pub struct Plan {
    pub packets: Vec<Packet>,
    /// The number of these packets that belong to the picture.
    pub of_picture: usize,
    pub bytes: u64,
}

/// Selects the packets of the request up to its limit, variants of the packet with the most hits, and the packets of directed scenes.
pub fn plan(
    request: &Request<'_>,
    shape: &Shape,
    directed: &[DirectedScene],
    casters: &[&Caster],
) -> Plan {
    let packets = request.packets;
    let cast = |packet: &RayPacket| {
        let result = casters[0].cast(&packet.rays, &mut ());
        let hits = result.hits.iter().filter(|hit| hit.is_hit()).count();
        (hits, result.counts)
    };
    let results: Vec<(usize, Counts)> = packets.par_iter().map(cast).collect();
    let mut counts = vec![];
    let mut chosen = vec![];
    for number in spread(packets.len(), request.limit) {
        counts.push(results[number].1);
        chosen.push(Packet {
            scene: 0,
            block: Some(number as u32),
            label: PICTURE,
            rays: packets[number].rays.clone(),
            kinds: vec![],
        });
    }
    let of_picture = chosen.len();
    // All packets are candidates, not only those that are cast, because variants of rays without a hit would test little.
    let richest = (0..packets.len())
        .rev()
        .max_by_key(|&number| results[number].0);
    let richest = &packets[richest.expect("there are packets")].rays;
    let hits = casters[0].cast(richest, &mut ()).hits;
    chosen.extend(directed::variants(
        &Arithmetic::new(shape.format),
        richest,
        &hits,
    ));
    for (number, scene) in directed.iter().enumerate() {
        chosen.extend(scene.packets.iter().map(|(label, rays)| Packet {
            scene: number + 1,
            block: None,
            label,
            rays: rays.clone(),
            kinds: vec![],
        }));
    }
    for packet in &chosen[of_picture..] {
        counts.push(casters[packet.scene].cast(&packet.rays, &mut ()).counts);
    }
    let images = || {
        [request.image]
            .into_iter()
            .chain(directed.iter().map(|scene| &scene.image))
    };
    let sizes = Sizes {
        shape,
        rays: (chosen.len() * shape.rays) as u64,
        slots: images().map(|image| image.records.len() as u64).sum(),
        vertices: images().map(|image| image.vertices.len() as u64).sum(),
        skinned: request
            .skins
            .iter()
            .map(|mesh| mesh.rest.len() as u64)
            .sum(),
    };
    Plan {
        bytes: sizes.bytes(&counts),
        packets: chosen,
        of_picture,
    }
}

/// The numbers of the packets to cast: one at random from each of `limit` equal parts. A constant distance would often
/// select the same column of the picture.
fn spread(packets: usize, limit: Option<usize>) -> Vec<usize> {
    let count = limit.unwrap_or(packets).min(packets);
    let mut rng = fastrand::Rng::with_seed(3);
    let bound = |part: usize| part * packets / count;
    (0..count)
        .map(|part| rng.usize(bound(part)..bound(part + 1)))
        .collect()
}

impl Plan {
    /// Checks that the files are not larger than allowed.
    ///
    /// # Errors
    /// One line with the size of the files and the remedy.
    pub fn check(&self, scene: &str, force: bool) -> Result<()> {
        ensure!(
            force || self.bytes <= MOST_BYTES,
            "scene {}: the files would take about {:.1} GiB, and more than 1 GiB is written only with --force; give it, or cast fewer \
             than {} packets of the picture with --limit",
            crate::text::escaped(scene),
            self.bytes as f64 / MOST_BYTES as f64,
            self.of_picture
        );
        Ok(())
    }
}

/// Quantities that determine the sizes of the files.
struct Sizes<'a> {
    shape: &'a Shape,
    rays: u64,
    /// Number of slots (of nodes and records) and of vertices in all scenes.
    slots: u64,
    vertices: u64,
    skinned: u64,
}

impl Sizes<'_> {
    /// Size of all files in bytes. Parts that are the same for every scene, and the programs and vertices of updates, are estimated.
    fn bytes(&self, counts: &[Counts]) -> u64 {
        /// Directed lines per unit and per arithmetic unit.
        const DIRECTED: u64 = 500;
        const OPERATIONS: u64 = 10_000;
        /// Bytes of the manifest, the macros, and the directed updates and meshes.
        const REST: u64 = 400_000;
        let shape = self.shape;
        let total =
            |of: fn(&Counts) -> u32| -> u64 { counts.iter().map(|c| u64::from(of(c))).sum() };
        let record = |record: Record| record.hex_digits() as u64 + 1;
        let [steps, tests] = [total(|c| c.steps), total(|c| c.ray_tests)];
        let ray = [
            shape.raycast_rays(),
            shape.raycast_hits(),
            shape.ray_setup_stimulus(),
        ];
        let setup = Sheet::bytes(&shape.ray_setup_expected(), self.rays + DIRECTED);
        let step = Sheet::bytes(&shape.packet_step_expected(), steps + DIRECTED);
        let test = Sheet::bytes(&shape.triangle_test_expected(), tests + DIRECTED);
        let [node, vertex] = [Record::node(shape.format), Record::vertex(shape.format)].map(record);
        let of_packets = ray
            .iter()
            .map(|layout| Sheet::bytes(layout, self.rays))
            .sum::<u64>()
            + 2 * (setup + step + test)
            + Sheet::bytes(&shape.packet_step_stimulus(), steps + DIRECTED)
            + Sheet::bytes(&shape.triangle_test_stimulus(), tests + DIRECTED)
            + [
                shape.ray_transform_stimulus(),
                shape.ray_transform_expected(),
            ]
            .iter()
            .map(|layout| Sheet::bytes(layout, total(|c| c.ray_transforms)))
            .sum::<u64>();
        // Nodes before, written and after; 5.5 bytes of program per triangle, in rows of 16 bytes.
        let update = self.slots * (3 * node + 12) + self.vertices * vertex;
        let skinning = self.skinned * 4 * vertex;
        of_packets
            + self.slots * (node + record(Record::triangle()))
            + self.vertices * vertex
            + update
            + skinning
            + OPERATIONS
                * 4
                * (Sheet::bytes(&shape.operands(2), 1) + Sheet::bytes(&shape.result(), 1))
                * 4
                / 5
            + REST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_a_gibibyte_is_refused_unless_it_is_forced() {
        let plan = |bytes| Plan {
            packets: vec![],
            of_picture: 7,
            bytes,
        };
        plan(MOST_BYTES).check("a", false).unwrap();
        plan(MOST_BYTES + 1).check("a", true).unwrap();
        let refusal = plan(5 << 29).check("a\nb", false).unwrap_err();
        assert_eq!(
            refusal.to_string(),
            "scene a\\nb: the files would take about 2.5 GiB, and more than 1 GiB is written only with --force; give it, or cast \
             fewer than 7 packets of the picture with --limit"
        );
    }

    #[test]
    fn one_packet_of_each_equal_part_is_cast() {
        let numbers = spread(10, Some(3));
        assert_eq!(numbers.len(), 3);
        assert!(
            (0..3).contains(&numbers[0])
                && (3..6).contains(&numbers[1])
                && (6..10).contains(&numbers[2])
        );
        assert_eq!(spread(3, Some(9)), [0, 1, 2]);
        assert_eq!(spread(3, None), [0, 1, 2]);
    }
}
