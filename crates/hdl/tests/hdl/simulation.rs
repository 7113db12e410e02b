//! The printed Verilog computes the described function.

use dynrt_hdl::{Builder, Design, Module, Signal, Style};
use dynrt_verilated::model::{BuildOptions, Model, PortHandle, Sources, build, lint};
use dynrt_verilated::seed;
use std::sync::Arc;

/// A module in Verilator, with its ports by name.
pub struct Verilated {
    pub model: Model,
}

impl Verilated {
    pub fn new(module: Arc<Module>) -> Verilated {
        lint(&Sources::of(&Design::new(module.clone()).unwrap())).unwrap();
        Verilated::new_without_lint(&module)
    }

    pub fn new_without_lint(module: &Arc<Module>) -> Verilated {
        let sources = Sources::of(&Design::new(module.clone()).unwrap());
        let options = BuildOptions {
            opt: "-O0".into(),
            ..BuildOptions::default()
        };
        let built = build(&sources, &options, &|_| ()).unwrap();
        let model = Model::load(&built, &sources.ports).unwrap();
        Verilated { model }
    }

    pub fn port(&self, name: &str) -> PortHandle {
        self.model.port(name).unwrap()
    }

    pub fn set(&mut self, name: &str, value: u64) {
        let port = self.port(name);
        self.model.set(port, value);
    }

    pub fn get(&self, name: &str) -> u64 {
        self.model.get(self.port(name))
    }

    pub fn clock(&mut self) {
        self.model.clock();
    }

    pub fn set_wide(&mut self, port: PortHandle, value: u128) {
        let words = [0, 32, 64, 96].map(|shift| (value >> shift) as u32);
        self.model.set_words(port, &words);
    }

    pub fn get_wide(&self, port: PortHandle) -> u128 {
        let mut words = [0; 4];
        self.model.get_words(port, &mut words);
        words
            .iter()
            .rev()
            .fold(0, |all, word| all << 32 | u128::from(*word))
    }
}

/// A net of a random module for the interpreter; operands are earlier nets.
#[derive(Debug)]
enum Net {
    Input(usize),
    Literal(u128),
    /// The same value, with any number of registers in between.
    Same(usize),
    Not(usize),
    Two(Two, usize, usize),
    Mux(usize, usize, usize),
    /// Most significant first.
    Concat(Vec<usize>),
    Part(usize, u32),
    Any(usize),
    All(usize),
    Parity(usize),
    State(usize),
    ReadNow(usize, usize),
    Instance(usize, usize),
}

#[derive(Clone, Copy, Debug)]
enum Two {
    And,
    Or,
    Xor,
    Add,
    Sub,
    Mul,
    Eq,
    Ne,
    Lt,
    Le,
    Gt,
    Ge,
    Shl,
    Shr,
}

const TWO: [Two; 14] = [
    Two::And,
    Two::Or,
    Two::Xor,
    Two::Add,
    Two::Sub,
    Two::Mul,
    Two::Eq,
    Two::Ne,
    Two::Lt,
    Two::Le,
    Two::Gt,
    Two::Ge,
    Two::Shl,
    Two::Shr,
];

enum State {
    Register {
        next: usize,
        enable: Option<usize>,
        reset: Option<u128>,
    },
    Read {
        memory: usize,
        address: usize,
    },
}

struct Stored {
    depth: u32,
    write: [usize; 3],
}

/// A random module, described to the layer and to the interpreter.
pub struct Random {
    pub module: Arc<Module>,
    nets: Vec<(Net, u32)>,
    states: Vec<State>,
    memories: Vec<Stored>,
    instances: Vec<(Arc<Random>, Vec<usize>)>,
    /// Name, width, and stage in a pipeline.
    pub inputs: Vec<(String, u32, u32)>,
    pub outputs: Vec<(String, usize)>,
}

pub fn mask(width: u32) -> u128 {
    u128::MAX >> (128 - width)
}

/// Makes a random module with the same description for the layer and for the interpreter.
struct Maker<'b, 'r> {
    m: &'b Builder,
    rng: &'r mut fastrand::Rng,
    signals: Vec<Signal<'b>>,
    /// Nets in both descriptions, without constants, which would produce more and more constants.
    pool: Vec<usize>,
    nets: Vec<(Net, u32)>,
    states: Vec<State>,
    memories: Vec<Stored>,
    instances: Vec<(Arc<Random>, Vec<usize>)>,
    names: usize,
}

impl<'b> Maker<'b, '_> {
    fn add(&mut self, net: Net, signal: Signal<'b>) -> usize {
        let signal = if self.rng.u32(..6) == 0 {
            self.names += 1;
            signal.named(format!("n{}", self.names))
        } else {
            signal
        };
        self.plain(net, signal)
    }

    fn plain(&mut self, net: Net, signal: Signal<'b>) -> usize {
        if signal.literal().is_none() {
            self.pool.push(self.nets.len());
        }
        self.nets.push((net, signal.width()));
        self.signals.push(signal);
        self.nets.len() - 1
    }

    fn width(&self, net: usize) -> u32 {
        self.nets[net].1
    }

    /// A random net; later nets have a higher probability.
    fn any(&mut self) -> usize {
        let n = self.pool.len();
        self.pool[self.rng.usize(..n).max(self.rng.usize(..n))]
    }

    fn part(&mut self, net: usize, width: u32) -> usize {
        let low = self.rng.u32(..=self.width(net) - width);
        self.add(Net::Part(net, low), self.signals[net].field(low, width))
    }

    fn literal(&mut self, width: u32) -> usize {
        let value = match self.rng.u32(..4) {
            0 => 0,
            1 => mask(width),
            2 => self.rng.u128(..4) & mask(width),
            _ => self.rng.u128(..) & mask(width),
        };
        self.plain(Net::Literal(value), self.m.lit(value, width))
    }

    /// A random net of a width.
    fn of(&mut self, width: u32) -> usize {
        if self.rng.u32(..12) == 0 {
            return self.literal(width);
        }
        let net = self.any();
        let have = self.width(net);
        if have > width {
            return self.part(net, width);
        }
        if have == width {
            return net;
        }
        match self.rng.u32(..3) {
            0 => {
                let zeros = self.literal_zero(width - have);
                let signal = self.signals[net].extend(width);
                self.add(Net::Concat(vec![zeros, net]), signal)
            }
            1 => {
                let times = width.div_ceil(have);
                if times * have > 128 {
                    return self.input_bit(width);
                }
                let signal = self.signals[net].repeat(times);
                let repeated = self.add(Net::Concat(vec![net; times as usize]), signal);
                self.part(repeated, width)
            }
            _ => {
                let rest = self.of(width - have);
                let signal = self.m.concat(&[self.signals[rest], self.signals[net]]);
                self.add(Net::Concat(vec![rest, net]), signal)
            }
        }
    }

    fn literal_zero(&mut self, width: u32) -> usize {
        self.plain(Net::Literal(0), self.m.zero(width))
    }

    /// Adds a random operation without state.
    fn operation(&mut self) {
        let a = self.any();
        let (x, width) = (self.signals[a], self.width(a));
        match self.rng.u32(..22) {
            0..12 => {
                let op = TWO[self.rng.usize(..TWO.len())];
                let (a, b) = match op {
                    Two::Mul => {
                        let widths = [self.rng.u32(1..=64), self.rng.u32(1..=36)];
                        (self.of(widths[0]), self.of(widths[1]))
                    }
                    Two::Shl | Two::Shr => {
                        let width = self.rng.u32(1..=9);
                        (a, self.of(width))
                    }
                    Two::Lt | Two::Le | Two::Gt | Two::Ge => {
                        let b = match self.rng.u32(..4) {
                            0 => self.literal(width),
                            _ => self.varied(width),
                        };
                        (self.varied(width), b)
                    }
                    _ => (a, self.of(width)),
                };
                let (x, y) = (self.signals[a], self.signals[b]);
                let signal = match op {
                    Two::And => x & y,
                    Two::Or => x | y,
                    Two::Xor => x ^ y,
                    Two::Add => x + y,
                    Two::Sub => x - y,
                    Two::Mul => x.mul(y),
                    Two::Eq => x.eq(y),
                    Two::Ne => x.ne(y),
                    Two::Lt => x.lt(y),
                    Two::Le => x.le(y),
                    Two::Gt => x.gt(y),
                    Two::Ge => x.ge(y),
                    Two::Shl => x.shl(y),
                    Two::Shr => x.shr(y),
                };
                self.add(Net::Two(op, a, b), signal);
            }
            12 | 13 => {
                self.add(Net::Not(a), !x);
            }
            14 => {
                self.add(Net::Any(a), x.any());
            }
            15 => {
                self.add(Net::All(a), x.all());
            }
            16 => {
                self.add(Net::Parity(a), x.parity());
            }
            17 => {
                let width = self.rng.u32(1..=width);
                self.part(a, width);
            }
            18 => {
                let mut parts = vec![];
                let mut total = 0;
                for _ in 0..self.rng.u32(2..6) {
                    let part = self.any();
                    if total + self.width(part) <= 120 {
                        total += self.width(part);
                        parts.push(part);
                    }
                }
                if parts.len() > 1 {
                    let signals: Vec<_> = parts.iter().map(|p| self.signals[*p]).collect();
                    let signal = self.m.concat(&signals);
                    self.add(Net::Concat(parts), signal);
                }
            }
            _ => {
                let (condition, b) = (self.of(1), self.of(width));
                let signal = self.signals[condition].mux(x, self.signals[b]);
                self.add(Net::Mux(condition, a, b), signal);
            }
        }
    }

    fn state(&mut self, state: State, signal: Signal<'b>) -> usize {
        self.states.push(state);
        self.add(Net::State(self.states.len() - 1), signal)
    }

    /// Adds an operation with state, or a composite operation of the layer.
    fn stateful(&mut self) {
        match self.rng.u32(..6) {
            0 => {
                let mut net = self.any();
                if self.signals[net].literal().is_some() {
                    return; // the layer knows no time at which a constant is not one
                }
                let clocks = self.rng.u32(1..8);
                let delayed = self.signals[net].delay(clocks);
                for clock in 1..=clocks {
                    let state = State::Register {
                        next: net,
                        enable: None,
                        reset: None,
                    };
                    self.states.push(state);
                    let signal = self.signals[net].delay(1);
                    if clock < clocks {
                        net = self.plain(Net::State(self.states.len() - 1), signal);
                    } else {
                        net = self.add(Net::State(self.states.len() - 1), delayed);
                    }
                }
            }
            1 => {
                let driver = self.any();
                self.names += 1;
                let wire = self.m.wire(format!("w{}", self.names), self.width(driver));
                self.add(Net::Same(driver), wire.get());
                wire.drive(self.signals[driver]);
            }
            2 => {
                let count = self.rng.u32(2..6);
                let width = self.rng.u32(1..=40);
                let choices: Vec<usize> = (0..count).map(|_| self.of(width)).collect();
                let index = self.of(3);
                let signals: Vec<_> = choices.iter().map(|c| self.signals[*c]).collect();
                let signal = self.m.select(self.signals[index], &signals);
                // The interpreter has its own form: the last choice, then the others from it back to the first.
                let mut chosen = choices[choices.len() - 1];
                for (i, choice) in choices.iter().enumerate().rev().skip(1) {
                    let number = Net::Literal(i as u128);
                    let number = self.silent(number, 3);
                    let same = self.silent(Net::Two(Two::Eq, index, number), 1);
                    chosen = self.silent(Net::Mux(same, *choice, chosen), width);
                }
                self.add(Net::Same(chosen), signal);
            }
            3 => {
                // One memory; its depth is a power of two, because addresses beyond the depth are undefined.
                let (bits, width) = (self.rng.u32(1..6), self.rng.u32(1..=70));
                let now = self.rng.bool();
                let style = if now {
                    Style::Distributed
                } else {
                    Style::Block
                };
                self.names += 1;
                let memory = self
                    .m
                    .memory(format!("m{}", self.names), 1 << bits, width, style);
                let write = [self.of(1), self.variable(bits), self.of(width)];
                let [e, a, d] = write.map(|net| self.signals[net]);
                memory.write(e, a, d);
                self.memories.push(Stored {
                    depth: 1 << bits,
                    write,
                });
                let index = self.memories.len() - 1;
                for _ in 0..self.rng.u32(1..4) {
                    let address = self.variable(bits);
                    let at = self.signals[address];
                    if now && self.rng.bool() {
                        self.add(Net::ReadNow(index, address), memory.read_now(at));
                    } else {
                        let state = State::Read {
                            memory: index,
                            address,
                        };
                        self.state(state, memory.read(at));
                    }
                }
            }
            _ => self.operation(),
        }
    }

    /// A net of a width that is not constant and has a stage in a pipeline: one bit of an input, repeated.
    fn input_bit(&mut self, width: u32) -> usize {
        let bit = self.part(0, 1);
        let signal = self.signals[bit].repeat(width);
        self.add(Net::Concat(vec![bit; width as usize]), signal)
    }

    /// A net without bits that are outputs of registers: tools report a register that only keeps its value,
    /// and a comparison with a constant result.
    fn varied(&mut self, width: u32) -> usize {
        let (value, changes) = (self.of(width), self.input_bit(width));
        let signal = self.signals[value] ^ self.signals[changes];
        match signal.literal() {
            Some(_) => changes,
            None => self.add(Net::Two(Two::Xor, value, changes), signal),
        }
    }

    /// A net of a width that is not constant: an address must not be constant, and an instance needs a
    /// stage.
    fn variable(&mut self, width: u32) -> usize {
        let net = self.of(width);
        match self.signals[net].literal() {
            Some(_) => self.input_bit(width),
            None => net,
        }
    }

    fn instance(&mut self, child: &Arc<Random>, staged: bool) {
        let mut inputs = vec![];
        for (i, (_, width, _)) in child.inputs.iter().enumerate() {
            // One input determines the stage of the instance.
            let net = if staged && i == 0 {
                self.variable(*width)
            } else {
                self.of(*width)
            };
            inputs.push(net);
        }
        let ports: Vec<_> = child
            .inputs
            .iter()
            .map(|(name, ..)| name.as_str())
            .collect();
        let signals = inputs.iter().map(|net| self.signals[*net]);
        let given: Vec<_> = ports.into_iter().zip(signals).collect();
        self.names += 1;
        let out = self
            .m
            .instance(format!("i{}", self.names), &child.module, &given);
        self.instances.push((child.clone(), inputs));
        for (index, (name, _)) in child.outputs.iter().enumerate() {
            let net = Net::Instance(self.instances.len() - 1, index);
            self.plain(net, out.get(name));
        }
    }

    /// A net that exists only in the interpreter.
    fn silent(&mut self, net: Net, width: u32) -> usize {
        self.nets.push((net, width));
        self.signals.push(self.m.zero(width));
        self.nets.len() - 1
    }
}

pub fn random_module(
    name: &str,
    rng: &mut fastrand::Rng,
    pipelined: bool,
    below: &[Arc<Random>],
) -> Arc<Random> {
    let m = Builder::new(name, "a random module.");
    let mut maker = Maker {
        m: &m,
        signals: vec![],
        pool: vec![],
        nets: vec![],
        states: vec![],
        memories: vec![],
        instances: vec![],
        names: 0,
        rng,
    };
    let p = m.pipeline();
    let mut inputs = vec![];
    for i in 0..maker.rng.u32(2..6) {
        let width = maker.rng.u32(1..=70);
        let name = format!("x{i}");
        let stage = if pipelined && i > 0 {
            maker.rng.u32(..4)
        } else {
            0
        };
        let signal = if pipelined {
            p.input_at(&name, width, stage)
        } else {
            m.input(&name, width)
        };
        inputs.push((name, width, stage));
        maker.plain(Net::Input(i as usize), signal);
    }
    let mut registers = vec![];
    if !pipelined {
        for i in 0..maker.rng.u32(..5) {
            let width = maker.rng.u32(1..=70);
            let reset = maker.rng.bool().then(|| maker.rng.u128(..) & mask(width));
            let name = format!("r{i}");
            let register = match reset {
                Some(value) => m.reg_reset(name, width, value),
                None => m.reg(name, width),
            };
            registers.push((register, maker.states.len()));
            maker.states.push(State::Register {
                next: 0,
                enable: None,
                reset,
            });
            maker.plain(Net::State(maker.states.len() - 1), register.q);
        }
    }
    let steps = maker.rng.u32(10..50);
    for _ in 0..steps {
        match maker.rng.u32(..8) {
            0 | 1 if !pipelined => maker.stateful(),
            0 | 1 => {
                let net = maker.any();
                let clocks = maker.rng.u32(1..7);
                maker.add(Net::Same(net), maker.signals[net].delay(clocks));
            }
            2 if !below.is_empty() && maker.rng.u32(..4) == 0 => {
                let child = &below[maker.rng.usize(..below.len())];
                maker.instance(child, pipelined);
            }
            _ => maker.operation(),
        }
    }
    for (register, state) in registers {
        let width = register.q.width();
        let value = maker.varied(width);
        let enabled = maker.rng.bool().then(|| maker.varied(1));
        match enabled {
            Some(net) => register.next_when(maker.signals[net], maker.signals[value]),
            None => register.next(maker.signals[value]),
        }
        if let State::Register { next, enable, .. } = &mut maker.states[state] {
            (*next, *enable) = (value, enabled);
        }
    }
    let mut outputs = vec![];
    while outputs.len() < 4 {
        let net = maker.any();
        if !pipelined || maker.signals[net].staged().is_some() {
            let name = format!("y{}", outputs.len());
            m.output(&name, maker.signals[net]);
            outputs.push((name, net));
        }
    }
    let Maker {
        nets,
        states,
        memories,
        instances,
        ..
    } = maker;
    Arc::new(Random {
        module: m.finish().unwrap(),
        nets,
        states,
        memories,
        instances,
        inputs,
        outputs,
    })
}

/// Simulates a random module cycle by cycle; registers and memories start as zero.
struct Interpreter {
    random: Arc<Random>,
    values: Vec<u128>,
    states: Vec<u128>,
    memories: Vec<Vec<u128>>,
    instances: Vec<Interpreter>,
}

impl Interpreter {
    fn new(random: &Arc<Random>) -> Interpreter {
        let memories = random.memories.iter();
        Interpreter {
            values: vec![0; random.nets.len()],
            states: vec![0; random.states.len()],
            memories: memories.map(|m| vec![0; m.depth as usize]).collect(),
            instances: random
                .instances
                .iter()
                .map(|(child, _)| Interpreter::new(child))
                .collect(),
            random: random.clone(),
        }
    }

    /// The outputs for the inputs and the state.
    fn outputs(&mut self, inputs: &[u128]) -> Vec<u128> {
        let random = self.random.clone();
        for (net, (kind, width)) in random.nets.iter().enumerate() {
            let v = &self.values;
            let value = match kind {
                Net::Input(i) => inputs[*i],
                Net::Literal(value) => *value,
                Net::Same(a) => v[*a],
                Net::Not(a) => !v[*a],
                Net::Two(op, a, b) => {
                    let (a, b) = (v[*a], v[*b]);
                    match op {
                        Two::And => a & b,
                        Two::Or => a | b,
                        Two::Xor => a ^ b,
                        Two::Add => a.wrapping_add(b),
                        Two::Sub => a.wrapping_sub(b),
                        Two::Mul => a.wrapping_mul(b),
                        Two::Eq => (a == b).into(),
                        Two::Ne => (a != b).into(),
                        Two::Lt => (a < b).into(),
                        Two::Le => (a <= b).into(),
                        Two::Gt => (a > b).into(),
                        Two::Ge => (a >= b).into(),
                        Two::Shl => a.checked_shl(b as u32).unwrap_or(0),
                        Two::Shr => a.checked_shr(b as u32).unwrap_or(0),
                    }
                }
                Net::Mux(c, a, b) => v[if v[*c] == 1 { *a } else { *b }],
                Net::Concat(parts) => parts
                    .iter()
                    .fold(0, |all, part| all << random.nets[*part].1 | v[*part]),
                Net::Part(a, low) => v[*a] >> low,
                Net::Any(a) => (v[*a] != 0).into(),
                Net::All(a) => (v[*a] == mask(random.nets[*a].1)).into(),
                Net::Parity(a) => u128::from(v[*a].count_ones() % 2),
                Net::State(state) => self.states[*state],
                Net::ReadNow(memory, address) => self.memories[*memory][v[*address] as usize],
                Net::Instance(instance, output) => {
                    let (child, inputs) = &random.instances[*instance];
                    let interpreter = &mut self.instances[*instance];
                    if *output == 0 {
                        let given: Vec<u128> = inputs.iter().map(|net| v[*net]).collect();
                        interpreter.outputs(&given);
                    }
                    interpreter.values[child.outputs[*output].1]
                }
            };
            self.values[net] = value & mask(*width);
        }
        let outputs = random.outputs.iter();
        outputs.map(|(_, net)| self.values[*net]).collect()
    }

    /// A clock edge, with the inputs of the last call of [`Interpreter::outputs`].
    fn clock(&mut self, rst: bool) {
        let v = &self.values;
        let random = self.random.clone();
        for (state, kind) in self.states.iter_mut().zip(&random.states) {
            match kind {
                State::Register {
                    reset: Some(value), ..
                } if rst => *state = *value,
                State::Register { next, enable, .. } => {
                    if enable.is_none_or(|enable| v[enable] == 1) {
                        *state = v[*next];
                    }
                }
                State::Read { memory, address } => {
                    *state = self.memories[*memory][v[*address] as usize];
                }
            }
        }
        for (words, memory) in self.memories.iter_mut().zip(&random.memories) {
            let [enable, address, data] = memory.write.map(|net| v[net]);
            if enable == 1 {
                words[address as usize] = data;
            }
        }
        for instance in &mut self.instances {
            instance.clock(rst);
        }
    }
}

/// Random modules with all operators and kinds of state, and with nested modules: Verilator's results equal those of an
/// interpreter without pipelines and Verilog, in every cycle and every bit.
#[test]
fn random_modules_compute_what_was_described() {
    const STATEFUL: usize = 40;
    const PIPELINED: usize = 24;
    const CLOCKS: usize = 600;
    const BUSES: usize = 8;
    const BUS: u32 = 72;
    let mut rng = fastrand::Rng::with_seed(seed::of_run());
    let (mut stateful, mut pipelined) = (vec![], vec![]);
    for i in 0..STATEFUL {
        let random = random_module(&format!("stateful{i}"), &mut rng, false, &stateful);
        stateful.push(random);
    }
    for i in 0..PIPELINED {
        let random = random_module(&format!("pipelined{i}"), &mut rng, true, &pipelined);
        pipelined.push(random);
    }

    let top = Builder::new("random_modules", "all of them, side by side.");
    let buses: Vec<_> = (0..BUSES)
        .map(|i| top.input(format!("bus{i}"), BUS))
        .collect();
    // For each module, the bus of each input, and its first bit there.
    let mut wiring: Vec<Vec<(usize, u32)>> = vec![];
    for random in stateful.iter().chain(&pipelined) {
        let mut inputs = vec![];
        let mut from = vec![];
        for (port, width, _) in &random.inputs {
            let (bus, low) = (rng.usize(..BUSES), rng.u32(..=BUS - width));
            inputs.push((port.as_str(), buses[bus].field(low, *width)));
            from.push((bus, low));
        }
        wiring.push(from);
        let name = random.module.name();
        let out = top.instance(format!("the_{name}"), &random.module, &inputs);
        for (port, _) in &random.outputs {
            top.output(format!("{name}_{port}"), out.get(port));
        }
    }
    let mut model = Verilated::new(top.finish().unwrap());
    let ports: Vec<_> = (0..BUSES).map(|i| model.port(&format!("bus{i}"))).collect();
    let all: Vec<_> = stateful.iter().chain(&pipelined).collect();
    let outputs: Vec<Vec<_>> = all
        .iter()
        .map(|random| {
            let name = random.module.name();
            let ports = random.outputs.iter();
            ports
                .map(|(port, _)| model.port(&format!("{name}_{port}")))
                .collect()
        })
        .collect();

    let mut interpreters: Vec<_> = all.iter().map(|random| Interpreter::new(random)).collect();
    let mut history: Vec<[u128; BUSES]> = vec![];
    let mut compared = 0u64;
    let mut ones = 0u64;
    for clock in 0..CLOCKS {
        let rst = clock < 3 || rng.u32(..60) == 0;
        model.set("rst", rst.into());
        let mut values = [0; BUSES];
        for (value, port) in values.iter_mut().zip(&ports) {
            *value = mask(BUS)
                & match rng.u32(..8) {
                    0 => 0,
                    1 => u128::MAX,
                    2 => 1 << rng.u32(..BUS),
                    3 => history.last().map_or(0, |last| last[0]),
                    _ => rng.u128(..),
                };
            model.set_wide(*port, *value);
        }
        history.push(values);
        model.model.eval();
        for (index, random) in all.iter().enumerate() {
            let input = |port: usize, at: usize| {
                let (bus, low) = wiring[index][port];
                let width = random.inputs[port].1;
                let then = history.get(at).map_or(0, |buses| buses[bus]);
                then >> low & mask(width)
            };
            let ports = 0..random.inputs.len();
            let interpreter = &mut interpreters[index];
            for (output, (name, _)) in random.outputs.iter().enumerate() {
                // A pipeline's output belongs to inputs that are earlier by the difference of the stages.
                let latency = random.module.port(name).unwrap().stage;
                let entered = match latency {
                    Some(latency) => match clock.checked_sub(latency as usize) {
                        Some(entered) => entered,
                        None => continue,
                    },
                    None => clock,
                };
                let inputs: Vec<u128> = ports
                    .clone()
                    .map(|port| input(port, entered + random.inputs[port].2 as usize))
                    .collect();
                let expected = interpreter.outputs(&inputs)[output];
                let computed = model.get_wide(outputs[index][output]);
                assert_eq!(
                    computed,
                    expected,
                    "{}.{name} in clock {clock}: {computed:x}, not {expected:x}\n{}\n{:?}",
                    random.module.name(),
                    random.module.verilog(),
                    random.nets.iter().enumerate().collect::<Vec<_>>()
                );
                compared += 1;
                ones += u64::from(expected.count_ones());
            }
            interpreter.clock(rst);
        }
        model.clock();
    }
    let nets: usize = all.iter().map(|random| random.nets.len()).sum();
    eprintln!(
        "{} random modules of {nets} nets: {compared} outputs compared, {ones} bits of them 1",
        all.len()
    );
    let least = (all.len() * CLOCKS * 3) as u64;
    assert!(compared > least && ones > least, "too little was compared");
}
