//! The driver in C: its descriptors and hits against the tables, and its functions against the chip in Verilator.

mod library;

use crate::support::{Prepared, prepare, seed};
use dynrt::bkd::bytes::ByteRecord;
use dynrt::chip::descriptor::{self, Command, ERRORS, Scene, Skin, Update, WORDS};
use dynrt::chip::image::{Builder, Still, hits_of, still};
use dynrt::chip::memory::Memory;
use dynrt::chip::registers::{COUNTERS, interrupt, offset, registers};
use dynrt::chip::{Limits, descriptor::Cast as CastWords, most_rays};
use dynrt::config::Config;
use dynrt::cosim::chip::{Chip, Options};
use dynrt::golden::chip as golden;
use dynrt::port::Ray;
use dynrt::scene::View;
use library::{Behind, Camera, Cast, Driver, Fault, Hit, Host, Image, List, print, text};
use std::collections::HashMap;
use std::ffi::c_int;
use std::ptr::{null, null_mut};

// `enum dynrt_result`.
const OK: c_int = 0;
const WRONG_ID: c_int = 1;
const WRONG_VERSION: c_int = 2;
const WRONG_MACHINE: c_int = 3;
const MISALIGNED: c_int = 4;
const OUT_OF_RANGE: c_int = 5;
const NO_ROOM: c_int = 6;
const BUSY: c_int = 7;
const TIMED_OUT: c_int = 8;
const LIST_FAILED: c_int = 9;

const END: u32 = 1 << interrupt::END;
const SIGNAL: u32 = 1 << interrupt::SIGNAL;
const ERROR: u32 = 1 << interrupt::ERROR;

/// Descriptors that the golden chip executes at most, and polls of a list that ends.
const MOST: usize = 1 << 10;
const POLLS: u32 = 1 << 20;

fn tiny() -> Config {
    Config::load("tiny").unwrap()
}

/// A machine with another format of numbers.
fn with_format(exponent_bits: u32, fraction_bits: u32) -> Config {
    Config {
        exponent_bits,
        fraction_bits,
        ..tiny()
    }
}

/// A chip in Verilator with a memory.
fn chip(config: &Config, memory: &Memory) -> Box<Host> {
    let options = Options {
        seed: seed(),
        ..Options::default()
    };
    let mut chip = Chip::new(config, &options, &|_| ()).unwrap_or_else(|error| panic!("{error:#}"));
    chip.connect(memory);
    Host::new(Behind::Chip(Box::new(chip)))
}

/// A host with zeros as memory, from an address on, and no chip.
fn table(address: u32, bytes: usize) -> Box<Host> {
    let memory = Memory::new(address, vec![0; bytes]);
    Host::new(Behind::Table(HashMap::new(), memory))
}

fn words(memory: &Memory, address: u32) -> [u32; WORDS] {
    std::array::from_fn(|k| memory.word(u64::from(address) + 4 * k as u64).unwrap())
}

/// The example runs an image on the chip: the bytes of memory are the golden chip's, and so is what it prints.
#[test]
fn the_example_casts_an_image() {
    let config = tiny();
    let driver = Driver::new(&config);
    let Prepared { image, rays, .. } = prepare(&config, "builtin:cornell", "16x12", None);
    for any_hit in [false, true] {
        let rays: Vec<Ray> = rays.iter().map(|ray| Ray { any_hit, ..*ray }).collect();
        let builder = Builder::new(0x2000, 1 << 24);
        let Still { memory, list, .. } = still(&config, builder, &image, &rays).unwrap();
        let mut expected = memory.clone();
        let outcome = golden::Chip::new(&config).run(&mut expected, list, MOST);
        outcome.check().unwrap();
        assert!(outcome.hits > 30 && outcome.hits < outcome.rays);

        let empty = Memory::new(memory.base(), vec![0; memory.bytes().len()]);
        let mut host = chip(&config, &empty);
        let device = host.device();
        let packed = Image {
            bytes: memory.bytes().as_ptr(),
            size: memory.bytes().len() as u32,
            address: memory.base(),
            list,
        };
        // SAFETY: all pointers are of objects that outlive the call.
        let result = unsafe { (driver.example)(&device, &packed, POLLS, print, device.context()) };
        assert_eq!(result, OK, "{}", host.printed);
        assert!(host.memory() == expected, "memory is the golden chip's");
        let printed = &host.printed;
        let lines: Vec<&str> = printed.lines().collect();
        assert_eq!(lines[0], format!("rays {}", outcome.rays));
        assert_eq!(lines[1], format!("hits {}", outcome.hits));
        let cycles: u64 = lines[2].strip_prefix("cycles ").unwrap().parse().unwrap();
        assert!(cycles > outcome.rays && lines.len() == 3, "{printed}");
        println!(
            "any hit {any_hit}: {lines:?}, {} bytes",
            memory.bytes().len()
        );
    }
}

/// The example says what is wrong: with the list, and with the chip.
#[test]
fn the_example_reports_failures() {
    let config = tiny();
    let driver = Driver::new(&config);
    let mut builder = Builder::new(0, 1 << 16);
    let cast = CastWords {
        rays: 0,
        count: 1,
        hits: 0,
        any_hit: false,
        short: None,
    };
    let list = builder.list("list", &[Command::Cast(cast)]).unwrap();
    let (memory, _) = builder.finish();
    let image = Image {
        bytes: memory.bytes().as_ptr(),
        size: memory.bytes().len() as u32,
        address: 0,
        list,
    };
    let run = |host: &mut Host| {
        let device = host.device();
        // SAFETY: all pointers are of objects that outlive the call.
        unsafe { (driver.example)(&device, &image, POLLS, print, device.context()) }
    };
    let mut host = chip(&config, &memory);
    assert_eq!(run(&mut host), LIST_FAILED);
    assert_eq!(
        host.printed,
        "error: the command list has ended with an error: a cast before the first scene, descriptor at 0, value 1\n"
    );
    let mut host = table(0, 256);
    assert_eq!(run(&mut host), WRONG_ID);
    assert_eq!(
        host.printed,
        "error: there is no DynRT chip at this address\n"
    );
}

/// Lists that run, wait, fail and time out on the chip, with and without the interrupt.
#[test]
fn lists_are_submitted_and_waited_for() {
    let config = tiny();
    let driver = Driver::new(&config);
    let Prepared { image, rays, .. } = prepare(&config, "builtin:cornell", "16x12", None);
    let mut builder = Builder::new(0x1000, 1 << 24);
    let scene = builder.scene(&image).unwrap();
    let cast = builder.casts(&config, &rays).unwrap()[0];
    let word = builder.reserve("word", 4).unwrap();
    let lists: [u32; 4] = [(); 4].map(|()| builder.reserve("list", 512).unwrap());
    let (memory, _) = builder.finish();
    let mut host = chip(&config, &memory);
    let device = host.device();
    let arrays = arrays_of(&scene);
    let rays_of = |count| Cast {
        rays: cast.rays,
        count,
        hits: cast.hits,
        short_rays: c_int::from(cast.short.is_some()),
        origin: cast.short.unwrap().0,
        tmin: cast.short.unwrap().1,
        ..Cast::default()
    };
    // SAFETY: all pointers are of objects that outlive the calls.
    unsafe {
        assert_eq!((driver.open)(&device), OK);
        let build = |place: u32, what: &dyn Fn(*mut List)| {
            let mut list = empty_list();
            (driver.begin_list)(&mut list, &device, place, 512);
            what(&mut list);
            list
        };
        // Casts, a word when they are done, the interrupt; its end is behind a jump.
        let mut tail = build(lists[1], &|list| {
            (driver.add_signal)(list, word, 0x1234_5678, 1);
        });
        assert_eq!((driver.finish_list)(&mut tail), OK);
        let mut list = build(lists[0], &|list| {
            (driver.add_scene)(list, &arrays);
            (driver.add_cast)(list, &rays_of(cast.count));
            (driver.add_fence)(list);
        });
        assert_eq!((driver.finish_list_with_jump)(&mut list, lists[1]), OK);
        (driver.enable_interrupt)(&device, SIGNAL);
        let mut before = [0; COUNTERS.len()];
        (driver.read_counters)(&device, &mut before);
        let mut value = [0xff; 4];
        assert_eq!((driver.copy_out)(&device, word, value.as_mut_ptr(), 4), OK);
        assert_eq!(value, [0; 4]);
        assert_eq!((driver.submit)(&device, lists[0]), OK);
        assert_eq!((driver.run)(&device, lists[0], POLLS), BUSY);
        assert_eq!((driver.submit)(&device, lists[0]), OK);
        assert_eq!((driver.is_busy)(&device), 1);
        // One runs, one is queued.
        assert_eq!((driver.submit)(&device, lists[0]), BUSY);
        assert_eq!((driver.run)(&device, lists[0], POLLS), BUSY);
        let mut seen = 0;
        assert_eq!((driver.wait)(&device, SIGNAL, 1, &mut seen), TIMED_OUT);
        assert_eq!((seen, Host::pauses_of(&device)), (0, 1));
        // The interrupt of the signal, without polling.
        let mut cycles = 0;
        while !Host::interrupts_of(&device) {
            Host::pause_of(&device);
            cycles += 1;
            assert!(cycles < POLLS);
        }
        let events = (driver.events)(&device);
        assert!(events & SIGNAL != 0 && events & ERROR == 0, "{events:#x}");
        Host::pause_of(&device);
        // Both have ended, whatever was seen before; the events of the second one come later than those of the first.
        while (driver.is_busy)(&device) != 0 {
            Host::pause_of(&device);
        }
        let before_wait = 1 << 31;
        seen = before_wait;
        assert_eq!((driver.wait)(&device, END, 1, &mut seen), OK);
        assert_eq!(seen & (before_wait | END | ERROR), before_wait | END);
        assert_eq!((driver.events)(&device), 0);
        assert_eq!((driver.copy_out)(&device, word, value.as_mut_ptr(), 4), OK);
        assert_eq!(u32::from_le_bytes(value), 0x1234_5678);
        let mut after = [0; COUNTERS.len()];
        (driver.read_counters)(&device, &mut after);
        let counted = |name: &str| {
            let place = COUNTERS.iter().position(|(known, _)| *known == name);
            (driver.counted)(&before, &after, place.unwrap() as u32)
        };
        assert_eq!(counted("cast_rays"), 2 * u64::from(cast.count));
        assert!(counted("cycles") > counted("list_cycles") && counted("list_cycles") > 0);

        // A list that has ended, but whose event nobody has taken.
        assert_eq!((driver.submit)(&device, lists[1]), OK);
        while (driver.is_busy)(&device) != 0 {
            Host::pause_of(&device);
        }
        // A list with a wrong descriptor, which the driver would not have built.
        let wrong = CastWords {
            count: most_rays(&config) + 1,
            ..cast
        };
        for (place, value) in (0..).zip(Command::Cast(wrong).encode()) {
            let address = lists[2] + 4 * place;
            (driver.copy_in)(&device, address, value.to_le_bytes().as_ptr(), 4);
        }
        let mut fault = Fault::default();
        (driver.fault)(&device, &mut fault);
        assert_eq!(fault, Fault::default());
        assert_eq!((driver.run)(&device, lists[2], POLLS), LIST_FAILED);
        (driver.fault)(&device, &mut fault);
        let expected = Fault {
            code: descriptor::Fault::SIZE,
            descriptor: lists[2],
            value: wrong.count,
        };
        assert_eq!(fault, expected);
        // The next list runs; stale events of others do not end its wait.
        assert_eq!((driver.run)(&device, lists[0], POLLS), OK);
        assert_eq!((driver.is_busy)(&device), 0);
        assert_eq!((driver.submit)(&device, lists[0] + 4), MISALIGNED);
    }
    let mut expected = host.memory();
    let outcome = golden::Chip::new(&config).run(&mut expected, lists[0], MOST);
    assert_eq!(outcome.error, None);
    assert!(host.memory() == expected, "the golden chip changes nothing");
}

/// A picture from a camera, in several casts: the directions are those of the pixels, and the hits the golden chip's.
#[test]
fn a_camera_fills_rays() {
    let config = tiny();
    let driver = Driver::new(&config);
    let Prepared {
        image,
        camera: expected,
        mesh,
        ..
    } = prepare(&config, "builtin:cornell", "20x9", Some(View::Outside));
    let (width, height) = (20, 9);
    let mut builder = Builder::new(0x1000, 1 << 24);
    let arrays = arrays_of(&builder.scene(&image).unwrap());
    // SAFETY: plain numbers.
    let all = unsafe { (driver.picture_rays)(width, height) };
    assert_eq!(all, 3 * 2 * 64);
    let most = most_rays(&config);
    assert!(all > most, "the picture takes several casts");
    let rays = builder.reserve("rays", 16 * u64::from(all)).unwrap();
    let hits = builder.reserve("hits", 16 * u64::from(all)).unwrap();
    let place = builder.reserve("list", 1024).unwrap();
    let (memory, _) = builder.finish();
    let mut host = chip(&config, &memory);
    let device = host.device();
    let mut found = 0;
    // SAFETY: all pointers are of objects that outlive the calls.
    unsafe {
        assert_eq!((driver.open)(&device), OK);
        let mut camera = Camera::default();
        // Far away, so that rounded coordinates turn the view by less than is compared.
        let scale = f64::from(mesh.log2_scale).exp2();
        let eye = expected.eye.map(|x| (x * scale) as f32);
        let target =
            std::array::from_fn(|k| (expected.eye[k] * scale + 1e5 * expected.forward[k]) as f32);
        let up = [0.0, 7.0, 0.0];
        assert_eq!((driver.look_at)(&mut camera, &eye, &target, &up, 0.55), OK);
        let mut list = empty_list();
        (driver.begin_list)(&mut list, &device, place, 1024);
        (driver.add_scene)(&mut list, &arrays);
        for first in (0..all).step_by(most as usize) {
            let mut cast = Cast {
                rays: rays + 16 * first,
                hits: hits + 16 * first,
                tmin: 5.0,
                ..Cast::default()
            };
            let count = most.min(all - first);
            let filled =
                (driver.fill_rays)(&device, &camera, width, height, first, count, &mut cast);
            assert_eq!((filled, cast.count, cast.short_rays), (OK, count, 1));
            assert_eq!((cast.origin, cast.tmin), (eye, 0.0));
            (driver.add_cast)(&mut list, &cast);
        }
        assert_eq!((driver.finish_list)(&mut list), OK);
        // What the processor's cache holds of the hits is old after the list.
        let mut old = Hit::default();
        (driver.read_hit)(&device, hits, 0, &mut old);
        assert_eq!(old.triangle, 0);
        assert_eq!((driver.run)(&device, place, POLLS), OK);
        (driver.read_hit)(&device, hits, 0, &mut old);
        assert_eq!(old.triangle, 0);
        (driver.discard)(&device, hits, 16 * all);
        let mut seen = vec![false; (width * height) as usize];
        for ray in 0..all {
            let (mut column, mut row) = (0, 0);
            (driver.pixel_of_ray)(width, ray, &mut column, &mut row);
            let at = u64::from(rays + 16 * ray);
            let numbers: [f32; 4] = std::array::from_fn(|k| {
                f32::from_bits(host.memory().word(at + 4 * k as u64).unwrap())
            });
            let is_inside = column < width && row < height;
            if is_inside {
                let pixel = &mut seen[(row * width + column) as usize];
                assert!(!std::mem::replace(pixel, true), "a ray for each pixel");
                let x = (2.0 * f64::from(column) + 1.0 - f64::from(width)) / f64::from(height);
                let y = (f64::from(height) - 2.0 * f64::from(row) - 1.0) / f64::from(height);
                for (k, number) in numbers[..3].iter().enumerate() {
                    let exact = expected.forward[k] + x * expected.right[k] + y * expected.up[k];
                    let error = (f64::from(*number) - exact).abs();
                    assert!(error < 1e-6, "{number} is not {exact}");
                }
            }
            let tmax = if is_inside { 1.0 } else { -1.0 } * f32::INFINITY;
            assert_eq!(numbers[3].to_bits(), tmax.to_bits());
            let mut hit = Hit::default();
            (driver.read_hit)(&device, hits, ray, &mut hit);
            assert!(is_inside || hit.triangle == u32::MAX);
            found += u32::from(hit.triangle != u32::MAX);
        }
        assert!(seen.iter().all(|pixel| *pixel));
    }
    assert!(found > 20, "{found} hits");
    let left = host.memory();
    let mut expected = memory_of(&left, hits, 16 * all);
    let outcome = golden::Chip::new(&config).run(&mut expected, place, MOST);
    assert_eq!((outcome.error, outcome.hits), (None, u64::from(found)));
    assert!(left == expected, "the hits are the golden chip's");
    println!("{all} rays, {found} hits");
}

/// A memory in which a range is 0.
fn memory_of(memory: &Memory, address: u32, bytes: u32) -> Memory {
    let mut memory = memory.clone();
    let range = memory.read_mut(address.into(), bytes as usize);
    range.unwrap().fill(0);
    memory
}

fn arrays_of(scene: &Scene) -> [u32; 5] {
    let Scene {
        root,
        nodes,
        records,
        vertices,
        bounds,
    } = *scene;
    [root, nodes, records, vertices, bounds]
}

fn empty_list() -> List {
    List {
        device: null(),
        address: 0,
        next: 0,
        left: 0,
        result: OK,
    }
}

/// An address: mostly a multiple of 64, and seldom a multiple of less.
fn some_address(rng: &mut fastrand::Rng) -> u32 {
    let step = match rng.u8(..24) {
        step @ 0..=5 => 1 << step,
        _ => 64,
    };
    step * rng.u32(..=u32::MAX / step)
}

/// A count or an index: mostly in the range of all of them, else at a limit or anywhere.
fn some_number(rng: &mut fastrand::Rng, limits: &Limits) -> u32 {
    let Limits {
        rays,
        joints,
        greatest_index,
        ..
    } = *limits;
    let at_limits = [0, rays, joints, greatest_index];
    match rng.u8(..32) {
        0 => rng.u32(..),
        1 => at_limits[rng.usize(..4)],
        2 => at_limits[rng.usize(..4)].wrapping_add(1),
        _ => rng.u32(1..=joints),
    }
}

/// A random command with a descriptor, right or wrong.
fn some_command(rng: &mut fastrand::Rng, limits: &Limits) -> Command {
    let kind = rng.u8(..8);
    let any = |rng: &mut fastrand::Rng| some_number(rng, limits);
    match kind {
        0 => Command::Fence,
        1 => Command::Jump {
            to: some_address(rng),
        },
        2 => Command::Signal {
            address: some_address(rng),
            value: rng.u32(..),
            interrupt: rng.bool(),
        },
        3 => Command::Wait {
            address: some_address(rng),
            value: rng.u32(..),
        },
        4 => Command::Scene(Scene {
            root: rng.u32(..),
            nodes: some_address(rng),
            records: some_address(rng),
            vertices: some_address(rng),
            bounds: some_address(rng),
        }),
        5 => Command::Cast(CastWords {
            rays: some_address(rng),
            count: any(rng),
            hits: some_address(rng),
            any_hit: rng.bool(),
            short: rng
                .bool()
                .then(|| ([0; 3].map(|_| rng.f32() - 0.5), rng.f32())),
        }),
        6 => Command::Skin(Skin {
            vertices: some_address(rng),
            palette: any(rng),
            joints: any(rng),
            influences: some_address(rng),
            rows: any(rng),
            rest: any(rng),
            count: any(rng),
            target: any(rng),
        }),
        _ => Command::Update(Update {
            program: some_address(rng),
            rows: any(rng),
            vertices: some_address(rng),
            first_vertex: any(rng),
            nodes: some_address(rng),
            first_node: any(rng),
            bounds: some_address(rng),
        }),
    }
}

/// Adds a command to a list through the driver.
///
/// # Safety
/// The list has begun.
unsafe fn add(driver: &Driver, list: *mut List, command: &Command) -> c_int {
    // SAFETY: the caller's.
    unsafe {
        match *command {
            Command::End => (driver.finish_list)(list),
            Command::Fence => (driver.add_fence)(list),
            Command::Jump { to } => (driver.finish_list_with_jump)(list, to),
            Command::Signal {
                address,
                value,
                interrupt,
            } => (driver.add_signal)(list, address, value, c_int::from(interrupt)),
            Command::Wait { address, value } => (driver.add_wait)(list, address, value),
            Command::Scene(scene) => (driver.add_scene)(list, &arrays_of(&scene)),
            Command::Cast(cast) => {
                let (origin, tmin) = cast.short.unwrap_or_default();
                let cast = Cast {
                    rays: cast.rays,
                    count: cast.count,
                    hits: cast.hits,
                    any_hit: c_int::from(cast.any_hit),
                    short_rays: c_int::from(cast.short.is_some()),
                    origin,
                    tmin,
                };
                (driver.add_cast)(list, &cast)
            }
            Command::Skin(skin) => {
                let words = [
                    skin.vertices,
                    skin.palette,
                    skin.joints,
                    skin.influences,
                    skin.rows,
                    skin.rest,
                    skin.count,
                    skin.target,
                ];
                (driver.add_skin)(list, &words)
            }
            Command::Update(update) => {
                let words = [
                    update.program,
                    update.rows,
                    update.vertices,
                    update.first_vertex,
                    update.nodes,
                    update.first_node,
                    update.bounds,
                ];
                (driver.add_update)(list, &words)
            }
        }
    }
}

/// The driver writes the words that the table says, and refuses what the chip refuses, for the same reason.
#[test]
fn descriptors_are_those_of_the_table() {
    let seed = seed();
    let mut rng = fastrand::Rng::with_seed(seed);
    let wide = Config {
        tag_bits: 32,
        address_bits: 27,
        ..with_format(10, 23)
    };
    for config in [tiny(), wide] {
        let driver = Driver::new(&config);
        let limits = Limits::of(&config);
        let mut accepted: HashMap<u32, u32> = HashMap::new();
        let mut refused: HashMap<(u32, u32), u32> = HashMap::new();
        let mut commands = 0;
        while commands < 20_000 || accepted.len() + refused.len() < 8 + 10 {
            assert!(commands < 1_000_000, "{accepted:?}, {refused:?}");
            commands += 1;
            let command = some_command(&mut rng, &limits);
            let encoded = command.encode();
            let opcode = encoded[0] & 0xff;
            let memory = Memory::new(0x1000, vec![0xff; 128]);
            let mut host = Host::new(Behind::Table(HashMap::new(), memory));
            let device = host.device();
            let mut list = empty_list();
            // SAFETY: all pointers are of objects that outlive the calls.
            let result = unsafe {
                (driver.begin_list)(&mut list, &device, 0x1000, 64);
                let result = add(&driver, &mut list, &command);
                if result == OK && !matches!(command, Command::Jump { .. }) {
                    assert_eq!((driver.finish_list)(&mut list), NO_ROOM);
                    list.result = OK;
                    list.left = 64;
                    assert_eq!((driver.finish_list)(&mut list), OK);
                }
                result
            };
            match Command::decode(&encoded, &limits) {
                Ok(decoded) => {
                    assert_eq!((decoded, result), (command, OK), "seed {seed}");
                    assert_eq!(words(&host.memory(), 0x1000), encoded, "{command:?}");
                    if !matches!(command, Command::Jump { .. }) {
                        let end = words(&host.memory(), 0x1040);
                        assert_eq!(end, Command::End.encode());
                    }
                    *accepted.entry(opcode).or_default() += 1;
                }
                Err(fault) => {
                    let expected = match fault.code {
                        descriptor::Fault::ALIGNMENT => MISALIGNED,
                        _ => OUT_OF_RANGE,
                    };
                    assert_eq!(result, expected, "{command:?}, seed {seed}");
                    assert_eq!(words(&host.memory(), 0x1000), [u32::MAX; WORDS]);
                    *refused.entry((opcode, fault.code)).or_default() += 1;
                }
            }
        }
        println!("{commands} commands: accepted {accepted:?}, refused {refused:?}");
    }
}

/// A failure of a list stays until its end, and a list begins at an aligned address.
#[test]
fn a_list_keeps_its_first_failure() {
    let driver = Driver::new(&tiny());
    let mut host = table(0, 256);
    let device = host.device();
    let mut list = empty_list();
    // SAFETY: all pointers are of objects that outlive the calls.
    unsafe {
        assert_eq!((driver.begin_list)(&mut list, &device, 32, 128), MISALIGNED);
        assert_eq!((driver.add_fence)(&mut list), MISALIGNED);
        assert_eq!((driver.begin_list)(&mut list, &device, 64, 128), OK);
        assert_eq!((driver.add_signal)(&mut list, 2, 0, 0), MISALIGNED);
        let cast = Cast::default();
        assert_eq!((driver.add_cast)(&mut list, &cast), MISALIGNED);
        assert_eq!((driver.finish_list)(&mut list), MISALIGNED);
        assert_eq!((driver.begin_list)(&mut list, &device, 64, 127), OK);
        assert_eq!((driver.add_fence)(&mut list), OK);
        assert_eq!((driver.finish_list)(&mut list), NO_ROOM);
        assert_eq!((driver.copy_in)(&device, 2, null(), 0), MISALIGNED);
        assert_eq!((driver.copy_out)(&device, 1, null_mut(), 0), MISALIGNED);
    }
    assert_eq!(host.memory().bytes(), [0; 256]);
}

/// A chip of another version or configuration is refused, and nothing is written to it.
#[test]
fn other_chips_are_refused() {
    let config = tiny();
    let driver = Driver::new(&config);
    let all = registers(&config);
    let good: HashMap<u32, u32> = all.iter().map(|r| (r.offset, r.reset)).collect();
    let open = |changes: &[(u32, u32)]| {
        let mut registers = good.clone();
        registers.insert(offset::INTERRUPT_STATUS, END);
        registers.insert(offset::INTERRUPT_ENABLE, 7);
        registers.extend(changes.iter().copied());
        let memory = Memory::new(0, vec![]);
        let mut host = Host::new(Behind::Table(registers, memory));
        let device = host.device();
        // SAFETY: the device outlives the calls.
        let result = unsafe { (driver.open)(&device) };
        let left = [offset::INTERRUPT_ENABLE, offset::INTERRUPT_STATUS];
        (result, left.map(|offset| device.read(offset)))
    };
    let of = |name: &str| all.iter().find(|r| r.name == name).unwrap();
    let [id, version] = [of("ID"), of("VERSION")];
    let untouched = [7, END];
    assert_eq!(open(&[]), (OK, [0, 0]));
    for value in [0, u32::MAX] {
        assert_eq!(open(&[(id.offset, value)]), (WRONG_ID, untouched));
    }
    for (value, result) in [
        (version.reset + 1, OK),
        (version.reset + 0x1_0000, WRONG_VERSION),
        (version.reset - 0x1_0000, WRONG_VERSION),
        (0, WRONG_VERSION),
    ] {
        assert_eq!(open(&[(version.offset, value)]).0, result, "{value:#x}");
    }
    for name in ["FORMAT", "PACKETS", "TREE"] {
        let register = of(name);
        for field in &register.fields {
            let changed = register.reset ^ 1 << field.lsb;
            let found = open(&[(register.offset, changed)]);
            assert_eq!(found, (WRONG_MACHINE, untouched), "{name}.{}", field.name);
        }
    }
    // What does not change results does not matter.
    for name in ["BUS", "CACHES", "CACHE_KIB"] {
        assert_eq!(open(&[(of(name).offset, 0)]).0, OK, "{name}");
    }
}

/// Hits in memory are those of the golden chip, for formats of every size.
#[test]
fn hits_are_read_from_memory() {
    let seed = seed();
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut compared = 0;
    for (exponent_bits, fraction_bits) in [(7, 16), (3, 2), (8, 23), (10, 23), (5, 9)] {
        let config = with_format(exponent_bits, fraction_bits);
        let driver = Driver::new(&config);
        let record = ByteRecord::hit(config.format());
        let count = 500;
        let bytes = (0..count * record.bytes).map(|_| rng.u8(..)).collect();
        let mut host = Host::new(Behind::Table(HashMap::new(), Memory::new(0x40, bytes)));
        let device = host.device();
        let cast = |any_hit| CastWords {
            rays: 0,
            count,
            hits: 0x40,
            any_hit,
            short: None,
        };
        let expected = hits_of(&host.memory(), &config, &cast(false));
        let answers = hits_of(&host.memory(), &config, &cast(true));
        for (ray, (hit, answer)) in (0..).zip(expected.iter().zip(&answers)) {
            let mut found = Hit::default();
            // SAFETY: all pointers are of objects that outlive the calls.
            unsafe {
                (driver.read_hit)(&device, 0x40, ray, &mut found);
                let bit = (driver.read_answer)(&device, 0x40, ray);
                assert_eq!(bit == 1, answer.is_hit());
            }
            for (number, exact) in [(found.t, hit.t), (found.u, hit.u), (found.v, hit.v)] {
                let bound = f64::from(f32::MIN_POSITIVE);
                let flushed = if exact.abs() < bound { 0.0 } else { exact };
                // A cast from f64 to f32 makes what is too large infinite; it is exact otherwise.
                let expected = flushed as f32;
                let same = number == expected || number.is_nan() && expected.is_nan();
                assert!(same, "{number} is not {exact}, seed {seed}");
                compared += 1;
            }
            assert_eq!(found.triangle, hit.triangle);
            assert!(hit.triangle == u32::MAX || found.instance == hit.instance);
        }
        // SAFETY: plain numbers.
        unsafe {
            assert_eq!((driver.hits_bytes)(count, 0), count * record.bytes);
            for (count, bytes) in [(0, 0), (1, 4), (32, 4), (33, 8), (1 << 26, 1 << 23)] {
                assert_eq!((driver.hits_bytes)(count, 1), bytes);
            }
        }
    }
    println!("{compared} numbers compared");
}

/// Memory-mapped registers and memory, without callbacks.
#[test]
fn mapped_hardware_needs_no_callbacks() {
    let config = tiny();
    let driver = Driver::new(&config);
    let mut window = vec![0; 1024];
    for register in registers(&config) {
        window[register.offset as usize / 4] = register.reset;
    }
    let address = 0x8000_0000;
    let mut memory = vec![0u32; 64];
    let device = Host::mapped(&mut window, &mut memory, address);
    let bytes: Vec<u8> = (1..=10).collect();
    let mut back = [0xff; 12];
    let mut list = empty_list();
    // SAFETY: all pointers are of objects that outlive the calls.
    unsafe {
        assert_eq!((driver.open)(&device), OK);
        assert_eq!(
            (driver.copy_in)(&device, address + 8, bytes.as_ptr(), 10),
            OK
        );
        assert_eq!(
            (driver.copy_out)(&device, address + 8, back.as_mut_ptr(), 11),
            OK
        );
        (driver.begin_list)(&mut list, &device, address + 64, 128);
        assert_eq!((driver.add_fence)(&mut list), OK);
        assert_eq!((driver.finish_list)(&mut list), OK);
        assert_eq!((driver.submit)(&device, address + 64), OK);
        assert_eq!((driver.wait)(&device, END, 3, null_mut()), TIMED_OUT);
    }
    assert_eq!(back, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 0, 0xff]);
    let bytes: Vec<u8> = memory.iter().flat_map(|word| word.to_le_bytes()).collect();
    let memory = Memory::new(address, bytes);
    assert_eq!(memory.word(u64::from(address) + 8), Some(0x0403_0201));
    assert_eq!(words(&memory, address + 64), Command::Fence.encode());
    assert_eq!(words(&memory, address + 128), Command::End.encode());
    assert_eq!(window[offset::LIST as usize / 4], address + 64);
    assert_eq!(window[offset::DOORBELL as usize / 4], 1);
}

/// Every code has its name and its text, and wrong cameras and pictures are refused.
#[test]
fn texts_and_limits_are_those_of_the_tables() {
    let driver = Driver::new(&tiny());
    let mut host = table(0, 64);
    let device = host.device();
    // SAFETY: all pointers are of objects that outlive the calls.
    unsafe {
        for (code, name, condition) in ERRORS {
            assert_eq!(text((driver.error_name)(*code)), *name);
            assert_eq!(text((driver.error_text)(*code)), *condition);
        }
        assert_eq!(text((driver.error_name)(99)), "unknown");
        for (place, (name, _)) in (0..).zip(COUNTERS) {
            assert_eq!(text((driver.counter_name)(place)), *name);
        }
        assert_eq!(text((driver.counter_name)(u32::MAX)), "unknown");
        let texts: Vec<String> = (OK..=LIST_FAILED)
            .map(|result| text((driver.result_text)(result)))
            .collect();
        let unique: std::collections::BTreeSet<&String> = texts.iter().collect();
        assert_eq!(unique.len(), texts.len());
        assert_eq!(
            text((driver.result_text)(LIST_FAILED + 1)),
            "unknown result"
        );

        let (zero, up) = ([0.0; 3], [0.0, 1.0, 0.0]);
        let look = |eye: [f32; 3], target: [f32; 3], up: [f32; 3], tangent: f32| {
            (driver.look_at)(&mut Camera::default(), &eye, &target, &up, tangent)
        };
        assert_eq!(look(zero, [0.0, 0.0, 1.0], up, 0.5), OK);
        for (eye, target, up, tangent) in [
            (zero, zero, up, 0.5),
            (zero, [0.0, 2.0, 0.0], up, 0.5),
            (zero, [0.0, 0.0, 1.0], zero, 0.5),
            (zero, [0.0, 0.0, 1.0], up, 0.0),
            (zero, [0.0, 0.0, 1.0], up, f32::NAN),
            (zero, [0.0, 0.0, 1.0], up, f32::INFINITY),
            (zero, [0.0, 0.0, f32::NAN], up, 0.5),
            ([f32::INFINITY; 3], [0.0, 0.0, 1.0], up, 0.5),
        ] {
            let result = look(eye, target, up, tangent);
            assert_eq!(result, OUT_OF_RANGE, "{eye:?} {target:?} {up:?} {tangent}");
        }
        for (width, height) in [(0, 1), (1, 0), (65_529, 1), (1, u32::MAX)] {
            assert_eq!((driver.picture_rays)(width, height), 0);
        }
        assert_eq!((driver.picture_rays)(65_528, 65_528), 8191 * 8191 * 64);
        let fill = |rays: u32, width: u32, first: u32, count: u32| {
            let mut cast = Cast {
                rays,
                ..Cast::default()
            };
            let camera = Camera::default();
            (driver.fill_rays)(&device, &camera, width, 8, first, count, &mut cast)
        };
        assert_eq!(fill(8, 8, 0, 1), MISALIGNED);
        let most = most_rays(&tiny());
        for (width, first, count) in [
            (0, 0, 1),
            (8, 64, 1),
            (8, 0, 0),
            (8, 1, 64),
            (8, 1, u32::MAX),
            (800, 0, most + 1),
        ] {
            let result = fill(0, width, first, count);
            assert_eq!(result, OUT_OF_RANGE, "{width} {first} {count}");
        }
        assert_eq!(fill(0, 8, 60, 4), OK);
    }
}
