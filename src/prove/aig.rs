//! And-inverter graphs: the bit-level form in which a unit and its reference are compared.
//!
//! A graph is read from ASCII AIGER, as written by Yosys, and passed to ABC as binary AIGER. In between, a pipeline becomes
//! combinational if all paths have the required number of registers, and inputs are fixed to the values of a case.

use anyhow::{Context, Result, bail, ensure};
use std::collections::HashMap;
use std::ops::Range;

/// Twice the number of a node, plus 1 for its complement. Node 0 is the constant false.
type Literal = u32;

const FALSE: Literal = 0;
const TRUE: Literal = 1;

fn node(literal: Literal) -> usize {
    (literal >> 1) as usize
}

/// A circuit from Yosys: inputs, registers, gates.
pub struct Circuit {
    inputs: Vec<String>,
    /// The definition of each node.
    nodes: Vec<Node>,
    outputs: Vec<(String, Literal)>,
}

#[derive(Clone, Copy)]
enum Node {
    False,
    /// An input, by its index in [`Circuit::inputs`].
    Input(usize),
    /// A register, by its value in the next cycle.
    Register(Literal),
    And(Literal, Literal),
}

/// The gates of a combinational circuit, inputs first; equal gates are shared.
#[derive(Clone, Default)]
pub struct Graph {
    pub inputs: Vec<String>,
    gates: Vec<[Literal; 2]>,
    shared: HashMap<[Literal; 2], Literal>,
    /// Output words, by name, least significant bit first.
    outputs: Vec<(String, Vec<Literal>)>,
}

/// The name and the bit number of `name[bit]`, or of a signal of one bit.
fn bit_of(name: &str) -> Result<(&str, usize)> {
    match name.strip_suffix(']').and_then(|n| n.split_once('[')) {
        Some((word, bit)) => Ok((
            word,
            bit.parse().with_context(|| format!("AIGER name {name}"))?,
        )),
        None => Ok((name, 0)),
    }
}

/// The state of a node during the replacement of registers by wires.
#[derive(Clone, Copy)]
enum Sight {
    Unseen,
    UnderWay,
    /// Its literal, and the number of registers on the paths to it.
    Seen(Literal, Option<u32>),
}

impl Circuit {
    /// Reads ASCII AIGER with a symbol table.
    ///
    /// # Errors
    /// A description of the mistake in the text.
    pub fn parse(text: &str) -> Result<Circuit> {
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
        let ["aag", rest @ ..] = &header[..] else {
            bail!("this is not an ASCII AIGER file");
        };
        let numbers = |line: &str| -> Result<Vec<u32>> {
            let parts = line.split(' ').map(|n| n.parse::<u32>());
            parts
                .collect::<Result<_, _>>()
                .with_context(|| format!("AIGER line {line:?}"))
        };
        let header = numbers(&rest.join(" "))?;
        let &[most, inputs, registers, outputs, gates, ..] = &header[..] else {
            bail!("the AIGER header has {} numbers", header.len());
        };
        let mut nodes = vec![None; most as usize + 1];
        nodes[0] = Some(Node::False);
        let mut define = |literal: u32, what: Node| match nodes.get_mut(node(literal)) {
            Some(place @ None) if literal.is_multiple_of(2) => {
                *place = Some(what);
                Ok(())
            }
            _ => bail!("AIGER literal {literal} is defined twice or out of range"),
        };
        let mut next = || {
            lines
                .next()
                .context("the AIGER file ends early")
                .and_then(numbers)
        };
        for i in 0..inputs as usize {
            define(next()?[0], Node::Input(i))?;
        }
        for _ in 0..registers {
            match next()?[..] {
                [register, after, ..] => define(register, Node::Register(after))?,
                _ => bail!("an AIGER register has no next state"),
            }
        }
        let roots = (0..outputs)
            .map(|_| Ok(next()?[0]))
            .collect::<Result<Vec<_>>>()?;
        for _ in 0..gates {
            match next()?[..] {
                [gate, a, b] => define(gate, Node::And(a, b))?,
                _ => bail!("an AIGER gate has two operands"),
            }
        }
        let mut names = HashMap::new();
        for line in lines.take_while(|line| *line != "c") {
            // A node may have several names; the first one is the port's.
            if let [place, name, ..] = line.split(' ').collect::<Vec<_>>()[..] {
                names.insert(place.to_string(), name.to_string());
            }
        }
        let mut name = |kind: char, i: usize| {
            let place = format!("{kind}{i}");
            names
                .remove(&place)
                .with_context(|| format!("AIGER {place} has no name"))
        };
        Ok(Circuit {
            inputs: (0..inputs as usize)
                .map(|i| name('i', i))
                .collect::<Result<_>>()?,
            outputs: (roots.into_iter().enumerate())
                .map(|(i, root)| Ok((name('o', i)?, root)))
                .collect::<Result<_>>()?,
            nodes: nodes
                .into_iter()
                .enumerate()
                .map(|(i, n)| n.with_context(|| format!("AIGER node {i} is not defined")))
                .collect::<Result<_>>()?,
        })
    }

    /// The combinational function of a pipeline without feedback.
    ///
    /// Every output word must come `latency` cycles after its inputs, on every path through gates
    /// and registers. Then its value in a cycle is a function of the inputs of a single cycle: the function that
    /// results if registers are replaced by wires. This is checked gate by gate. Values that do not depend on any
    /// input may come at any time.
    ///
    /// # Errors
    /// The output or the gate at which the numbers of registers differ, or a loop of registers.
    pub fn transparent(&self, latency: impl Fn(&str) -> u32) -> Result<Graph> {
        self.staged(|_| 0, latency)
    }

    /// The same for a pipeline whose input words enter at different stages, given by `entry`; an output word then comes at the
    /// stage given by `latency`.
    ///
    /// # Errors
    /// As for [`Circuit::transparent`].
    pub fn staged(
        &self,
        entry: impl Fn(&str) -> u32,
        latency: impl Fn(&str) -> u32,
    ) -> Result<Graph> {
        let entries: Vec<u32> = (self.inputs.iter())
            .map(|name| Ok(entry(bit_of(name)?.0)))
            .collect::<Result<_>>()?;
        let mut graph = Graph {
            inputs: self.inputs.clone(),
            ..Graph::default()
        };
        let mut known = vec![Sight::Unseen; self.nodes.len()];
        let mut outputs: Vec<(String, Vec<Literal>)> = vec![];
        for (name, root) in &self.outputs {
            let (word, bit) = bit_of(name)?;
            let (literal, registers) = self
                .see_through(node(*root), &entries, &mut graph, &mut known)
                .with_context(|| format!("output {name}"))?;
            let expected = latency(word);
            if let Some(registers) = registers {
                ensure!(
                    registers == expected,
                    "output {name} comes {registers} clocks after its inputs, not {expected}"
                );
            }
            if outputs.last().is_none_or(|(last, _)| last != word) {
                outputs.push((word.to_string(), vec![]));
            }
            let (_, bits) = outputs.last_mut().expect("there is one");
            ensure!(
                bits.len() == bit,
                "the bits of output {word} are not in order"
            );
            bits.push(literal ^ (root & 1));
        }
        graph.outputs = outputs;
        Ok(graph)
    }

    /// A node in the graph, and the number of registers on the paths to it; `None` if it depends on no input.
    fn see_through(
        &self,
        index: usize,
        entries: &[u32],
        graph: &mut Graph,
        known: &mut [Sight],
    ) -> Result<(Literal, Option<u32>)> {
        match known[index] {
            Sight::Seen(literal, registers) => return Ok((literal, registers)),
            Sight::UnderWay => bail!("a register's value depends on the one it had before"),
            Sight::Unseen => known[index] = Sight::UnderWay,
        }
        let mut follow = |literal: Literal, graph: &mut Graph| {
            let (value, registers) = self.see_through(node(literal), entries, graph, known)?;
            anyhow::Ok((value ^ (literal & 1), registers))
        };
        let value = match self.nodes[index] {
            Node::False => (FALSE, None),
            Node::Input(i) => (2 * (i as u32 + 1), Some(entries[i])),
            Node::Register(next) => {
                let (value, registers) = follow(next, graph)?;
                (value, registers.map(|n| n + 1))
            }
            Node::And(a, b) => {
                let (a, registers_a) = follow(a, graph)?;
                let (b, registers_b) = follow(b, graph)?;
                let registers = match (registers_a, registers_b) {
                    (Some(x), Some(y)) if x != y => {
                        bail!("paths of {x} and of {y} registers meet in one gate")
                    }
                    (x, y) => x.or(y),
                };
                (graph.and(a, b), registers)
            }
        };
        let value = (value.0, value.1.filter(|_| value.0 > TRUE));
        known[index] = Sight::Seen(value.0, value.1);
        Ok(value)
    }
}

impl Graph {
    fn first_gate(&self) -> usize {
        self.inputs.len() + 1
    }

    fn and(&mut self, a: Literal, b: Literal) -> Literal {
        let (a, b) = (a.min(b), a.max(b));
        if a == FALSE || a == b ^ 1 {
            return FALSE;
        }
        if a == TRUE || a == b {
            return b;
        }
        let next = 2 * (self.first_gate() + self.gates.len()) as u32;
        let gates = &mut self.gates;
        *self.shared.entry([a, b]).or_insert_with(|| {
            gates.push([a, b]);
            next
        })
    }

    fn xor(&mut self, a: Literal, b: Literal) -> Literal {
        let neither = self.and(a ^ 1, b ^ 1);
        let both = self.and(a, b);
        self.and(neither ^ 1, both ^ 1)
    }

    fn output(&self, name: &str) -> Result<&Vec<Literal>> {
        let found = self.outputs.iter().find(|(n, _)| n == name);
        Ok(&found
            .with_context(|| format!("no output is called {name}"))?
            .1)
    }

    /// The positions of an input's bits among all inputs, least significant bit first.
    fn input_bits(&self, word: &str) -> Result<Vec<usize>> {
        let mut bits = vec![];
        for (place, name) in self.inputs.iter().enumerate() {
            let (of, bit) = bit_of(name)?;
            if of == word {
                bits.push((bit, place));
            }
        }
        ensure!(!bits.is_empty(), "no input is called {word}");
        bits.sort_unstable();
        Ok(bits.into_iter().map(|(_, place)| place).collect())
    }

    /// The graph with fields of inputs fixed to values.
    ///
    /// # Errors
    /// If an input does not exist or has no such bits.
    pub fn fixed(&self, values: &[Fixed]) -> Result<Graph> {
        let mut map: Vec<Literal> = (0..self.first_gate() as u32).map(|i| 2 * i).collect();
        for Fixed { input, bits, value } in values {
            let places = self.input_bits(input)?;
            let places = places.get(bits.start as usize..bits.end as usize);
            let places = places.with_context(|| format!("input {input} has no bits {bits:?}"))?;
            for (i, place) in places.iter().enumerate() {
                map[place + 1] = (value >> i & 1) as Literal;
            }
        }
        let mut graph = Graph {
            inputs: self.inputs.clone(),
            ..Graph::default()
        };
        let moved = |literal: Literal, map: &[Literal]| map[node(literal)] ^ (literal & 1);
        for [a, b] in &self.gates {
            let gate = graph.and(moved(*a, &map), moved(*b, &map));
            map.push(gate);
        }
        graph.outputs = (self.outputs.iter())
            .map(|(name, bits)| (name.clone(), bits.iter().map(|l| moved(*l, &map)).collect()))
            .collect();
        Ok(graph)
    }

    /// A bit that is 1 if output `legal` is 1 and outputs `got` and `expected` differ.
    ///
    /// # Errors
    /// If an output does not exist, or if the widths differ.
    pub fn differs(&mut self, legal: &str, got: &str, expected: &str) -> Result<Literal> {
        let (legal, a, b) = (
            self.output(legal)?[0],
            self.output(got)?.clone(),
            self.output(expected)?.clone(),
        );
        ensure!(
            a.len() == b.len(),
            "{got} has {} bits, {expected} {}",
            a.len(),
            b.len()
        );
        let mut same = TRUE;
        for (a, b) in a.into_iter().zip(b) {
            let differs = self.xor(a, b);
            same = self.and(same, differs ^ 1);
        }
        Ok(self.and(legal, same ^ 1))
    }

    /// Binary AIGER of the gates on which one output depends.
    pub fn to_aiger(&self, output: Literal) -> Vec<u8> {
        let first = self.first_gate();
        let mut used = vec![false; first + self.gates.len()];
        used[node(output)] = true;
        for (i, gate) in self.gates.iter().enumerate().rev() {
            if used[first + i] {
                gate.iter().for_each(|l| used[node(*l)] = true);
            }
        }
        let mut map: Vec<Literal> = (0..first as u32).map(|i| 2 * i).collect();
        let mut body = vec![];
        let mut next = 2 * first as u32;
        for (i, [a, b]) in self.gates.iter().enumerate() {
            if !used[first + i] {
                map.push(FALSE);
                continue;
            }
            let [a, b] = [*a, *b].map(|l| map[node(l)] ^ (l & 1));
            let (less, greater) = (a.min(b), a.max(b));
            for mut delta in [next - greater, greater - less] {
                while delta >= 0x80 {
                    body.push(delta as u8 | 0x80);
                    delta >>= 7;
                }
                body.push(delta as u8);
            }
            map.push(next);
            next += 2;
        }
        let gates = next / 2 - first as u32;
        let inputs = self.inputs.len() as u32;
        let root = map[node(output)] ^ (output & 1);
        let header = format!("aig {} {inputs} 0 1 {gates}\n{root}\n", inputs + gates);
        [header.into_bytes(), body].concat()
    }

    /// The values of all nodes for 64 assignments of the inputs in each of `N` words.
    pub fn evaluate<const N: usize>(&self, inputs: &[[u64; N]], nodes: &mut Vec<[u64; N]>) {
        nodes.clear();
        nodes.push([0; N]);
        nodes.extend(inputs);
        for [a, b] in &self.gates {
            let (a, b) = (Graph::literal(nodes, *a), Graph::literal(nodes, *b));
            nodes.push(std::array::from_fn(|word| a[word] & b[word]));
        }
    }

    /// The values of a literal, given those of all nodes.
    pub fn literal<const N: usize>(nodes: &[[u64; N]], literal: Literal) -> [u64; N] {
        let complement = 0u64.wrapping_sub(u64::from(literal & 1));
        nodes[node(literal)].map(|word| word ^ complement)
    }

    /// The values of all nodes for 64 assignments of the inputs.
    pub fn simulate(&self, inputs: &[u64]) -> Values<'_> {
        let inputs: Vec<[u64; 1]> = inputs.iter().map(|word| [*word]).collect();
        let mut nodes = vec![];
        self.evaluate(&inputs, &mut nodes);
        Values { graph: self, nodes }
    }
}

/// A bit field of an input, and its value in a case.
#[derive(Clone, Debug)]
pub struct Fixed {
    pub input: String,
    pub bits: Range<u32>,
    pub value: u64,
}

/// The result of [`Graph::simulate`].
pub struct Values<'g> {
    graph: &'g Graph,
    nodes: Vec<[u64; 1]>,
}

impl Values<'_> {
    /// The value of a literal in each of 64 assignments.
    pub fn literal(&self, literal: Literal) -> u64 {
        Graph::literal(&self.nodes, literal)[0]
    }

    /// The value of an output word in the assignment with this number.
    ///
    /// # Errors
    /// If the output does not exist.
    pub fn word(&self, name: &str, assignment: u32) -> Result<u64> {
        let bits = self.graph.output(name)?.iter().enumerate();
        Ok(bits.fold(0, |word, (i, bit)| {
            word | (self.literal(*bit) >> assignment & 1) << i
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = a & b, with a register on each path, or on one only.
    fn circuit(registers: [bool; 2]) -> Circuit {
        let next = |i: usize, input| {
            if registers[i] {
                6 + 2 * i as u32
            } else {
                input
            }
        };
        let text = format!(
            "aag 5 2 2 1 1\n2\n4\n6 2\n8 4\n10\n10 {} {}\ni0 a\ni1 b\no0 y\nc\n",
            next(0, 2),
            next(1, 4)
        );
        Circuit::parse(&text).expect("well formed")
    }

    #[test]
    fn registers_on_all_paths_become_wires() {
        let graph = circuit([true, true]).transparent(|_| 1).expect("balanced");
        let values = graph.simulate(&[0b1100, 0b1010]);
        let y: Vec<u64> = (0..4).map(|i| values.word("y", i).expect("y")).collect();
        assert_eq!(y, [0, 0, 0, 1]);
    }

    #[test]
    fn paths_of_unequal_length_are_an_error() {
        let error = |registers, latency| {
            let result = circuit(registers).transparent(|_| latency);
            format!("{:#}", result.err().expect("an error"))
        };
        assert!(error([true, false], 1).contains("paths of 1 and of 0 registers"));
        assert!(error([true, true], 2).contains("1 clocks after its inputs, not 2"));
        let text = "aag 2 1 1 1 0\n2\n4 4\n4\ni0 a\no0 y\nc\n";
        let looped = Circuit::parse(text)
            .expect("well formed")
            .transparent(|_| 0);
        assert!(format!("{:#}", looped.err().expect("a loop")).contains("depends on"));
    }

    #[test]
    fn fixed_inputs_fold() {
        let graph = circuit([false, false])
            .transparent(|_| 0)
            .expect("balanced");
        let fixed = |value| Fixed {
            input: "a".into(),
            bits: 0..1,
            value,
        };
        assert_eq!(graph.fixed(&[fixed(0)]).expect("an input").gates.len(), 0);
        let b = graph.fixed(&[fixed(1)]).expect("an input");
        assert_eq!(b.output("y").expect("y"), &vec![4]);
        assert!(
            graph
                .fixed(&[Fixed {
                    input: "x".into(),
                    ..fixed(0)
                }])
                .is_err()
        );
    }

    #[test]
    fn aiger_has_the_gates_that_matter() {
        let graph = circuit([false, false])
            .transparent(|_| 0)
            .expect("balanced");
        let root = graph.output("y").expect("y")[0];
        assert_eq!(graph.to_aiger(root), b"aig 3 2 0 1 1\n6\n\x02\x02".to_vec());
        assert_eq!(graph.to_aiger(TRUE), b"aig 2 2 0 1 0\n1\n".to_vec());
    }
}
