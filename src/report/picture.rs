//! Pictures of hits and of counts per packet.

use super::Staged;
use crate::port::{Hit, Ray};
use crate::scene::{ImageSize, MachineMesh, RayPacket};
use crate::text;
use anyhow::{Context, Result};
use glam::{DVec3, dvec3};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, DynamicImage, Frame, ImageFormat, Rgb, RgbImage};
use std::path::Path;

/// Draws the hits of the primary rays of `packets`. Each triangle has one shade, which depends on the angle between its plane
/// and the ray, and a slight tint of its own; misses show a background. If `shadowed` is given, with one value
/// per ray in order, the pixels of shadowed rays are darkened.
///
/// `hits` are the results of all rays in order, inactive ones included.
///
/// # Panics
/// If the number of hits or shadows is not the number of rays, or if a hit's triangle is not in `mesh`.
pub fn shade(
    size: ImageSize,
    packets: &[RayPacket],
    hits: &[Hit],
    mesh: &MachineMesh,
    shadowed: Option<&[bool]>,
) -> RgbImage {
    let corners = |hit: &Hit| {
        let triangle = mesh.triangles[hit.triangle as usize];
        triangle.map(|index| mesh.vertices[index as usize])
    };
    shade_triangles(size, packets, hits, corners, shadowed)
}

/// Draws the hits of the primary rays of `packets` as [`shade`] does; `corners` returns the corners of a hit's
/// triangle in the world.
///
/// # Panics
/// If the number of hits or shadows is not the number of rays.
pub fn shade_triangles(
    size: ImageSize,
    packets: &[RayPacket],
    hits: &[Hit],
    corners: impl Fn(&Hit) -> [[f64; 3]; 3],
    shadowed: Option<&[bool]>,
) -> RgbImage {
    let rays: usize = packets.iter().map(|packet| packet.rays.len()).sum();
    assert_eq!(hits.len(), rays, "every ray has a hit");
    assert!(
        shadowed.is_none_or(|s| s.len() == rays),
        "every ray has a shadow or none"
    );
    let mut picture = RgbImage::new(size.width, size.height);
    let pixels = packets
        .iter()
        .flat_map(|packet| std::iter::zip(&packet.pixels, &packet.rays));
    for (number, ((&[column, row], ray), hit)) in pixels.zip(hits).enumerate() {
        if !ray.active {
            continue;
        }
        let light = match shadowed {
            Some(shadowed) if shadowed[number] => 0.4,
            _ => 1.0,
        };
        let colour = match hit.is_hit() {
            true => light * surface(corners(hit), ray, hit),
            false => background(f64::from(row) / f64::from(size.height)),
        };
        picture.put_pixel(column, row, to_pixel(colour));
    }
    picture
}

/// The linear colour of a triangle for a ray.
fn surface(corners: [[f64; 3]; 3], ray: &Ray, hit: &Hit) -> DVec3 {
    let [a, b, c] = corners.map(DVec3::from);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let direction = DVec3::from(ray.direction).normalize_or_zero();
    // A lamp at the eye lights both sides; a little light from above distinguishes walls from floors.
    let facing = if normal.dot(direction) > 0.0 {
        -normal
    } else {
        normal
    };
    let lamp = 0.02 + 0.52 * facing.dot(-direction).powf(1.4);
    let sky = 0.1 * (1.0 + facing.y);
    // Neighbouring triangles and instances have consecutive numbers; mixing the bits makes their tints differ. Instance 0, the
    // only one in a scene of one level, leaves the number unchanged.
    let number = hit.triangle ^ hit.instance.wrapping_mul(0xc2b2_ae35);
    let mixed = number.wrapping_mul(0x9e37_79b1) ^ number.rotate_left(15).wrapping_mul(0x85eb_ca6b);
    let byte = |shift: u32| f64::from(mixed >> shift & 255) / 255.0 - 0.5;
    let tint = dvec3(0.95, 0.82, 0.66) + 0.07 * dvec3(byte(0), byte(8), byte(16)) + 0.1 * byte(24);
    tint * (lamp + sky)
}

/// A gradient from a light horizon at the lower edge to a darker sky.
fn background(down: f64) -> DVec3 {
    dvec3(0.05, 0.09, 0.17).lerp(dvec3(0.34, 0.4, 0.46), down)
}

fn to_pixel(linear: DVec3) -> Rgb<u8> {
    let encode = |x: f64| (x.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
    Rgb([encode(linear.x), encode(linear.y), encode(linear.z)])
}

/// Draws one count per packet, such as its steps, on the scale of [`heatmap_colour`], in which `greatest` is 1; by
/// default that is the maximum count. Returns the picture and `greatest`.
///
/// # Panics
/// If the number of counts is not the number of packets.
pub fn heatmap(
    size: ImageSize,
    packets: &[RayPacket],
    counts: &[u32],
    greatest: Option<u32>,
) -> (RgbImage, u32) {
    assert_eq!(packets.len(), counts.len(), "every packet has a count");
    let greatest = greatest.unwrap_or_else(|| counts.iter().copied().max().unwrap_or(0));
    let mut picture = RgbImage::new(size.width, size.height);
    for (packet, &count) in packets.iter().zip(counts) {
        let colour = heatmap_colour(f64::from(count) / f64::from(greatest.max(1)));
        for (&[column, row], ray) in packet.pixels.iter().zip(&packet.rays) {
            if ray.active {
                picture.put_pixel(column, row, Rgb(colour));
            }
        }
    }
    (picture, greatest)
}

/// A colour for a value from 0 to 1 (others are clamped): from near black through violet, red and orange to light
/// yellow. The lightness increases with the value, so the picture is readable without colour.
pub fn heatmap_colour(value: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 7] = [
        [8.0, 6.0, 28.0],
        [58.0, 16.0, 96.0],
        [124.0, 30.0, 112.0],
        [192.0, 50.0, 84.0],
        [236.0, 104.0, 44.0],
        [248.0, 172.0, 48.0],
        [252.0, 246.0, 176.0],
    ];
    let place = value.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let lower = (place as usize).min(STOPS.len() - 2);
    let share = place - lower as f64;
    std::array::from_fn(|k| {
        let (a, b) = (STOPS[lower][k], STOPS[lower + 1][k]);
        (a + share * (b - a)).round() as u8
    })
}

/// Writes a picture as PNG, independent of the file's extension.
///
/// # Errors
/// One line that names the file if it cannot be written.
pub fn write_png(path: &Path, picture: &RgbImage) -> Result<()> {
    Staged::png(path, picture)?.publish()
}

/// Writes pictures as a GIF, see [`Staged::gif`].
///
/// # Errors
/// One line that names the file if it cannot be written or drawn.
///
/// # Panics
/// Unless `frames_per_second` is above 0 and finite.
pub fn write_gif(path: &Path, pictures: &[RgbImage], frames_per_second: f64) -> Result<()> {
    Staged::gif(path, pictures, frames_per_second)?.publish()
}

impl Staged {
    /// Stages a picture as PNG, independent of the file's extension.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn png(path: &Path, picture: &RgbImage) -> Result<Staged> {
        let mut png = std::io::Cursor::new(Vec::new());
        picture
            .write_to(&mut png, ImageFormat::Png)
            .with_context(|| format!("{}: cannot be drawn", text::path(path)))?;
        Staged::write(path, |file| {
            Ok(std::io::Write::write_all(file, png.get_ref())?)
        })
    }

    /// Stages pictures as a GIF that repeats forever, independent of the file's extension.
    ///
    /// GIF counts in hundredths of a second, and players handle values below 2 badly. Each picture gets the duration nearest
    /// to 1 / `frames_per_second`, at least 2.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written or drawn.
    ///
    /// # Panics
    /// Unless `frames_per_second` is above 0 and finite.
    pub fn gif(path: &Path, pictures: &[RgbImage], frames_per_second: f64) -> Result<Staged> {
        assert!(frames_per_second > 0.0 && frames_per_second.is_finite());
        // The maximum of the format, 655 s, is longer than any picture of an animation.
        let hundredths = (100.0 / frames_per_second).round().clamp(2.0, 65535.0) as u32;
        let delay = Delay::from_numer_denom_ms(10 * hundredths, 1);
        let mut gif = Vec::new();
        let drawn = (|| {
            let mut encoder = GifEncoder::new_with_speed(&mut gif, 10);
            encoder.set_repeat(Repeat::Infinite)?;
            for picture in pictures {
                let picture = DynamicImage::from(picture.clone()).to_rgba8();
                encoder.encode_frame(Frame::from_parts(picture, 0, 0, delay))?;
            }
            Ok::<_, image::ImageError>(())
        })();
        drawn.with_context(|| format!("{}: cannot be drawn", text::path(path)))?;
        Staged::write(path, |file| Ok(std::io::Write::write_all(file, &gif)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;
    use crate::scene::{self, Camera, builtin};

    /// Four packets of two rays for 3×2 pixels; the last ray of each row is outside the image.
    fn small() -> (ImageSize, Vec<RayPacket>, MachineMesh) {
        let size = ImageSize::new(3, 2).unwrap();
        let scene = builtin("sphere?level=0").unwrap();
        let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
        let frame = scene::Frame::new(size, 2).unwrap();
        let camera = Camera::outside(scene.bounds());
        let packets = frame.primary_rays(&camera, &mesh).unwrap();
        (size, packets, mesh)
    }

    #[test]
    fn hits_misses_and_shadows_differ() {
        let (size, packets, mesh) = small();
        let hit = Hit {
            t: 1.0,
            u: 0.0,
            v: 0.0,
            instance: 0,
            triangle: 0,
        };
        let mut hits = [Hit::MISS; 8];
        hits[0] = hit;
        hits[1] = hit;
        let mut shadowed = [false; 8];
        shadowed[1] = true;
        let picture = shade(size, &packets, &hits, &mesh, Some(&shadowed));
        assert_eq!(picture.dimensions(), (3, 2));
        let brightness = |x, y| -> u32 {
            let Rgb(colour) = picture.get_pixel(x, y);
            colour.iter().map(|&c| u32::from(c)).sum()
        };
        assert!(brightness(0, 0) > brightness(1, 0), "the shadow is darker");
        assert_ne!(picture.get_pixel(0, 0), picture.get_pixel(2, 0));
        assert!(
            brightness(0, 1) > brightness(2, 0),
            "the background lightens downwards"
        );
    }

    #[test]
    fn the_heat_map_spans_its_scale() {
        let (size, packets, _) = small();
        let (picture, greatest) = heatmap(size, &packets, &[0, 5, 10, 10], None);
        assert_eq!(greatest, 10);
        assert_eq!(picture.get_pixel(0, 0).0, heatmap_colour(0.0));
        assert_eq!(picture.get_pixel(2, 0).0, heatmap_colour(0.5));
        assert_eq!(picture.get_pixel(0, 1).0, heatmap_colour(1.0));
        let (picture, greatest) = heatmap(size, &packets, &[0, 5, 10, 10], Some(20));
        assert_eq!(
            (greatest, picture.get_pixel(0, 1).0),
            (20, heatmap_colour(0.5))
        );
        assert_eq!(heatmap(size, &packets, &[0; 4], None).1, 0);
    }

    #[test]
    fn heat_map_colours_lighten_throughout() {
        let light = |[r, g, b]: [u8; 3]| {
            0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
        };
        let scale: Vec<f64> = (0..=100)
            .map(|i| light(heatmap_colour(f64::from(i) / 100.0)))
            .collect();
        assert!(scale.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(heatmap_colour(-1.0), heatmap_colour(0.0));
        assert_eq!(heatmap_colour(7.0), heatmap_colour(1.0));
    }

    #[test]
    fn a_png_reads_back_whatever_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let (size, packets, _) = small();
        let (picture, _) = heatmap(size, &packets, &[1, 2, 3, 4], None);
        let path = folder.path().join("picture");
        write_png(&path, &picture).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let read = image::load_from_memory_with_format(&bytes, ImageFormat::Png).unwrap();
        assert_eq!(read.to_rgb8(), picture);
        assert!(write_png(&folder.path().join("no/such/place.png"), &picture).is_err());
    }

    #[test]
    fn a_gif_reads_back_frame_by_frame() {
        use image::AnimationDecoder;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("moving");
        let pictures: Vec<RgbImage> = [[255, 0, 0], [0, 0, 255], [0, 255, 0]]
            .map(|colour| RgbImage::from_pixel(5, 4, Rgb(colour)))
            .into();
        write_gif(&path, &pictures, 24.0).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), 3);
        for (frame, picture) in frames.iter().zip(&pictures) {
            assert_eq!(frame.delay().numer_denom_ms(), (40, 1));
            let read = DynamicImage::from(frame.buffer().clone()).to_rgb8();
            assert_eq!(&read, picture);
        }
    }
}
