//! The function of a cache: which requests hit, which wait for a line in flight, which line each miss replaces.
//!
//! It has no clock: a test bench tells it in which order requests are looked up and answers leave, and it says what each must come to.
//! It knows lines by their numbers (byte address ÷ bytes of a line), and holds no data.

/// The sizes that its function depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Lines per set: 1, 2 or 4.
    pub ways: usize,
    /// A power of two.
    pub sets: usize,
    /// Lines that can be in flight.
    pub misses: usize,
}

/// What a lookup comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The line is there.
    Hit,
    /// The line is in flight: the request is the one with this number in its list.
    Listed { place: usize },
    /// The line is requested; the line that it replaces.
    Requested { replaced: Option<u64> },
}

/// Why a lookup must wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waits {
    /// All miss registers are in use.
    pub registers: bool,
    /// All ways of the set are in flight.
    pub ways: bool,
}

/// Requests so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheCounts {
    pub requests: u64,
    pub hits: u64,
    /// Lines requested.
    pub misses: u64,
}

impl CacheCounts {
    pub fn hit_rate(&self) -> f64 {
        self.hits as f64 / self.requests.max(1) as f64
    }
}

/// A line in flight.
#[derive(Clone, Debug)]
struct Flight {
    line: u64,
    /// Requests that wait for it, by tag, in order of arrival.
    list: Vec<u64>,
}

/// A set: its lines by way, and the order in which they are replaced.
#[derive(Clone, Debug)]
struct Set {
    lines: Vec<Option<u64>>,
    /// The way that is replaced first: of two the one not used last, else the ways in turn.
    next: usize,
}

/// A cache.
#[derive(Clone, Debug)]
pub struct Cache {
    sizes: Sizes,
    sets: Vec<Set>,
    flights: Vec<Flight>,
    pub counts: CacheCounts,
}

impl Cache {
    /// An empty cache.
    pub fn new(sizes: Sizes) -> Cache {
        let empty = Set {
            lines: vec![None; sizes.ways],
            next: 0,
        };
        Cache {
            sizes,
            sets: vec![empty; sizes.sets],
            flights: vec![],
            counts: CacheCounts::default(),
        }
    }

    /// Discards all lines. None may be in flight.
    pub fn invalidate(&mut self) {
        assert!(self.flights.is_empty(), "lines are in flight");
        for set in &mut self.sets {
            set.lines.fill(None);
            set.next = 0;
        }
    }

    fn set_of(&self, line: u64) -> usize {
        (line % self.sizes.sets as u64) as usize
    }

    fn is_in_flight(&self, line: u64) -> bool {
        self.flights.iter().any(|flight| flight.line == line)
    }

    /// Why a request for a line must wait, if it must.
    pub fn waits(&self, line: u64) -> Option<Waits> {
        let set = &self.sets[self.set_of(line)];
        if set.lines.contains(&Some(line)) {
            return None;
        }
        let in_flight = |line: &Option<u64>| line.is_some_and(|line| self.is_in_flight(line));
        let waits = Waits {
            registers: self.flights.len() == self.sizes.misses,
            ways: set.lines.iter().all(in_flight),
        };
        (waits.registers || waits.ways).then_some(waits)
    }

    /// Looks up the line of a request with a tag. It must not have to wait.
    pub fn lookup(&mut self, line: u64, tag: u64) -> Outcome {
        debug_assert!(self.waits(line).is_none());
        self.counts.requests += 1;
        let (index, ways) = (self.set_of(line), self.sizes.ways);
        let found = self.sets[index].lines.iter().position(|l| *l == Some(line));
        if let Some(way) = found {
            if ways == 2 {
                self.sets[index].next = 1 - way;
            }
            if let Some(flight) = self.flights.iter_mut().find(|flight| flight.line == line) {
                flight.list.push(tag);
                let place = flight.list.len();
                return Outcome::Listed { place };
            }
            self.counts.hits += 1;
            return Outcome::Hit;
        }
        self.counts.misses += 1;
        let next = self.sets[index].next;
        let in_turn = (0..ways).map(|k| (next + k) % ways);
        let lines = &self.sets[index].lines;
        let way = in_turn
            .into_iter()
            .find(|way| !lines[*way].is_some_and(|line| self.is_in_flight(line)))
            .expect("a way that is not in flight");
        let replaced = self.sets[index].lines[way].replace(line);
        self.sets[index].next = (way + 1) % ways;
        self.flights.push(Flight {
            line,
            list: vec![tag],
        });
        Outcome::Requested { replaced }
    }

    /// Whether a tag waits in a list.
    pub fn is_listed(&self, tag: u64) -> bool {
        self.flights.iter().any(|flight| flight.list.contains(&tag))
    }

    /// Takes the answer to the first request of a line's list. After the last one the line is there. The result is the line and whether it
    /// is; nothing, if the tag is not the first of a list.
    pub fn answered(&mut self, tag: u64) -> Option<(u64, bool)> {
        let mut flights = self.flights.iter();
        let at = flights.position(|flight| flight.list.first() == Some(&tag))?;
        let flight = &mut self.flights[at];
        flight.list.remove(0);
        let (line, arrived) = (flight.line, flight.list.is_empty());
        if arrived {
            self.flights.swap_remove(at);
        }
        Some((line, arrived))
    }

    /// The number of lines in flight.
    pub fn in_flight(&self) -> usize {
        self.flights.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cache(ways: usize, misses: usize) -> Cache {
        Cache::new(Sizes {
            ways,
            sets: 2,
            misses,
        })
    }

    /// Requests lines one after another; each arrives before the next. Returns the replaced ones.
    fn replaced(cache: &mut Cache, lines: &[u64]) -> Vec<Option<u64>> {
        let mut replaced = vec![];
        for line in lines {
            if let Outcome::Requested { replaced: old } = cache.lookup(*line, 7) {
                replaced.push(old);
                assert_eq!(cache.answered(7), Some((*line, true)));
            }
        }
        replaced
    }

    #[test]
    fn the_way_that_was_not_used_last_is_replaced() {
        let mut two = cache(2, 4);
        let old = replaced(&mut two, &[0, 2, 0, 4, 0, 2]);
        assert_eq!(old, [None, None, Some(2), Some(4)]);
        let counts = two.counts;
        assert_eq!((counts.requests, counts.hits, counts.misses), (6, 2, 4));
        assert_eq!(counts.hit_rate(), 2.0 / 6.0);
        two.invalidate();
        assert_eq!(replaced(&mut two, &[0, 0]), [None]);
        let mut four = cache(4, 4);
        let old = replaced(&mut four, &[0, 2, 4, 6, 0, 8, 10, 0]);
        assert_eq!(old, [None, None, None, None, Some(0), Some(2), Some(4)]);
    }

    #[test]
    fn lines_in_flight_are_waited_for() {
        let mut two = cache(2, 3);
        assert_eq!(two.lookup(0, 1), Outcome::Requested { replaced: None });
        assert_eq!(two.lookup(0, 2), Outcome::Listed { place: 2 });
        assert_eq!(two.lookup(2, 3), Outcome::Requested { replaced: None });
        let ways = Some(Waits {
            registers: false,
            ways: true,
        });
        assert_eq!(
            (two.waits(4), two.waits(2), two.waits(1)),
            (ways, None, None)
        );
        assert_eq!(two.lookup(1, 4), Outcome::Requested { replaced: None });
        assert!(two.waits(3).is_some_and(|waits| waits.registers));
        // The second cannot be answered before the first.
        assert_eq!(two.answered(2), None);
        assert_eq!(two.answered(1), Some((0, false)));
        assert!(two.is_listed(2) && !two.is_listed(1));
        assert_eq!(two.answered(2), Some((0, true)));
        assert_eq!((two.lookup(0, 1), two.in_flight()), (Outcome::Hit, 2));
        // Way 1 is preferred, but in flight.
        assert_eq!(two.lookup(4, 2), Outcome::Requested { replaced: Some(0) });
    }
}
