//! Vectors of the skinning processor: meshes bound to joints, and the expected vertices.
//!
//! All meshes are in separate memories, each preceded by a filler record, and are skinned one after another.

use super::layout::{Kind, Layout};
use super::shape::Shape;
use super::sheet::Sheet;
use super::update::filler;
use crate::bkd::layout::{
    Columns, INFLUENCES_PER_ROW, Influence, JOINT_BITS, LINK_BITS, Record, influence_words,
    vector_words,
};
use crate::config::Config;
use crate::cosim::unit_skinning::SkinMesh;
use crate::float::{Arithmetic, Format, specials};
use crate::golden::skinning::{MOST_INFLUENCES, SkinCommand, SkinEvent, SkinMemory, skin};
use crate::report::folder::Folder;
use anyhow::{Context, Result, ensure};

use Kind::Unsigned;

/// Number of directed meshes: small meshes with many special values.
const DIRECTED: usize = 12;

/// Labels of the parts.
const OF_SCENE: &str = "skinned objects of the scene";
const OF_NONE: &str = "directed meshes";

/// The files of the skinning processor.
pub struct SkinSheets {
    pub influences: Sheet,
    pub vectors: Sheet,
    pub commands: Sheet,
    pub expected: Sheet,
    /// Number of influences of all meshes.
    pub total: u64,
}

impl Shape {
    fn skinning_commands(&self) -> Layout {
        let index =
            |layout: Layout, name: &str, what: &str| layout.field(name, LINK_BITS, Unsigned, what);
        let layout = index(
            Layout::default(),
            "palette",
            "index of the palette's first vector",
        );
        let layout = layout.field(
            "joints",
            JOINT_BITS + 1,
            Unsigned,
            "number of matrices in the palette",
        );
        let layout = index(layout, "influences", "index of the first row of influences");
        let layout = index(layout, "rows", "number of rows of influences");
        let layout = index(layout, "rest", "index of the first vertex at rest");
        let layout = index(layout, "vertices", "number of vertices");
        index(layout, "target", "index of the first vertex to write")
            .field(
                "first_vertex",
                32,
                Unsigned,
                "line of the first vertex in skinning_expected.hex, counted from 0",
            )
            .field("count", 32, Unsigned, "number of influences")
    }

    fn skinning_expected(&self) -> Layout {
        Layout::default()
            .field("vertex", LINK_BITS, Unsigned, "index of the vertex written")
            .record(&Record::vertex(self.format), self.format)
    }
}

impl SkinSheets {
    /// Skins the scene's meshes and directed meshes.
    ///
    /// # Errors
    /// One line if the machine cannot hold a mesh, or if a file cannot be written.
    pub fn write(
        folder: &Folder,
        config: &Config,
        shape: &Shape,
        meshes: &[SkinMesh],
    ) -> Result<Self> {
        let format = shape.format;
        let mut rng = fastrand::Rng::with_seed(5);
        let directed: Vec<_> = (0..DIRECTED)
            .map(|number| directed(format, config.skinning_joints, number, &mut rng))
            .collect();
        let (mut vectors, mut rows) = (vec![], vec![]);
        let mut commands = vec![];
        let row_words = Record::influence_row(format).words();
        for (number, mesh) in meshes.iter().chain(&directed).enumerate() {
            // Including the filler in front.
            let room = 1 + 4 * mesh.palette.len() + 2 * mesh.rest.len();
            let fits = (vectors.len() + room) as u64 <= 1 << config.address_bits;
            if number >= meshes.len() && !fits {
                continue;
            }
            ensure!(
                mesh.palette.len() as u32 <= config.skinning_joints,
                "{} has {} joints, but the machine's palette holds {}; raise skinning.joints, or bind the object to fewer",
                mesh.name,
                mesh.palette.len(),
                config.skinning_joints
            );
            // A row and a vector that are never read or written.
            vectors.push([f64::NAN; 3]);
            rows.extend(filler(&Record::influence_row(format), format));
            let influences = influence_words(format, &mesh.influences);
            let count = mesh.rest.len() as u32;
            let palette = vectors.len() as u32;
            vectors.extend(mesh.palette.as_flattened());
            let rest = vectors.len() as u32;
            vectors.extend(&mesh.rest);
            let target = vectors.len() as u32;
            vectors.extend(std::iter::repeat_n([0.0; 3], mesh.rest.len()));
            commands.push(SkinCommand {
                palette,
                joints: mesh.palette.len() as u32,
                influences: (rows.len() / row_words) as u32,
                rows: mesh.influences.len().div_ceil(INFLUENCES_PER_ROW) as u32,
                rest,
                vertices: count,
                target,
            });
            rows.extend(influences);
        }
        let most = vectors.len().max(rows.len() / row_words) as u64;
        ensure!(
            most <= 1 << config.address_bits,
            "the skinned objects take {most} indices, but {} address bits hold {}; simplify them or widen the address",
            config.address_bits,
            1u64 << config.address_bits
        );
        run(
            folder,
            shape,
            &rows,
            &vector_words(format, &vectors),
            (&commands, meshes.len()),
        )
    }
}

/// Runs the golden model and writes all files.
fn run(
    folder: &Folder,
    shape: &Shape,
    rows: &[u32],
    vectors: &[u32],
    (commands, of_scene): (&[SkinCommand], usize),
) -> Result<SkinSheets> {
    let format = shape.format;
    let records = |stem: &str, record: &Record, words: &[u32]| {
        let layout = Layout::default().record(record, format);
        let mut sheet = Sheet::new(folder, stem, layout, "meshes and fillers")?;
        for line in record.hex_lines(words).lines() {
            sheet.push_text(line)?;
        }
        anyhow::Ok(sheet)
    };
    let influences = records("skinning_influences", &Record::influence_row(format), rows)?;
    let sheet = records("skinning_vectors", &Record::vertex(format), vectors)?;
    let sheet_of = |stem: &str, layout| Sheet::new(folder, stem, layout, OF_SCENE);
    let mut lines = sheet_of("skinning_commands", shape.skinning_commands())?;
    let mut expected = sheet_of("skinning_expected", shape.skinning_expected())?;
    let mut memory = vectors.to_vec();
    let mut total = 0;
    for (number, &command) in commands.iter().enumerate() {
        if number == of_scene {
            lines.begin(OF_NONE);
            expected.begin(OF_NONE);
        }
        let first_vertex = expected.lines;
        let mut result = Ok(());
        let arrays = SkinMemory {
            format,
            influences: rows,
            vertices: &mut memory,
        };
        let skinned = skin(arrays, command, |event| {
            if let (SkinEvent::VertexWrite { vertex, position }, true) = (event, result.is_ok()) {
                let [x, y, z] = position;
                result = expected.push(&[u64::from(vertex), x, y, z]);
            }
        })
        .with_context(|| format!("skinned mesh {number}"))?;
        result?;
        total += skinned.influences;
        let values = [
            command.palette,
            command.joints,
            command.influences,
            command.rows,
            command.rest,
            command.vertices,
            command.target,
        ];
        let mut values: Vec<u64> = values.map(u64::from).to_vec();
        values.extend([first_vertex, skinned.influences]);
        lines.push(&values)?;
    }
    Ok(SkinSheets {
        influences,
        vectors: sheet,
        commands: lines,
        expected,
        total,
    })
}

/// A small mesh with coordinates and matrices on a coarse grid, some of them special values.
fn directed(format: Format, most_joints: u32, number: usize, rng: &mut fastrand::Rng) -> SkinMesh {
    let a = Arithmetic::new(format);
    let special: Vec<f64> = specials(format).iter().map(|&b| format.to_f64(b)).collect();
    // The first meshes have no special values, so that finite sums are compared.
    let rarely = if number < DIRECTED / 2 { 0 } else { 4 };
    let mut coordinate = || match rng.u8(..16) {
        k if k < rarely => special[rng.usize(..special.len())] + 0.0,
        _ => a.round(rng.f64() * 8.0 - 4.0) + 0.0,
    };
    let mut vector = || std::array::from_fn(|_| coordinate());
    let joints = [1, 2, most_joints.min(9), most_joints][number % 4];
    let mut palette: Vec<Columns> = (0..joints)
        .map(|_| -> Columns { std::array::from_fn(|_| vector()) })
        .collect();
    let rest: Vec<[f64; 3]> = (0..[1, 2, 5, 30][number / 3]).map(|_| vector()).collect();
    let influences: Vec<Influence> = rest
        .iter()
        .flat_map(|_| {
            let follows = rng.usize(1..=MOST_INFLUENCES);
            let influence = |k| Influence {
                joint: rng.u32(..joints) as u8,
                weight: a.round(rng.f64()),
                last: k == follows,
            };
            (1..=follows).map(influence).collect::<Vec<_>>()
        })
        .collect();
    // A matrix that no influence names is a NaN, so any use of it changes the result.
    for (joint, matrix) in palette.iter_mut().enumerate() {
        if !influences.iter().any(|i| usize::from(i.joint) == joint) {
            *matrix = [[f64::NAN; 3]; 4];
        }
    }
    SkinMesh {
        name: format!("directed mesh {number}"),
        rest,
        influences,
        palette,
    }
}
