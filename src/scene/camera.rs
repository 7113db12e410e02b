//! Pinhole cameras, in scene units.

use super::Bounds;
use crate::text;
use anyhow::{Result, ensure};
use glam::DVec3;

/// The two standard cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum View {
    /// Inside the scene's box, along its x axis, for rooms.
    Inside,
    /// Outside, towards the centre of the scene's box, for objects.
    Outside,
}

impl View {
    /// The camera of this view for a scene with the box `bounds`.
    pub fn camera(self, bounds: Bounds) -> Camera {
        match self {
            View::Inside => Camera::inside(bounds),
            View::Outside => Camera::outside(bounds),
        }
    }
}

/// A pinhole camera. The ray through image position (x, y) has the direction forward + x·right + y·up, where
/// y runs from −1 at the lower to 1 at the upper edge. x has the same unit as y: it runs from −w/h to w/h.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The origin of rays.
    pub eye: [f64; 3],
    /// The direction of the image's centre; constructors set its length to 1.
    pub forward: [f64; 3],
    /// Towards the image's right. Its length relative to `forward` is the tangent of half the vertical field of view.
    pub right: [f64; 3],
    /// Towards the image's upper edge, with the length of `right`.
    pub up: [f64; 3],
}

impl Camera {
    /// `tangent` is that of half the vertical field of view.
    fn new(eye: DVec3, forward: DVec3, up: DVec3, tangent: f64) -> Self {
        let forward = forward.normalize();
        let right = forward.cross(up).normalize();
        Camera {
            eye: eye.into(),
            forward: forward.into(),
            right: (tangent * right).into(),
            up: (tangent * right.cross(forward)).into(),
        }
    }

    /// For rooms: the eye at c + (0.3, 0, 0.05)·d, where c and d are the centre and the extent of the scene's box; the
    /// direction (−1, 0.05, 0.1), y up, the tangent of half the vertical field of view 0.7.
    pub fn inside(bounds: Bounds) -> Self {
        let (centre, extent) = centre_and_extent(bounds);
        let eye = centre + DVec3::new(0.3, 0.0, 0.05) * extent;
        Camera::new(eye, DVec3::new(-1.0, 0.05, 0.1), DVec3::Y, 0.7)
    }

    /// For objects: the eye at c + 0.9·|d|·normalise(0.5, 0.4, 1), looking at c, y up, the tangent 0.55.
    pub fn outside(bounds: Bounds) -> Self {
        let (centre, extent) = centre_and_extent(bounds);
        // A scene that is a single point also needs a distance.
        let distance = 0.9 * positive_or_one(extent.length());
        let eye = centre + distance * OUTSIDE.normalize();
        Camera::new(eye, -OUTSIDE, DVec3::Y, 0.55)
    }

    /// From the direction of [`Camera::outside`], at the shortest distance from which the whole box of the scene is visible, with a
    /// small margin, in an image that is square or wider than high.
    pub fn framing(bounds: Bounds) -> Self {
        const TANGENT: f64 = 0.45;
        const MARGIN: f64 = 1.05;
        let (centre, extent) = centre_and_extent(bounds);
        let mut camera = Camera::new(centre, -OUTSIDE, DVec3::Y, TANGENT);
        let [forward, right, up] =
            [camera.forward, camera.right, camera.up].map(|v| DVec3::from(v).normalize());
        let distance = (0..8)
            .map(|corner| {
                let side = |axis: u32| if corner >> axis & 1 == 1 { 0.5 } else { -0.5 };
                let corner = extent * DVec3::new(side(0), side(1), side(2));
                let across = corner.dot(right).abs().max(corner.dot(up).abs());
                MARGIN * across / TANGENT - corner.dot(forward)
            })
            .fold(0.0, f64::max);
        camera.eye = (centre - positive_or_one(distance) * forward).into();
        camera
    }

    /// From the direction of [`Camera::outside`], at the shortest distance from which all of these points are visible, with a small
    /// margin, in an image `aspect` times as wide as high. The distance to a point is at least a tenth of the points' depth.
    ///
    /// # Panics
    /// If there are no points, or `aspect` is not positive.
    pub fn framing_points(points: impl IntoIterator<Item = [f64; 3]>, aspect: f64) -> Self {
        const TANGENT: f64 = 0.45;
        const MARGIN: f64 = 1.05;
        const NEAR: f64 = 0.1;
        assert!(aspect > 0.0, "an image has a width");
        let mut camera = Camera::new(DVec3::ZERO, -OUTSIDE, DVec3::Y, TANGENT);
        let [forward, right, up] =
            [camera.forward, camera.right, camera.up].map(|v| DVec3::from(v).normalize());
        let tangents = [aspect * TANGENT / MARGIN, TANGENT / MARGIN];
        // A point at x across and z along the direction is visible from an eye at (a, c) if |x − a| ≤ tangent · (z − c).
        let mut sides = [[f64::NEG_INFINITY; 2]; 2];
        let (mut nearest, mut farthest) = (f64::INFINITY, f64::NEG_INFINITY);
        for point in points {
            let point = DVec3::from(point);
            let along = point.dot(forward);
            (nearest, farthest) = (nearest.min(along), farthest.max(along));
            for (across, (sides, tangent)) in
                [right, up].into_iter().zip(sides.iter_mut().zip(tangents))
            {
                let across = point.dot(across);
                sides[0] = sides[0].max(across - tangent * along);
                sides[1] = sides[1].max(-across - tangent * along);
            }
        }
        assert!(nearest.is_finite(), "there are points, and they are finite");
        let along = std::iter::zip(sides, tangents)
            .map(|([a, b], tangent)| -(a + b) / (2.0 * tangent))
            .fold(f64::INFINITY, f64::min);
        // The end of a thin scene that points at the eye could otherwise be at the eye.
        let room = NEAR * positive_or_one(farthest - nearest);
        let along = along.min(nearest - room);
        let [x, y] = sides.map(|[a, b]| (a - b) / 2.0);
        camera.eye = (along * forward + x * right + y * up).into();
        camera
    }

    /// The full vertical field of view.
    pub fn vertical_fov_degrees(&self) -> f64 {
        let [up, forward] = [self.up, self.forward].map(|v| DVec3::from(v).length());
        2.0 * (up / forward).atan().to_degrees()
    }

    /// From `eye` towards `target`, with `up` upwards in the image (it need not be perpendicular), and with the full
    /// vertical field of view in degrees.
    ///
    /// # Errors
    /// One line if a number is not finite, if eye and target are equal, if `up` is zero or along the direction, or if the
    /// field of view is not between 0 and 180 degrees.
    pub fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        vertical_fov_degrees: f64,
    ) -> Result<Self> {
        for (name, vector) in [("eye", eye), ("look-at point", target), ("up vector", up)] {
            ensure!(
                vector.iter().all(|x| x.is_finite()),
                "the camera's {name} {} is not finite; give three finite numbers",
                shown(vector)
            );
        }
        ensure!(
            vertical_fov_degrees > 0.0 && vertical_fov_degrees < 180.0,
            "the camera's vertical field of view is {} degrees; give more than 0 and less than 180",
            text::number(vertical_fov_degrees)
        );
        // The halves cannot overflow.
        let towards = (DVec3::from(target) / 2.0 - DVec3::from(eye) / 2.0).try_normalize_scaled();
        let Some(forward) = towards else {
            anyhow::bail!(
                "the camera's eye and look-at point are both {}; move one of them",
                shown(eye)
            );
        };
        let upwards = DVec3::from(up).try_normalize_scaled();
        let Some(up) = upwards.filter(|up| forward.cross(*up).length() > 1e-9) else {
            anyhow::bail!(
                "the camera's up vector {} does not say which way is up: it is zero or along the direction of view; give another",
                shown(up)
            );
        };
        let tangent = (vertical_fov_degrees.to_radians() / 2.0).tan();
        Ok(Camera::new(eye.into(), forward, up, tangent))
    }
}

/// The direction of the eye in outside views, seen from the scene's centre.
const OUTSIDE: DVec3 = DVec3::new(0.5, 0.4, 1.0);

/// A position for a point light. For an eye inside the box it is below the ceiling near the middle, to be in the
/// same room; otherwise it is behind and above the eye, to its right.
pub fn default_light(bounds: Bounds, camera: &Camera) -> [f64; 3] {
    let (centre, extent) = centre_and_extent(bounds);
    let (low, high) = bounds;
    let is_inside = (0..3).all(|k| low[k] < camera.eye[k] && camera.eye[k] < high[k]);
    if is_inside {
        return (centre + DVec3::new(0.1, 0.3, 0.05) * extent).into();
    }
    let [forward, right, up] =
        [camera.forward, camera.right, camera.up].map(|v| DVec3::from(v).normalize());
    let from_eye = 0.8 * up + 0.5 * right - 0.2 * forward;
    (DVec3::from(camera.eye) + positive_or_one(extent.length()) * from_eye).into()
}

fn centre_and_extent((low, high): Bounds) -> (DVec3, DVec3) {
    let (low, high) = (DVec3::from(low), DVec3::from(high));
    (low + (high - low) / 2.0, high - low)
}

fn positive_or_one(x: f64) -> f64 {
    if x > 0.0 { x } else { 1.0 }
}

/// A position or a direction, for messages.
pub(super) fn shown([x, y, z]: [f64; 3]) -> String {
    let [x, y, z] = [x, y, z].map(text::number);
    format!("({x}, {y}, {z})")
}

trait NormalizeScaled: Sized {
    /// The vector of length 1 in the same direction, for any length; `None` for zero.
    fn try_normalize_scaled(self) -> Option<Self>;
}

impl NormalizeScaled for DVec3 {
    fn try_normalize_scaled(self) -> Option<Self> {
        let greatest = self.abs().max_element();
        (greatest > 0.0).then(|| (self / greatest).normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: Bounds = ([-10.0, 0.0, -5.0], [10.0, 8.0, 5.0]);

    fn close(a: [f64; 3], b: [f64; 3]) {
        assert!(
            DVec3::from(a).distance(b.into()) < 1e-12,
            "{a:?} is not {b:?}"
        );
    }

    fn frame_is_orthogonal(camera: &Camera, tangent: f64) {
        let [f, r, u] = [camera.forward, camera.right, camera.up].map(DVec3::from);
        for (a, b) in [(f, r), (r, u), (u, f)] {
            assert!(a.dot(b).abs() < 1e-12);
        }
        for (v, length) in [(f, 1.0), (r, tangent), (u, tangent)] {
            assert!((v.length() - length).abs() < 1e-12);
        }
        assert!(r.cross(f).dot(u) > 0.0, "mirrored");
    }

    #[test]
    fn the_inside_view_is_as_defined() {
        let camera = View::Inside.camera(BOX);
        close(camera.eye, [6.0, 4.0, 0.5]);
        close(
            camera.forward,
            DVec3::new(-1.0, 0.05, 0.1).normalize().into(),
        );
        assert!(camera.up[1] > 0.6);
        frame_is_orthogonal(&camera, 0.7);
    }

    #[test]
    fn the_outside_view_is_as_defined() {
        let camera = View::Outside.camera(BOX);
        let away = DVec3::new(0.5, 0.4, 1.0).normalize();
        let distance = 0.9 * DVec3::new(20.0, 8.0, 10.0).length();
        close(
            camera.eye,
            (DVec3::new(0.0, 4.0, 0.0) + distance * away).into(),
        );
        close(camera.forward, (-away).into());
        frame_is_orthogonal(&camera, 0.55);
    }

    #[test]
    fn framing_shows_every_corner_and_wastes_little() {
        let flat = ([0.0; 3], [3.0, 0.0, 7.0]);
        for bounds in [BOX, flat, ([1e6; 3], [1e6 + 1.0, 1e6 + 9.0, 1e6 + 2.0])] {
            let camera = Camera::framing(bounds);
            let (low, high) = bounds;
            let [eye, forward, right, up] =
                [camera.eye, camera.forward, camera.right, camera.up].map(DVec3::from);
            let mut reach: f64 = 0.0;
            for corner in 0..8 {
                let side = |k: usize| {
                    if corner >> k & 1 == 1 {
                        high[k]
                    } else {
                        low[k]
                    }
                };
                let d = DVec3::new(side(0), side(1), side(2)) - eye;
                let depth = d.dot(forward);
                assert!(depth > 0.0);
                for axis in [right, up] {
                    reach = reach.max((d.dot(axis) / axis.length_squared() / depth).abs());
                }
            }
            assert!(reach > 0.9 && reach < 1.0, "{reach}");
        }
    }

    #[test]
    fn a_single_point_can_be_framed() {
        for camera in [
            Camera::framing(([2.0; 3], [2.0; 3])),
            Camera::outside(([2.0; 3], [2.0; 3])),
        ] {
            assert!(camera.eye.iter().all(|x| x.is_finite()));
            assert_ne!(camera.eye, [2.0; 3]);
        }
    }

    #[test]
    fn look_at_takes_any_lengths() {
        let camera =
            Camera::look_at([0.0; 3], [0.0, 0.0, -1e-200], [0.0, 1e200, 0.0], 90.0).unwrap();
        close(camera.forward, [0.0, 0.0, -1.0]);
        close(camera.right, [1.0, 0.0, 0.0]);
        close(camera.up, [0.0, 1.0, 0.0]);
        assert!((camera.vertical_fov_degrees() - 90.0).abs() < 1e-9);
    }

    #[test]
    fn look_at_refuses_what_is_no_view() {
        let y = [0.0, 1.0, 0.0];
        let fault = |eye, target, up, fov| {
            Camera::look_at(eye, target, up, fov)
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            fault([1.0; 3], [1.0; 3], y, 60.0),
            "the camera's eye and look-at point are both (1, 1, 1); move one of them"
        );
        for up in [[0.0, -3.0, 0.0], [0.0; 3]] {
            assert_eq!(
                fault([0.0; 3], y, up, 60.0),
                format!(
                    "the camera's up vector {} does not say which way is up: it is zero or along the direction of view; give another",
                    shown(up)
                )
            );
        }
        for fov in [0.0, 180.0, -5.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                fault([0.0; 3], [1.0; 3], y, fov),
                format!(
                    "the camera's vertical field of view is {fov} degrees; give more than 0 and less than 180"
                )
            );
        }
        assert_eq!(
            fault([f64::NAN, 0.0, 1.0], [1.0; 3], y, 60.0),
            "the camera's eye (NaN, 0, 1) is not finite; give three finite numbers"
        );
        assert_eq!(
            fault([0.0; 3], [1.0; 3], [f64::INFINITY; 3], 60.0),
            "the camera's up vector (inf, inf, inf) is not finite; give three finite numbers"
        );
    }

    #[test]
    fn the_light_is_inside_with_the_eye_and_above_it_outside() {
        let inside = default_light(BOX, &Camera::inside(BOX));
        assert!((0..3).all(|k| BOX.0[k] < inside[k] && inside[k] < BOX.1[k]));
        let camera = Camera::outside(BOX);
        assert!(default_light(BOX, &camera)[1] > camera.eye[1]);
    }

    #[test]
    fn points_are_framed_closely() {
        let mut random = fastrand::Rng::with_seed(5);
        let mut close = 0;
        for aspect in [0.75, 1.0, 4.0 / 3.0, 2.5] {
            for _ in 0..50 {
                let size = [0; 3].map(|_| 10f64.powi(random.i32(-2..=2)));
                let points: Vec<[f64; 3]> = (0..40)
                    .map(|_| size.map(|s| s * (random.f64() - 0.3)))
                    .collect();
                let camera = Camera::framing_points(points.iter().copied(), aspect);
                let [eye, forward, right, up] =
                    [camera.eye, camera.forward, camera.right, camera.up].map(DVec3::from);
                let tangent = up.length();
                let mut widest = 0f64;
                let (mut nearest, mut farthest) = (f64::INFINITY, 0f64);
                for &point in &points {
                    let to = DVec3::from(point) - eye;
                    let depth = to.dot(forward);
                    (nearest, farthest) = (nearest.min(depth), farthest.max(depth));
                    let x = to.dot(right) / tangent / (depth * tangent * aspect);
                    let y = to.dot(up) / tangent / (depth * tangent);
                    widest = widest.max(x.abs()).max(y.abs());
                }
                let room = nearest / (farthest - nearest);
                assert!(room > 0.1 - 1e-9 && widest < 1.0 / 1.05 + 1e-9);
                let is_close = widest > 1.0 / 1.05 - 1e-9;
                assert!(is_close || room < 0.1 + 1e-9, "{widest} {room}");
                close += u32::from(is_close);
            }
        }
        assert!(close > 100, "{close}");
        let camera = Camera::framing_points([[3.0, 4.0, 5.0]], 1.0);
        let distance = DVec3::from(camera.eye).distance(DVec3::new(3.0, 4.0, 5.0));
        assert!((distance - 0.1).abs() < 1e-9);
    }
}
