//! Marks the pixels in which two intersectors report different triangles.

use image::{Rgb, RgbImage};

use crate::golden::oracle::{Account, Explanation};
use crate::scene::RayPacket;

/// Distance in pixels from a differing pixel to the frame around it.
const REACH: i64 = 4;

/// Colours of the marks: equal distance, near an edge, unexplained.
const SAME_DISTANCE: [u8; 3] = [70, 200, 255];
const NEAR_EDGE: [u8; 3] = [255, 180, 40];
const UNEXPLAINED: [u8; 3] = [255, 40, 160];

/// Fades a picture to dark grey and marks every ray that an account counts as different, by its pixel and a square frame around
/// it: blue for equal distances, orange near an edge, magenta if unexplained.
///
/// # Panics
/// If the account names a ray that is not in `packets`.
pub fn mark_differences(picture: &mut RgbImage, packets: &[RayPacket], account: &Account) {
    for pixel in picture.pixels_mut() {
        let [red, green, blue] = pixel.0.map(u32::from);
        let grey = (2 * red + 5 * green + blue) / 8 / 2;
        *pixel = Rgb([grey as u8; 3]);
    }
    let pixels: Vec<[u32; 2]> = (packets.iter())
        .flat_map(|packet| packet.pixels.iter().copied())
        .collect();
    let (width, height) = picture.dimensions();
    for &(index, explanation) in &account.differences {
        let colour = Rgb(match explanation {
            Explanation::Agrees => continue,
            Explanation::SameDistance { .. } => SAME_DISTANCE,
            Explanation::NearEdge { .. } => NEAR_EDGE,
            Explanation::Unexplained { .. } => UNEXPLAINED,
        });
        let [column, row] = pixels[index].map(i64::from);
        for y in -REACH..=REACH {
            for x in -REACH..=REACH {
                let around = x.abs().max(y.abs());
                let (x, y) = (column + x, row + y);
                let inside =
                    (0..i64::from(width)).contains(&x) && (0..i64::from(height)).contains(&y);
                if inside && (around == REACH || around == 0) {
                    picture.put_pixel(x as u32, y as u32, colour);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::port::Ray;

    #[test]
    fn a_difference_is_framed_and_the_rest_is_grey() {
        let packets: Vec<RayPacket> = (0..20)
            .flat_map(|row| (0..20).map(move |column| [column, row]))
            .map(|pixel| RayPacket {
                pixels: vec![pixel],
                rays: vec![Ray::INACTIVE],
            })
            .collect();
        let near_edge = Explanation::NearEdge {
            distance: 0.0,
            epsilon: 1.0,
        };
        let account = Account {
            near_edge: 2,
            differences: vec![(0, near_edge), (10 * 20 + 12, near_edge)],
            ..Account::default()
        };
        let mut picture = RgbImage::from_pixel(20, 20, Rgb([80, 160, 40]));
        mark_differences(&mut picture, &packets, &account);
        for marked in [(0, 0), (4, 0), (4, 4), (0, 4), (12, 10), (8, 6), (16, 14)] {
            assert_eq!(
                picture.get_pixel(marked.0, marked.1).0,
                NEAR_EDGE,
                "{marked:?}"
            );
        }
        let count = picture
            .pixels()
            .filter(|pixel| pixel.0 == NEAR_EDGE)
            .count();
        // A full frame of 9 × 9 pixels with its centre; of the other frame, the part within the picture.
        assert_eq!(count, (9 * 9 - 7 * 7 + 1) + (5 + 4 + 1));
        let Rgb([red, green, blue]) = *picture.get_pixel(1, 1);
        assert!(red == green && green == blue && red < 80);
    }
}
