//! The skinning processor: moves vertices at rest by the weighted matrices of their joints
//! (`docs/arithmetic.md`, *Skinning*; `docs/layout.md`, *Influence row*).

use anyhow::{Context, Result, bail, ensure};

use crate::bkd::layout::{Columns, INFLUENCES_PER_ROW, Influence, JOINT_BITS, Record};
use crate::float::{Arithmetic, Format};

/// Maximum number of influences of a vertex.
pub const MOST_INFLUENCES: usize = 4;

/// The command to skin a mesh. Indices count vectors of the vertex array; a joint has four, a vertex one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SkinCommand {
    /// Index of the palette's first vector.
    pub palette: u32,
    /// Number of matrices in the palette, at least 1 and at most the machine's `skinning.joints`.
    pub joints: u32,
    /// Index of the first row of influences.
    pub influences: u32,
    /// Number of rows of influences, exactly as many as the vertices' influences need.
    pub rows: u32,
    /// Index of the first vertex at rest.
    pub rest: u32,
    /// Number of vertices, at least 1.
    pub vertices: u32,
    /// Index of the first vertex to write.
    pub target: u32,
}

/// The arrays that skinning reads and writes, as words of whole records ([`Record::words`] each).
pub struct SkinMemory<'a> {
    pub format: Format,
    /// [`Record::influence_row`].
    pub influences: &'a [u32],
    /// [`Record::vertex`]: palette, vertices at rest, and written vertices.
    pub vertices: &'a mut [u32],
}

/// An externally visible event of skinning. Events of one kind are in the machine's order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkinEvent {
    /// A vector of the palette or a vertex at rest is read, by absolute index.
    VectorRead { index: u32 },
    /// A row of influences is read, by absolute index.
    RowRead { row: u32 },
    /// A vertex is written, by absolute index: bit patterns of x, y, z.
    VertexWrite { vertex: u32, position: [u64; 3] },
}

/// Counts of the skinning of one mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skinned {
    pub influences: u64,
    pub vertices: u64,
}

/// Computes one vertex: (x, y, z) transformed by each of up to [`MOST_INFLUENCES`] matrices, multiplied by its weight and summed
/// pairwise. All are values of the arithmetic's format.
pub fn skin_vertex(
    a: &Arithmetic,
    rest: [f64; 3],
    influences: impl IntoIterator<Item = (Columns, f64)>,
) -> [f64; 3] {
    let [x, y, z] = rest;
    let mut q = [[0.0; 3]; MOST_INFLUENCES];
    for (q, ([p_x, p_y, p_z, p_w], w)) in q.iter_mut().zip(influences) {
        *q = std::array::from_fn(|i| {
            let xy = a.add(a.mul(p_x[i], x), a.mul(p_y[i], y));
            let moved = a.add(a.add(xy, a.mul(p_z[i], z)), p_w[i]);
            a.mul(moved, w)
        });
    }
    std::array::from_fn(|i| a.add(a.add(q[0][i], q[1][i]), a.add(q[2][i], q[3][i])))
}

/// Computes all vertices of a mesh. `influences` are in the order of the vertices, with the last one of each vertex marked. All
/// numbers are values of the arithmetic's format.
///
/// # Panics
/// If the number of marked influences is not the number of vertices, if a vertex has more than [`MOST_INFLUENCES`], or if a
/// joint is not in `palette`.
pub fn skin_vertices(
    a: &Arithmetic,
    rest: &[[f64; 3]],
    influences: &[Influence],
    palette: &[Columns],
) -> Vec<[f64; 3]> {
    let of_vertices = influences.split_inclusive(|influence| influence.last);
    let count = of_vertices.clone().count();
    assert_eq!(count, rest.len(), "a vertex for each marked influence");
    rest.iter()
        .zip(of_vertices)
        .map(|(rest, influences)| {
            assert!(influences.len() <= MOST_INFLUENCES, "the last is marked");
            let of_joint = |i: &Influence| (palette[usize::from(i.joint)], i.weight);
            skin_vertex(a, *rest, influences.iter().map(of_joint))
        })
        .collect()
}

/// Skins a mesh in memory and reports all reads and writes to `observe`.
///
/// # Errors
/// If the command or the stream reads or writes outside the arrays, if a vertex has more than [`MOST_INFLUENCES`]
/// influences or a joint that is not in the palette, if the number of rows is wrong, or if written vectors overlap
/// those that are read.
pub fn skin(
    memory: SkinMemory,
    command: SkinCommand,
    mut observe: impl FnMut(SkinEvent),
) -> Result<Skinned> {
    check_ranges(&memory, command)?;
    let SkinMemory {
        format,
        influences,
        vertices,
    } = memory;
    let vector = Record::vertex(format);
    let arithmetic = Arithmetic::new(format);
    let read_vector = |vertices: &[u32], index: u32| -> [f64; 3] {
        let words = &vertices[index as usize * vector.words()..][..vector.words()];
        ["x", "y", "z"].map(|name| format.to_f64(vector.get(words, name)))
    };
    let mut palette: Vec<Columns> = Vec::with_capacity(command.joints as usize);
    for joint in 0..command.joints {
        palette.push(std::array::from_fn(|column| {
            let index = command.palette + 4 * joint + column as u32;
            observe(SkinEvent::VectorRead { index });
            read_vector(vertices, index)
        }));
    }

    let mut stream = Stream {
        format,
        row: Record::influence_row(format),
        influences,
        command,
        place: 0,
    };
    for number in 0..command.vertices {
        let index = command.rest + number;
        observe(SkinEvent::VectorRead { index });
        let rest = read_vector(vertices, index);
        let of_vertex = stream.of_vertex(number, &palette, &mut observe)?;
        let position = skin_vertex(&arithmetic, rest, of_vertex).map(|x| format.to_bits(x));
        let vertex = command.target + number;
        let words = &mut vertices[vertex as usize * vector.words()..][..vector.words()];
        for (name, bits) in ["x", "y", "z"].into_iter().zip(position) {
            vector.set(words, name, bits);
        }
        observe(SkinEvent::VertexWrite { vertex, position });
    }
    let (needed, rows) = (stream.place.div_ceil(INFLUENCES_PER_ROW), command.rows);
    ensure!(
        needed == rows as usize,
        "the vertices' influences fill {needed} rows, but {rows} are to be read"
    );
    Ok(Skinned {
        influences: stream.place as u64,
        vertices: command.vertices.into(),
    })
}

/// Checks that a command reads and writes only within the arrays, and that its target overlaps nothing that it reads.
fn check_ranges(memory: &SkinMemory, command: SkinCommand) -> Result<()> {
    let SkinCommand { joints, rows, .. } = command;
    ensure!(
        (1..=1 << JOINT_BITS).contains(&joints),
        "a palette has 1 to {} joints, not {joints}",
        1 << JOINT_BITS
    );
    ensure!(command.vertices > 0, "there are no vertices to skin");
    // Ranges in u64, so sums do not wrap.
    let range = |from: u32, length: u32, factor: u64| {
        let from = u64::from(from);
        from..from + factor * u64::from(length)
    };
    let palette = range(command.palette, joints, 4);
    let rest = range(command.rest, command.vertices, 1);
    let target = range(command.target, command.vertices, 1);
    let vectors = (memory.vertices.len() / Record::vertex(memory.format).words()) as u64;
    for (what, range) in [
        ("the palette", &palette),
        ("the vertices at rest", &rest),
        ("the vertices to write", &target),
    ] {
        ensure!(
            range.end <= vectors,
            "{what} lie at {} to {}, but there are {vectors} vectors",
            range.start,
            range.end - 1
        );
    }
    let all_rows = memory.influences.len() / Record::influence_row(memory.format).words();
    ensure!(
        range(command.influences, rows, 1).end <= all_rows as u64,
        "the influences take {rows} rows from {}, but there are {all_rows}",
        command.influences
    );
    for (what, read) in [("the palette", palette), ("the vertices at rest", rest)] {
        ensure!(
            target.end <= read.start || read.end <= target.start,
            "the vertices to write overlap {what}"
        );
    }
    Ok(())
}

/// The influences of a command, in order, from its rows.
struct Stream<'a> {
    format: Format,
    row: Record,
    influences: &'a [u32],
    command: SkinCommand,
    /// Number of influences read.
    place: usize,
}

impl Stream<'_> {
    /// Returns the next influence. A row is read together with its first influence.
    fn next(&mut self, observe: &mut impl FnMut(SkinEvent)) -> Result<Influence> {
        let row = &self.row;
        let (at_row, slot) = (
            self.place / INFLUENCES_PER_ROW,
            self.place % INFLUENCES_PER_ROW,
        );
        ensure!(
            at_row < self.command.rows as usize,
            "the {} rows of influences end before the vertices do; give the rows of all",
            self.command.rows
        );
        let index = self.command.influences as usize + at_row;
        if slot == 0 {
            observe(SkinEvent::RowRead { row: index as u32 });
        }
        self.place += 1;
        let words = &self.influences[index * row.words()..][..row.words()];
        let names = [
            ["weight0", "joint0", "last0"],
            ["weight1", "joint1", "last1"],
            ["weight2", "joint2", "last2"],
            ["weight3", "joint3", "last3"],
        ];
        let [weight, joint, last] = names[slot].map(|name| row.get(words, name));
        Ok(Influence {
            weight: self.format.to_f64(weight),
            joint: joint as u8,
            last: last == 1,
        })
    }

    /// The matrices and weights of the next vertex.
    fn of_vertex(
        &mut self,
        number: u32,
        palette: &[Columns],
        observe: &mut impl FnMut(SkinEvent),
    ) -> Result<Vec<(Columns, f64)>> {
        let mut of_vertex = Vec::with_capacity(MOST_INFLUENCES);
        loop {
            let influence = (self.next(observe)).with_context(|| format!("vertex {number}"))?;
            ensure!(
                of_vertex.len() < MOST_INFLUENCES,
                "vertex {number} follows more than {MOST_INFLUENCES} joints; mark its last influence"
            );
            let Some(matrix) = palette.get(usize::from(influence.joint)) else {
                bail!(
                    "vertex {number} follows joint {}, but the palette has {}",
                    influence.joint,
                    palette.len()
                );
            };
            of_vertex.push((*matrix, influence.weight));
            if influence.last {
                return Ok(of_vertex);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bkd::layout::{influence_words, vector_words};

    const FORMAT: Format = Format::FP24;

    /// The formula of `docs/arithmetic.md` on bit patterns, by the integer arithmetic.
    fn by_integers(rest: [f64; 3], influences: &[(Columns, f64)]) -> [u64; 3] {
        use crate::float::plain::{add, mul};
        let (add, mul) = (|a, b| add(FORMAT, a, b), |a, b| mul(FORMAT, a, b));
        let bits = |x: f64| FORMAT.to_bits(x);
        std::array::from_fn(|i| {
            let mut q = [0; MOST_INFLUENCES];
            for (q, (p, w)) in q.iter_mut().zip(influences) {
                let product = |k: usize| mul(bits(p[k][i]), bits(rest[k]));
                let moved = add(add(add(product(0), product(1)), product(2)), bits(p[3][i]));
                *q = mul(moved, bits(*w));
            }
            add(add(q[0], q[1]), add(q[2], q[3]))
        })
    }

    fn random_mesh(rng: &mut fastrand::Rng) -> (Vec<[f64; 3]>, Vec<Influence>, Vec<Columns>) {
        let mut number = || match rng.u8(..8) {
            0 => [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0][rng.usize(..4)],
            1 => FORMAT.to_f64(rng.u64(..1 << FORMAT.width())),
            _ => Arithmetic::new(FORMAT).round(rng.f64() * 8.0 - 4.0),
        };
        let mut vector = || std::array::from_fn(|_| number());
        let palette: Vec<Columns> = (0..7).map(|_| std::array::from_fn(|_| vector())).collect();
        let rest: Vec<[f64; 3]> = (0..50).map(|_| vector()).collect();
        let mut influences = vec![];
        for _ in &rest {
            let count = rng.usize(1..=MOST_INFLUENCES);
            for k in 1..=count {
                influences.push(Influence {
                    joint: rng.u8(..7),
                    weight: FORMAT.to_f64(rng.u64(..FORMAT.sign_bit())),
                    last: k == count,
                });
            }
        }
        (rest, influences, palette)
    }

    #[test]
    fn skinning_is_the_formula_in_memory_and_out_of_it() {
        let seed = 0x5eed_0003;
        let mut rng = fastrand::Rng::with_seed(seed);
        for round in 0..100 {
            let (rest, influences, palette) = random_mesh(&mut rng);
            let skinned = skin_vertices(&Arithmetic::new(FORMAT), &rest, &influences, &palette);
            let mut vectors = palette.as_flattened().to_vec();
            vectors.extend(&rest);
            vectors.extend(&rest);
            let mut vertices = vector_words(FORMAT, &vectors);
            let rows = influence_words(FORMAT, &influences);
            let command = SkinCommand {
                palette: 0,
                joints: 7,
                influences: 0,
                rows: influences.len().div_ceil(4) as u32,
                rest: 28,
                vertices: 50,
                target: 78,
            };
            let memory = SkinMemory {
                format: FORMAT,
                influences: &rows,
                vertices: &mut vertices,
            };
            let mut written = vec![];
            let (mut read, mut read_rows) = (vec![], vec![]);
            let counts = skin(memory, command, |event| match event {
                SkinEvent::VectorRead { index } => read.push(index),
                SkinEvent::RowRead { row } => read_rows.push(row),
                SkinEvent::VertexWrite { vertex, position } => written.push((vertex, position)),
            })
            .unwrap();
            assert_eq!(
                counts,
                Skinned {
                    influences: influences.len() as u64,
                    vertices: 50
                }
            );
            assert_eq!(read, (0..78).collect::<Vec<u32>>());
            assert_eq!(read_rows, (0..command.rows).collect::<Vec<u32>>());
            let mut groups = influences.split_inclusive(|i| i.last);
            for (k, (vertex, position)) in written.into_iter().enumerate() {
                let group: Vec<_> = groups
                    .next()
                    .unwrap()
                    .iter()
                    .map(|i| (palette[usize::from(i.joint)], i.weight))
                    .collect();
                assert_eq!(vertex, 78 + k as u32);
                assert_eq!(
                    position,
                    by_integers(rest[k], &group),
                    "seed {seed:#x}, round {round}, vertex {k}"
                );
                assert_eq!(position, skinned[k].map(|x| FORMAT.to_bits(x)));
                let words = &vertices[vertex as usize * 3..][..3];
                assert_eq!(vector_words(FORMAT, &skinned[k..=k]), words);
            }
        }
    }

    #[test]
    fn what_cannot_be_skinned_is_refused() {
        let influence = |joint, last| Influence {
            joint,
            weight: 1.0,
            last,
        };
        let good = SkinCommand {
            palette: 0,
            joints: 1,
            influences: 0,
            rows: 1,
            rest: 4,
            vertices: 1,
            target: 5,
        };
        let try_skin = |command, stream: &[Influence]| {
            let rows = influence_words(FORMAT, stream);
            let mut vertices = vector_words(FORMAT, &[[0.0; 3]; 6]);
            let memory = SkinMemory {
                format: FORMAT,
                influences: &rows,
                vertices: &mut vertices,
            };
            skin(memory, command, |_| ()).map_err(|error| format!("{error:#}"))
        };
        let one = [influence(0, true)];
        assert!(try_skin(good, &one).is_ok());
        let five = [influence(0, false); 8];
        let two_rows = SkinCommand { rows: 2, ..good };
        for (command, stream, says) in [
            (
                SkinCommand { joints: 0, ..good },
                &one[..],
                "1 to 256 joints",
            ),
            (
                SkinCommand {
                    vertices: 0,
                    ..good
                },
                &one,
                "no vertices",
            ),
            (SkinCommand { target: 6, ..good }, &one, "to write lie at 6"),
            (SkinCommand { palette: 3, ..good }, &one, "the palette lie"),
            (
                SkinCommand { target: 4, ..good },
                &one,
                "overlap the vertices",
            ),
            (
                SkinCommand { target: 3, ..good },
                &one,
                "overlap the palette",
            ),
            (two_rows, &one, "there are 1"),
            (two_rows, &five, "more than 4"),
            (good, &five[..4], "end before"),
            (good, &[influence(1, true)], "the palette has 1"),
        ] {
            let error = try_skin(command, stream).unwrap_err();
            assert!(error.contains(says), "{error}");
        }
        let mut unneeded = vec![influence(0, true)];
        unneeded.resize(5, influence(0, true));
        let error = try_skin(two_rows, &unneeded).unwrap_err();
        assert!(error.contains("fill 1 rows, but 2"), "{error}");
    }
}
