//! The update program: the guarantees of its compiler, checked by an independent interpreter on random topologies; the
//! golden update, compared with a refit from scratch in all bits; and the figures that determine its speed.

use crate::support::shared_scene;
use dynrt::bkd::{Bounds, BuildOptions, Child, MemoryImage, Record, Tree, TreeNode, build};
use dynrt::float::{Arithmetic, Format};
use dynrt::golden::update::{UpdateCommand, UpdateEvent, UpdateMemory, update};
use dynrt::program::{self, Instruction, Program, UpdateMachine};
use dynrt::scene::{self, MachineMesh};
use fastrand::Rng;

// ---------------------------------------------------------------------------------------------------
// Random meshes and trees.

struct Object {
    vertices: usize,
    triangles: Vec<[u32; 3]>,
    tree: Tree,
}

/// The tree over `order` with the splits of `split`, which returns the number of leaves of the left child. The numbers of nodes
/// and the axes are random.
fn tree_over(order: &[u32], random: &mut Rng, split: &dyn Fn(&mut Rng, usize) -> usize) -> Tree {
    let count = order.len() - 1;
    let mut numbers: Vec<u32> = (0..count as u32).collect();
    random.shuffle(&mut numbers);
    let unset = TreeNode {
        children: [Child::Leaf(u32::MAX); 2],
        axes: [0; 2],
    };
    let mut nodes = vec![unset; count];
    let mut next = 0;
    let mut child_of = |len: usize, first: usize| {
        if len == 1 {
            return Child::Leaf(order[first]);
        }
        next += 1;
        Child::Inner(numbers[next - 1])
    };
    let root = child_of(order.len(), 0);
    let mut open = vec![(root, 0, order.len())];
    while let Some((child, first, len)) = open.pop() {
        let Child::Inner(index) = child else {
            continue;
        };
        let left = split(random, len);
        assert!(0 < left && left < len);
        let children = [child_of(left, first), child_of(len - left, first + left)];
        open.push((children[0], first, left));
        open.push((children[1], first + left, len - left));
        nodes[index as usize] = TreeNode {
            children,
            axes: [random.u8(..3), random.u8(..3)],
        };
    }
    Tree { nodes, root }
}

/// A mesh and a tree of random shape and size, mostly small.
fn random_object(random: &mut Rng) -> Object {
    let most = [1, 2, 3, 8, 40, 300, 1500][random.usize(..7)];
    let count = random.usize(1..=most);
    let triangles: Vec<[u32; 3]>;
    let mut vertices;
    match random.u32(..4) {
        // Random order, few vertices or many, coinciding corners.
        0 => {
            vertices = random.usize(1..=2 * count + 1);
            triangles = (0..count)
                .map(|_| std::array::from_fn(|_| random.u32(..vertices as u32)))
                .collect();
        }
        // A strip.
        1 => {
            vertices = count + 2;
            triangles = (0..count as u32).map(|k| [k + 1, k, k + 2]).collect();
        }
        // No shared vertices.
        2 => {
            vertices = 3 * count;
            triangles = (0..count as u32)
                .map(|k| [3 * k, 3 * k + 1, 3 * k + 2])
                .collect();
        }
        // A grid.
        _ => {
            let side = (count as f64).sqrt().ceil() as u32 + 1;
            vertices = (side * side) as usize;
            triangles = grid(side).take(count).collect();
        }
    }
    // Unused vertices, and a random numbering.
    vertices += random.usize(..4);
    let mut names: Vec<u32> = (0..vertices as u32).collect();
    random.shuffle(&mut names);
    let triangles: Vec<_> = triangles
        .into_iter()
        .map(|triangle| triangle.map(|vertex| names[vertex as usize]))
        .collect();

    let mut order: Vec<u32> = (0..count as u32).collect();
    if random.bool() {
        random.shuffle(&mut order);
    }
    let tree = match random.u32(..5) {
        0 => tree_over(&order, random, &|random, len| random.usize(1..len)),
        1 => tree_over(&order, random, &|_, len| len / 2),
        2 => tree_over(&order, random, &|_, _| 1),
        3 => tree_over(&order, random, &|random, len| {
            if random.bool() { 1 } else { len - 1 }
        }),
        _ => tree_over(&order, random, &|random, len| {
            (len / 4 + random.usize(..=len / 2)).clamp(1, len - 1)
        }),
    };
    Object {
        vertices,
        triangles,
        tree,
    }
}

/// The triangles of a grid of side × side vertices, row by row.
fn grid(side: u32) -> impl Iterator<Item = [u32; 3]> {
    (0..side - 1).flat_map(move |y| {
        (0..side - 1).flat_map(move |x| {
            let corner = y * side + x;
            [
                [corner, corner + 1, corner + side],
                [corner + 1, corner + side + 1, corner + side],
            ]
        })
    })
}

fn random_machine(random: &mut Rng) -> UpdateMachine {
    UpdateMachine {
        vertex_registers: random.u32(UpdateMachine::REGISTERS),
        box_registers: [64, random.u32(UpdateMachine::REGISTERS)][random.usize(..2)],
        merge_distance: random.u32(UpdateMachine::MERGE_DISTANCE),
    }
}

// ---------------------------------------------------------------------------------------------------
// The interpreter tracks the vertices of every register, not the numbers.

/// The content of a box register.
#[derive(Clone, Debug, PartialEq)]
enum Holds {
    /// The box of these vertices of the mesh, in ascending order.
    Triangle([u32; 3]),
    Node(u32),
}

struct BoxRegister {
    holds: Holds,
    written: usize,
}

fn sorted(mut triangle: [u32; 3]) -> [u32; 3] {
    triangle.sort_unstable();
    triangle
}

/// Interprets a program's bytes and panics if a guarantee of `docs/update.md` is violated. Returns the number of
/// reads from registers.
fn interpret(object: &Object, program: &Program, context: &str) -> u64 {
    let machine = program.machine;
    let bytes = program.bytes();
    assert_eq!(bytes.len() % 16, 0, "{context}");
    let instructions = program::decode(&bytes).unwrap();
    assert_eq!(instructions, program.instructions, "{context}");

    let mut vertex_registers: Vec<Option<u32>> = vec![None; machine.vertex_registers as usize];
    let mut box_registers: Vec<Option<BoxRegister>> = Vec::new();
    box_registers.resize_with(machine.box_registers as usize, || None);
    let mut free: Vec<usize> = (0..machine.box_registers as usize).rev().collect();
    let (mut next_vertex, mut next_node, mut last) = (0, 0, usize::MAX);
    let (mut leaves, mut reads, mut ended) = (0, 0, false);
    for (number, &instruction) in instructions.iter().enumerate() {
        let context = format!("{context}, instruction {number}, {instruction:?}");
        assert!(!ended, "{context}");
        match instruction {
            Instruction::Load { register } => {
                last = register as usize;
                vertex_registers[last] = Some(program.vertex_order[next_vertex]);
                next_vertex += 1;
            }
            Instruction::Reload { register, vertex } => {
                assert!((vertex as usize) < next_vertex, "{context}");
                last = register as usize;
                let vertex = program.vertex_order[vertex as usize];
                assert!(
                    !vertex_registers.contains(&Some(vertex)),
                    "{context}: it was still there"
                );
                vertex_registers[last] = Some(vertex);
            }
            Instruction::Leaf { .. } | Instruction::LeafLast { .. } => {
                let operands = match instruction {
                    Instruction::Leaf { vertices } => vertices.map(usize::from),
                    Instruction::LeafLast { vertices: [x, y] } => [x.into(), y.into(), last],
                    _ => unreachable!(),
                };
                let vertices = operands.map(|register| {
                    vertex_registers[register].unwrap_or_else(|| panic!("{context}: unwritten"))
                });
                reads += 3;
                leaves += 1;
                let register = free.pop().unwrap_or_else(|| panic!("{context}: none free"));
                let written = box_registers[register].replace(BoxRegister {
                    holds: Holds::Triangle(sorted(vertices)),
                    written: number,
                });
                assert!(written.is_none(), "{context}: overwritten while needed");
            }
            Instruction::Node { children, axes } => {
                let index = program.node_order[next_node];
                let node = &object.tree.nodes[index as usize];
                assert_eq!(axes, node.axes, "{context}");
                for (register, child) in children.into_iter().zip(node.children) {
                    let Some(held) = &box_registers[register as usize] else {
                        panic!("{context}: unwritten");
                    };
                    let wanted = match child {
                        Child::Inner(index) => Holds::Node(index),
                        Child::Leaf(leaf) => {
                            Holds::Triangle(sorted(object.triangles[leaf as usize]))
                        }
                    };
                    assert_eq!(held.holds, wanted, "{context}");
                    let distance = number - held.written;
                    assert!(
                        distance >= machine.merge_distance as usize,
                        "{context}: distance {distance}"
                    );
                    reads += 1;
                }
                box_registers[children[0] as usize] = Some(BoxRegister {
                    holds: Holds::Node(index),
                    written: number,
                });
                box_registers[children[1] as usize] = None;
                free.push(children[1].into());
                next_node += 1;
            }
            Instruction::Nop => {}
            Instruction::End { register } => {
                let wanted = match object.tree.root {
                    Child::Inner(index) => Holds::Node(index),
                    Child::Leaf(leaf) => Holds::Triangle(sorted(object.triangles[leaf as usize])),
                };
                let held = box_registers[register as usize].take();
                assert_eq!(held.unwrap().holds, wanted, "{context}");
                assert!(
                    box_registers.iter().all(Option::is_none),
                    "{context}: boxes are left over"
                );
                ended = true;
            }
        }
    }
    assert!(ended, "{context}");
    assert_eq!(leaves, object.triangles.len(), "{context}");
    assert_eq!(next_node, object.tree.nodes.len(), "{context}");

    // All vertices, each once; the used ones are loaded first, and no others are loaded.
    let mut used = vec![false; object.vertices];
    for vertex in object.triangles.iter().flatten() {
        used[*vertex as usize] = true;
    }
    let mut order = program.vertex_order.clone();
    for (place, &vertex) in order.iter().enumerate() {
        assert_eq!(used[vertex as usize], place < next_vertex, "{context}");
    }
    order.sort_unstable();
    assert!(order.into_iter().eq(0..object.vertices as u32), "{context}");
    reads
}

// ---------------------------------------------------------------------------------------------------
// Numbers.

/// Random vertices, some of them coarse, so that coordinates coincide.
fn random_vertices(random: &mut Rng, count: usize, format: Format) -> Vec<[f64; 3]> {
    let arithmetic = Arithmetic::new(format);
    let coarse = random.bool();
    let limit = f64::from(1 << MachineMesh::log2_limit(format));
    let mut coordinate = || {
        let x = (random.f64() * 2.0 - 1.0) * limit;
        arithmetic.round(if coarse { (x / limit * 4.0).round() } else { x }) + 0.0
    };
    (0..count)
        .map(|_| std::array::from_fn(|_| coordinate()))
        .collect()
}

/// Runs a program over moved vertices in a memory with other contents, and compares every word with a refit from
/// scratch. Returns the number of nodes compared.
fn update_and_compare(
    object: &Object,
    program: &Program,
    format: Format,
    random: &mut Rng,
    context: &str,
) -> u64 {
    let Object {
        tree, triangles, ..
    } = object;
    let rest = random_vertices(random, object.vertices, format);
    let moved = random_vertices(random, object.vertices, format);
    let at_rest = program.image(format, &rest, triangles, tree).unwrap();
    let expected = program.image(format, &moved, triangles, tree).unwrap();
    at_rest.check(u32::MAX).unwrap();

    let mut noise = |words: usize| -> Vec<u32> { (0..words).map(|_| random.u32(..)).collect() };
    let (vertex_words, node_words) = (Record::vertex(format).words(), Record::node(format).words());
    let box_layout = Record::bounding_box(format);
    let command = UpdateCommand {
        program: 32,
        vertex_base: 5,
        node_base: 7,
        box_index: 2,
    };
    let mut code = vec![0xaa; command.program as usize];
    code.extend(program.bytes());
    let mut vertices = noise(command.vertex_base as usize * vertex_words);
    vertices.extend(expected.vertex_words());
    let mut nodes = noise(command.node_base as usize * node_words);
    let node_start = nodes.len();
    nodes.extend(at_rest.node_words());
    nodes.extend(noise(3 * node_words));
    let mut boxes = noise(4 * box_layout.words());

    // The unused slot does not change.
    let (mut wanted_nodes, mut wanted_boxes) = (nodes.clone(), boxes.clone());
    let bounds_of = expected.node_words();
    let written = tree.nodes.len() * node_words;
    wanted_nodes[node_start..node_start + written].copy_from_slice(&bounds_of[..written]);
    let root: Bounds = tree.refit(&moved, triangles).root;
    let wanted_box = &mut wanted_boxes[2 * box_layout.words()..3 * box_layout.words()];
    for (field, value) in box_layout.fields.iter().zip(root.lo.iter().chain(&root.hi)) {
        field.set(wanted_box, format.to_bits(*value));
    }

    let (mut next_node, mut reads) = (command.node_base, 0);
    let updated = update(
        UpdateMemory {
            format,
            program: &code,
            vertices: &vertices,
            nodes: &mut nodes,
            boxes: &mut boxes,
        },
        command,
        |event| match event {
            UpdateEvent::NodeWrite { node, .. } => {
                assert_eq!(node, next_node, "{context}: nodes are written in sequence");
                next_node += 1;
            }
            UpdateEvent::VertexRead { .. } => reads += 1,
            UpdateEvent::BoxWrite { index, .. } => assert_eq!(index, command.box_index),
        },
    )
    .unwrap();
    assert_eq!(nodes, wanted_nodes, "{context}");
    assert_eq!(boxes, wanted_boxes, "{context}");
    assert_eq!(updated.bounds, root, "{context}");
    assert_eq!(
        updated.nodes_written as usize,
        tree.nodes.len(),
        "{context}"
    );
    let figures = program.statistics();
    assert_eq!(
        (reads, updated.instructions),
        (figures.loads, figures.instructions),
        "{context}"
    );
    updated.nodes_written
}

#[test]
fn programs_of_random_topologies_keep_their_guarantees() {
    let (mut reads, mut refused, mut nodes) = (0, 0, 0);
    let cases = 3000;
    let seed: u64 = 0x5eed_0302;
    for case in 0..cases {
        let context = format!("seed {seed:#x}, case {case}");
        let mut random = Rng::with_seed(seed + case);
        let object = random_object(&mut random);
        let machine = random_machine(&mut random);
        let compiled = Program::compile(&object.tree, &object.triangles, object.vertices, machine);
        let program = match compiled {
            Ok(program) => program,
            Err(error) => {
                // Two registers per doubling of the number of triangles are always sufficient.
                let enough = 2 * object.triangles.len().ilog2();
                assert!(machine.box_registers < enough, "{context}: {error}");
                refused += 1;
                continue;
            }
        };
        program
            .check()
            .unwrap_or_else(|error| panic!("{context}: {error}"));
        reads += interpret(&object, &program, &context);
        let figures = program.statistics();
        assert!(figures.box_registers_used <= machine.box_registers);
        assert!(figures.vertex_registers_used <= machine.vertex_registers);
        let (exponent, fraction) = [(7, 16), (3, 2), (10, 23), (8, 23)][random.usize(..4)];
        let format = Format::new(exponent, fraction).unwrap();
        nodes += update_and_compare(&object, &program, format, &mut random, &context);
    }
    eprintln!(
        "{cases} topologies, {refused} refused for want of registers; {reads} register reads and {nodes} nodes checked"
    );
    assert!(cases - refused >= 2500 && nodes > 100_000 && reads > 500_000);
}

/// The checker rejects a program in which any instruction is damaged.
#[test]
fn broken_programs_are_noticed() {
    let seed = 0x5eed_0303;
    let mut random = Rng::with_seed(seed);
    let triangles: Vec<_> = grid(12).collect();
    let order: Vec<u32> = (0..triangles.len() as u32).collect();
    let tree = tree_over(&order, &mut random, &|_, len| len / 2);
    let machine = UpdateMachine {
        vertex_registers: 16,
        ..UpdateMachine::default()
    };
    let program = Program::compile(&tree, &triangles, 144, machine).unwrap();
    let object = Object {
        vertices: 144,
        triangles,
        tree,
    };
    let verdict = |program: &Program| {
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            interpret(&object, program, "broken")
        }))
        .is_ok()
    };
    assert!(verdict(&program));
    let quiet = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| ()));
    let mut survivors = Vec::new();
    let mut caught_by_check = 0;
    for at in 0..program.instructions.len() {
        let mut broken = program.clone();
        broken.instructions.remove(at);
        caught_by_check += usize::from(broken.check().is_err());
        // Without a nop, or a load of an unused vertex, only the distance is wrong.
        if verdict(&broken) && program.instructions[at] != Instruction::Nop {
            survivors.push(at);
        }
    }
    std::panic::set_hook(quiet);
    assert!(survivors.is_empty(), "not noticed: {survivors:?}");
    assert!(caught_by_check > object.triangles.len());
}

#[test]
fn the_smallest_objects_have_the_smallest_programs() {
    let machine = UpdateMachine::default();
    let leaf = |number| Child::Leaf(number);
    let one = Tree {
        nodes: vec![],
        root: leaf(0),
    };
    let program = Program::compile(&one, &[[4, 2, 7]], 9, machine).unwrap();
    assert_eq!(
        program.listing(),
        "00000000  03              load v0, [0]\n\
         00000001  07              load v1, [1]\n\
         00000002  0b              load v2, [2]\n\
         00000003  0d 04           leaf b0, v0 v1 v2\n\
         00000005  1e 00           end  b0\n"
    );
    assert_eq!(program.vertex_order, [4, 2, 7, 0, 1, 3, 5, 6, 8]);
    assert_eq!(program.renumber(&[[4, 2, 7]]), [[0, 1, 2]]);
    assert_eq!(program.bytes().len(), 16);
    assert_eq!(program.hex_lines(), "000000000000000000001e040d0b0703\n");

    // All corners are one vertex.
    let program = Program::compile(&one, &[[0, 0, 0]], 1, machine).unwrap();
    assert_eq!(program.instructions.len(), 3);

    let two = Tree {
        nodes: vec![TreeNode {
            children: [leaf(1), leaf(0)],
            axes: [2, 0],
        }],
        root: Child::Inner(0),
    };
    let near = UpdateMachine {
        merge_distance: 1,
        ..machine
    };
    let program = Program::compile(&two, &[[0, 1, 2], [2, 1, 3]], 4, near).unwrap();
    assert_eq!(
        program.listing(),
        "00000000  03              load v0, [0]\n\
         00000001  07              load v1, [1]\n\
         00000002  0b              load v2, [2]\n\
         00000003  0d 04           leaf b0, v0 v1 v2\n\
         00000005  0b              load v2, [3]\n\
         00000006  1d 00           leaf b1, v1 v0 v2\n\
         00000008  02 04           node b0, b0.z b1.x  ; node 0\n\
         0000000a  1e 00           end  b0\n"
    );
}

#[test]
fn what_cannot_be_compiled_is_refused_in_one_line() {
    let fault = |tree: &Tree, triangles: &[[u32; 3]], machine| {
        let error = Program::compile(tree, triangles, 3, machine).unwrap_err();
        error.to_string()
    };
    let mut random = Rng::with_seed(1);
    let machine = UpdateMachine::default();
    let order: Vec<u32> = (0..64).collect();
    let balanced = tree_over(&order, &mut random, &|_, len| len / 2);
    let few = UpdateMachine {
        box_registers: 8,
        ..machine
    };
    assert_eq!(
        fault(&balanced, &[[0, 1, 2]; 64], few),
        "the tree's update program needs 12 box registers, but the machine has 8; give it more or split the mesh"
    );
    assert_eq!(
        fault(&balanced, &[[0, 1, 2]; 63], machine),
        "the tree has 64 leaves but the mesh 63 triangles; build the tree again"
    );
    assert_eq!(
        fault(&balanced, &[[0, 3, 2]; 64], machine),
        "triangle 0 names vertex 3, but there are 3; correct the mesh"
    );
    let wide = UpdateMachine {
        vertex_registers: 65,
        ..machine
    };
    assert_eq!(
        fault(&balanced, &[[0, 1, 2]; 64], wide),
        "an update processor has 8 to 64 vertex registers, not 65"
    );
}

#[test]
fn the_golden_update_refuses_what_it_cannot_run() {
    let format = Format::FP24;
    let fault = |bytes: &[u8], vertices: usize, command| {
        let (mut nodes, mut boxes) = ([0; 8], [0; 5]);
        let vertices = vec![0; vertices * Record::vertex(format).words()];
        let memory = UpdateMemory {
            format,
            program: bytes,
            vertices: &vertices,
            nodes: &mut nodes,
            boxes: &mut boxes,
        };
        format!("{:#}", update(memory, command, |_| ()).unwrap_err())
    };
    let start = UpdateCommand::default();
    // Three loads and a leaf; then the fault.
    let leaf = [0x03, 0x07, 0x0b, 0x0d, 0x04];
    let with = |rest: &[u8]| [&leaf[..], rest].concat();
    assert_eq!(
        fault(&leaf, 3, start),
        "the update program does not end: there are only 5 bytes"
    );
    assert_eq!(
        fault(&leaf, 2, start),
        "update program, byte 2: vertex 2 is outside memory"
    );
    assert_eq!(
        fault(&leaf[3..], 3, start),
        "update program, byte 0: v0 is read, but nothing wrote it"
    );
    assert_eq!(
        fault(&with(&[0x00, 0x04]), 3, start),
        "update program, byte 5: b0 or b1 is read, but holds no box"
    );
    assert_eq!(
        fault(&with(&[0x00, 0x00]), 3, start),
        "update program, byte 5: b0 is merged with itself"
    );
    assert_eq!(
        fault(&with(&[0x3e]), 3, start),
        "update program, byte 5: 0x3e starts no instruction"
    );
    assert_eq!(
        fault(&with(&[0x1e, 0x01]), 3, start),
        "update program, byte 5: b1 is written as the object's box, but holds none"
    );
    let beyond = UpdateCommand {
        box_index: 1,
        ..start
    };
    assert_eq!(
        fault(&with(&[0x1e, 0x00]), 3, beyond),
        "update program, byte 5: box 1 is outside memory"
    );
    let beyond = UpdateCommand {
        node_base: 2,
        ..start
    };
    assert_eq!(
        fault(&with(&[0x0d, 0x04, 0x00, 0x04]), 3, beyond),
        "update program, byte 7: node 2 is outside memory"
    );
    let odd = UpdateCommand {
        program: 8,
        ..start
    };
    assert_eq!(
        fault(&leaf, 3, odd),
        "a program starts at a multiple of 16 bytes, not at 8"
    );
}

#[test]
fn a_nan_is_never_a_bound() {
    let format = Format::FP24;
    let tree = Tree {
        nodes: vec![],
        root: Child::Leaf(0),
    };
    let program = Program::compile(&tree, &[[0, 1, 2]], 3, UpdateMachine::default()).unwrap();
    let vertices = vec![
        [f64::NAN, 1.0, f64::NAN],
        [2.0, f64::NAN, f64::NAN],
        [-3.0, f64::INFINITY, f64::NAN],
    ];
    let image = MemoryImage {
        vertices: program.reorder_vertices(&vertices),
        ..program
            .image(format, &vertices, &[[0, 1, 2]], &tree)
            .unwrap()
    };
    let mut boxes = vec![0; Record::bounding_box(format).words()];
    let updated = update(
        UpdateMemory {
            format,
            program: &program.bytes(),
            vertices: &image.vertex_words(),
            nodes: &mut [],
            boxes: &mut boxes,
        },
        UpdateCommand::default(),
        |_| (),
    )
    .unwrap();
    assert_eq!(updated.bounds.lo, [-3.0, 1.0, f64::INFINITY]);
    assert_eq!(updated.bounds.hi, [2.0, f64::INFINITY, f64::NEG_INFINITY]);
}

// ---------------------------------------------------------------------------------------------------
// Figures.

/// Compiles a scene's program, checks it and prints its statistics.
fn figures(scene: &str, machine: UpdateMachine) -> program::Statistics {
    let scene = scene::load(scene).unwrap();
    let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
    let options = BuildOptions::default_for(2, 32);
    let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
    let object = Object {
        vertices: mesh.vertices.len(),
        triangles: mesh.triangles,
        tree,
    };
    measure(&scene.name, &object, machine)
}

fn measure(name: &str, object: &Object, machine: UpdateMachine) -> program::Statistics {
    let start = std::time::Instant::now();
    let program =
        Program::compile(&object.tree, &object.triangles, object.vertices, machine).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    program.check().unwrap();
    interpret(object, &program, name);
    let mut random = Rng::with_seed(3);
    update_and_compare(object, &program, Format::FP24, &mut random, name);
    let f = program.statistics();
    eprintln!(
        "{name}, distance {}: {} triangles, {} vertices, {:.3} loads a vertex, {:.3} instructions and {:.2} bytes a triangle, \
         {:.0} % short leaves, {} nops, {}+{} registers, {seconds:.2} s",
        machine.merge_distance,
        f.triangles,
        f.vertices,
        f.loads_per_vertex,
        f.instructions_per_triangle,
        f.bytes_per_triangle,
        100.0 * f.short_leaf_merges as f64 / f.leaf_merges as f64,
        f.nops,
        f.vertex_registers_used,
        f.box_registers_used,
    );
    assert!(f.bytes_per_triangle <= 8.0, "{name}");
    if f.triangles >= 10_000 {
        // The goal is 0.95 instructions per cycle; the rest is left for memory.
        assert!(f.nops * 200 < f.instructions, "{name}: {} nops", f.nops);
    }
    f
}

#[test]
fn built_in_scenes_reach_the_figures() {
    for distance in [1, 4, 6, 8] {
        let machine = UpdateMachine {
            merge_distance: distance,
            ..UpdateMachine::default()
        };
        let teapot = figures("builtin:teapot?tessellation=20", machine);
        assert!(teapot.loads_per_vertex <= 1.2);
    }
    figures("builtin:interior", UpdateMachine::default());
}

#[test]
fn real_scenes_reach_the_figures() {
    let closed = |f: program::Statistics| {
        // Only nops are lost, and one cycle in twenty for memory.
        assert!(f.loads_per_vertex <= 1.10);
        assert!(0.95 / f.instructions_per_triangle >= 0.37);
        assert!(f.bytes_per_triangle <= 5.5);
    };
    for (file, is_closed) in [
        ("stanford_bunny/stanford-bunny.obj", true),
        ("spot/spot.obj", true),
        ("teapot/teapot.obj", false),
        ("sponza/sponza.obj", false),
    ] {
        if let Some(scene) = shared_scene(file) {
            let f = figures(&scene, UpdateMachine::default());
            if is_closed {
                closed(f);
            }
        }
    }
}

#[test]
fn a_million_triangles_compile() {
    let side = 709;
    let triangles: Vec<_> = grid(side).collect();
    // Squares in the order of a space-filling curve, so that halves of the order are compact.
    let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
    let spread = |x: u32| (0..16).fold(0u64, |s, bit| s | u64::from(x >> bit & 1) << (2 * bit));
    order.sort_by_key(|&number| {
        let square = number / 2;
        spread(square % (side - 1)) | spread(square / (side - 1)) << 1
    });
    let mut random = Rng::with_seed(4);
    let tree = tree_over(&order, &mut random, &|_, len| len / 2);
    let object = Object {
        vertices: (side * side) as usize,
        triangles,
        tree,
    };
    assert!(object.triangles.len() > 1_000_000);
    let f = measure("a million triangles", &object, UpdateMachine::default());
    assert!(f.bytes_per_triangle <= 6.0);
}

// ---------------------------------------------------------------------------------------------------
// Top-level trees: leaves are the boxes of instances, whose corners have other vectors between them.

/// The update of a top-level tree writes the nodes and the box that are built from the same boxes, in all bits.
#[test]
fn a_top_level_tree_is_refitted_from_the_corners_of_its_instances() {
    let seed = 0x5eed_0304;
    let mut random = Rng::with_seed(seed);
    let (mut nodes_compared, mut refused) = (0, 0);
    for case in 0..400 {
        let formats = [(7, 16), (3, 2), (10, 23)];
        let (exponent, fraction) = formats[random.usize(..3)];
        let format = Format::new(exponent, fraction).unwrap();
        let context = format!("seed {seed:#x}, case {case}");
        let object = random_object(&mut random);
        let (tree, count) = (object.tree, object.triangles.len());
        // Six vectors for each instance; the last two are its corners.
        let mut vectors = random_vertices(&mut random, 6 * count, format);
        for instance in vectors.chunks_mut(6) {
            let [a, b] = [instance[4], instance[5]];
            instance[4] = std::array::from_fn(|axis| a[axis].min(b[axis]));
            instance[5] = std::array::from_fn(|axis| a[axis].max(b[axis]));
        }
        let corners: Vec<[u32; 2]> = (0..count as u32).map(|k| [6 * k + 4, 6 * k + 5]).collect();
        let machine = random_machine(&mut random);
        let length = vectors.len() as u32;
        let Ok(program) = Program::compile_top(&tree, &corners, length, machine) else {
            refused += 1;
            continue;
        };
        program.check().unwrap();
        let loads = program.instructions.iter().filter(|instruction| {
            assert!(
                !matches!(instruction, Instruction::Load { .. }),
                "{context}"
            );
            matches!(instruction, Instruction::Reload { .. })
        });
        assert_eq!(
            loads.count(),
            2 * count,
            "{context}: each corner is loaded once"
        );
        let boxes = |number: u32| Bounds {
            lo: vectors[6 * number as usize + 4],
            hi: vectors[6 * number as usize + 5],
        };
        let refit = tree.refit_leaves(boxes);
        let node_layout = Record::node(format);
        let mut nodes = vec![u32::MAX; (count + 2) * node_layout.words()];
        let mut all = dynrt::bkd::layout::vector_words(format, &[[1.0; 3]; 3]);
        all.extend(dynrt::bkd::layout::vector_words(format, &vectors));
        let memory = UpdateMemory {
            format,
            program: &program.bytes(),
            vertices: &all,
            nodes: &mut nodes,
            boxes: &mut vec![0; Record::bounding_box(format).words()],
        };
        let command = UpdateCommand {
            vertex_base: 3,
            node_base: 1,
            ..UpdateCommand::default()
        };
        let updated = update(memory, command, |_| ()).unwrap();
        assert_eq!(updated.bounds, refit.root, "{context}");
        let written = nodes.chunks_exact(node_layout.words()).skip(1);
        for (&index, words) in program.node_order.iter().zip(written) {
            let [left, right] = refit.intervals[index as usize];
            let wanted = [left[0], left[1], right[0], right[1]].map(|x| format.to_bits(x));
            let names = ["left_lo", "left_hi", "right_lo", "right_hi"];
            assert_eq!(
                names.map(|name| node_layout.get(words, name)),
                wanted,
                "{context}"
            );
            nodes_compared += 1;
        }
        assert_eq!(
            updated.nodes_written as usize,
            tree.nodes.len(),
            "{context}"
        );
    }
    eprintln!("{nodes_compared} nodes of top-level trees compared, {refused} trees refused");
    assert!(nodes_compared > 10_000 && refused < 100);
}

/// Loads by index are checked against the length of the array, and a load of the next vertex is refused.
#[test]
fn broken_programs_of_top_level_trees_are_noticed() {
    let tree = Tree {
        nodes: vec![TreeNode {
            children: [Child::Leaf(0), Child::Leaf(1)],
            axes: [0, 1],
        }],
        root: Child::Inner(0),
    };
    let machine = UpdateMachine::default();
    let program = Program::compile_top(&tree, &[[4, 5], [10, 11]], 12, machine).unwrap();
    program.check().unwrap();
    let with = |at: usize, instruction| {
        let mut broken = program.clone();
        broken.instructions[at] = instruction;
        broken.check().unwrap_err().to_string()
    };
    let beyond = Instruction::Reload {
        register: 0,
        vertex: 12,
    };
    assert!(with(0, beyond).contains("that is not there"));
    let next = Instruction::Load { register: 0 };
    assert!(with(0, next).contains("these have no order"));
    let error = Program::compile_top(&tree, &[[4, 5], [10, 12]], 12, machine).unwrap_err();
    assert!(error.to_string().contains("names vertex 12"), "{error}");
}
