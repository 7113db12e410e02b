//! The pipeline depth of a unit: its steps are distributed, in order, over the fewest stages that the clock allows.
//!
//! Every unit lists its critical path as steps, each with a delay: a level of logic, a carry chain, a multiplication.
//! A step is never split, and the sum of the delays in a stage does not exceed the [`budget`] of the clock, except for a single
//! longer step. With the resulting minimum number of stages, the worst stage is made as short as possible.
//!
//! Delays are those of an ECP5 of the slowest grade, including routing; a Virtex-4 of the slowest grade is within a few
//! percent. They determine the positions of registers, never the function of a unit.

/// A level of logic: one LUT and the route to the next.
pub(super) const LOGIC: u32 = 1100;
/// A level of a shifter: two levels share one wide LUT.
pub(super) const SHIFT: u32 = 800;
/// The additional delay of a fan-out to one LUT per bit of a significand.
pub(super) const FAN_OUT: u32 = 350;
/// A multiplication of at most 17 by 17 bits in a DSP block without use of its internal registers.
pub(super) const MULTIPLY: u32 = 6000;

/// An addition, subtraction or comparison of `width` bits on a carry chain.
pub(super) const fn chain(width: u32) -> u32 {
    1650 + 40 * width
}

/// A test of `width` bits, all ones or all zeros, as a tree of 4-input LUTs.
pub(super) const fn reduction(width: u32) -> u32 {
    let (mut levels, mut reach) = (0, 1);
    while reach < width {
        levels += 1;
        reach *= 4;
    }
    levels * LOGIC
}

/// The maximum delay of the steps between two registers at a clock of `clock_mhz`, in picoseconds: the period minus clock-to-output
/// and setup times of the registers, minus a margin for routing in a full device. The margin is a fifth of the period and at
/// least 2 ns, because wires do not become shorter at a higher clock.
pub(super) const fn budget(clock_mhz: u32) -> u32 {
    let period = 1_000_000 / if clock_mhz == 0 { 1 } else { clock_mhz };
    let routing = if period / 5 > 2000 { period / 5 } else { 2000 };
    period.saturating_sub(routing + 700)
}

/// A part of a unit's critical path that is never split by a register.
pub(super) struct Step {
    name: String,
    picoseconds: u32,
    /// The next step begins a stage at any clock.
    registered: bool,
}

impl Step {
    pub fn new(name: impl Into<String>, picoseconds: u32) -> Step {
        Step {
            name: name.into(),
            picoseconds,
            registered: false,
        }
    }

    /// The same step, followed by a register at any clock.
    pub fn registered(self) -> Step {
        Step {
            registered: true,
            ..self
        }
    }
}

/// The stage of each step of a unit, counted from 0.
pub(super) struct Schedule {
    steps: Vec<(String, u32)>,
    /// The unused part of the budget in the first stage, in picoseconds.
    headroom: u32,
}

impl Schedule {
    pub fn new(steps: Vec<Step>, clock_mhz: u32) -> Schedule {
        // Stages are filled from the last one backwards. So the first stages are short, and the caller may add logic to
        // them.
        let within = |limit: u32| {
            let (mut from_end, mut used) = (0, 0);
            let mut stages: Vec<u32> = steps
                .iter()
                .rev()
                .map(|step| {
                    if used > 0 && (step.registered || used + step.picoseconds > limit) {
                        from_end += 1;
                        used = 0;
                    }
                    used += step.picoseconds;
                    from_end
                })
                .collect();
            stages.reverse();
            stages
                .iter()
                .map(|stage| from_end - stage)
                .collect::<Vec<u32>>()
        };
        let depth = |limit| within(limit).last().map_or(0, |last| last + 1);
        // The least limit with the same number of stages: the depth decreases as the limit grows.
        let (mut too_low, mut enough) = (0, budget(clock_mhz));
        let fewest = depth(enough);
        while enough - too_low > 1 {
            let middle = too_low + (enough - too_low) / 2;
            if depth(middle) == fewest {
                enough = middle;
            } else {
                too_low = middle;
            }
        }
        let stages = within(enough);
        let first: u32 = steps
            .iter()
            .zip(&stages)
            .filter(|(_, stage)| **stage == 0)
            .map(|(step, _)| step.picoseconds)
            .sum();
        Schedule {
            headroom: budget(clock_mhz).saturating_sub(first),
            steps: steps.into_iter().map(|s| s.name).zip(stages).collect(),
        }
    }

    /// The stage of a step.
    pub fn at(&self, step: impl AsRef<str>) -> u32 {
        let step = step.as_ref();
        self.steps
            .iter()
            .find(|(name, _)| name == step)
            .unwrap_or_else(|| panic!("the unit has no step \"{step}\""))
            .1
    }

    /// Whether a two-input multiplexer (one level of logic) fits before the unit without a register.
    pub fn takes_choice(&self) -> bool {
        self.headroom >= LOGIC
    }

    /// The number of stages. It is the latency of the unit, because each stage ends with a register.
    pub fn depth(&self) -> u32 {
        self.steps.last().map_or(0, |(_, stage)| stage + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stages(steps: &[u32], clock_mhz: u32) -> Vec<u32> {
        let steps = steps.iter().map(|ps| Step::new("", *ps)).collect();
        let schedule = Schedule::new(steps, clock_mhz);
        schedule.steps.iter().map(|(_, stage)| *stage).collect()
    }

    #[test]
    fn stages_are_few_first_and_even_then() {
        assert_eq!([50, 100, 125].map(budget), [15_300, 7300, 5300]);
        assert_eq!(stages(&[3000, 3000, 1000], 100), [0, 0, 0]);
        // Two stages either way: 7000 | 2000 is within the budget, 5000 | 4000 is better.
        assert_eq!(stages(&[3000, 2000, 2000, 2000], 100), [0, 0, 1, 1]);
        // A step beyond the budget has its stage to itself.
        assert_eq!(stages(&[1000, 9000, 1000], 100), [0, 1, 2]);
    }

    #[test]
    fn a_choice_fits_before_a_short_first_stage() {
        let takes = |first| Schedule::new(vec![Step::new("a", first)], 100).takes_choice();
        assert!(takes(7300 - LOGIC) && !takes(7301 - LOGIC) && !takes(9000));
        // Only the first stage counts.
        let steps = vec![Step::new("a", 100).registered(), Step::new("b", 7300)];
        assert!(Schedule::new(steps, 100).takes_choice());
    }

    #[test]
    fn a_registered_step_ends_its_stage() {
        let steps = vec![Step::new("a", 10).registered(), Step::new("b", 10)];
        let schedule = Schedule::new(steps, 1);
        assert_eq!((schedule.at("a"), schedule.at("b")), (0, 1));
        assert_eq!(schedule.depth(), 2);
    }
}
