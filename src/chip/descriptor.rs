//! Descriptors of commands: 16 words of 32 bits each.

use super::ray;

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
    (Fault::SIZE, "size", "the number of rays is 0 or too large"),
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
    Scene(Scene),
    Cast(Cast),
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

    /// Decodes and checks a descriptor; a cast may have `most_rays` rays.
    ///
    /// # Errors
    /// Why the chip refuses it. Addresses are checked in the order of the words.
    pub fn decode(words: &[u32; WORDS], most_rays: u32) -> Result<Command, Fault> {
        let flag = |bit: u32| words[0] >> (8 + bit) & 1 == 1;
        let aligned = |place: usize, to: u32| match words[place] % to {
            0 => Ok(words[place]),
            _ => Err(Fault {
                code: Fault::ALIGNMENT,
                value: words[place],
            }),
        };
        let opcode = words[0] & 0xff;
        Ok(match opcode {
            end::OPCODE => Command::End,
            fence::OPCODE => Command::Fence,
            jump::OPCODE => Command::Jump {
                to: aligned(jump::word::to, BYTES)?,
            },
            signal::OPCODE => Command::Signal {
                address: aligned(signal::word::address, 4)?,
                value: words[signal::word::value],
                interrupt: flag(signal::flag::interrupt),
            },
            scene::OPCODE => {
                use scene::word;
                Command::Scene(Scene {
                    root: words[word::root],
                    nodes: aligned(word::nodes, 64)?,
                    records: aligned(word::records, 64)?,
                    vertices: aligned(word::vertices, 64)?,
                    bounds: aligned(word::bounds, 64)?,
                })
            }
            cast::OPCODE => {
                use cast::word;
                let rays = aligned(word::rays, 16)?;
                let hits = aligned(word::hits, 64)?;
                let count = words[word::count];
                if count == 0 || count > most_rays {
                    return Err(Fault {
                        code: Fault::SIZE,
                        value: count,
                    });
                }
                let number = |place: usize| f32::from_bits(words[place]);
                let origin = [word::origin_x, word::origin_y, word::origin_z].map(number);
                Command::Cast(Cast {
                    rays,
                    count,
                    hits,
                    any_hit: flag(cast::flag::any_hit),
                    short: flag(cast::flag::short_rays).then(|| (origin, number(word::tmin))),
                })
            }
            _ => {
                return Err(Fault {
                    code: Fault::OPCODE,
                    value: opcode,
                });
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        ];
        for command in commands {
            assert_eq!(Command::decode(&command.encode(), 8), Ok(command));
        }
    }

    #[test]
    fn wrong_descriptors_are_refused_with_code_and_value() {
        let fault = |words: &[(usize, u32)]| {
            let mut descriptor = [0; WORDS];
            for (place, value) in words {
                descriptor[*place] = *value;
            }
            let fault = Command::decode(&descriptor, 100).unwrap_err();
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
    }
}
