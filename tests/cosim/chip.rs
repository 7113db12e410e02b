//! The units of the chip, each alone, and the whole chip.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim chip::` replays them. With `DYNRT_FULL=1` the units have a million
//! transactions each, the cast unit in each of its configurations.

use crate::support::{Prepared, full, prepare, seed};
use dynrt::chip::descriptor::{Cast, Command, Scene, Skin, Update, WORDS};
use dynrt::chip::memory::Memory;
use dynrt::chip::most_rays;
use dynrt::chip::registers::offset;
use dynrt::config::{Config, MemoryModel};
use dynrt::cosim::chip::{Behaviour, Chip, Options, Report};
use dynrt::cosim::lists::Lists;
use dynrt::cosim::scoreboard::{UnitOptions, UnitReport};
use dynrt::cosim::{unit_cast, unit_commands, unit_motion, unit_registers};
use dynrt::golden::chip as golden;

/// The reference with some keys changed.
fn variant(keys: &[(&str, &str)]) -> Config {
    let mut config = Config::reference();
    for (key, value) in keys {
        config.set(key, value).unwrap();
        config.name += &format!(", {key} = {value}");
    }
    config
}

/// Rays of random casts with random neighbours: formats of every record size, packets of every number of rays, and tags so short that a
/// cast is never longer than the window of answers.
#[test]
fn casts_read_rays_and_write_hits() {
    let rays = if full() { 1_000_000 } else { 20_000 };
    let configs = [
        unit_cast::reference(),
        variant(&[
            ("packets.rays", "1"),
            ("packets.tag_bits", "7"),
            ("float.exponent_bits", "10"),
            ("float.fraction_bits", "23"),
        ]),
        variant(&[
            ("packets.rays", "8"),
            ("float.exponent_bits", "8"),
            ("float.fraction_bits", "23"),
        ]),
        variant(&[
            ("packets.rays", "2"),
            ("packets.tag_bits", "32"),
            ("float.exponent_bits", "3"),
            ("float.fraction_bits", "2"),
        ]),
    ];
    for (number, config) in configs.iter().enumerate() {
        let report = unit_cast::run(config, rays, &UnitOptions::new(seed())).unwrap();
        println!("{}: {}", config.name, report.summary());
        report.verdict().unwrap_or_else(|error| panic!("{error}"));
        assert!(report.transactions >= rays);
        for (category, count) in report.categories.iter().filter(|_| number == 0) {
            assert!(*count > 0, "no {}", category.name());
        }
    }
}

/// Transactions of a unit of the chip in each of its configurations.
fn transactions(configs: usize) -> u64 {
    match full() {
        true => 1_000_000 / configs as u64,
        false => 20_000,
    }
}

/// Shows what came of a run; every category must have been met.
fn check(config: &Config, least: u64, report: anyhow::Result<UnitReport>) {
    let report = report.unwrap_or_else(|error| panic!("{error:#}"));
    println!("{}: {}", config.name, report.summary());
    report.verdict().unwrap_or_else(|error| panic!("{error:#}"));
    assert!(report.transactions >= least);
    for (category, count) in &report.categories {
        assert!(*count > 0, "{}: no {}", config.name, category.name());
    }
}

/// Accesses of a random host while lists start, end and fail, compared in every cycle with the golden register file.
#[test]
fn registers_in_front_of_any_host() {
    let narrow = variant(&[
        ("packets.rays", "1"),
        ("packets.tag_bits", "7"),
        ("float.exponent_bits", "10"),
        ("float.fraction_bits", "23"),
    ]);
    let (configs, seed) = ([Config::reference(), narrow], seed());
    let least = transactions(configs.len());
    for config in configs {
        let report = unit_registers::run(&config, least, &UnitOptions::new(seed));
        check(&config, least, report);
    }
}

/// Random lists with all commands and all errors, on buses of every width and with boxes of every size, behind neighbours of any pace.
#[test]
fn commands_follow_any_list() {
    let configs = [
        unit_commands::reference(),
        variant(&[("bus.data_bits", "32"), ("packets.tag_bits", "7")]),
        variant(&[
            ("bus.data_bits", "64"),
            ("float.exponent_bits", "10"),
            ("float.fraction_bits", "23"),
        ]),
        variant(&[
            ("bus.data_bits", "256"),
            ("packets.tag_bits", "32"),
            ("float.exponent_bits", "3"),
            ("float.fraction_bits", "2"),
        ]),
    ];
    let (least, seed) = (transactions(configs.len()), seed());
    for config in configs {
        let report = unit_commands::run(&config, least, &UnitOptions::new(seed));
        check(&config, least, report);
    }
}

/// Random meshes and objects with rows and records of every size, behind neighbours of any pace.
#[test]
fn motions_hand_on_rows_and_write_records() {
    let configs = [
        Config::reference(),
        variant(&[
            ("float.exponent_bits", "10"),
            ("float.fraction_bits", "23"),
            ("skinning.rows_ahead", "2"),
        ]),
        variant(&[
            ("float.exponent_bits", "3"),
            ("float.fraction_bits", "2"),
            ("tree.address_bits", "26"),
            ("update.program_rows", "32"),
        ]),
    ];
    let (least, seed) = (transactions(configs.len()), seed());
    for config in configs {
        let report = unit_motion::run(&config, least, &UnitOptions::new(seed));
        check(&config, least, report);
    }
}

/// A picture of the Cornell box in memory.
fn cornell(config: &Config) -> Lists {
    let Prepared { image, rays, .. } = prepare(config, "builtin:cornell", "32x24", None);
    let mut rng = fastrand::Rng::with_seed(seed());
    Lists::new(config, &image, &rays, &mut rng).unwrap()
}

fn run(chip: &mut Chip, memory: &mut Memory, list: u32) -> Report {
    chip.run(memory, list, &|_| ())
        .unwrap_or_else(|error| panic!("{error:#}"))
}

/// Random lists: casts of parts of the rays, of both kinds and both sizes, signals, fences and jumps, behind every behaviour of memory.
#[test]
fn random_lists_leave_the_bytes_of_the_golden_chip() {
    let seed = seed();
    let lists = if full() { 400 } else { 12 };
    let config = Config::load("tiny").unwrap();
    let mut rng = fastrand::Rng::with_seed(seed);
    let (mut rays, mut bytes, mut bursts) = (0, 0, 0);
    let (mut skinned, mut nodes) = (0, 0);
    for behaviour in [Behaviour::Random, Behaviour::Model] {
        let options = Options {
            seed,
            behaviour,
            ..Options::default()
        };
        let mut chip = Chip::new(&config, &options, &|_| ()).unwrap();
        let mut setting = cornell(&config);
        for _ in 0..lists {
            setting.add(&mut rng).unwrap();
        }
        let (mut memory, starts) = setting.finish();
        for list in starts {
            let report = run(&mut chip, &mut memory, list);
            assert_eq!(report.outcome.error, None);
            assert_eq!(report.counter("cast_rays"), report.outcome.rays);
            assert_eq!(report.counter("skin_influences"), report.outcome.influences);
            assert_eq!(
                report.counter("update_instructions"),
                report.outcome.instructions
            );
            rays += report.outcome.rays;
            skinned += report.outcome.vertices_skinned;
            nodes += report.outcome.nodes_written;
            bytes += report.checked;
            bursts += report.traffic.read_bursts + report.traffic.write_bursts;
        }
    }
    println!(
        "seed {seed}: {rays} rays, {skinned} vertices, {nodes} nodes, {bytes} bytes compared, {bursts} bursts"
    );
    assert!(rays > 1000 && bursts > 1000 && skinned > 0 && nodes > 0);
}

/// Every wrong descriptor ends its list with its code, its address and the wrong value, and the next list runs.
#[test]
fn wrong_descriptors_end_their_list_and_not_the_next() {
    let config = Config::load("tiny").unwrap();
    let options = Options {
        seed: seed(),
        ..Options::default()
    };
    let mut chip = Chip::new(&config, &options, &|_| ()).unwrap();
    let mut setting = cornell(&config);
    let cast = setting.casts[0];
    let scene = setting.scene;
    let good = [
        Command::Scene(scene),
        Command::Cast(Cast { count: 40, ..cast }),
        Command::End,
    ];
    let good = setting.memory.list("good list", &good).unwrap();
    let raw = |words: &[u32]| {
        let mut all = [0; WORDS];
        all[..words.len()].copy_from_slice(words);
        all
    };
    let most = most_rays(&config);
    let wrong = [
        // The first cast of all, before any scene.
        Command::Cast(cast).encode(),
        raw(&[]),
        raw(&[0xff]),
        raw(&[10]),
        Command::Wait {
            address: setting.scratch + 1,
            value: 0,
        }
        .encode(),
        Command::Skin(Skin {
            joints: 1,
            influences: 8,
            ..Skin::default()
        })
        .encode(),
        Command::Skin(Skin {
            joints: config.skinning_joints + 1,
            rows: 1,
            count: 1,
            ..Skin::default()
        })
        .encode(),
        Command::Update(Update {
            rows: 1,
            bounds: 16,
            ..Update::default()
        })
        .encode(),
        Command::Update(Update {
            rows: 1,
            first_node: 1 << config.address_bits,
            ..Update::default()
        })
        .encode(),
        Command::Jump { to: 0x1020 }.encode(),
        Command::Signal {
            address: setting.scratch + 2,
            value: 1,
            interrupt: true,
        }
        .encode(),
        Command::Scene(Scene {
            nodes: scene.nodes + 32,
            ..scene
        })
        .encode(),
        Command::Scene(Scene {
            records: scene.records + 16,
            bounds: scene.bounds + 4,
            ..scene
        })
        .encode(),
        Command::Scene(Scene {
            vertices: scene.vertices + 1,
            ..scene
        })
        .encode(),
        Command::Scene(Scene {
            bounds: scene.bounds + 8,
            ..scene
        })
        .encode(),
        Command::Cast(Cast {
            rays: cast.rays + 8,
            ..cast
        })
        .encode(),
        Command::Cast(Cast {
            hits: cast.hits + 32,
            count: 0,
            ..cast
        })
        .encode(),
        Command::Cast(Cast { count: 0, ..cast }).encode(),
        Command::Cast(Cast {
            count: most + 1,
            ..cast
        })
        .encode(),
    ];
    let lists: Vec<u32> = (wrong.iter())
        .map(|words| {
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            setting.memory.place("wrong list", &bytes).unwrap()
        })
        .collect();
    // The last one is read nowhere: its address is wrong.
    let odd = lists[0] + 32;
    let lists: Vec<u32> = lists.into_iter().chain([odd]).collect();
    let (mut memory, _) = setting.memory.finish();
    for (number, &list) in lists.iter().enumerate() {
        let report = run(&mut chip, &mut memory, list);
        let error = report.outcome.error;
        assert_eq!(error.map(|error| error.descriptor), Some(list), "{number}");
        let report = run(&mut chip, &mut memory, good);
        assert_eq!(report.outcome.error, None);
        assert_eq!(report.outcome.rays, 40);
    }
    println!("wrong descriptors: {}", lists.len());
}

/// Both memories of the table that are DRAM, and the ideal one: the same bytes, and a list takes longer behind slower memory.
#[test]
fn memory_models_change_cycles_only() {
    let models = [
        MemoryModel::Ideal,
        MemoryModel::DdrVirtex4,
        MemoryModel::SdrUlx3s,
    ];
    let runs = models.map(|memory_model| {
        let config = Config {
            memory_model,
            ..Config::load("tiny").unwrap()
        };
        let mut chip = Chip::new(&config, &Options::default(), &|_| ()).unwrap();
        let mut setting = cornell(&config);
        let commands = [
            Command::Scene(setting.scene),
            Command::Cast(setting.casts[0]),
            Command::End,
        ];
        let list = setting.memory.list("list", &commands).unwrap();
        let (mut memory, _) = setting.memory.finish();
        let report = run(&mut chip, &mut memory, list);
        (report.cycles, memory)
    });
    let [ideal, ddr, sdr] = &runs;
    println!("cycles: {}, {}, {}", ideal.0, ddr.0, sdr.0);
    assert!(ideal.0 < ddr.0 && ddr.0 < sdr.0);
    assert!(ideal.1 == ddr.1 && ddr.1 == sdr.1);
}

/// A list waits for the host: the host sees the word that the list has written, and the list goes on when the host's word is great enough.
#[test]
fn a_list_waits_for_the_host() {
    let config = Config::load("tiny").unwrap();
    let mut setting = cornell(&config);
    let (told, awaited, after) = (setting.scratch, setting.scratch + 4, setting.scratch + 8);
    let signal = |address, value| Command::Signal {
        address,
        value,
        interrupt: false,
    };
    let commands = [
        signal(told, 1),
        Command::Wait {
            address: awaited,
            value: 0x8000_0005,
        },
        signal(after, 7),
        Command::End,
    ];
    let list = setting.memory.list("list", &commands).unwrap();
    let (memory, _) = setting.memory.finish();
    let mut behaviours = 0;
    for behaviour in [Behaviour::Model, Behaviour::Random] {
        let options = Options {
            seed: seed(),
            behaviour,
            ..Options::default()
        };
        let mut chip = Chip::new(&config, &options, &|_| ()).unwrap();
        chip.connect(&memory);
        chip.write(offset::LIST, list).unwrap();
        chip.write(offset::DOORBELL, 1).unwrap();
        chip.step(2000).unwrap();
        assert_eq!(chip.read_memory(told).unwrap(), 1, "the host is told");
        // Smaller words, one of them greater if it had a sign.
        for value in [5, 0x7fff_ffff, 0x8000_0004] {
            chip.write_memory(awaited, value).unwrap();
            chip.step(1000).unwrap();
            assert!(!chip.interrupts(), "the list waits on at {value:#x}");
            assert_eq!(chip.read_memory(after).unwrap(), 0);
        }
        chip.write_memory(awaited, 0x8000_0005).unwrap();
        let mut cycles = 0;
        while !chip.interrupts() {
            chip.step(1).unwrap();
            cycles += 1;
            assert!(cycles < 5000, "the list goes on");
        }
        assert_eq!(chip.read_memory(after).unwrap(), 7);
        // The golden chip's host writes the same word.
        let mut expected = memory.clone();
        let mut golden = golden::Chip::new(&config);
        golden.host_writes([(awaited, 0x8000_0004), (awaited, 0x8000_0005)]);
        golden.run(&mut expected, list, 10).check().unwrap();
        assert!(chip.memory() == expected);
        behaviours += 1;
    }
    assert_eq!(behaviours, 2);
}
