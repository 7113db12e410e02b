//! The change of one property over the time of a clip.

use super::number as shown;
use anyhow::{Result, ensure};
use glam::DQuat;

/// The interpolation of a property between two keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Constant until the next key.
    Step,
    /// Linear; rotations along the shorter great arc.
    Linear,
    /// A cubic Hermite spline; every key has an incoming tangent, a value and an outgoing tangent.
    CubicSpline,
}

/// The keys of one property with `width` numbers each. Before the first key and after the last the property is constant.
#[derive(Clone, Debug)]
pub struct Curve {
    /// In seconds, in non-decreasing order.
    times: Vec<f64>,
    values: Vec<f64>,
    width: usize,
    interpolation: Interpolation,
    /// Whether values are quaternions (x, y, z, w), which interpolate on the sphere.
    rotation: bool,
}

impl Curve {
    /// `values` has `width` numbers per key, or three times as many for cubic splines.
    ///
    /// # Errors
    /// One line if there are no keys, if times decrease or are not finite, if the number of values does not match the keys,
    /// or if a rotation is invalid.
    pub fn new(
        times: Vec<f64>,
        values: Vec<f64>,
        width: usize,
        interpolation: Interpolation,
    ) -> Result<Self> {
        ensure!(!times.is_empty(), "has no keys");
        for (number, time) in times.iter().enumerate() {
            ensure!(time.is_finite(), "key {number} is at the time {time}");
            ensure!(
                number == 0 || times[number - 1] <= *time,
                "times decrease: key {number} is at {} s, the one before it at {} s",
                shown(*time),
                shown(times[number - 1])
            );
        }
        let parts = match interpolation {
            Interpolation::CubicSpline => 3,
            Interpolation::Step | Interpolation::Linear => 1,
        };
        let wanted = times.len() * width * parts;
        ensure!(
            values.len() == wanted,
            "has {} numbers for {} keys, where {wanted} belong",
            values.len(),
            times.len()
        );
        Ok(Self {
            times,
            values,
            width,
            interpolation,
            rotation: false,
        })
    }

    /// The same curve as a curve of rotations.
    ///
    /// # Errors
    /// One line if a key is not a rotation.
    pub fn of_rotations(self) -> Result<Self> {
        ensure!(
            self.width == 4,
            "a rotation has 4 numbers, not {}",
            self.width
        );
        for number in 0..self.times.len() {
            let squared: f64 = self.key(number).iter().map(|x| x * x).sum();
            ensure!(
                squared > 0.0,
                "key {number} is not a rotation: all of its numbers are zero"
            );
        }
        Ok(Self {
            rotation: true,
            ..self
        })
    }

    /// The time of the last key, in seconds.
    pub fn end(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// The property at a time. Rotations have length 1.
    pub fn sample(&self, seconds: f64) -> Vec<f64> {
        let following = self.times.partition_point(|&time| time <= seconds);
        let value = if following == 0 {
            self.key(0).to_vec()
        } else if following == self.times.len() {
            self.key(following - 1).to_vec()
        } else {
            self.between(following - 1, seconds)
        };
        if self.rotation {
            let length = value.iter().map(|x| x * x).sum::<f64>().sqrt();
            // A spline between opposite quaternions may pass through zero, which gives the identity.
            if length > 0.0 {
                value.iter().map(|x| x / length).collect()
            } else {
                vec![0.0, 0.0, 0.0, 1.0]
            }
        } else {
            value
        }
    }

    /// The property between a key and the next one, whose time is greater.
    fn between(&self, key: usize, seconds: f64) -> Vec<f64> {
        let (from, to) = (self.key(key), self.key(key + 1));
        let length = self.times[key + 1] - self.times[key];
        let t = (seconds - self.times[key]) / length;
        match self.interpolation {
            Interpolation::Step => from.to_vec(),
            Interpolation::Linear if self.rotation => {
                let [from, to] = [from, to].map(|q| DQuat::from_slice(q).normalize());
                from.slerp(to, t).to_array().to_vec()
            }
            Interpolation::Linear => std::iter::zip(from, to)
                .map(|(a, b)| a + (b - a) * t)
                .collect(),
            Interpolation::CubicSpline => {
                let (leaving, entering) = (self.part(key, 2), self.part(key + 1, 0));
                let (t2, t3) = (t * t, t * t * t);
                (0..self.width)
                    .map(|i| {
                        (2.0 * t3 - 3.0 * t2 + 1.0) * from[i]
                            + length * (t3 - 2.0 * t2 + t) * leaving[i]
                            + (3.0 * t2 - 2.0 * t3) * to[i]
                            + length * (t3 - t2) * entering[i]
                    })
                    .collect()
            }
        }
    }

    fn key(&self, number: usize) -> &[f64] {
        match self.interpolation {
            Interpolation::CubicSpline => self.part(number, 1),
            Interpolation::Step | Interpolation::Linear => {
                &self.values[number * self.width..][..self.width]
            }
        }
    }

    /// One part of a spline's key: 0 its incoming tangent, 1 its value, 2 its outgoing tangent.
    fn part(&self, number: usize, part: usize) -> &[f64] {
        &self.values[(3 * number + part) * self.width..][..self.width]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(interpolation: Interpolation, values: &[f64]) -> Curve {
        Curve::new(vec![1.0, 2.0, 4.0], values.to_vec(), 1, interpolation).unwrap()
    }

    #[test]
    fn steps_stay_and_lines_run_and_ends_hold() {
        let step = curve(Interpolation::Step, &[5.0, 7.0, 3.0]);
        let line = curve(Interpolation::Linear, &[5.0, 7.0, 3.0]);
        for (time, stepped, ran) in [
            (f64::NEG_INFINITY, 5.0, 5.0),
            (0.0, 5.0, 5.0),
            (1.0, 5.0, 5.0),
            (1.5, 5.0, 6.0),
            (2.0, 7.0, 7.0),
            (3.5, 7.0, 4.0),
            (4.0, 3.0, 3.0),
            (1e9, 3.0, 3.0),
        ] {
            assert_eq!(step.sample(time), [stepped], "step at {time}");
            assert_eq!(line.sample(time), [ran], "line at {time}");
        }
    }

    #[test]
    fn a_spline_reproduces_its_cubic() {
        // x³ − 2x with its own derivative as tangents is reproduced.
        let f = |x: f64| x * x * x - 2.0 * x;
        let slope = |x: f64| 3.0 * x * x - 2.0;
        let values: Vec<f64> = [1.0, 2.0, 4.0]
            .iter()
            .flat_map(|&x| [slope(x), f(x), slope(x)])
            .collect();
        let spline = curve(Interpolation::CubicSpline, &values);
        for i in 0..=30 {
            let x = 1.0 + f64::from(i) / 10.0;
            let sampled = spline.sample(x)[0];
            assert!((sampled - f(x)).abs() < 1e-12, "{sampled} at {x}");
        }
        assert_eq!(spline.sample(0.0), [f(1.0)]);
        assert_eq!(spline.sample(9.0), [f(4.0)]);
    }

    #[test]
    fn rotations_take_the_shorter_arc_at_constant_speed() {
        let quarter = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        // The same rotation with the opposite sign gives the longer arc.
        let values = [DQuat::IDENTITY.to_array(), (-quarter).to_array()].concat();
        let curve = Curve::new(vec![0.0, 1.0], values, 4, Interpolation::Linear)
            .and_then(Curve::of_rotations)
            .unwrap();
        for i in 0..=8 {
            let t = f64::from(i) / 8.0;
            let expected = DQuat::from_rotation_y(t * std::f64::consts::FRAC_PI_2);
            let sampled = DQuat::from_slice(&curve.sample(t));
            assert!(sampled.angle_between(expected) < 1e-7, "at {t}");
            assert!((sampled.length() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn splines_of_rotations_have_length_one() {
        let zero = [0.0; 4];
        let turned = DQuat::from_rotation_x(1.0).to_array();
        let values = [zero, [0.0, 0.0, 0.0, 1.0], zero, zero, turned, zero].concat();
        let curve = Curve::new(vec![0.0, 2.0], values, 4, Interpolation::CubicSpline)
            .and_then(Curve::of_rotations)
            .unwrap();
        let middle = DQuat::from_slice(&curve.sample(1.0));
        assert!(middle.angle_between(DQuat::from_rotation_x(0.5)) < 1e-7);
        assert!((middle.length() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn keys_at_the_same_time_jump() {
        let values = vec![1.0, 2.0, 3.0];
        let curve = Curve::new(vec![0.0, 1.0, 1.0], values, 1, Interpolation::Linear).unwrap();
        assert_eq!(curve.sample(0.5), [1.5]);
        assert_eq!(curve.sample(1.0), [3.0]);
    }

    #[test]
    fn faulty_keys_are_refused() {
        let fault = |times: &[f64], values: &[f64], interpolation| {
            let curve = Curve::new(times.to_vec(), values.to_vec(), 1, interpolation);
            curve.unwrap_err().to_string()
        };
        let linear = Interpolation::Linear;
        assert_eq!(fault(&[], &[], linear), "has no keys");
        assert_eq!(
            fault(&[f64::NAN], &[0.0], linear),
            "key 0 is at the time NaN"
        );
        assert_eq!(
            fault(&[1.0, 0.5], &[0.0, 0.0], linear),
            "times decrease: key 1 is at 0.5 s, the one before it at 1 s"
        );
        assert_eq!(
            fault(&[1.0, 2.0], &[0.0], linear),
            "has 1 numbers for 2 keys, where 2 belong"
        );
        assert_eq!(
            fault(&[1.0], &[0.0], Interpolation::CubicSpline),
            "has 1 numbers for 1 keys, where 3 belong"
        );
        let zero = Curve::new(vec![0.0], vec![0.0; 4], 4, linear).unwrap();
        assert_eq!(
            zero.of_rotations().unwrap_err().to_string(),
            "key 0 is not a rotation: all of its numbers are zero"
        );
    }
}
