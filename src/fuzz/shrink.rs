//! Shrinks a failing case to the simplest one that still fails.

use super::case::{Case, Size, plain, set};
use crate::config::{Config, KEYS, Key, Values};

/// The simplest case found.
#[derive(Clone, Debug)]
pub struct Shrunk {
    pub case: Case,
    /// Number of cases tried.
    pub attempts: usize,
}

/// Simplifies a case while `fails` returns true. Sizes move towards 1, then keys towards the reference machine's
/// values. The keys of the memory model come first, because they do not change the Verilog. `fails` is called at most `most`
/// times, and never with `case` itself.
pub fn shrink(case: &Case, most: usize, fails: impl FnMut(&Case) -> bool) -> Shrunk {
    let mut search = Search {
        case: case.clone(),
        left: most,
        fails,
    };
    loop {
        let before = search.case.clone();
        search.sizes();
        search.keys(|key| key.environment);
        search.keys(|_| true);
        search.values();
        if search.case == before || search.left == 0 {
            return Shrunk {
                case: search.case,
                attempts: most - search.left,
            };
        }
    }
}

struct Search<F> {
    case: Case,
    left: usize,
    fails: F,
}

impl<F: FnMut(&Case) -> bool> Search<F> {
    /// Replaces the current case if the given one fails too.
    fn take(&mut self, case: Case) -> bool {
        if self.left == 0 || case == self.case {
            return false;
        }
        self.left -= 1;
        let fails = (self.fails)(&case);
        if fails {
            self.case = case;
        }
        fails
    }

    fn sizes(&mut self) {
        for size in Size::ALL {
            // Try 1 first, then halve, then decrement.
            let to = |search: &mut Self, value: u32| {
                let mut case = search.case.clone();
                case.sizes.set(size, value);
                search.take(case)
            };
            if self.case.sizes.get(size) == 1 || to(self, 1) {
                continue;
            }
            while self.case.sizes.get(size) > 3 && to(self, self.case.sizes.get(size) / 2) {}
            // Large sizes are not decremented, because 999 transactions are no simpler than 1,000.
            while (3..=24).contains(&self.case.sizes.get(size))
                && to(self, self.case.sizes.get(size) - 1)
            {}
        }
    }

    /// Sets keys to their reference values: all together, then in groups of half the size, down to single keys.
    fn keys(&mut self, which: impl Fn(&Key) -> bool) {
        let reference = Config::reference();
        let differing: Vec<&Key> = (KEYS.iter())
            .filter(|key| which(key) && key.value(&self.case.config) != key.value(&reference))
            .collect();
        let mut chunk = differing.len();
        while chunk > 0 {
            for keys in differing.chunks(chunk) {
                let mut case = self.case.clone();
                for key in keys {
                    set(&mut case.config, key, plain(&key.value(&reference)));
                }
                self.take(case);
            }
            chunk /= 2;
        }
    }

    /// Moves each number that must differ from the reference as close to it as possible, by bisection.
    fn values(&mut self) {
        let reference = Config::reference();
        for key in KEYS {
            let number = |config: &Config| plain(&key.value(config)).parse::<i64>();
            let (Ok(passes), Ok(fails)) = (number(&reference), number(&self.case.config)) else {
                continue;
            };
            // Indices into the list of values, or the values themselves.
            let place = |value: i64| match &key.values {
                Values::OneOf(values) => {
                    let at = values.iter().position(|&v| i64::from(v) == value);
                    at.expect("a value of the list") as i64
                }
                _ => value,
            };
            let (mut passes, mut fails) = (place(passes), place(fails));
            while (passes - fails).abs() > 1 && self.left > 0 {
                let middle = (passes + fails) / 2;
                let value = match &key.values {
                    Values::OneOf(values) => i64::from(values[middle as usize]),
                    _ => middle,
                };
                let mut case = self.case.clone();
                set(&mut case.config, key, &value.to_string());
                match self.take(case) {
                    true => fails = middle,
                    false => passes = middle,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANY: usize = 10_000;

    /// A case that fails with the seeded fault.
    fn failing(mut fails: impl FnMut(&Case) -> bool) -> Case {
        (0..10_000)
            .map(Case::random)
            .find(|case| fails(case))
            .expect("some case fails")
    }

    #[test]
    fn what_always_fails_shrinks_to_the_reference_and_nothing_to_do() {
        let case = Case::random(3);
        let shrunk = shrink(&case, MANY, |_| true);
        assert_eq!(shrunk.case.settings(), Vec::<String>::new());
        assert!(
            Size::ALL
                .iter()
                .all(|&size| shrunk.case.sizes.get(size) == 1)
        );
        // One attempt per size, then one for the keys of the memory model and one for all others.
        assert!(shrunk.attempts <= Size::ALL.len() + 2);
    }

    #[test]
    fn a_fault_of_some_keys_and_sizes_shrinks_to_just_these() {
        // The reference has 4 rays, 48 packets and 26 address bits, which all hide the fault.
        let fault = |case: &Case| {
            case.config.rays_per_packet == 8
                && case.config.packets_in_flight < 20
                && case.config.memory_jitter >= 7
                && case.sizes.get(Size::Triangles) >= 5
        };
        let case = failing(fault);
        let shrunk = shrink(&case, MANY, fault);
        assert!(fault(&shrunk.case));
        assert_eq!(
            shrunk.case.settings(),
            ["packets.rays=8", "packets.in_flight=19", "memory.jitter=7"]
        );
        let sizes = Size::ALL.map(|size| shrunk.case.sizes.get(size));
        assert_eq!(sizes, [1, 5, 1, 1, 1, 1]);
        assert!(shrunk.attempts < 150, "{} attempts", shrunk.attempts);
    }

    #[test]
    fn keys_that_only_fail_together_stay_together() {
        let fault = |case: &Case| {
            let few = case.config.update_box_registers < 20;
            let one = case.config.axes_per_node == 1;
            few == one
        };
        // Both values or neither: from a case with both, removing one alone passes.
        let both = failing(|case| fault(case) && case.config.axes_per_node == 1);
        let shrunk = shrink(&both, MANY, fault);
        assert_eq!(shrunk.case.settings(), Vec::<String>::new());
        let alone = |case: &Case| case.config.axes_per_node == 1 && fault(case);
        let shrunk = shrink(&both, MANY, alone);
        assert_eq!(
            shrunk.case.settings(),
            ["tree.axes_per_node=1", "update.box_registers=19"]
        );
    }

    #[test]
    fn it_asks_no_more_often_than_it_may_and_keeps_only_what_fails() {
        let case = Case::random(11);
        for most in [0, 1, 5, 17] {
            let mut asked = 0;
            let shrunk = shrink(&case, most, |_| {
                asked += 1;
                asked % 2 == 0
            });
            assert!(shrunk.attempts == asked && asked <= most);
        }
        // No simpler case fails.
        let shrunk = shrink(&case, MANY, |other| *other == case);
        assert_eq!(shrunk.case, case);
        assert!(shrunk.attempts > 0);
    }
}
