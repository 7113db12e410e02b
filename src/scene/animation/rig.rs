//! The hierarchy of nodes, and the tracks of clips that move it.

use super::Curve;
use anyhow::{Result, bail, ensure};
use glam::{DAffine3, DQuat, DVec3};

/// The nodes and the tracks of all clips.
#[derive(Clone, Debug, Default)]
pub struct Rig {
    pub nodes: Vec<Node>,
    /// All nodes, every parent before its children.
    order: Vec<usize>,
    /// The tracks of each clip.
    pub tracks: Vec<Vec<Track>>,
}

/// A node of the hierarchy.
#[derive(Clone, Debug)]
pub struct Node {
    pub name: String,
    pub parent: Option<usize>,
    pub local: Local,
    /// The weights of its morph targets.
    pub weights: Vec<f64>,
}

/// A node's transform relative to its parent.
#[derive(Clone, Copy, Debug)]
pub struct Local {
    pub translation: DVec3,
    pub rotation: DQuat,
    pub scale: DVec3,
    /// A matrix, which may shear, in place of the three until one of them is set.
    matrix: Option<DAffine3>,
}

impl Local {
    pub fn new(translation: DVec3, rotation: DQuat, scale: DVec3) -> Self {
        Self {
            translation,
            rotation,
            scale,
            matrix: None,
        }
    }

    pub fn of_matrix(matrix: DAffine3) -> Self {
        let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
        Self {
            matrix: Some(matrix),
            ..Self::new(translation, rotation, scale)
        }
    }

    pub fn set_rotation(&mut self, rotation: DQuat) {
        self.rotation = rotation;
        self.matrix = None;
    }

    fn affine(&self) -> DAffine3 {
        self.matrix.unwrap_or_else(|| {
            DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
        })
    }
}

/// The change of one property of a node by a clip.
#[derive(Clone, Debug)]
pub struct Track {
    pub node: usize,
    pub property: Property,
    /// Its width is that of the property.
    pub curve: Curve,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Property {
    Translation,
    Rotation,
    Scale,
    Weights,
}

/// The state of all nodes at a time.
pub struct Posed {
    /// From node space to the world.
    pub globals: Vec<DAffine3>,
    /// The weights of each node's morph targets.
    pub weights: Vec<Vec<f64>>,
}

impl Rig {
    /// # Errors
    /// One line if a node is its own ancestor.
    pub fn new(nodes: Vec<Node>) -> Result<Self> {
        let mut children = vec![Vec::new(); nodes.len()];
        let mut order = Vec::with_capacity(nodes.len());
        for (number, node) in nodes.iter().enumerate() {
            match node.parent {
                Some(parent) => children[parent].push(number),
                None => order.push(number),
            }
        }
        let mut next = 0;
        while next < order.len() {
            order.extend(&children[order[next]]);
            next += 1;
        }
        if order.len() < nodes.len() {
            // A node that cannot be reached from a root has a cycle among its ancestors.
            let mut reached = vec![false; nodes.len()];
            order.iter().for_each(|&number| reached[number] = true);
            let unreached = (0..nodes.len()).find(|&number| !reached[number]);
            let mut number = unreached.expect("fewer were reached than there are");
            while !std::mem::replace(&mut reached[number], true) {
                number = nodes[number].parent.expect("only roots have none");
            }
            bail!(
                "node {number} ({}) is its own ancestor: the nodes are cyclic; correct their children",
                nodes[number].name
            );
        }
        Ok(Self {
            nodes,
            order,
            tracks: Vec::new(),
        })
    }

    /// Adds the tracks of the next clip.
    pub fn add_clip(&mut self, tracks: Vec<Track>) {
        self.tracks.push(tracks);
    }

    /// The state of the nodes at a time of a clip, or at rest; `change` may modify the nodes before the hierarchy is applied.
    pub fn pose(
        &self,
        clip: Option<usize>,
        seconds: f64,
        change: impl FnOnce(&mut [Local]) -> Result<()>,
    ) -> Result<Posed> {
        let mut locals: Vec<Local> = self.nodes.iter().map(|node| node.local).collect();
        let mut weights: Vec<Vec<f64>> =
            self.nodes.iter().map(|node| node.weights.clone()).collect();
        // A clip that moves no nodes has no tracks.
        let tracks = clip.and_then(|clip| self.tracks.get(clip));
        for track in tracks.into_iter().flatten() {
            let value = track.curve.sample(seconds);
            let local = &mut locals[track.node];
            match track.property {
                Property::Translation => local.translation = DVec3::from_slice(&value),
                Property::Rotation => local.rotation = DQuat::from_slice(&value),
                Property::Scale => local.scale = DVec3::from_slice(&value),
                Property::Weights => {
                    weights[track.node] = value;
                    continue;
                }
            }
            local.matrix = None;
        }
        change(&mut locals)?;
        let mut globals = vec![DAffine3::IDENTITY; self.nodes.len()];
        for &number in &self.order {
            let local = locals[number].affine();
            globals[number] = match self.nodes[number].parent {
                Some(parent) => globals[parent] * local,
                None => local,
            };
        }
        ensure!(
            weights.iter().flatten().all(|weight| weight.is_finite()),
            "a morph target's weight is not finite; correct the clip"
        );
        Ok(Posed { globals, weights })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(parent: Option<usize>, x: f64) -> Node {
        Node {
            name: format!("n{x}"),
            parent,
            local: Local::new(DVec3::X * x, DQuat::IDENTITY, DVec3::splat(2.0)),
            weights: Vec::new(),
        }
    }

    #[test]
    fn children_may_precede_their_parents() {
        let rig = Rig::new(vec![
            node(Some(2), 1.0),
            node(Some(0), 1.0),
            node(None, 1.0),
        ])
        .unwrap();
        let posed = rig.pose(None, 0.0, |_| Ok(())).unwrap();
        let at = |number: usize| posed.globals[number].translation.x;
        assert_eq!([at(2), at(0), at(1)], [1.0, 3.0, 7.0]);
    }

    #[test]
    fn cycles_are_named_not_followed() {
        for (parents, culprit) in [
            (vec![Some(0)], 0),
            (vec![None, Some(2), Some(1)], 1),
            (vec![Some(1), Some(2), Some(3), Some(1)], 1),
        ] {
            let nodes = parents.into_iter().map(|p| node(p, 0.0)).collect();
            let error = Rig::new(nodes).unwrap_err().to_string();
            assert_eq!(
                error,
                format!(
                    "node {culprit} (n0) is its own ancestor: the nodes are cyclic; correct their children"
                )
            );
        }
    }

    #[test]
    fn a_matrix_holds_until_a_part_of_it_is_set() {
        let sheared = DAffine3::from_cols(
            DVec3::X,
            DVec3::new(1.0, 1.0, 0.0),
            DVec3::Z,
            DVec3::new(5.0, 0.0, 0.0),
        );
        let mut local = Local::of_matrix(sheared);
        assert_eq!(local.affine(), sheared);
        local.set_rotation(DQuat::IDENTITY);
        assert_eq!(local.affine().translation, DVec3::new(5.0, 0.0, 0.0));
        assert_ne!(local.affine(), sheared);
    }
}
