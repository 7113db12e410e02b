//! Packets of rays, in the machine's number format.

use super::machine::power_of_two;
use super::{Camera, MachineMesh, camera};
use crate::float::{Arithmetic, Format};
use crate::port::{Hit, Ray};
use anyhow::{Result, bail, ensure};
use glam::DVec3;
use std::fmt;
use std::str::FromStr;

/// The valid packet sizes.
pub const RAYS_PER_PACKET: [usize; 4] = [1, 2, 4, 8];

/// The size of an image in pixels, written as `WIDTHxHEIGHT`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    pub width: u32,
    pub height: u32,
}

impl ImageSize {
    const LIMIT: u32 = 16384;

    /// # Errors
    /// If a side is 0 or longer than 16384 pixels.
    pub fn new(width: u32, height: u32) -> Result<Self> {
        ensure!(
            (1..=Self::LIMIT).contains(&width) && (1..=Self::LIMIT).contains(&height),
            "an image of {width}x{height} pixels cannot be made; give 1 to {} for each side",
            Self::LIMIT
        );
        Ok(Self { width, height })
    }
}

impl FromStr for ImageSize {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let sides = text.split_once('x');
        match sides.map(|(width, height)| (width.parse(), height.parse())) {
            Some((Ok(width), Ok(height))) => Self::new(width, height),
            _ => {
                bail!("`{text}` is not an image size; give WIDTHxHEIGHT in pixels, such as 512x384")
            }
        }
    }
}

impl fmt::Display for ImageSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// The rays of a packet, and their pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct RayPacket {
    /// Column and row of each ray's pixel, from the upper left; the pixel of an inactive ray may be outside the image.
    pub pixels: Vec<[u32; 2]>,
    pub rays: Vec<Ray>,
}

/// The division of an image into packets: blocks of 1×1, 2×1, 2×2 or 4×2 pixels, row by row from the upper
/// left, and in the same order within a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    size: ImageSize,
    /// Width and height of a block.
    block: [u32; 2],
}

impl Frame {
    /// # Errors
    /// If `rays_per_packet` is not a valid packet size.
    pub fn new(size: ImageSize, rays_per_packet: usize) -> Result<Self> {
        let block = match rays_per_packet {
            1 => [1, 1],
            2 => [2, 1],
            4 => [2, 2],
            8 => [4, 2],
            other => bail!("there are no packets of {other} rays; choose 1, 2, 4 or 8"),
        };
        Ok(Self { size, block })
    }

    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Width and height of a packet's block of pixels.
    pub fn block(&self) -> [u32; 2] {
        self.block
    }

    pub fn rays_per_packet(&self) -> usize {
        (self.block[0] * self.block[1]) as usize
    }

    pub fn packet_count(&self) -> usize {
        self.blocks_per_row() * self.size.height.div_ceil(self.block[1]) as usize
    }

    fn blocks_per_row(&self) -> usize {
        self.size.width.div_ceil(self.block[0]) as usize
    }

    /// The pixels of packet number `packet`; those at the right and lower edge may be outside the image.
    pub fn pixels(&self, packet: usize) -> Vec<[u32; 2]> {
        let [width, height] = self.block;
        let column = (packet % self.blocks_per_row()) as u32 * width;
        let row = (packet / self.blocks_per_row()) as u32 * height;
        (0..height)
            .flat_map(|y| (0..width).map(move |x| [column + x, row + y]))
            .collect()
    }

    /// The rays through the pixels' centres, in the coordinates of `mesh`. The eye is scaled and rounded. The
    /// direction is computed in double precision from the camera and rounded; it is neither normalised nor scaled, so
    /// the distance of a hit is t·|direction| machine units. tmin is 0, tmax +∞; rays of pixels outside the image are inactive.
    ///
    /// # Errors
    /// If the eye exceeds the format's greatest number.
    pub fn primary_rays(&self, camera: &Camera, mesh: &MachineMesh) -> Result<Vec<RayPacket>> {
        self.rays_in(camera, mesh.format, mesh.log2_scale)
    }

    /// [`Frame::primary_rays`] in the coordinates of a world that is scaled by 2^`log2_scale`.
    ///
    /// # Errors
    /// If the eye exceeds the format's greatest number.
    pub fn rays_in(
        &self,
        camera: &Camera,
        format: Format,
        log2_scale: i32,
    ) -> Result<Vec<RayPacket>> {
        let arithmetic = Arithmetic::new(format);
        let scale = power_of_two(log2_scale);
        let origin = camera.eye.map(|x| arithmetic.round(x * scale) + 0.0);
        ensure!(
            origin.iter().all(|x| x.is_finite()),
            "the camera's eye {} lies too far from the scene for {format}; move it nearer",
            camera::shown(camera.eye)
        );
        let ImageSize { width, height } = self.size;
        let (columns, rows) = (f64::from(width), f64::from(height));
        let ray = |[column, row]: [u32; 2]| {
            let x = (2.0 * (f64::from(column) + 0.5) - columns) / rows;
            let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / rows;
            let Camera {
                forward, right, up, ..
            } = camera;
            Ray {
                origin,
                direction: std::array::from_fn(|k| {
                    arithmetic.round(forward[k] + x * right[k] + y * up[k])
                }),
                tmin: 0.0,
                tmax: f64::INFINITY,
                active: column < width && row < height,
                any_hit: false,
            }
        };
        Ok((0..self.packet_count())
            .map(|packet| {
                let pixels = self.pixels(packet);
                let rays = pixels.iter().map(|&pixel| ray(pixel)).collect();
                RayPacket { pixels, rays }
            })
            .collect())
    }
}

/// The rays of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RayKind {
    /// Closest hits of the camera's rays
    Primary,
    /// Any-hit rays of finite length from the camera's hits to a light
    Shadow,
    /// Closest hits of rays from the camera's hits in random directions
    Diffuse,
}

impl RayKind {
    pub const ALL: [RayKind; 3] = [RayKind::Primary, RayKind::Shadow, RayKind::Diffuse];

    pub fn name(self) -> &'static str {
        match self {
            RayKind::Primary => "primary",
            RayKind::Shadow => "shadow",
            RayKind::Diffuse => "diffuse",
        }
    }

    /// The rays of this kind that belong to primary rays with these hits. `seed` is that of random directions.
    ///
    /// # Errors
    /// As [`shadow_rays`].
    ///
    /// # Panics
    /// As [`shadow_rays`].
    pub fn rays(
        self,
        primary: &[RayPacket],
        hits: &[Hit],
        mesh: &MachineMesh,
        light: [f64; 3],
        seed: u64,
    ) -> Result<Vec<RayPacket>> {
        match self {
            RayKind::Primary => Ok(primary.to_vec()),
            RayKind::Shadow => shadow_rays(primary, hits, mesh, light),
            RayKind::Diffuse => Ok(diffuse_rays(primary, hits, mesh, seed)),
        }
    }
}

/// Sorts packets along a Morton curve over the image, so that packets that are cast at the same time are neighbours in both directions.
pub fn sort_along_morton_curve(packets: &mut [RayPacket]) {
    let spread =
        |x: u32| (0..u32::BITS).fold(0u64, |all, k| all | u64::from(x >> k & 1) << (2 * k));
    packets.sort_by_key(|packet| {
        let [column, row] = packet.pixels[0];
        spread(column) | spread(row) << 1
    });
}

/// Any-hit rays from the hits of `packets` to a point light; a hit means shadow.
///
/// `hits` are the results of all rays in order, inactive ones included. `light` is in scene units. The origin of a shadow
/// ray is the hit, moved along the triangle's normal, to the side of the incoming ray, by 32 ulps of the scene's greatest
/// coordinate, or by 1/64 of the diagonal of its box if that is less. The direction is light − origin, tmin is 0 and tmax 1.
/// Rays without a hit, and rays that start exactly at the light, are inactive.
///
/// # Errors
/// If the light exceeds the format's greatest number.
///
/// # Panics
/// If the number of hits is not the number of rays, or if a hit's triangle is not in `mesh`.
pub fn shadow_rays(
    packets: &[RayPacket],
    hits: &[Hit],
    mesh: &MachineMesh,
    light: [f64; 3],
) -> Result<Vec<RayPacket>> {
    let arithmetic = Arithmetic::new(mesh.format);
    let light = light.map(|x| arithmetic.round(x * mesh.scale()) + 0.0);
    ensure!(
        light.iter().all(|x| x.is_finite()),
        "the light lies too far from the scene for {}; move it nearer",
        mesh.format
    );
    let shadow = |point: DVec3, _normal: DVec3| {
        let origin = point.to_array().map(|x| arithmetic.round(x) + 0.0);
        let direction = std::array::from_fn(|k| arithmetic.round(light[k] - origin[k]));
        Ray {
            origin,
            direction,
            tmin: 0.0,
            tmax: 1.0,
            active: direction != [0.0; 3],
            any_hit: true,
        }
    };
    Ok(secondary_rays(packets, hits, mesh, shadow))
}

/// Returns a ray for each hit, from its point in a random direction: with the probability of a cosine to the surface's normal, on the
/// side of the ray that hit it. They are as incoherent as rays become in global illumination. Rays that hit nothing have an inactive
/// ray.
///
/// # Panics
/// As [`shadow_rays`].
pub fn diffuse_rays(
    packets: &[RayPacket],
    hits: &[Hit],
    mesh: &MachineMesh,
    seed: u64,
) -> Vec<RayPacket> {
    let arithmetic = Arithmetic::new(mesh.format);
    let mut rng = fastrand::Rng::with_seed(seed);
    let diffuse = |point: DVec3, normal: DVec3| {
        // A point of the unit sphere around the tip of the normal.
        let (z, angle) = (2.0 * rng.f64() - 1.0, std::f64::consts::TAU * rng.f64());
        let radius = (1.0 - z * z).sqrt();
        let direction = normal + DVec3::new(radius * angle.cos(), radius * angle.sin(), z);
        let direction = direction.to_array().map(|x| arithmetic.round(x) + 0.0);
        Ray {
            origin: point.to_array().map(|x| arithmetic.round(x) + 0.0),
            direction,
            tmin: 0.0,
            tmax: f64::INFINITY,
            active: direction != [0.0; 3],
            any_hit: false,
        }
    };
    secondary_rays(packets, hits, mesh, diffuse)
}

/// A ray for each hit: `make` has the point, moved a little off the surface towards the ray that hit it, and the normal on that side.
fn secondary_rays(
    packets: &[RayPacket],
    hits: &[Hit],
    mesh: &MachineMesh,
    mut make: impl FnMut(DVec3, DVec3) -> Ray,
) -> Vec<RayPacket> {
    let ray_count: usize = packets.iter().map(|packet| packet.rays.len()).sum();
    assert_eq!(hits.len(), ray_count, "every ray has a hit");
    let offset = shadow_offset(mesh);
    let mut of_hit = |ray: &Ray, hit: &Hit| {
        let Some(&triangle) = mesh.triangles.get(hit.triangle as usize) else {
            assert!(!hit.is_hit(), "hits are of this mesh");
            return Ray::INACTIVE;
        };
        let [a, b, c] = triangle.map(|index| DVec3::from(mesh.vertices[index as usize]));
        let direction = DVec3::from(ray.direction);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let towards_ray = if normal.dot(direction) > 0.0 {
            -normal
        } else {
            normal
        };
        let point = DVec3::from(ray.origin) + hit.t * direction + offset * towards_ray;
        let ray = make(point, towards_ray);
        if ray.active { ray } else { Ray::INACTIVE }
    };
    let mut hits = hits.iter();
    packets
        .iter()
        .map(|packet| RayPacket {
            pixels: packet.pixels.clone(),
            rays: std::iter::zip(&packet.rays, &mut hits)
                .map(|(ray, hit)| of_hit(ray, hit))
                .collect(),
        })
        .collect()
}

/// Distance of the origins of secondary rays from the surface, in machine units; see [`shadow_rays`].
fn shadow_offset(mesh: &MachineMesh) -> f64 {
    let (low, high) = mesh.bounds();
    let greatest = low.iter().chain(&high).fold(0f64, |g, x| g.max(x.abs()));
    let ulps = 32.0 * greatest / (1u64 << mesh.format.fraction_bits()) as f64;
    ulps.min(DVec3::from(low).distance(high.into()) / 64.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;
    use crate::scene::builtin;

    fn sphere() -> MachineMesh {
        MachineMesh::new(&builtin("sphere?level=1").unwrap(), Format::FP24).unwrap()
    }

    fn camera() -> Camera {
        Camera::look_at([0.0, 0.0, 3.0], [0.0; 3], [0.0, 1.0, 0.0], 90.0).unwrap()
    }

    fn frame(size: &str, rays: usize) -> Frame {
        Frame::new(size.parse().unwrap(), rays).unwrap()
    }

    #[test]
    fn every_pixel_has_one_active_ray_in_every_packet_size() {
        for size in ["13x7", "1x1", "16x8", "3x2"] {
            let mut rays_by_pixel = Vec::new();
            for count in RAYS_PER_PACKET {
                let frame = frame(size, count);
                let packets = frame.primary_rays(&camera(), &sphere()).unwrap();
                assert_eq!(packets.len(), frame.packet_count());
                let mut active: Vec<([u32; 2], [f64; 3])> = Vec::new();
                for packet in &packets {
                    assert_eq!((packet.pixels.len(), packet.rays.len()), (count, count));
                    for (&pixel, ray) in packet.pixels.iter().zip(&packet.rays) {
                        let is_inside =
                            pixel[0] < frame.size().width && pixel[1] < frame.size().height;
                        assert_eq!(ray.active, is_inside);
                        if ray.active {
                            active.push((pixel, ray.direction));
                        }
                    }
                }
                active.sort_by_key(|&(pixel, _)| pixel);
                let pixels: Vec<_> = active.iter().map(|&(pixel, _)| pixel).collect();
                let ImageSize { width, height } = frame.size();
                let expected: Vec<_> = (0..width)
                    .flat_map(|x| (0..height).map(move |y| [x, y]))
                    .collect();
                assert_eq!(pixels, expected);
                rays_by_pixel.push(active);
            }
            assert!(rays_by_pixel.windows(2).all(|pair| pair[0] == pair[1]));
        }
    }

    #[test]
    fn blocks_have_the_stated_shapes() {
        assert_eq!(frame("8x4", 2).pixels(1), [[2, 0], [3, 0]]);
        assert_eq!(frame("8x4", 4).pixels(5), [[2, 2], [3, 2], [2, 3], [3, 3]]);
        assert_eq!(
            frame("8x4", 8).pixels(1)[4..],
            [[4, 1], [5, 1], [6, 1], [7, 1]]
        );
        let fault = Frame::new("8x4".parse().unwrap(), 3).unwrap_err();
        assert_eq!(
            fault.to_string(),
            "there are no packets of 3 rays; choose 1, 2, 4 or 8"
        );
    }

    #[test]
    fn rays_go_through_pixel_centres() {
        let mesh = sphere();
        let packets = frame("4x2", 1).primary_rays(&camera(), &mesh).unwrap();
        let directions: Vec<_> = packets.iter().map(|p| p.rays[0].direction).collect();
        let row = |y: f64| [-1.5, -0.5, 0.5, 1.5].map(|x| [x, y, -1.0]);
        let expected = [row(0.5), row(-0.5)].concat();
        for (direction, expected) in directions.iter().zip(&expected) {
            let distance = DVec3::from(*direction).distance((*expected).into());
            assert!(distance < 1e-4, "{direction:?} {expected:?}");
        }
        let Ray {
            origin,
            tmin,
            tmax,
            any_hit,
            ..
        } = packets[0].rays[0];
        assert_eq!(mesh.log2_scale, 8);
        assert_eq!(
            (origin, tmin, tmax),
            ([0.0, 0.0, 768.0], 0.0, f64::INFINITY)
        );
        assert!(!any_hit);
    }

    #[test]
    fn an_eye_beyond_the_format_is_refused() {
        let mut camera = camera();
        camera.eye = [1e30, 0.0, 0.0];
        let fault = frame("4x2", 1)
            .primary_rays(&camera, &sphere())
            .unwrap_err();
        let text = fault.to_string();
        assert!(
            text.starts_with("the camera's eye (1e30, 0, 0) lies too far from the scene for "),
            "{text}"
        );
    }

    #[test]
    fn shadow_rays_lead_from_the_lit_side_to_the_light() {
        let mesh = sphere();
        let ray = Ray {
            origin: [0.0, 0.0, 768.0],
            direction: [0.0, 0.0, -1.0],
            tmin: 0.0,
            tmax: f64::INFINITY,
            active: true,
            any_hit: false,
        };
        let packet = RayPacket {
            pixels: vec![[0, 0], [1, 0]],
            rays: vec![ray, ray],
        };
        let hit = Hit {
            t: 512.0,
            u: 0.0,
            v: 0.0,
            instance: 0,
            triangle: 0,
        };
        let light = [0.0, 0.0, 2.0];
        let shadows = shadow_rays(&[packet], &[hit, Hit::MISS], &mesh, light).unwrap();
        let [lit, missed] = shadows[0].rays[..] else {
            panic!("two rays");
        };
        assert!(!missed.active);
        assert!(lit.active && lit.any_hit);
        assert_eq!((lit.tmin, lit.tmax), (0.0, 1.0));
        let origin = DVec3::from(lit.origin);
        let distance = origin.distance(DVec3::new(0.0, 0.0, 256.0));
        let offset = shadow_offset(&mesh);
        assert!(
            (distance - offset).abs() < 0.02 && offset > 0.1,
            "{distance} {offset}"
        );
        assert!(origin.z > 256.0 - 1e-9, "pushed towards the eye");
        let end = origin + DVec3::from(lit.direction);
        assert!(end.distance(DVec3::new(0.0, 0.0, 512.0)) < 0.02);
    }

    #[test]
    fn sizes_are_read_and_refused() {
        let size: ImageSize = "512x384".parse().unwrap();
        assert_eq!(
            (size.width, size.height, size.to_string()),
            (512, 384, "512x384".into())
        );
        for (text, expected) in [
            (
                "512",
                "`512` is not an image size; give WIDTHxHEIGHT in pixels, such as 512x384",
            ),
            (
                "5x-1",
                "`5x-1` is not an image size; give WIDTHxHEIGHT in pixels, such as 512x384",
            ),
            (
                "0x5",
                "an image of 0x5 pixels cannot be made; give 1 to 16384 for each side",
            ),
        ] {
            assert_eq!(text.parse::<ImageSize>().unwrap_err().to_string(), expected);
        }
    }
}
