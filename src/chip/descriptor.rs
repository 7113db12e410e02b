//! Descriptors of commands: 16 words of 32 bits each.

use super::{Limits, ray};
use std::ops::RangeInclusive;

/// 32-bit words of a descriptor.
pub const WORDS: usize = 16;

/// Bytes of a descriptor; its address is a multiple of it.
pub const BYTES: u32 = 4 * WORDS as u32;

/// The words and flags of a command, for documentation.
pub struct Layout {
    pub name: &'static str,
    pub opcode: u32,
    pub what: &'static str,
    /// Word, name, meaning.
    pub words: &'static [(usize, &'static str, &'static str)],
    /// Bit of the flags, name, meaning.
    pub flags: &'static [(u32, &'static str, &'static str)],
}

macro_rules! commands {
    ($($module:ident $what:literal $opcode:literal
        words { $($word:ident $at:literal $meaning:literal;)* }
        flags { $($flag:ident $bit:literal $says:literal;)* })*) => {
        $(
            #[doc = concat!("The descriptor of `", stringify!($module), "`: ", $what, ".")]
            #[allow(non_upper_case_globals, reason = "the constants have the names of the words")]
            pub mod $module {
                /// The opcode.
                pub const OPCODE: u32 = $opcode;
                /// The places of the words.
                pub mod word {
                    $(#[doc = $meaning] pub const $word: usize = $at;)*
                }
                /// The bits of the flags.
                pub mod flag {
                    $(#[doc = $says] pub const $flag: u32 = $bit;)*
                }
            }
        )*

        /// All commands.
        pub const COMMANDS: &[Layout] = &[$(Layout {
            name: stringify!($module),
            opcode: $opcode,
            what: $what,
            words: &[$(($at, stringify!($word), $meaning),)*],
            flags: &[$(($bit, stringify!($flag), $says),)*],
        },)*];
    };
}

commands! {
    end "does what a fence does, then ends the list" 1 words {} flags {}
    jump "continues at another descriptor" 2
        words { to 1 "address of the next descriptor, a multiple of 64"; }
        flags {}
    fence "waits until all commands are complete and all writes are in memory, and invalidates the caches" 3 words {} flags {}
    signal "writes a word to memory, and may raise the interrupt" 4
        words {
            address 1 "address of the word, a multiple of 4";
            value 2 "the word to write";
        }
        flags { interrupt 0 "set the interrupt status bit `signal`"; }
    wait "waits until a word in memory is at least a value" 5
        words {
            address 1 "address of the word, a multiple of 4";
            value 2 "the least value, unsigned";
        }
        flags {}
    scene "sets the scene that the following casts use" 6
        words {
            root 1 "root link word";
            nodes 2 "base of the nodes, a multiple of 64";
            records 3 "base of the triangle records, a multiple of 64";
            vertices 4 "base of the vertices, a multiple of 64";
            bounds 5 "address of the box of the scene, two vertex records, a multiple of 64";
        }
        flags {}
    cast "casts rays and writes their hits" 7
        words {
            rays 1 "address of the rays, a multiple of 16";
            count 2 "number of rays, at least 1";
            hits 3 "address of the hits, a multiple of 64";
            origin_x 4 "first coordinate of the origin of short rays, binary32";
            origin_y 5 "second coordinate of the origin of short rays, binary32";
            origin_z 6 "third coordinate of the origin of short rays, binary32";
            tmin 7 "tmin of short rays, binary32";
        }
        flags {
            any_hit 0 "ask only whether there is a hit";
            short_rays 1 "rays take 16 bytes; origin and tmin are in this descriptor";
        }
    skin "computes the vertices of a mesh from a palette of matrices" 8
        words {
            vertices 1 "base of the vertices, a multiple of 64";
            palette 2 "index of the first vector of the palette";
            joints 3 "matrices of the palette, at least 1";
            influences 4 "address of the rows of influences, a multiple of 16";
            rows 5 "number of rows, at least 1";
            rest 6 "index of the first vertex at rest";
            count 7 "number of vertices, at least 1";
            target 8 "index of the first vertex to write";
        }
        flags {}
    update "runs an update program: rewrites the bounds of the nodes of an object, and its box" 9
        words {
            program 1 "address of the program, a multiple of 16";
            rows 2 "rows of 16 bytes of the program, at least 1";
            vertices 3 "base of the vertices, a multiple of 64";
            first_vertex 4 "index of the object's first vertex";
            nodes 5 "base of the nodes, a multiple of 64";
            first_node 6 "index of the object's first node";
            bounds 7 "address of the box to write, two vertex records, a multiple of their size";
        }
        flags {}
}

/// Error codes: code, name, condition.
pub const ERRORS: &[(u32, &str, &str)] = &[
    (0, "none", "no error since the last list started"),
    (Fault::OPCODE, "opcode", "the opcode is unknown"),
    (
        Fault::ALIGNMENT,
        "alignment",
        "an address is not a multiple of what it must be",
    ),
    (
        Fault::SIZE,
        "size",
        "a number of rays, matrices, rows or vertices is 0 or too large, or an index has too many bits",
    ),
    (
        Fault::BUS,
        "bus",
        "a read or a write was answered with SLVERR or DECERR",
    ),
    (Fault::SCENE, "scene", "a cast before the first scene"),
];

/// The name of an error code.
///
/// # Panics
/// If there is no such code.
pub fn error_name(code: u32) -> &'static str {
    let known = ERRORS.iter().find(|(known, ..)| *known == code);
    known.map(|(_, name, _)| *name).expect("an error code")
}

/// Why a descriptor is refused: the code, and the wrong value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    pub code: u32,
    pub value: u32,
}

impl Fault {
    pub const OPCODE: u32 = 1;
    pub const ALIGNMENT: u32 = 2;
    pub const SIZE: u32 = 3;
    pub const BUS: u32 = 4;
    pub const SCENE: u32 = 5;
}

/// A command in decoded form. Addresses are in bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    End,
    Jump {
        to: u32,
    },
    Fence,
    Signal {
        address: u32,
        value: u32,
        interrupt: bool,
    },
    Wait {
        address: u32,
        value: u32,
    },
    Scene(Scene),
    Cast(Cast),
    Skin(Skin),
    Update(Update),
}

/// The arrays of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scene {
    /// Root link word.
    pub root: u32,
    pub nodes: u32,
    pub records: u32,
    pub vertices: u32,
    /// Address of the box.
    pub bounds: u32,
}

/// Rays to cast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cast {
    pub rays: u32,
    pub count: u32,
    pub hits: u32,
    pub any_hit: bool,
    /// Origin and tmin of short rays.
    pub short: Option<([f32; 3], f32)>,
}

/// A mesh to skin. All but `vertices` and `influences`, which are addresses, are indices and counts of records.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skin {
    pub vertices: u32,
    pub palette: u32,
    pub joints: u32,
    pub influences: u32,
    pub rows: u32,
    pub rest: u32,
    pub count: u32,
    pub target: u32,
}

/// An object to update. `first_vertex` and `first_node` are indices; the rest but `rows` are addresses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Update {
    pub program: u32,
    pub rows: u32,
    pub vertices: u32,
    pub first_vertex: u32,
    pub nodes: u32,
    pub first_node: u32,
    pub bounds: u32,
}

impl Cast {
    /// Bytes of each ray.
    pub fn ray_bytes(&self) -> usize {
        match self.short {
            None => ray::BYTES,
            Some(_) => ray::SHORT_BYTES,
        }
    }
}

impl Command {
    /// The descriptor's words.
    pub fn encode(&self) -> [u32; WORDS] {
        let mut words = [0; WORDS];
        let mut head = |opcode, flags| words[0] = opcode | flags << 8;
        match *self {
            Command::End => head(end::OPCODE, 0),
            Command::Fence => head(fence::OPCODE, 0),
            Command::Jump { to } => {
                head(jump::OPCODE, 0);
                words[jump::word::to] = to;
            }
            Command::Signal {
                address,
                value,
                interrupt,
            } => {
                head(
                    signal::OPCODE,
                    u32::from(interrupt) << signal::flag::interrupt,
                );
                words[signal::word::address] = address;
                words[signal::word::value] = value;
            }
            Command::Wait { address, value } => {
                head(wait::OPCODE, 0);
                words[wait::word::address] = address;
                words[wait::word::value] = value;
            }
            Command::Skin(skin) => {
                use self::skin::word;
                head(self::skin::OPCODE, 0);
                words[word::vertices] = skin.vertices;
                words[word::palette] = skin.palette;
                words[word::joints] = skin.joints;
                words[word::influences] = skin.influences;
                words[word::rows] = skin.rows;
                words[word::rest] = skin.rest;
                words[word::count] = skin.count;
                words[word::target] = skin.target;
            }
            Command::Update(update) => {
                use self::update::word;
                head(self::update::OPCODE, 0);
                words[word::program] = update.program;
                words[word::rows] = update.rows;
                words[word::vertices] = update.vertices;
                words[word::first_vertex] = update.first_vertex;
                words[word::nodes] = update.nodes;
                words[word::first_node] = update.first_node;
                words[word::bounds] = update.bounds;
            }
            Command::Scene(Scene {
                root,
                nodes,
                records,
                vertices,
                bounds,
            }) => {
                use scene::word;
                head(scene::OPCODE, 0);
                words[word::root] = root;
                words[word::nodes] = nodes;
                words[word::records] = records;
                words[word::vertices] = vertices;
                words[word::bounds] = bounds;
            }
            Command::Cast(Cast {
                rays,
                count,
                hits,
                any_hit,
                short,
            }) => {
                use cast::{flag, word};
                let flags = u32::from(any_hit) << flag::any_hit
                    | u32::from(short.is_some()) << flag::short_rays;
                head(cast::OPCODE, flags);
                words[word::rays] = rays;
                words[word::count] = count;
                words[word::hits] = hits;
                if let Some((origin, tmin)) = short {
                    let places = [word::origin_x, word::origin_y, word::origin_z];
                    for (place, value) in places.into_iter().zip(origin) {
                        words[place] = value.to_bits();
                    }
                    words[word::tmin] = tmin.to_bits();
                }
            }
        }
        words
    }

    /// Decodes and checks a descriptor.
    ///
    /// # Errors
    /// Why the chip refuses it. Addresses are checked first, then counts and indices, both in the order of the words.
    pub fn decode(words: &[u32; WORDS], limits: &Limits) -> Result<Command, Fault> {
        let opcode = words[0] & 0xff;
        let checks = Checks { words };
        Ok(match opcode {
            end::OPCODE => Command::End,
            fence::OPCODE => Command::Fence,
            jump::OPCODE => {
                checks.aligned(&[(jump::word::to, BYTES)])?;
                Command::Jump {
                    to: words[jump::word::to],
                }
            }
            signal::OPCODE => {
                use signal::{flag, word};
                checks.aligned(&[(word::address, 4)])?;
                Command::Signal {
                    address: words[word::address],
                    value: words[word::value],
                    interrupt: checks.flag(flag::interrupt),
                }
            }
            wait::OPCODE => {
                use wait::word;
                checks.aligned(&[(word::address, 4)])?;
                Command::Wait {
                    address: words[word::address],
                    value: words[word::value],
                }
            }
            scene::OPCODE => Command::Scene(checks.scene()?),
            cast::OPCODE => Command::Cast(checks.cast(limits)?),
            skin::OPCODE => Command::Skin(checks.skin(limits)?),
            update::OPCODE => Command::Update(checks.update(limits)?),
            _ => {
                return Err(Fault {
                    code: Fault::OPCODE,
                    value: opcode,
                });
            }
        })
    }
}

/// The checks of a descriptor.
struct Checks<'a> {
    words: &'a [u32; WORDS],
}

impl Checks<'_> {
    fn flag(&self, bit: u32) -> bool {
        self.words[0] >> (8 + bit) & 1 == 1
    }

    /// Refuses the first of some words that is not a multiple of its number.
    fn aligned(&self, places: &[(usize, u32)]) -> Result<(), Fault> {
        let odd = (places.iter()).find(|&&(place, to)| !self.words[place].is_multiple_of(to));
        odd.map_or(Ok(()), |&(place, _)| {
            Err(Fault {
                code: Fault::ALIGNMENT,
                value: self.words[place],
            })
        })
    }

    /// Refuses the first of some words that is out of its range.
    fn in_range(&self, places: &[(usize, RangeInclusive<u32>)]) -> Result<(), Fault> {
        let out = places
            .iter()
            .find(|(place, range)| !range.contains(&self.words[*place]));
        out.map_or(Ok(()), |(place, _)| {
            Err(Fault {
                code: Fault::SIZE,
                value: self.words[*place],
            })
        })
    }

    fn scene(&self) -> Result<Scene, Fault> {
        use scene::word;
        let arrays = [word::nodes, word::records, word::vertices, word::bounds];
        self.aligned(&arrays.map(|place| (place, 64)))?;
        Ok(Scene {
            root: self.words[word::root],
            nodes: self.words[word::nodes],
            records: self.words[word::records],
            vertices: self.words[word::vertices],
            bounds: self.words[word::bounds],
        })
    }

    fn cast(&self, limits: &Limits) -> Result<Cast, Fault> {
        use cast::{flag, word};
        self.aligned(&[(word::rays, 16), (word::hits, 64)])?;
        self.in_range(&[(word::count, 1..=limits.rays)])?;
        let number = |place: usize| f32::from_bits(self.words[place]);
        let origin = [word::origin_x, word::origin_y, word::origin_z].map(number);
        Ok(Cast {
            rays: self.words[word::rays],
            count: self.words[word::count],
            hits: self.words[word::hits],
            any_hit: self.flag(flag::any_hit),
            short: (self.flag(flag::short_rays)).then(|| (origin, number(word::tmin))),
        })
    }

    fn skin(&self, limits: &Limits) -> Result<Skin, Fault> {
        use skin::word;
        self.aligned(&[(word::vertices, 64), (word::influences, 16)])?;
        let index = limits.greatest_index;
        self.in_range(&[
            (word::palette, 0..=index),
            (word::joints, 1..=limits.joints),
            (word::rows, 1..=index),
            (word::rest, 0..=index),
            (word::count, 1..=index),
            (word::target, 0..=index),
        ])?;
        let word = |place: usize| self.words[place];
        Ok(Skin {
            vertices: word(word::vertices),
            palette: word(word::palette),
            joints: word(word::joints),
            influences: word(word::influences),
            rows: word(word::rows),
            rest: word(word::rest),
            count: word(word::count),
            target: word(word::target),
        })
    }

    fn update(&self, limits: &Limits) -> Result<Update, Fault> {
        use update::word;
        self.aligned(&[
            (word::program, 16),
            (word::vertices, 64),
            (word::nodes, 64),
            (word::bounds, limits.box_bytes),
        ])?;
        let index = limits.greatest_index;
        self.in_range(&[
            (word::rows, 1..=index),
            (word::first_vertex, 0..=index),
            (word::first_node, 0..=index),
        ])?;
        let word = |place: usize| self.words[place];
        Ok(Update {
            program: word(word::program),
            rows: word(word::rows),
            vertices: word(word::vertices),
            first_vertex: word(word::first_vertex),
            nodes: word(word::nodes),
            first_node: word(word::first_node),
            bounds: word(word::bounds),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        rays: 100,
        joints: 16,
        greatest_index: 255,
        box_bytes: 32,
    };

    #[test]
    fn commands_come_back_from_their_descriptors() {
        let commands = [
            Command::End,
            Command::Fence,
            Command::Jump { to: 0x40 },
            Command::Signal {
                address: 0x1004,
                value: 77,
                interrupt: true,
            },
            Command::Scene(Scene {
                root: 0x0800_0001,
                nodes: 0x40,
                records: 0x80,
                vertices: 0xffff_ffc0,
                bounds: 0xc0,
            }),
            Command::Cast(Cast {
                rays: 0x10,
                count: 8,
                hits: 0x40,
                any_hit: true,
                short: Some(([1.0, -2.0, 0.5], 0.25)),
            }),
            Command::Cast(Cast {
                rays: 0x30,
                count: 1,
                hits: 0x80,
                any_hit: false,
                short: None,
            }),
            Command::Wait {
                address: 0x2004,
                value: 3,
            },
            Command::Skin(Skin {
                vertices: 0x1000,
                palette: 1,
                joints: 16,
                influences: 0x30,
                rows: 2,
                rest: 3,
                count: 255,
                target: 4,
            }),
            Command::Update(Update {
                program: 0x10,
                rows: 255,
                vertices: 0x40,
                first_vertex: 5,
                nodes: 0x80,
                first_node: 6,
                bounds: 0x60,
            }),
        ];
        for command in commands {
            assert_eq!(Command::decode(&command.encode(), &LIMITS), Ok(command));
        }
    }

    #[test]
    fn wrong_descriptors_are_refused_with_code_and_value() {
        let fault = |words: &[(usize, u32)]| {
            let mut descriptor = [0; WORDS];
            for (place, value) in words {
                descriptor[*place] = *value;
            }
            let fault = Command::decode(&descriptor, &LIMITS).unwrap_err();
            (fault.code, fault.value)
        };
        assert_eq!(fault(&[]), (Fault::OPCODE, 0));
        assert_eq!(fault(&[(0, 99)]), (Fault::OPCODE, 99));
        assert_eq!(
            fault(&[(0, jump::OPCODE), (1, 0x20)]),
            (Fault::ALIGNMENT, 0x20)
        );
        assert_eq!(
            fault(&[(0, scene::OPCODE), (4, 0x44)]),
            (Fault::ALIGNMENT, 0x44)
        );
        assert_eq!(fault(&[(0, cast::OPCODE), (1, 8)]), (Fault::ALIGNMENT, 8));
        assert_eq!(fault(&[(0, cast::OPCODE)]), (Fault::SIZE, 0));
        assert_eq!(fault(&[(0, cast::OPCODE), (2, 101)]), (Fault::SIZE, 101));
        assert_eq!(
            fault(&[(0, wait::OPCODE), (1, 0x102)]),
            (Fault::ALIGNMENT, 0x102)
        );
        assert_eq!(
            fault(&[(0, skin::OPCODE), (2, 256), (4, 8)]),
            (Fault::ALIGNMENT, 8)
        );
        assert_eq!(fault(&[(0, skin::OPCODE), (2, 256)]), (Fault::SIZE, 256));
        assert_eq!(fault(&[(0, skin::OPCODE), (3, 17)]), (Fault::SIZE, 17));
        assert_eq!(
            fault(&[(0, update::OPCODE), (2, 1), (7, 0x10)]),
            (Fault::ALIGNMENT, 0x10)
        );
        assert_eq!(fault(&[(0, update::OPCODE)]), (Fault::SIZE, 0));
    }
}
