//! Reduces the JSON of a glTF file to the part that is read here.
//!
//! Objects keep only the fields listed here. All other fields are removed before the crate validates the document, so faults in
//! them cannot cause an error. Entries that no shown node, skin or animation uses are replaced by neutral ones with the same
//! number. Everything that is read is passed on unchanged and validated.

use super::{extensions, titled};
use crate::scene::animation::some;
use crate::text::escaped;
use anyhow::{Context, Result, bail, ensure};
use serde_json::{Map, Value, json};
use std::collections::HashMap;

/// The fields of a node that affect the picture. `mesh` and `skin` are kept for shown nodes only.
const NODE: [&str; 6] = [
    "children",
    "translation",
    "rotation",
    "scale",
    "matrix",
    "weights",
];
const SAMPLER: [&str; 3] = ["input", "output", "interpolation"];
/// In addition to `bufferView` and `sparse`.
const ACCESSOR: [&str; 5] = ["byteOffset", "componentType", "count", "type", "normalized"];
const SPARSE_INDICES: [&str; 2] = ["byteOffset", "componentType"];
const SPARSE_VALUES: [&str; 1] = ["byteOffset"];
/// In addition to `buffer`. Strides are checked where they are used: see [`Facts::strides`].
const VIEW: [&str; 2] = ["byteOffset", "byteLength"];
const BUFFER: [&str; 2] = ["uri", "byteLength"];

/// Facts about a file that the cleaned document does not contain.
#[derive(Default)]
pub struct Facts {
    /// The numbers of accessors and buffer views in the file. The cleaned document has one more of each, which is empty and
    /// stands for missing ones.
    pub accessors: usize,
    pub views: usize,
    /// The `byteStride` of each buffer view, if it has one.
    pub strides: Vec<Option<Value>>,
    /// For each mesh, the maximum number of morph targets of its primitives.
    pub targets: Vec<usize>,
    /// The mesh of each node, whether shown or not.
    pub meshes: Vec<Option<usize>>,
    /// The shown nodes, in the order of a walk through the hierarchy.
    pub shown: Vec<usize>,
    /// The accessors of EXT_mesh_gpu_instancing by the names of their attributes, for shown nodes with a mesh.
    pub instancing: HashMap<usize, Vec<(String, usize)>>,
    /// For each animation, the channels that are kept, by their numbers in the file.
    pub channels: Vec<Vec<usize>>,
    /// The parts of the file that were left out, one line each.
    pub warnings: Vec<String>,
}

/// Returns the document to validate, and the facts about it.
///
/// # Errors
/// One line if an extension contains the vertices, or if an accessor named by an extension or a primitive is out of range.
pub fn clean(root: &Map<String, Value>) -> Result<(Value, Facts)> {
    let mut cleaner = Cleaner::new(root);
    cleaner.walk();
    let meshes = cleaner.meshes()?;
    cleaner.instancing()?;
    let animations = cleaner.animations();
    let skins = cleaner.skins();
    let nodes = cleaner.nodes();
    let accessors = cleaner.accessors();
    let views = cleaner.views();
    let mut document = json!({
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "meshes": meshes,
        "skins": skins,
        "animations": animations,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": cleaner.buffers(),
        "scenes": cleaner.scenes(),
    });
    if let Some(scene) = root.get("scene") {
        document["scene"] = scene.clone();
    }
    cleaner.warn_of_accessors();
    let mut facts = cleaner.facts;
    facts.warnings.extend(extensions::warnings(root));
    Ok((document, facts))
}

struct Cleaner<'a> {
    root: &'a Map<String, Value>,
    facts: Facts,
    /// Shown nodes and joints, and all their ancestors.
    needed: Vec<bool>,
    /// For each shown mesh, whether any node binds it to a skin.
    skinned: HashMap<usize, bool>,
    skins: Vec<bool>,
    accessors: Vec<bool>,
    views: Vec<bool>,
    buffers: Vec<bool>,
}

impl<'a> Cleaner<'a> {
    fn new(root: &'a Map<String, Value>) -> Self {
        let count = |key: &str| items(root.get(key)).len();
        let views = items(root.get("bufferViews"));
        let facts = Facts {
            accessors: count("accessors"),
            views: views.len(),
            strides: views
                .iter()
                .map(|view| view.get("byteStride").cloned())
                .collect(),
            targets: (items(root.get("meshes")).iter())
                .map(target_count)
                .collect(),
            meshes: (items(root.get("nodes")).iter())
                .map(|node| index(node.get("mesh")))
                .collect(),
            ..Facts::default()
        };
        Self {
            root,
            facts,
            needed: vec![false; count("nodes")],
            skinned: HashMap::new(),
            skins: vec![false; count("skins")],
            accessors: vec![false; count("accessors")],
            views: vec![false; count("bufferViews")],
            buffers: vec![false; count("buffers")],
        }
    }

    fn list(&self, key: &str) -> &'a [Value] {
        items(self.root.get(key))
    }

    fn scene(&self) -> usize {
        index(self.root.get("scene")).unwrap_or(0)
    }

    /// Finds the shown nodes: those of the default scene, otherwise of the first scene, or all nodes if there are no scenes. Nodes
    /// hidden by KHR_node_visibility and their descendants are excluded, unless no other nodes could be shown.
    fn walk(&mut self) {
        let nodes = self.list("nodes");
        let mut parents = vec![Vec::new(); nodes.len()];
        for (number, node) in nodes.iter().enumerate() {
            for below in self.nodes_in(node.get("children")) {
                parents[below].push(number);
            }
        }
        let roots: Vec<usize> = match self.list("scenes") {
            [] => (0..nodes.len())
                .filter(|&node| parents[node].is_empty())
                .collect(),
            scenes => {
                let scene = scenes.get(self.scene());
                self.nodes_in(scene.and_then(|scene| scene.get("nodes")))
                    .collect()
            }
        };
        let (mut shown, hidden) = self.reached(&roots, true);
        let has_mesh = |nodes: &[usize]| {
            let meshes = &self.facts.meshes;
            nodes.iter().any(|&node| meshes[node].is_some())
        };
        if !hidden.is_empty() {
            let what = match hidden.len() {
                1 => "1 node is hidden".into(),
                count => format!("{count} nodes are hidden"),
            };
            let (all, _) = self.reached(&roots, false);
            let is_all = !has_mesh(&shown) && has_mesh(&all);
            let but = match is_all {
                true => "; nothing else is in the scene, so it is shown all the same",
                false => "",
            };
            self.facts.warnings.push(format!(
                "{what} by KHR_node_visibility, with all that is below: {}{but}",
                some(hidden.iter().map(String::as_str))
            ));
            if is_all {
                shown = all;
            }
        }
        self.facts.shown = shown;
        self.find_needed(&parents);
    }

    /// The valid node numbers of a list.
    fn nodes_in(
        &self,
        list: Option<&'a Value>,
    ) -> impl DoubleEndedIterator<Item = usize> + use<'a> {
        let count = self.needed.len();
        let numbers = items(list).iter();
        numbers.filter_map(move |number| index(Some(number)).filter(|&node| node < count))
    }

    /// The nodes in the order of a walk from `roots`, and the names of hidden nodes that the walk does not enter.
    fn reached(&self, roots: &[usize], hides: bool) -> (Vec<usize>, Vec<String>) {
        let nodes = self.list("nodes");
        let mut open: Vec<usize> = roots.iter().rev().copied().collect();
        let (mut reached, mut hidden) = (Vec::new(), Vec::new());
        let mut seen = vec![false; nodes.len()];
        while let Some(node) = open.pop() {
            if std::mem::replace(&mut seen[node], true) {
                continue;
            }
            if hides && extensions::is_hidden(&nodes[node]) {
                hidden.push(node_name(&nodes[node], node));
                continue;
            }
            open.extend(self.nodes_in(nodes[node].get("children")).rev());
            reached.push(node);
        }
        (reached, hidden)
    }

    /// Finds what shown nodes need: meshes, skins, joints, and the ancestors of all of them.
    fn find_needed(&mut self, parents: &[Vec<usize>]) {
        let nodes = self.list("nodes");
        let mut needed = self.facts.shown.clone();
        for &node in &self.facts.shown {
            let Some(mesh) = index(nodes[node].get("mesh")) else {
                continue;
            };
            let skin = index(nodes[node].get("skin"));
            *self.skinned.entry(mesh).or_default() |= skin.is_some();
            let Some(skin) = skin.filter(|&skin| skin < self.skins.len()) else {
                continue;
            };
            if !std::mem::replace(&mut self.skins[skin], true) {
                let joints = self.nodes_in(self.list("skins")[skin].get("joints"));
                needed.extend(joints);
            }
        }
        while let Some(node) = needed.pop() {
            if !std::mem::replace(&mut self.needed[node], true) {
                needed.extend(&parents[node]);
            }
        }
    }

    fn scenes(&self) -> Vec<Value> {
        let scene = self.scene();
        let shown = |(number, value): (usize, &Value)| match value {
            Value::Object(fields) if number == scene => match fields.get("nodes") {
                Some(nodes) => json!({ "nodes": nodes }),
                None => json!({"nodes": []}),
            },
            other if number == scene => other.clone(),
            _ => json!({"nodes": []}),
        };
        self.list("scenes").iter().enumerate().map(shown).collect()
    }

    fn nodes(&self) -> Vec<Value> {
        let mut shown = vec![false; self.needed.len()];
        for &node in &self.facts.shown {
            shown[node] = true;
        }
        let node = |(number, node): (usize, &Value)| {
            let Value::Object(fields) = node else {
                return match self.needed[number] {
                    true => node.clone(),
                    false => json!({}),
                };
            };
            let mut kept = match self.needed[number] {
                true => fields_of(fields, &NODE),
                false => Map::new(),
            };
            if shown[number] && index(fields.get("mesh")).is_some() {
                kept.extend(fields_of(fields, &["mesh", "skin"]));
            }
            name_into(&mut kept, fields);
            Value::Object(kept)
        };
        self.list("nodes").iter().enumerate().map(node).collect()
    }

    fn meshes(&mut self) -> Result<Vec<Value>> {
        let mut meshes = Vec::new();
        for (number, mesh) in self.list("meshes").iter().enumerate() {
            let Some(&skinned) = self.skinned.get(&number) else {
                meshes.push(json!({"primitives": []}));
                continue;
            };
            let Value::Object(fields) = mesh else {
                meshes.push(mesh.clone());
                continue;
            };
            let mut kept = fields_of(fields, &["weights"]);
            name_into(&mut kept, fields);
            if let Some(primitives) = fields.get("primitives") {
                let mut clean = primitives.clone();
                for (place, primitive) in items(Some(primitives)).iter().enumerate() {
                    let primitive = self.primitive(primitive, skinned).with_context(|| {
                        let name = kept.get("name").and_then(Value::as_str);
                        let name = name.map_or_else(String::new, |name| format!(" ({name})"));
                        format!("mesh {number}{name}: primitive {place}")
                    })?;
                    clean[place] = primitive;
                }
                kept.insert("primitives".into(), clean);
            }
            meshes.push(Value::Object(kept));
        }
        Ok(meshes)
    }

    fn primitive(&mut self, primitive: &Value, skinned: bool) -> Result<Value> {
        let none = Map::new();
        let (fields, attributes) = match (primitive, primitive.get("attributes")) {
            (Value::Object(fields), Some(Value::Object(attributes))) => (fields, attributes),
            (Value::Object(fields), None | Some(Value::Null)) => (fields, &none),
            _ => return Ok(primitive.clone()),
        };
        let mut kept = fields_of(fields, &["mode"]);
        let position = attributes.get("POSITION").filter(|value| !value.is_null());
        // Leave out points, lines and strips of lines, and primitives without positions.
        let is_left_out = fields
            .get("mode")
            .and_then(Value::as_u64)
            .is_some_and(|mode| mode < 4);
        let Some(position) = position.filter(|_| !is_left_out) else {
            kept.insert(
                "attributes".into(),
                json!({"POSITION": self.facts.accessors}),
            );
            return Ok(Value::Object(kept));
        };
        let position_number = index(Some(position));
        // The crate looks up this accessor before it has checked the index.
        ensure!(
            position_number.is_none_or(|accessor| accessor < self.facts.accessors),
            "has its POSITION in accessor {}, which is out of range (there are {}, counted from 0); export the file again",
            position_number.unwrap_or_default(),
            self.facts.accessors
        );
        let indices = fields.get("indices").filter(|value| !value.is_null());
        if let Some(extension) = extensions::of_primitive(primitive) {
            let compressed = [Some(position), indices]
                .into_iter()
                .flatten()
                .any(|accessor| self.is_nowhere(accessor));
            ensure!(
                !compressed,
                "its vertices are compressed by {extension}, which cannot be read here; export it without (uncompressed)"
            );
        }
        let mut attributes_kept = Map::new();
        for (name, accessor) in attributes {
            let set = ["JOINTS_", "WEIGHTS_"]
                .iter()
                .find_map(|prefix| name.strip_prefix(prefix));
            let is_set = set.is_some_and(|set| set.parse::<u32>().is_ok());
            if name == "POSITION" || (skinned && is_set) {
                attributes_kept.insert(name.clone(), self.accessor(accessor));
            }
        }
        kept.insert("attributes".into(), Value::Object(attributes_kept));
        if let Some(indices) = indices {
            kept.insert("indices".into(), self.accessor(indices));
        }
        if let Some(targets) = fields.get("targets") {
            let mut clean = targets.clone();
            for (place, target) in items(Some(targets)).iter().enumerate() {
                if let Value::Object(fields) = target {
                    let mut kept = Map::new();
                    if let Some(position) = fields.get("POSITION") {
                        kept.insert("POSITION".into(), self.accessor(position));
                    }
                    clean[place] = Value::Object(kept);
                }
            }
            kept.insert("targets".into(), clean);
        }
        Ok(Value::Object(kept))
    }

    /// Whether an accessor's elements are in no buffer.
    fn is_nowhere(&self, accessor: &Value) -> bool {
        let accessor = index(Some(accessor)).and_then(|place| self.list("accessors").get(place));
        let has = |key: &str| {
            let value = accessor.and_then(|accessor| accessor.get(key));
            value.is_some_and(|value| !value.is_null())
        };
        accessor.is_some() && !has("bufferView") && !has("sparse")
    }

    fn instancing(&mut self) -> Result<()> {
        for node in self.facts.shown.clone() {
            let fields = &self.list("nodes")[node];
            if index(fields.get("mesh")).is_none() {
                continue;
            }
            let name = titled(node, &node_name(fields, node));
            let instancing = match extensions::instancing(fields) {
                Ok(instancing) if instancing.is_empty() => continue,
                Ok(instancing) => instancing,
                Err(fault) => {
                    self.facts.warnings.push(format!(
                        "{name}: its EXT_mesh_gpu_instancing {fault}: the mesh is shown once"
                    ));
                    continue;
                }
            };
            if index(fields.get("skin")).is_some() {
                self.facts.warnings.push(format!(
                    "{name}: its EXT_mesh_gpu_instancing is not read, since a skinned mesh ignores its node's place: the mesh is shown once"
                ));
                continue;
            }
            let mut accessors = Vec::new();
            for (attribute, accessor) in instancing {
                let Some(place) =
                    index(Some(accessor)).filter(|&place| place < self.accessors.len())
                else {
                    bail!(
                        "{name}: EXT_mesh_gpu_instancing: {attribute} is not an accessor of the file (there are {}, counted from 0); export it again",
                        self.accessors.len()
                    );
                };
                self.accessors[place] = true;
                accessors.push((attribute.to_string(), place));
            }
            self.facts.instancing.insert(node, accessors);
        }
        Ok(())
    }

    fn skins(&mut self) -> Vec<Value> {
        let mut skins = Vec::new();
        for (number, skin) in self.list("skins").iter().enumerate() {
            skins.push(match skin {
                _ if !self.skins[number] => json!({"joints": []}),
                Value::Object(fields) => {
                    let mut kept = fields_of(fields, &["joints"]);
                    if let Some(matrices) = fields.get("inverseBindMatrices") {
                        kept.insert("inverseBindMatrices".into(), self.accessor(matrices));
                    }
                    Value::Object(kept)
                }
                other => other.clone(),
            });
        }
        skins
    }

    /// Animations with the channels that move nodes; channels without a node belong to extensions.
    fn animations(&mut self) -> Vec<Value> {
        let mut animations = Vec::new();
        let mut left_out = LeftOut::default();
        for animation in self.list("animations") {
            let Value::Object(fields) = animation else {
                animations.push(animation.clone());
                self.facts.channels.push(Vec::new());
                continue;
            };
            let mut kept = Map::new();
            name_into(&mut kept, fields);
            let samplers = items(fields.get("samplers"));
            let mut used = vec![false; samplers.len()];
            let mut numbers = Vec::new();
            match fields.get("channels") {
                Some(Value::Array(channels)) => {
                    let mut clean = Vec::new();
                    for (number, channel) in channels.iter().enumerate() {
                        if self.leaves_out(channel, &mut left_out) {
                            continue;
                        }
                        if let Some(used) =
                            index(channel.get("sampler")).and_then(|place| used.get_mut(place))
                        {
                            *used = true;
                        }
                        clean.push(channel_of(channel));
                        numbers.push(number);
                    }
                    kept.insert("channels".into(), Value::Array(clean));
                }
                Some(other) => drop(kept.insert("channels".into(), other.clone())),
                None => {}
            }
            self.facts.channels.push(numbers);
            let nothing = self.facts.accessors;
            match fields.get("samplers") {
                Some(Value::Array(samplers)) => {
                    let clean =
                        std::iter::zip(samplers, used).map(|(sampler, used)| match sampler {
                            _ if !used => json!({"input": nothing, "output": nothing}),
                            Value::Object(fields) => {
                                let mut kept = fields_of(fields, &SAMPLER);
                                for key in ["input", "output"] {
                                    if let Some(accessor) = kept.get_mut(key) {
                                        *accessor = self.accessor(accessor);
                                    }
                                }
                                Value::Object(kept)
                            }
                            other => other.clone(),
                        });
                    let clean = clean.collect();
                    kept.insert("samplers".into(), Value::Array(clean));
                }
                Some(other) => drop(kept.insert("samplers".into(), other.clone())),
                None => {}
            }
            animations.push(Value::Object(kept));
        }
        self.facts.warnings.extend(left_out.warnings());
        animations
    }

    /// Whether a channel moves nothing that is read here; such channels are counted.
    fn leaves_out(&self, channel: &Value, left_out: &mut LeftOut) -> bool {
        let Some(target) = channel.get("target") else {
            return false;
        };
        if let Some(pointer) = extensions::pointer(target) {
            left_out.pointers += 1;
            left_out.pointer.get_or_insert_with(|| pointer.to_string());
            return true;
        }
        let Some(node) = target.get("node").filter(|node| !node.is_null()) else {
            left_out.nodeless += 1;
            return true;
        };
        let mesh = index(Some(node)).map(|node| self.facts.meshes.get(node));
        let targets = match mesh {
            Some(Some(mesh)) => mesh.and_then(|mesh| self.facts.targets.get(mesh).copied()),
            // It is checked where the channel is read.
            _ => return false,
        };
        let is_weights = target.get("path").and_then(Value::as_str) == Some("weights");
        let moves_nothing = is_weights && targets.unwrap_or(0) == 0;
        left_out.weights += usize::from(moves_nothing);
        moves_nothing
    }

    /// A reference to an accessor, which marks it as read. An index out of range remains out of range in the document, which has one more accessor.
    fn accessor(&mut self, reference: &Value) -> Value {
        used(&mut self.accessors, reference)
    }

    fn accessors(&mut self) -> Vec<Value> {
        let zeros = || Value::from(vec![0.0; 3]);
        let nothing = json!({
            "bufferView": self.facts.views, "componentType": 5126, "count": 0, "type": "SCALAR",
            "min": zeros(), "max": zeros(),
        });
        let mut accessors = Vec::new();
        for (number, accessor) in self.list("accessors").iter().enumerate() {
            accessors.push(match accessor {
                _ if !self.accessors[number] => nothing.clone(),
                Value::Object(fields) => {
                    let mut kept = fields_of(fields, &ACCESSOR);
                    let sparse = fields.get("sparse").filter(|sparse| !sparse.is_null());
                    match fields.get("bufferView").filter(|view| !view.is_null()) {
                        Some(view) => {
                            kept.insert("bufferView".into(), used(&mut self.views, view));
                        }
                        // Zeros; the crate requires a view for them.
                        None if sparse.is_none() => {
                            kept.insert("bufferView".into(), self.facts.views.into());
                        }
                        None => {}
                    }
                    if let Some(sparse) = sparse {
                        kept.insert("sparse".into(), self.sparse(sparse));
                    }
                    // Bounding boxes are computed; those in the file are ignored.
                    kept.insert("min".into(), zeros());
                    kept.insert("max".into(), zeros());
                    Value::Object(kept)
                }
                other => other.clone(),
            });
        }
        accessors.push(nothing);
        accessors
    }

    fn sparse(&mut self, sparse: &Value) -> Value {
        let Value::Object(fields) = sparse else {
            return sparse.clone();
        };
        let mut kept = fields_of(fields, &["count"]);
        for (key, list) in [
            ("indices", &SPARSE_INDICES[..]),
            ("values", &SPARSE_VALUES[..]),
        ] {
            match fields.get(key) {
                Some(Value::Object(part)) => {
                    let mut clean = fields_of(part, list);
                    if let Some(view) = part.get("bufferView") {
                        clean.insert("bufferView".into(), used(&mut self.views, view));
                    }
                    kept.insert(key.into(), Value::Object(clean));
                }
                Some(other) => drop(kept.insert(key.into(), other.clone())),
                None => {}
            }
        }
        Value::Object(kept)
    }

    fn views(&mut self) -> Vec<Value> {
        let nothing = json!({"buffer": self.buffers.len(), "byteLength": 0});
        let mut views = Vec::new();
        for (number, view) in self.list("bufferViews").iter().enumerate() {
            views.push(match view {
                _ if !self.views[number] => nothing.clone(),
                Value::Object(fields) => {
                    let mut kept = fields_of(fields, &VIEW);
                    if let Some(buffer) = fields.get("buffer") {
                        kept.insert("buffer".into(), used(&mut self.buffers, buffer));
                    }
                    Value::Object(kept)
                }
                other => other.clone(),
            });
        }
        views.push(nothing);
        views
    }

    fn buffers(&self) -> Vec<Value> {
        let nothing = json!({"uri": "data:,", "byteLength": 0});
        let buffers = std::iter::zip(self.list("buffers"), &self.buffers);
        let kept = buffers.map(|(buffer, &used)| match buffer {
            _ if !used => nothing.clone(),
            Value::Object(fields) => Value::Object(fields_of(fields, &BUFFER)),
            other => other.clone(),
        });
        kept.chain([nothing.clone()]).collect()
    }

    /// Warns of faulty accessors that are not read.
    fn warn_of_accessors(&mut self) {
        let views = self.views.len();
        let is_faulty = |accessor: &Value| {
            let number = |key: &str| accessor.get(key).and_then(Value::as_u64);
            let kind = number("componentType");
            let shape = accessor.get("type").and_then(Value::as_str);
            let view = accessor.get("bufferView").filter(|view| !view.is_null());
            !matches!(kind, Some(5120..=5123 | 5125 | 5126))
                || !matches!(
                    shape,
                    Some("SCALAR" | "VEC2" | "VEC3" | "VEC4" | "MAT2" | "MAT3" | "MAT4")
                )
                || number("count").is_none()
                || view.is_some_and(|view| index(Some(view)).is_none_or(|view| view >= views))
        };
        let accessors = std::iter::zip(self.list("accessors"), &self.accessors).enumerate();
        let faulty: Vec<String> = accessors
            .filter(|(_, (accessor, used))| !**used && is_faulty(accessor))
            .map(|(number, _)| number.to_string())
            .collect();
        if !faulty.is_empty() {
            let what = match faulty.len() {
                1 => "1 accessor is faulty, but nothing here reads it: accessor".into(),
                count => {
                    format!("{count} accessors are faulty, but nothing here reads them: accessors")
                }
            };
            let line = format!("{what} {}", some(faulty.iter().map(String::as_str)));
            self.facts.warnings.push(line);
        }
    }
}

/// The omitted channels of animations, by kind.
#[derive(Default)]
struct LeftOut {
    pointers: usize,
    /// The first such pointer.
    pointer: Option<String>,
    nodeless: usize,
    weights: usize,
}

impl LeftOut {
    fn warnings(self) -> Vec<String> {
        let channels = |count: usize| match count {
            1 => "1 animation channel is left out".into(),
            count => format!("{count} animation channels are left out"),
        };
        let mut warnings = Vec::new();
        if self.pointers > 0 {
            let pointer = self.pointer.unwrap_or_default();
            let more = match self.pointers {
                1 => " stays as it is",
                _ => " and others stay as they are",
            };
            warnings.push(format!(
                "{}: KHR_animation_pointer is not read here, so that `{pointer}`{more}",
                channels(self.pointers)
            ));
        }
        if self.nodeless > 0 {
            let line = format!("{}, without a node to move", channels(self.nodeless));
            warnings.push(line);
        }
        if self.weights > 0 {
            warnings.push(format!(
                "{}: the node has no morph targets that the weights could blend",
                channels(self.weights)
            ));
        }
        warnings
    }
}

fn channel_of(channel: &Value) -> Value {
    let Value::Object(fields) = channel else {
        return channel.clone();
    };
    let mut kept = fields_of(fields, &["sampler"]);
    match fields.get("target") {
        Some(Value::Object(target)) => {
            let target = fields_of(target, &["node", "path"]);
            kept.insert("target".into(), Value::Object(target));
        }
        Some(other) => drop(kept.insert("target".into(), other.clone())),
        None => {}
    }
    Value::Object(kept)
}

/// The elements of a JSON list; empty if the value is not a list.
pub fn items(list: Option<&Value>) -> &[Value] {
    list.and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

/// A non-negative integer.
fn index(value: Option<&Value>) -> Option<usize> {
    let number = value.and_then(Value::as_u64)?;
    usize::try_from(number).ok()
}

fn fields_of(fields: &Map<String, Value>, kept: &[&str]) -> Map<String, Value> {
    let kept = kept.iter().filter_map(|&key| {
        let value = fields.get(key)?;
        Some((key.to_string(), value.clone()))
    });
    kept.collect()
}

/// Copies a name, escaped once here because names are printed.
fn name_into(kept: &mut Map<String, Value>, fields: &Map<String, Value>) {
    if let Some(Value::String(name)) = fields.get("name") {
        kept.insert("name".into(), escaped(name).into());
    }
}

fn node_name(node: &Value, number: usize) -> String {
    match node.get("name") {
        Some(Value::String(name)) if !name.is_empty() => escaped(name).into_owned(),
        _ => format!("node {number}"),
    }
}

/// Marks the element that a reference names. A reference out of range is changed to one that is out of range in every list.
fn used(all: &mut [bool], reference: &Value) -> Value {
    match index(Some(reference)) {
        Some(number) => match all.get_mut(number) {
            Some(used) => {
                *used = true;
                reference.clone()
            }
            None => Value::from(u32::MAX),
        },
        None => reference.clone(),
    }
}

/// The number of morph targets of a mesh: the maximum over its primitives.
fn target_count(mesh: &Value) -> usize {
    let primitives = items(mesh.get("primitives"));
    let targets = primitives
        .iter()
        .map(|primitive| items(primitive.get("targets")).len());
    targets.max().unwrap_or(0)
}
