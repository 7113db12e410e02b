//! A machine and its workload, generated from a seed.

use crate::config::{Config, KEYS, Key, Values};
use anyhow::{Context, Result, bail};
use std::fmt::Write as _;

/// The sizes of a workload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Sizes([u32; Sizes::NAMES.len()]);

/// The name of one of the [`Sizes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Objects in the animated scene.
    Objects,
    /// Triangles per object, or fewer if the machine cannot hold as many.
    Triangles,
    /// Instances in the animated scene.
    Instances,
    /// Frames of the animated scene.
    Frames,
    /// Packets of rays per frame of the animated scene, and per static scene.
    Packets,
    /// Packet steps, tests, transformations or instructions per unit.
    Transactions,
}

impl Size {
    pub const ALL: [Size; Sizes::NAMES.len()] = [
        Size::Objects,
        Size::Triangles,
        Size::Instances,
        Size::Frames,
        Size::Packets,
        Size::Transactions,
    ];

    pub fn name(self) -> &'static str {
        Sizes::NAMES[self as usize]
    }

    /// The maximum value: every machine can hold it and processes it in seconds.
    pub fn most(self) -> u32 {
        match self {
            Size::Objects | Size::Frames => 3,
            Size::Triangles => 24,
            Size::Instances => 6,
            Size::Packets => 32,
            Size::Transactions => 4000,
        }
    }
}

impl Sizes {
    const NAMES: [&str; 6] = [
        "objects",
        "triangles",
        "instances",
        "frames",
        "packets",
        "transactions",
    ];

    fn draw(rng: &mut fastrand::Rng) -> Sizes {
        Sizes(Size::ALL.map(|size| match size {
            Size::Packets => 24,
            Size::Transactions => 1000,
            _ => rng.u32(1..=size.most()),
        }))
    }

    pub fn get(&self, size: Size) -> u32 {
        self.0[size as usize]
    }

    /// # Panics
    /// If the value is 0 or more than [`Size::most`].
    pub fn set(&mut self, size: Size, value: u32) {
        assert!((1..=size.most()).contains(&value), "a size within range");
        self.0[size as usize] = value;
    }

    /// Sets a size from `NAME=VALUE`.
    ///
    /// # Errors
    /// One line that says what to write instead.
    pub fn parse(&mut self, setting: &str) -> Result<()> {
        let (name, value) = setting.split_once('=').with_context(|| {
            format!("{setting}: has no value; write NAME=VALUE, such as triangles=3")
        })?;
        let Some(size) = Size::ALL.into_iter().find(|size| size.name() == name) else {
            bail!(
                "{setting}: there is no size {name}; use one of {}",
                Sizes::NAMES.join(", ")
            );
        };
        match value.parse() {
            Ok(value) if (1..=size.most()).contains(&value) => self.set(size, value),
            _ => bail!("{setting}: is out of range; use 1 to {}", size.most()),
        }
        Ok(())
    }
}

/// A machine and its workload. Scenes and stimuli depend only on the seed, the configuration and the sizes.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Case {
    pub seed: u64,
    pub config: Config,
    pub sizes: Sizes,
}

impl Case {
    /// The case of a seed: every key of [`KEYS`] is random within its range. The minimum and the maximum have a higher
    /// probability than other values.
    pub fn random(seed: u64) -> Case {
        let mut rng = fastrand::Rng::with_seed(seed ^ 0x6d61_6368_696e_6573);
        let sizes = Sizes::draw(&mut rng);
        let mut config = Config::reference();
        config.name = format!("random-{seed}");
        for key in KEYS {
            match (rng.u8(..10), &key.values) {
                (0, Values::Range(range)) => set(&mut config, key, &range.start().to_string()),
                (1, Values::Range(range)) => set(&mut config, key, &range.end().to_string()),
                _ => key.randomise(&mut config, &mut rng),
            }
        }
        Case {
            seed,
            config,
            sizes,
        }
    }

    /// The keys that differ from the reference machine's, each as `section.name=value`, the syntax of `--set`.
    pub fn settings(&self) -> Vec<String> {
        let reference = Config::reference();
        let differs = |key: &&Key| key.value(&self.config) != key.value(&reference);
        let setting = |key: &Key| format!("{}={}", key.path(), plain(&key.value(&self.config)));
        KEYS.iter().filter(differs).map(setting).collect()
    }

    /// The command that checks this case, with only the given stage if there is one.
    pub fn command(&self, stage: Option<super::Stage>) -> String {
        let mut text = format!("dynrt fuzz --machines 1 --seed {}", self.seed);
        if let Some(stage) = stage {
            let _ = write!(text, " --stage {}", stage.name());
        }
        let drawn = Case::random(self.seed);
        let keys_differ = KEYS
            .iter()
            .any(|key| key.value(&self.config) != key.value(&drawn.config));
        if keys_differ {
            text += " --config virtex4-lx160";
            for setting in self.settings() {
                let _ = write!(text, " --set {setting}");
            }
        }
        for size in Size::ALL {
            let value = self.sizes.get(size);
            if value != drawn.sizes.get(size) {
                let _ = write!(text, " --size {}={value}", size.name());
            }
        }
        text
    }
}

/// Sets a key to a valid value.
pub(super) fn set(config: &mut Config, key: &Key, value: &str) {
    (config.set(&key.path(), value)).expect("the value is one of the key's own");
}

/// The value of a key without quotes.
pub(super) fn plain(value: &str) -> &str {
    value.trim_matches('"')
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn cases_replay_and_reach_every_end_of_every_range() {
        let mut seen = vec![BTreeSet::new(); KEYS.len()];
        for seed in 0..300 {
            let case = Case::random(seed);
            assert_eq!(case, Case::random(seed));
            let text = case.config.to_toml();
            assert_eq!(
                Config::parse(&case.config.name, "f", &text).unwrap(),
                case.config
            );
            for (key, seen) in KEYS.iter().zip(&mut seen) {
                seen.insert(plain(&key.value(&case.config)).to_string());
            }
        }
        for (key, seen) in KEYS.iter().zip(&seen) {
            let ends = match &key.values {
                Values::Range(range) => vec![range.start().to_string(), range.end().to_string()],
                Values::OneOf(values) => values.iter().map(u32::to_string).collect(),
                Values::Names(names) => names.iter().map(|name| name.to_string()).collect(),
            };
            for end in ends {
                assert!(seen.contains(&end), "{} is never {end}", key.path());
            }
        }
    }

    #[test]
    fn a_command_names_what_differs_from_what_its_seed_draws() {
        let case = Case::random(7);
        assert_eq!(case.command(None), "dynrt fuzz --machines 1 --seed 7");
        let mut other = case.clone();
        other.config = Config::reference();
        other.config.set("packets.rays", "8").unwrap();
        other.sizes.parse("triangles=3").unwrap();
        assert_eq!(
            other.command(Some(super::super::Stage::Tpu)),
            "dynrt fuzz --machines 1 --seed 7 --stage tpu --config virtex4-lx160 --set packets.rays=8 --size triangles=3"
        );
        // The settings reproduce the machine.
        let mut again = Config::reference();
        for setting in case.settings() {
            let (path, value) = setting.split_once('=').unwrap();
            again.set(path, value).unwrap();
        }
        again.name.clone_from(&case.config.name);
        assert_eq!(again, case.config);
    }

    #[test]
    fn bad_sizes_get_one_clear_line() {
        let mut sizes = Case::random(1).sizes;
        let mut fault = |text: &str| sizes.parse(text).unwrap_err().to_string();
        assert_eq!(
            fault("triangles"),
            "triangles: has no value; write NAME=VALUE, such as triangles=3"
        );
        assert_eq!(
            fault("triangle=3"),
            "triangle=3: there is no size triangle; use one of objects, triangles, instances, frames, packets, transactions"
        );
        assert_eq!(
            fault("triangles=0"),
            "triangles=0: is out of range; use 1 to 24"
        );
        assert_eq!(fault("frames=x"), "frames=x: is out of range; use 1 to 3");
    }
}
