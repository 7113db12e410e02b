//! Simulation of a Verilog module in this process: [`build()`] makes a shared library with Verilator, [`Model`] runs it.
//!
//! # Clock cycles
//!
//! [`Model::clock`] is one rising edge of `clk`. The edge samples the inputs as they were set before the call; when it
//! returns, all outputs have settled: registered outputs to their values after the edge, combinational ones to what
//! follows from them and the current inputs. If an output depends combinationally on an input, [`Model::eval`] updates
//! it after the input has changed, without a clock edge.
//!
//! The clock is called `clk`, the synchronous, active-high reset `rst`; a module may lack either. State is zero, not
//! unknown, unless the Verilog initialises it. Cycles are numbered from 0 by rising edges, including those of a reset.
//! In a trace, cycle *c* lasts from 10 *c* ns to 10 *c* + 10 ns, with its rising edge in the middle.
//!
//! # Cache
//!
//! Models are kept in the directory `$DYNRT_CACHE`, otherwise `$XDG_CACHE_HOME/dynrt`, otherwise `~/.cache/dynrt`,
//! under a hash of everything that they are built from: sources, interface code, options and tool versions. A model is
//! built in a directory of its own and renamed into place when it is complete. An interrupted build therefore leaves no
//! incomplete model, and several processes may build the same model at the same time. The cache can be deleted at any
//! time.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::fs;
use std::io::ErrorKind;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;

use anyhow::{Context, Result, anyhow, ensure};
use libloading::Library;

use super::build::interface;
pub use super::build::{BuildOptions, Built, Port, Sources, build, lint};
use dynrt_hdl::bundle::{Like, LikePorts};
use dynrt_hdl::{Bundle, Ports, Spec};

/// A window of cycles to trace.
#[derive(Clone, Debug)]
pub struct Trace {
    /// The FST file.
    pub path: PathBuf,
    /// The first cycle.
    pub from: u64,
    /// The number of cycles.
    pub cycles: u64,
}

/// A port of a [`Model`], returned by [`Model::port`]. It is valid for that model, and for others
/// loaded with the same list of ports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortHandle(u32);

/// Verilator's storage of a port: the smallest of these integers that holds it, otherwise 32-bit words.
#[derive(Clone, Copy, Debug)]
enum Storage {
    U8,
    U16,
    U32,
    U64,
    Words,
}

#[derive(Clone, Copy)]
struct Slot {
    address: NonNull<c_void>,
    width: u32,
    storage: Storage,
}

impl Slot {
    /// A mask of all bits of the port, for widths of at most 64.
    #[inline]
    fn mask(self) -> u64 {
        u64::MAX >> (64 - self.width)
    }

    fn words(self) -> usize {
        self.width.div_ceil(32) as usize
    }
}

/// The inputs of a model except `clk` and `rst` at successive rising edges.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The names of the inputs.
    ports: Vec<String>,
    most: usize,
    /// The inputs of each cycle in 32-bit words.
    cycles: Vec<Vec<Vec<u32>>>,
}

impl Recording {
    /// Returns the number of recorded cycles.
    pub fn len(&self) -> usize {
        self.cycles.len()
    }

    /// Returns whether nothing was recorded.
    pub fn is_empty(&self) -> bool {
        self.cycles.is_empty()
    }
}

/// A running instance of a module.
///
/// A model can be moved to another thread but not shared between threads. Any number of models, of
/// the same library or of others, can run at the same time. Access to a port costs a bounds check
/// and a branch on its width; a cycle costs one call into the library.
///
/// A model can end the process: Verilator does so, with a message, on `$finish` or `$fatal` in the
/// Verilog, and if combinational logic does not settle.
pub struct Model {
    slots: Vec<Slot>,
    ports: Vec<Port>,
    cycles: u64,
    recording: Option<Recording>,
    /// Source of random bits for inputs whose value has no meaning.
    noise: fastrand::Rng,
    rst: Option<PortHandle>,
    traced: bool,
    shim: NonNull<c_void>,
    clock: unsafe extern "C" fn(*mut c_void, u64),
    eval: unsafe extern "C" fn(*mut c_void),
    trace_open: unsafe extern "C" fn(*mut c_void, *const c_char, u64, u64) -> c_int,
    trace_close: unsafe extern "C" fn(*mut c_void),
    destroy: unsafe extern "C" fn(*mut c_void),
    /// The library must be dropped last, because it contains the functions above.
    _library: Library,
    _not_sync: PhantomData<*mut c_void>,
}

// SAFETY: everything that `shim` points to belongs to this model only (it has its own context, and the shim has
// no globals), and nothing in it is bound to the thread that created it.
unsafe impl Send for Model {}

impl Model {
    /// Loads a model and creates an instance of it with all inputs zero. `ports` is the list that
    /// the model was built with.
    ///
    /// # Errors
    /// The library cannot be loaded, or was built for other ports.
    pub fn load(built: &Built, ports: &[Port]) -> Result<Model> {
        let path = &built.library;
        let damaged = |error| {
            anyhow!(
                "cannot load the model {}: {error}; remove the file to have it built again",
                path.display()
            )
        };
        // SAFETY: the library was made by `build` from our shim and Verilator's runtime; loading it runs only
        // their static constructors. The signatures are those in the shim.
        unsafe {
            let library = Library::new(path).map_err(damaged)?;
            let interface_of = *library
                .get::<unsafe extern "C" fn() -> *const c_char>(b"dynrt_interface")
                .map_err(damaged)?;
            let create = *library
                .get::<unsafe extern "C" fn() -> *mut c_void>(b"dynrt_create")
                .map_err(damaged)?;
            let port = *library
                .get::<unsafe extern "C" fn(*mut c_void, u32) -> *mut c_void>(b"dynrt_port")
                .map_err(damaged)?;
            let traced = *library
                .get::<unsafe extern "C" fn() -> c_int>(b"dynrt_traced")
                .map_err(damaged)?;
            let clock = *library.get(b"dynrt_clock").map_err(damaged)?;
            let eval = *library.get(b"dynrt_eval").map_err(damaged)?;
            let trace_open = *library.get(b"dynrt_trace_open").map_err(damaged)?;
            let trace_close = *library.get(b"dynrt_trace_close").map_err(damaged)?;
            let destroy = *library.get(b"dynrt_destroy").map_err(damaged)?;

            // All accesses below rely on this check: each address has the storage that the width implies.
            ensure!(
                CStr::from_ptr(interface_of()).to_bytes() == interface(ports).as_bytes(),
                "the model {} was built for other ports",
                path.display()
            );
            let shim = NonNull::new(create()).context("the model cannot be created")?;
            let mut model = Model {
                slots: Vec::with_capacity(ports.len()),
                ports: ports.to_vec(),
                cycles: 0,
                recording: None,
                noise: fastrand::Rng::with_seed(1),
                rst: None,
                traced: traced() != 0,
                shim,
                clock,
                eval,
                trace_open,
                trace_close,
                destroy,
                _library: library,
                _not_sync: PhantomData,
            };
            for (
                index,
                &Port {
                    ref name,
                    width,
                    input,
                },
            ) in ports.iter().enumerate()
            {
                let address =
                    NonNull::new(port(shim.as_ptr(), index as u32)).with_context(|| {
                        format!("the model {} has no port `{name}`", path.display())
                    })?;
                let storage = match width {
                    0..=8 => Storage::U8,
                    9..=16 => Storage::U16,
                    17..=32 => Storage::U32,
                    33..=64 => Storage::U64,
                    _ => Storage::Words,
                };
                model.slots.push(Slot {
                    address,
                    width,
                    storage,
                });
                if name == "rst" && input {
                    model.rst = Some(PortHandle(index as u32));
                }
            }
            Ok(model)
        }
    }

    /// Returns the port called `name`.
    ///
    /// # Errors
    /// The model has no such port; the message lists those that it has.
    pub fn port(&self, name: &str) -> Result<PortHandle> {
        let index = self
            .ports
            .iter()
            .position(|port| port.name == name)
            .with_context(|| {
                let names: Vec<&str> = self.ports.iter().map(|port| port.name.as_str()).collect();
                format!(
                    "the model has no port `{name}`; its ports are {}",
                    names.join(", ")
                )
            })?;
        Ok(PortHandle(index as u32))
    }

    /// Returns the ports of a typed interface (see [`Ports`]).
    ///
    /// # Errors
    /// The model lacks a port; the message names the first.
    pub fn ports<I: Bundle<Leaf = Spec>, O: Bundle<Leaf = Spec>>(
        &self,
        ports: &Ports<I, O>,
    ) -> Result<LikePorts<I, O, PortHandle>> {
        ports.try_map(|spec| self.port(&spec.name))
    }

    /// Returns the values of a bundle of ports, the low 64 bits of each.
    #[inline]
    pub fn sample<B: Bundle<Leaf = PortHandle>>(&self, ports: &B) -> Like<B, u64> {
        ports.map(|_, port| self.get(port))
    }

    /// Sets a bundle of ports, each as by [`Model::set`].
    #[inline]
    pub fn drive<B: Bundle<Leaf = PortHandle>>(&mut self, ports: &B, values: Like<B, u64>) {
        ports.with(values, |port, value| self.set(port, value));
    }

    /// Returns the name, width and direction of a port.
    pub fn describe(&self, port: PortHandle) -> &Port {
        &self.ports[port.0 as usize]
    }

    /// Returns the value of a port; the low 64 bits if it is wider.
    #[inline]
    pub fn get(&self, port: PortHandle) -> u64 {
        let slot = self.slots[port.0 as usize];
        // SAFETY: `load` has checked that the address refers to storage of this kind. The storage lives as long
        // as the model and is written only through `&mut self`.
        unsafe {
            match slot.storage {
                Storage::U8 => slot.address.cast::<u8>().read().into(),
                Storage::U16 => slot.address.cast::<u16>().read().into(),
                Storage::U32 => slot.address.cast::<u32>().read().into(),
                Storage::U64 => slot.address.cast::<u64>().read(),
                Storage::Words => {
                    let words = self.wide(slot);
                    u64::from(words[0]) | u64::from(words[1]) << 32
                }
            }
        }
    }

    /// Sets an input port to the low bits of `value`; the bits of a wider port above them become
    /// zero.
    ///
    /// # Panics
    /// In builds with debug assertions, if the port is an output.
    #[inline]
    pub fn set(&mut self, port: PortHandle, value: u64) {
        let slot = self.input_slot(port);
        // SAFETY: as in `get`; `&mut self` makes this the only access.
        unsafe {
            match slot.storage {
                Storage::U8 => slot.address.cast::<u8>().write((value & slot.mask()) as u8),
                Storage::U16 => slot
                    .address
                    .cast::<u16>()
                    .write((value & slot.mask()) as u16),
                Storage::U32 => slot
                    .address
                    .cast::<u32>()
                    .write((value & slot.mask()) as u32),
                Storage::U64 => slot.address.cast::<u64>().write(value & slot.mask()),
                Storage::Words => {
                    let words = self.wide_mut(slot);
                    words.fill(0);
                    words[0] = value as u32;
                    words[1] = (value >> 32) as u32;
                }
            }
        }
    }

    /// Returns `width` bits (1 to 64) of a port from bit `lsb` upwards.
    ///
    /// # Panics
    /// If the port does not have these bits.
    #[inline]
    pub fn get_field(&self, port: PortHandle, lsb: u32, width: u32) -> u64 {
        let slot = self.slots[port.0 as usize];
        check_field(slot, lsb, width);
        let mask = u64::MAX >> (64 - width);
        match slot.storage {
            Storage::Words => {
                let words = self.wide(slot);
                let (first, shift) = (lsb as usize / 32, lsb % 32);
                let word = |i: usize| u128::from(words.get(first + i).copied().unwrap_or(0));
                ((word(0) | word(1) << 32 | word(2) << 64) >> shift) as u64 & mask
            }
            _ => self.get(port) >> lsb & mask,
        }
    }

    /// Sets `width` bits (1 to 64) of an input port, from bit `lsb` upwards, to the low bits of
    /// `value`.
    ///
    /// # Panics
    /// If the port does not have these bits.
    #[inline]
    pub fn set_field(&mut self, port: PortHandle, lsb: u32, width: u32, value: u64) {
        let slot = self.input_slot(port);
        check_field(slot, lsb, width);
        let mask = u64::MAX >> (64 - width);
        match slot.storage {
            Storage::Words => {
                let words = self.wide_mut(slot);
                let (first, shift) = (lsb as usize / 32, lsb % 32);
                let bits = u128::from(mask) << shift;
                let value = u128::from(value & mask) << shift;
                for (i, word) in words[first..].iter_mut().take(3).enumerate() {
                    let (bits, value) = ((bits >> (32 * i)) as u32, (value >> (32 * i)) as u32);
                    *word = *word & !bits | value;
                }
            }
            _ => {
                let rest = self.get(port) & !(mask << lsb);
                self.set(port, rest | (value & mask) << lsb);
            }
        }
    }

    /// Copies the value of a port to `words`, least significant word first. Words beyond the width
    /// of the port become zero.
    ///
    /// # Panics
    /// If there are too few words for the port.
    #[inline]
    pub fn get_words(&self, port: PortHandle, words: &mut [u32]) {
        let slot = self.slots[port.0 as usize];
        let count = slot.words();
        assert!(
            words.len() >= count,
            "a port of {} bits does not fit {} words",
            slot.width,
            words.len()
        );
        words[count..].fill(0);
        match slot.storage {
            Storage::Words => words[..count].copy_from_slice(self.wide(slot)),
            _ => {
                let value = self.get(port);
                words[0] = value as u32;
                if count > 1 {
                    words[1] = (value >> 32) as u32;
                }
            }
        }
    }

    /// Sets an input port to a value in 32-bit words, least significant first. Bits beyond the
    /// width of the port are ignored; missing words are zero.
    #[inline]
    pub fn set_words(&mut self, port: PortHandle, words: &[u32]) {
        let slot = self.input_slot(port);
        match slot.storage {
            Storage::Words => {
                let wide = self.wide_mut(slot);
                let count = wide.len().min(words.len());
                wide[..count].copy_from_slice(&words[..count]);
                wide[count..].fill(0);
                // Verilator assumes that the bits above the port's width are zero.
                if !slot.width.is_multiple_of(32) {
                    wide[slot.width as usize / 32] &= u32::MAX >> (32 - slot.width % 32);
                }
            }
            _ => {
                let word = |i: usize| u64::from(words.get(i).copied().unwrap_or(0));
                self.set(port, word(0) | word(1) << 32);
            }
        }
    }

    /// Simulates one rising edge: see the [module documentation](self).
    #[inline]
    pub fn clock(&mut self) {
        self.run(1);
    }

    /// Simulates `cycles` rising edges with constant inputs.
    #[inline]
    pub fn run(&mut self, cycles: u64) {
        if self.recording.is_some() {
            for _ in 0..cycles {
                self.record_inputs();
            }
        }
        // SAFETY: `shim` is what the library's `create` returned, not destroyed yet, and accessed by us only.
        unsafe { (self.clock)(self.shim.as_ptr(), cycles) };
        self.cycles += cycles;
    }

    /// Evaluates the outputs that depend combinationally on inputs, after inputs have changed.
    #[inline]
    pub fn eval(&mut self) {
        // SAFETY: as in `run`.
        unsafe { (self.eval)(self.shim.as_ptr()) };
    }

    /// Simulates `cycles` rising edges with random bits at all inputs except `rst`, then sets these
    /// inputs to zero. This brings the module into an arbitrary state, as after power-up, from
    /// which its reset must recover.
    pub fn disturb(&mut self, seed: u64, cycles: u64) {
        let mut rng = fastrand::Rng::with_seed(seed);
        let inputs: Vec<PortHandle> = self.inputs().collect();
        for cycle in 0..=cycles {
            if cycle < cycles {
                self.garble(inputs.iter().copied(), &mut rng);
                self.clock();
            } else {
                for &port in &inputs {
                    self.set_words(port, &[]);
                }
            }
        }
    }

    /// Sets the given inputs to random bits, for inputs whose value must not matter.
    pub fn garble(&mut self, ports: impl IntoIterator<Item = PortHandle>, rng: &mut fastrand::Rng) {
        for port in ports {
            let words: Vec<u32> = (0..self.slots[port.0 as usize].words())
                .map(|_| rng.u32(..))
                .collect();
            self.set_words(port, &words);
        }
    }

    /// Sets the given inputs to random bits from the model's own source, which are the same in every run.
    pub(crate) fn scramble(&mut self, ports: impl IntoIterator<Item = PortHandle>) {
        let mut noise = self.noise.clone();
        self.garble(ports, &mut noise);
        self.noise = noise;
    }

    /// Starts recording the inputs at the next `cycles` rising edges, for [`Model::recorded`].
    pub fn record(&mut self, cycles: usize) {
        self.recording = Some(Recording {
            ports: self
                .inputs()
                .map(|port| self.ports[port.0 as usize].name.clone())
                .collect(),
            most: cycles,
            cycles: vec![],
        });
    }

    /// Ends the recording and returns it; `None` if none was started.
    pub fn recorded(&mut self) -> Option<Recording> {
        self.recording.take()
    }

    fn inputs(&self) -> impl Iterator<Item = PortHandle> + use<'_> {
        (self.ports.iter().enumerate())
            .filter(|(_, port)| port.input && !matches!(&*port.name, "clk" | "rst"))
            .map(|(index, _)| PortHandle(index as u32))
    }

    fn record_inputs(&mut self) {
        let Some(mut recording) = self.recording.take() else {
            return;
        };
        if recording.cycles.len() < recording.most {
            let words_of = |port: PortHandle| {
                let mut words = vec![0; self.slots[port.0 as usize].words()];
                self.get_words(port, &mut words);
                words
            };
            recording.cycles.push(self.inputs().map(words_of).collect());
        }
        self.recording = Some(recording);
    }

    /// Replays the first `cycles` recorded cycles of a model with the same inputs, then sets the
    /// inputs to zero. This brings the module into a state amid real traffic, from which its reset
    /// must recover.
    ///
    /// # Errors
    /// The model lacks a recorded input.
    pub fn play(&mut self, recording: &Recording, cycles: usize) -> Result<()> {
        let ports: Vec<PortHandle> = (recording.ports.iter())
            .map(|name| self.port(name))
            .collect::<Result<_>>()?;
        for words in recording.cycles.iter().take(cycles) {
            for (&port, words) in ports.iter().zip(words) {
                self.set_words(port, words);
            }
            self.clock();
        }
        for port in ports {
            self.set_words(port, &[]);
        }
        Ok(())
    }

    /// Holds `rst` at 1 for `cycles` rising edges, then sets it to 0. A module without `rst` is
    /// only clocked.
    pub fn reset(&mut self, cycles: u64) {
        if let Some(rst) = self.rst {
            self.set(rst, 1);
        }
        self.run(cycles);
        if let Some(rst) = self.rst {
            self.set(rst, 0);
            self.eval();
        }
    }

    /// Returns the number of rising edges since the model was loaded: the number of the cycle that
    /// the next [`clock`](Self::clock) simulates.
    pub fn cycles(&self) -> u64 {
        self.cycles
    }

    /// Writes an FST trace of `cycles` cycles, starting with cycle `from`, to `path`. It replaces a
    /// trace in progress. The file is complete when the last of the cycles is over, when
    /// [`trace_end`](Self::trace_end) is called, or when the model is dropped.
    ///
    /// # Errors
    /// The model was built without [`traced`](BuildOptions::traced), the interval is empty or in
    /// the past, or the file cannot be written.
    pub fn trace(&mut self, path: &Path, from: u64, cycles: u64) -> Result<()> {
        let until = from.saturating_add(cycles);
        ensure!(
            cycles > 0 && until > self.cycles,
            "nothing to trace in cycles {from} to {until}: the model is at cycle {}",
            self.cycles
        );
        ensure!(
            self.traced,
            "no trace {}: the model was built without traces",
            path.display()
        );
        let failed = |error| anyhow!("cannot write the trace {}: {error}", path.display());
        // The trace writer does not report why it cannot write, so try to create the file first.
        fs::File::create(path).map_err(failed)?;
        let name = CString::new(path.as_os_str().as_encoded_bytes())
            .map_err(|_| failed(ErrorKind::InvalidInput.into()))?;
        // SAFETY: as in `run`; the name outlives the call, which copies it.
        let opened = unsafe { (self.trace_open)(self.shim.as_ptr(), name.as_ptr(), from, until) };
        ensure!(opened != 0, failed(ErrorKind::Other.into()));
        Ok(())
    }

    /// Completes a trace in progress; does nothing if there is none.
    pub fn trace_end(&mut self) {
        // SAFETY: as in `run`.
        unsafe { (self.trace_close)(self.shim.as_ptr()) };
    }

    #[inline]
    fn input_slot(&self, port: PortHandle) -> Slot {
        debug_assert!(
            self.describe(port).input,
            "port `{}` is an output",
            self.describe(port).name
        );
        self.slots[port.0 as usize]
    }

    #[inline]
    fn wide(&self, slot: Slot) -> &[u32] {
        debug_assert!(matches!(slot.storage, Storage::Words));
        // SAFETY: as in `get`; this function is called only for slots of `Words`, which have this many words.
        unsafe { std::slice::from_raw_parts(slot.address.cast().as_ptr(), slot.words()) }
    }

    #[inline]
    fn wide_mut(&mut self, slot: Slot) -> &mut [u32] {
        debug_assert!(matches!(slot.storage, Storage::Words));
        // SAFETY: as in `wide`; `&mut self` makes this the only access.
        unsafe { std::slice::from_raw_parts_mut(slot.address.cast().as_ptr(), slot.words()) }
    }
}

#[inline]
fn check_field(slot: Slot, lsb: u32, width: u32) {
    assert!(
        (1..=64).contains(&width) && lsb < slot.width && width <= slot.width - lsb,
        "a port of {} bits has no field of {width} bits from bit {lsb}",
        slot.width
    );
}

impl Drop for Model {
    fn drop(&mut self) {
        // SAFETY: as in `run`; nothing uses the shim after this.
        unsafe { (self.destroy)(self.shim.as_ptr()) };
    }
}
