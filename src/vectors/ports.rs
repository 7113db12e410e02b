//! Maps the fields of the files to the ports of the Verilog.

use super::layout::Layout;
use crate::hdl::{Direction, Module, Port};
use anyhow::{Context, Result, ensure};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The layouts of the files, by name.
pub type Layouts = BTreeMap<String, Layout>;

/// A range of a field's bits on a port.
#[derive(Serialize)]
struct Bits {
    layout: String,
    field: String,
    /// The first of the field's bits.
    lsb: u32,
    width: u32,
    /// The position of that bit in the port.
    port_lsb: u32,
}

/// The use of a port.
enum Use {
    Fields(Vec<Bits>),
    /// One of the fields, selected by the value of another field.
    Select(&'static str, Vec<Bits>),
    /// An input with a constant value.
    Constant,
    /// A port that the vectors do not define.
    Other(&'static str),
}

/// Maps the ports of one unit.
pub struct Map<'a> {
    pub layouts: &'a Layouts,
    pub unit: &'a str,
    pub rays: usize,
}

impl Map<'_> {
    /// Every port of the module, for each of its copies.
    ///
    /// # Errors
    /// One line that names a port for which there is no rule.
    pub fn of(&self, module: &Module, copies: usize) -> Result<Vec<Value>> {
        let mut list = vec![];
        for copy in 0..copies {
            for port in module.ports() {
                let what = self
                    .usage(port, copy)
                    .with_context(|| format!("port {} of {}", port.name, module.name()))?;
                list.push(entry(copy, port, what));
            }
        }
        Ok(list)
    }

    fn usage(&self, port: &Port, copy: usize) -> Result<Use> {
        match port.name.as_str() {
            "clk" => return Ok(Use::Other("clock")),
            "rst" => return Ok(Use::Other("reset")),
            _ => {}
        }
        let found = match self.unit {
            "ray_setup" => self.ray_setup(port),
            "packet_step" => self.packet_step(port, copy),
            "raycast" => self.raycast(port),
            "update" => self.update(port),
            "skinning" => self.skinning(port),
            // Ports have the names of fields; the remaining inputs drive the matrix and skinning.
            unit => Ok(match port.direction {
                Direction::Input => self.field(&format!("{unit}_stimulus"), &port.name, port),
                Direction::Output => self.field(&format!("{unit}_expected"), &port.name, port),
            }),
        }?;
        Ok(found.unwrap_or(match port.direction {
            Direction::Input => Use::Constant,
            Direction::Output => Use::Other("unused"),
        }))
    }

    /// The field of this name on the port, if it exists.
    fn field(&self, layout: &str, field: &str, port: &Port) -> Option<Use> {
        let width = self.width(layout, field)?.min(port.width);
        Some(Use::Fields(vec![bits(layout, field, 0, width, 0)]))
    }

    fn width(&self, layout: &str, field: &str) -> Option<u32> {
        let fields = &self.layouts.get(layout)?.fields;
        let found = fields.iter().find(|candidate| candidate.name == field)?;
        Some(found.width)
    }

    /// Several fields on one port, from the least significant bit up.
    fn packed(&self, layout: &str, fields: &[String], port: &Port) -> Result<Option<Use>> {
        let mut list = vec![];
        let mut place = 0;
        for field in fields {
            let width = self.width(layout, field);
            let width = width.with_context(|| format!("{layout} has no field {field}"))?;
            list.push(bits(layout, field, 0, width, place));
            place += width;
        }
        ensure!(
            place <= port.width,
            "{place} bits do not fit {}",
            port.width
        );
        Ok(Some(Use::Fields(list)))
    }

    fn ray_setup(&self, port: &Port) -> Result<Option<Use>> {
        Ok(match port.name.as_str() {
            "valid" | "out_valid" => Some(Use::Other("handshake")),
            "packet" | "ray" | "out_packet" | "out_ray" => Some(Use::Other("identity")),
            name => match (name.strip_prefix("scene_"), name.strip_prefix("out_")) {
                (Some(corner), _) => self.field("scene", corner, port),
                (_, Some(result)) => self.field("ray_setup_expected", result, port),
                _ => self.field("ray_setup_stimulus", name, port),
            },
        })
    }

    fn packet_step(&self, port: &Port, ray: usize) -> Result<Option<Use>> {
        const STIMULUS: &str = "packet_step_stimulus";
        const EXPECTED: &str = "packet_step_expected";
        let bit = |layout, field| Some(Use::Fields(vec![bits(layout, field, ray as u32, 1, 0)]));
        let of_ray = |what: &str| format!("ray{ray}_{what}");
        let by_axis = |side: &str, what: &str| {
            let axes = ["x", "y", "z"].map(|axis| of_ray(&format!("{what}_{axis}")));
            let fields = axes.map(|field| bits(STIMULUS, &field, 0, port.width, 0));
            let by = if side == "left" {
                "left_axis"
            } else {
                "right_axis"
            };
            Some(Use::Select(by, fields.into()))
        };
        let by_sign = |by| {
            let field = of_ray("signs");
            let fields = [0, 1, 2].map(|axis| bits(STIMULUS, &field, axis, 1, 0));
            Some(Use::Select(by, fields.into()))
        };
        Ok(match port.name.as_str() {
            "left_sign" => by_sign("left_axis"),
            "right_sign" => by_sign("right_axis"),
            "left_origin" => by_axis("left", "origin"),
            "right_origin" => by_axis("right", "origin"),
            "left_reciprocal" => by_axis("left", "reciprocal"),
            "right_reciprocal" => by_axis("right", "reciprocal"),
            "ray_near" => self.field(STIMULUS, &of_ray("near"), port),
            "ray_far" => self.field(STIMULUS, &of_ray("far"), port),
            "ray_active" => bit(STIMULUS, "mask"),
            "to_left" => bit(EXPECTED, "to_left"),
            "to_right" => bit(EXPECTED, "to_right"),
            "left_before_right" => bit(EXPECTED, "both_left_first"),
            name => match name
                .strip_prefix("out_")
                .and_then(|rest| rest.split_once('_'))
            {
                Some((side, end)) => self.field(EXPECTED, &format!("{side}_ray{ray}_{end}"), port),
                None => self.field(STIMULUS, name, port),
            },
        })
    }

    fn raycast(&self, port: &Port) -> Result<Option<Use>> {
        let name = port.name.as_str();
        if name.starts_with("skin_") || name.starts_with("influence_") {
            return Ok(None);
        }
        if is_memory(name) {
            return Ok(Some(Use::Other("memory")));
        }
        if name.ends_with("_valid") || name.ends_with("_ready") {
            return Ok(Some(Use::Other("handshake")));
        }
        let intervals = |side: &str| {
            let of_ray = |k: usize| ["near", "far"].map(|end| format!("{side}_ray{k}_{end}"));
            let fields: Vec<String> = (0..self.rays).flat_map(of_ray).collect();
            self.packed("packet_step_expected", &fields, port)
        };
        if let Some(traced) = name.strip_prefix("trace_") {
            let field = |layout, field| Ok(self.field(layout, field, port));
            return match traced {
                "start_tag" => field("raycast_rays", "tag"),
                "step_node" => field("packet_step_stimulus", "node"),
                "step_left" => field("packet_step_expected", "to_left"),
                "step_right" => field("packet_step_expected", "to_right"),
                "step_left_first" => field("packet_step_expected", "left_first"),
                "step_left_intervals" => intervals("left"),
                "step_right_intervals" => intervals("right"),
                "test_ray" => field("triangle_test_stimulus", "slot"),
                "test_record" => field("triangle_test_stimulus", "record"),
                "transform_ray" => field("ray_transform_stimulus", "slot"),
                "transform_record" => field("ray_transform_stimulus", "record"),
                rest if rest.ends_with("_packet") => Ok(Some(Use::Other("identity"))),
                rest => match rest.split_once('_') {
                    Some(("test", result)) => field("triangle_test_expected", result),
                    Some(("transform", result)) => field("ray_transform_expected", result),
                    _ => Ok(None),
                },
            };
        }
        Ok(match name.split_once('_') {
            Some(("scene", register)) => self.field("scene", register, port),
            Some(("ray", field)) => self.field("raycast_rays", field, port),
            Some(("hit", field)) => self.field("raycast_hits", field, port),
            _ => None,
        })
    }

    fn update(&self, port: &Port) -> Result<Option<Use>> {
        let name = port.name.as_str();
        if is_memory(name) {
            return Ok(Some(Use::Other("memory")));
        }
        if name.ends_with("_valid") || name.ends_with("_ready") || name == "done" {
            return Ok(Some(Use::Other("handshake")));
        }
        let corner = |end: &'static str| ["x", "y", "z"].map(|axis| format!("{end}_{axis}"));
        match name {
            "node_write_address" => Ok(self.field("update_node_writes", "node", port)),
            "node_write_mask" => Ok(self.field("update_node_writes", "mask", port)),
            "node_write_data" => {
                let numbers = ["left_lo", "left_hi", "right_lo", "right_hi"].map(String::from);
                self.packed("update_node_writes", &numbers, port)
            }
            "box_write_address" => Ok(self.field("update_commands", "box_index", port)),
            "box_write_data" => {
                self.packed("update_boxes", &[corner("lo"), corner("hi")].concat(), port)
            }
            _ => Ok((name.strip_prefix("start_"))
                .and_then(|field| self.field("update_commands", field, port))),
        }
    }

    fn skinning(&self, port: &Port) -> Result<Option<Use>> {
        let name = port.name.as_str();
        if is_memory(name) && (name.starts_with("vertex_") || name.starts_with("influence_")) {
            return Ok(Some(Use::Other("memory")));
        }
        let Some(own) = name.strip_prefix("skin_") else {
            return Ok(None);
        };
        if own.ends_with("_valid") || own.ends_with("_ready") || own == "done" {
            return Ok(Some(Use::Other("handshake")));
        }
        match own {
            "write_address" => Ok(self.field("skinning_expected", "vertex", port)),
            "write_data" => {
                let vector = ["x", "y", "z"].map(String::from);
                self.packed("skinning_expected", &vector, port)
            }
            _ => Ok((own.strip_prefix("start_"))
                .and_then(|field| self.field("skinning_commands", field, port))),
        }
    }
}

/// Whether a port belongs to a read port.
fn is_memory(name: &str) -> bool {
    name.contains("_request_") || name.contains("_response_")
}

fn bits(layout: &str, field: &str, lsb: u32, width: u32, port_lsb: u32) -> Bits {
    Bits {
        layout: layout.to_string(),
        field: field.to_string(),
        lsb,
        width,
        port_lsb,
    }
}

fn entry(copy: usize, port: &Port, what: Use) -> Value {
    let (word, fields, by, value) = match what {
        Use::Fields(fields) => ("fields", fields, Value::Null, Value::Null),
        Use::Select(by, fields) => {
            let by = json!({"layout": fields[0].layout, "field": by});
            ("select", fields, by, Value::Null)
        }
        Use::Constant => ("constant", vec![], Value::Null, json!(0)),
        Use::Other(word) => (word, vec![], Value::Null, Value::Null),
    };
    json!({
        "copy": copy,
        "port": port.name,
        "direction": match port.direction {
            Direction::Input => "input",
            Direction::Output => "output",
        },
        "width": port.width,
        "stage": port.stage,
        "use": word,
        "fields": fields,
        "by": by,
        "value": value,
    })
}
