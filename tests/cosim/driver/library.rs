//! The driver as a shared library, and what is behind its callbacks: a chip in Verilator, or registers and memory of a test.

use crate::support::driver::{FREESTANDING, STRICT, compile, source, write_header};
use dynrt::chip::memory::Memory;
use dynrt::chip::registers::{self, COUNTERS};
use dynrt::config::Config;
use dynrt::cosim::chip::Chip;
use libloading::Library;
use std::collections::HashMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::fs;
use std::path::Path;

/// `struct dynrt_device`.
#[repr(C)]
pub struct Device {
    registers: *mut u32,
    memory: *mut c_void,
    memory_address: u32,
    context: *mut c_void,
    read_register: Option<extern "C" fn(*mut c_void, u32) -> u32>,
    write_register: Option<extern "C" fn(*mut c_void, u32, u32)>,
    read_memory: Option<extern "C" fn(*mut c_void, u32) -> u32>,
    write_memory: Option<extern "C" fn(*mut c_void, u32, u32)>,
    barrier: Option<extern "C" fn(*mut c_void)>,
    clean: Option<extern "C" fn(*mut c_void, u32, u32)>,
    discard: Option<extern "C" fn(*mut c_void, u32, u32)>,
    pause: Option<extern "C" fn(*mut c_void)>,
}

impl Device {
    /// The context of the callbacks.
    pub fn context(&self) -> *mut c_void {
        self.context
    }

    /// A register, through the callback.
    pub fn read(&self, offset: u32) -> u32 {
        self.read_register.unwrap()(self.context, offset)
    }
}

/// `struct dynrt_list`.
#[repr(C)]
pub struct List {
    pub device: *const Device,
    pub address: u32,
    pub next: u32,
    pub left: u32,
    pub result: c_int,
}

/// `struct dynrt_cast`.
#[repr(C)]
#[derive(Default)]
pub struct Cast {
    pub rays: u32,
    pub count: u32,
    pub hits: u32,
    pub any_hit: c_int,
    pub short_rays: c_int,
    pub origin: [f32; 3],
    pub tmin: f32,
}

/// `struct dynrt_fault`.
#[repr(C)]
#[derive(Debug, Default, PartialEq)]
pub struct Fault {
    pub code: u32,
    pub descriptor: u32,
    pub value: u32,
}

/// `struct dynrt_hit`.
#[repr(C)]
#[derive(Debug, Default)]
pub struct Hit {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    pub triangle: u32,
    pub instance: u32,
}

/// `struct dynrt_camera`.
#[repr(C)]
#[derive(Debug, Default)]
pub struct Camera {
    pub eye: [f32; 3],
    pub forward: [f32; 3],
    pub right: [f32; 3],
    pub up: [f32; 3],
}

/// `struct dynrt_image`.
#[repr(C)]
pub struct Image {
    pub bytes: *const u8,
    pub size: u32,
    pub address: u32,
    pub list: u32,
}

/// `struct dynrt_counters`.
pub type Counters = [u64; COUNTERS.len()];

pub type Print = extern "C" fn(*mut c_void, *const c_char);

/// Sizes of the structures in C, to be held against those above.
const SIZES: &str = "#include \"example.h\"\n\
     const size_t dynrt_sizes[] = { sizeof(struct dynrt_device), sizeof(struct dynrt_list), sizeof(struct dynrt_cast),\n\
     sizeof(struct dynrt_fault), sizeof(struct dynrt_hit), sizeof(struct dynrt_camera), sizeof(struct dynrt_image),\n\
     sizeof(struct dynrt_counters) };\n";

macro_rules! functions {
    ($($name:ident($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The functions of the driver, without the prefix of their names.
        #[allow(clippy::type_complexity, reason = "signatures of C")]
        pub struct Driver {
            $(pub $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
            _library: Library,
        }

        impl Driver {
            /// Loads a library.
            fn load(path: &Path) -> Driver {
                // SAFETY: the library is the driver, which has no initialisers.
                let library = unsafe { Library::new(path) }.unwrap();
                // SAFETY: the types are those of dynrt.h and example.h; the library is kept with the functions.
                unsafe {
                    Driver {
                        $($name: *library.get(concat!("dynrt_", stringify!($name)).as_bytes()).unwrap(),)*
                        _library: library,
                    }
                }
            }
        }
    };
}

functions! {
    open(*const Device) -> c_int;
    copy_in(*const Device, u32, *const u8, u32) -> c_int;
    copy_out(*const Device, u32, *mut u8, u32) -> c_int;
    begin_list(*mut List, *const Device, u32, u32) -> c_int;
    finish_list(*mut List) -> c_int;
    finish_list_with_jump(*mut List, u32) -> c_int;
    add_fence(*mut List) -> c_int;
    add_signal(*mut List, u32, u32, c_int) -> c_int;
    add_wait(*mut List, u32, u32) -> c_int;
    add_scene(*mut List, *const [u32; 5]) -> c_int;
    add_cast(*mut List, *const Cast) -> c_int;
    add_skin(*mut List, *const [u32; 8]) -> c_int;
    add_update(*mut List, *const [u32; 7]) -> c_int;
    submit(*const Device, u32) -> c_int;
    enable_interrupt(*const Device, u32);
    events(*const Device) -> u32;
    wait(*const Device, u32, u32, *mut u32) -> c_int;
    run(*const Device, u32, u32) -> c_int;
    is_busy(*const Device) -> c_int;
    fault(*const Device, *mut Fault);
    error_name(u32) -> *const c_char;
    error_text(u32) -> *const c_char;
    result_text(c_int) -> *const c_char;
    counter_name(u32) -> *const c_char;
    read_counters(*const Device, *mut Counters);
    counted(*const Counters, *const Counters, u32) -> u64;
    hits_bytes(u32, c_int) -> u32;
    discard(*const Device, u32, u32);
    read_hit(*const Device, u32, u32, *mut Hit);
    read_answer(*const Device, u32, u32) -> c_int;
    look_at(*mut Camera, *const [f32; 3], *const [f32; 3], *const [f32; 3], f32) -> c_int;
    picture_rays(u32, u32) -> u32;
    pixel_of_ray(u32, u32, *mut u32, *mut u32);
    fill_rays(*const Device, *const Camera, u32, u32, u32, u32, *mut Cast) -> c_int;
    example(*const Device, *const Image, u32, Print, *mut c_void) -> c_int;
}

impl Driver {
    /// Compiles the driver and its example for a machine.
    pub fn new(config: &Config) -> Driver {
        let folder = tempfile::tempdir().unwrap();
        write_header(folder.path(), config);
        let sizes = folder.path().join("sizes.c");
        fs::write(&sizes, SIZES).unwrap();
        let options = format!("{STRICT} {FREESTANDING} -O2 -shared -fPIC -o driver.so");
        let files = [source("dynrt.c"), source("example.c"), sizes];
        compile(Path::new("gcc"), folder.path(), &options, &files);
        let driver = Driver::load(&folder.path().join("driver.so"));
        // SAFETY: the array has this type and length.
        let sizes: [usize; 8] = unsafe {
            let sizes = driver._library.get::<*const [usize; 8]>(b"dynrt_sizes");
            **sizes.unwrap()
        };
        let here = [
            size_of::<Device>(),
            size_of::<List>(),
            size_of::<Cast>(),
            size_of::<Fault>(),
            size_of::<Hit>(),
            size_of::<Camera>(),
            size_of::<Image>(),
            size_of::<Counters>(),
        ];
        assert_eq!(sizes, here, "the structures are those of C");
        driver
    }
}

/// A constant string of the driver.
pub fn text(text: *const c_char) -> String {
    // SAFETY: the driver's strings are constants that end with 0.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().unwrap().to_string()
}

/// What is behind the callbacks.
pub enum Behind {
    Chip(Box<Chip>),
    /// Registers by offset, and a memory.
    Table(HashMap<u32, u32>, Memory),
}

/// A host whose cache of words is coherent only by maintenance: it holds each word that was read or written. Words that are cleaned wait
/// in a buffer until the next barrier; then they are in memory.
pub struct Host {
    behind: Behind,
    /// Words in the cache, and whether each was written.
    cache: HashMap<u32, (u32, bool)>,
    /// Words on their way to memory.
    buffer: Vec<(u32, u32)>,
    /// Cycles of a pause.
    pause: u64,
    pauses: u64,
    /// Whether the interrupt was requested at the end of a pause.
    interrupts: bool,
    /// The first failure of an access.
    failure: Option<String>,
    /// What was printed.
    pub printed: String,
}

impl Host {
    pub fn new(behind: Behind) -> Box<Host> {
        Box::new(Host {
            behind,
            cache: HashMap::new(),
            buffer: vec![],
            pause: 64,
            pauses: 0,
            interrupts: false,
            failure: None,
            printed: String::new(),
        })
    }

    /// The device of this host, which is used only while the host is not borrowed.
    pub fn device(&mut self) -> Device {
        Device {
            registers: std::ptr::null_mut(),
            memory: std::ptr::null_mut(),
            memory_address: 0,
            context: std::ptr::from_mut(self).cast(),
            read_register: Some(read_register),
            write_register: Some(write_register),
            read_memory: Some(read_memory),
            write_memory: Some(write_memory),
            barrier: Some(barrier),
            clean: Some(clean),
            discard: Some(discard),
            pause: Some(pause),
        }
    }

    /// Memory as the chip sees it after all; fails if an access has failed.
    pub fn memory(&mut self) -> Memory {
        self.drain();
        assert_eq!(self.failure, None);
        match &self.behind {
            Behind::Chip(chip) => chip.memory(),
            Behind::Table(_, memory) => memory.clone(),
        }
    }

    /// The device of memory-mapped hardware: registers, and memory from an address on.
    pub fn mapped(registers: &mut [u32], memory: &mut [u32], address: u32) -> Device {
        Device {
            registers: registers.as_mut_ptr(),
            memory: memory.as_mut_ptr().cast(),
            memory_address: address,
            context: std::ptr::null_mut(),
            read_register: None,
            write_register: None,
            read_memory: None,
            write_memory: None,
            barrier: None,
            clean: None,
            discard: None,
            pause: None,
        }
    }

    /// The pauses of a device's host.
    pub fn pauses_of(device: &Device) -> u64 {
        Host::of(device.context).pauses
    }

    /// Whether the interrupt of a device was requested at the end of the last pause.
    pub fn interrupts_of(device: &Device) -> bool {
        Host::of(device.context).interrupts
    }

    /// Lets the host of a device pause.
    pub fn pause_of(device: &Device) {
        pause(device.context);
    }

    fn of(context: *mut c_void) -> &'static mut Host {
        // SAFETY: the context is a host that outlives the call, and nothing else borrows it meanwhile.
        unsafe { &mut *context.cast::<Host>() }
    }

    /// The value of an access, or 0 after its failure.
    fn done<T: Default>(&mut self, result: anyhow::Result<T>) -> T {
        result.unwrap_or_else(|error| {
            self.failure.get_or_insert(format!("{error:#}"));
            T::default()
        })
    }

    /// Empties the buffer into memory.
    fn drain(&mut self) {
        for (address, word) in std::mem::take(&mut self.buffer) {
            self.store(address, word);
        }
    }

    fn load(&mut self, address: u32) -> u32 {
        self.drain();
        let word = match &self.behind {
            Behind::Chip(chip) => chip.read_memory(address),
            Behind::Table(_, memory) => {
                let word = memory.word(address.into());
                word.ok_or_else(|| anyhow::anyhow!("no memory at {address:#x}"))
            }
        };
        self.done(word)
    }

    fn store(&mut self, address: u32, word: u32) {
        let result = match &mut self.behind {
            Behind::Chip(chip) => chip.write_memory(address, word),
            Behind::Table(_, memory) => match memory.read_mut(address.into(), 4) {
                Some(place) => {
                    place.copy_from_slice(&word.to_le_bytes());
                    Ok(())
                }
                None => Err(anyhow::anyhow!("no memory at {address:#x}")),
            },
        };
        self.done(result);
    }

    /// Words of the cache in a range of memory.
    fn cached(&self, address: u32, bytes: u32) -> Vec<u32> {
        let words = self.cache.keys().copied();
        words
            .filter(|word| word + 4 > address && *word < address + bytes)
            .collect()
    }
}

extern "C" fn read_register(context: *mut c_void, offset: u32) -> u32 {
    let host = Host::of(context);
    let value = match &mut host.behind {
        Behind::Chip(chip) => chip.read(offset),
        Behind::Table(registers, _) => Ok(registers.get(&offset).copied().unwrap_or_default()),
    };
    host.done(value)
}

extern "C" fn write_register(context: *mut c_void, offset: u32, value: u32) {
    let host = Host::of(context);
    let result = match &mut host.behind {
        Behind::Chip(chip) => chip.write(offset, value),
        // Writing 1 clears an event, as in the chip.
        Behind::Table(registers, _) => {
            let old = registers.get(&offset).copied().unwrap_or_default();
            let is_events = offset == registers::offset::INTERRUPT_STATUS;
            registers.insert(offset, if is_events { old & !value } else { value });
            Ok(())
        }
    };
    host.done(result);
}

extern "C" fn read_memory(context: *mut c_void, address: u32) -> u32 {
    let host = Host::of(context);
    if let Some((word, _)) = host.cache.get(&address) {
        return *word;
    }
    let word = host.load(address);
    host.cache.insert(address, (word, false));
    word
}

extern "C" fn write_memory(context: *mut c_void, address: u32, word: u32) {
    Host::of(context).cache.insert(address, (word, true));
}

extern "C" fn clean(context: *mut c_void, address: u32, bytes: u32) {
    let host = Host::of(context);
    for place in host.cached(address, bytes) {
        if let Some((word, true)) = host.cache.insert(place, (host.cache[&place].0, false)) {
            host.buffer.push((place, word));
        }
    }
}

extern "C" fn barrier(context: *mut c_void) {
    Host::of(context).drain();
}

extern "C" fn discard(context: *mut c_void, address: u32, bytes: u32) {
    let host = Host::of(context);
    for place in host.cached(address, bytes) {
        host.cache.remove(&place);
    }
}

extern "C" fn pause(context: *mut c_void) {
    let host = Host::of(context);
    host.pauses += 1;
    if let Behind::Chip(chip) = &mut host.behind {
        let result = chip.step(host.pause);
        host.interrupts = chip.interrupts();
        host.done(result);
    }
}

/// Adds a text to what the host has printed.
pub extern "C" fn print(context: *mut c_void, words: *const c_char) {
    Host::of(context).printed += &text(words);
}
