//! A trace as a volume would make it: beams walk through bricks in Morton order, front to back, and nothing ends them.

use glam::DVec3;
use memsavvy::trace::{NodeFrame, Trace};
use rt_core::schedule::Static;
use rt_core::{TILE_SIZE, TileId, Tiles};

/// A cube of bricks, one to a page, and a camera that goes around it.
///
/// The beam of a tile touches, from front to back in steps of half a brick, the bricks that its nine rays lie in at that
/// depth: the rays through its corners, the middles of its edges, and its middle. The eye is three quarters of the cube's
/// diagonal away from its middle and goes around it by two degrees a frame, a tenth of the cube above the horizon. All numbers
/// follow from this; there is no chance in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Volume {
    /// Bricks along an edge, a power of two up to 1024.
    pub(crate) bricks: u32,
    pub(crate) frames: u32,
    /// Edge of the picture in pixels.
    pub(crate) size: u32,
}

/// A brick of 16 x 16 x 16 bytes is the smallest page.
const PAGE_BYTES: u32 = 4096;

const STEP: f64 = 0.5;
const DEGREES_A_FRAME: f64 = 2.0;

impl Volume {
    pub(crate) fn trace(&self) -> Trace {
        let tiles = Tiles::of(self.size, self.size);
        let schedule = Static::new(tiles, 1);
        let frames = (0..self.frames).map(|frame| {
            let camera = Camera::around(f64::from(self.bricks), frame);
            let mut drawn = NodeFrame::default();
            for tile in schedule.drawing_order(0, frame) {
                drawn.push(tile, &self.beam(&camera, tiles, tile));
            }
            vec![drawn]
        });
        Trace {
            page_bytes: PAGE_BYTES,
            page_count: self.bricks.pow(3),
            nodes: 1,
            size: [self.size; 2],
            frames: frames.collect(),
        }
    }

    /// The pages that the beam of a tile touches, none twice in a row.
    fn beam(&self, camera: &Camera, tiles: Tiles, TileId(tile): TileId) -> Vec<u32> {
        let corner =
            [tile % tiles.columns(), tile / tiles.columns()].map(|place| f64::from(place * TILE_SIZE));
        let half = f64::from(TILE_SIZE) / 2.0;
        let rays: Vec<DVec3> = (0..9)
            .map(|ray| {
                let (x, y) = (corner[0] + half * f64::from(ray % 3), corner[1] + half * f64::from(ray / 3));
                camera.direction(x / f64::from(self.size), y / f64::from(self.size))
            })
            .collect();
        let mut pages = Vec::new();
        let mut depth = 0.0;
        while depth < 2.0 * camera.distance {
            for page in rays.iter().filter_map(|ray| self.brick_at(camera.eye + *ray * depth)) {
                if pages.last() != Some(&page) {
                    pages.push(page);
                }
            }
            depth += STEP;
        }
        pages
    }

    /// The Morton number of the brick that a point lies in.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the cube")]
    fn brick_at(&self, point: DVec3) -> Option<u32> {
        let inside = point.cmpge(DVec3::ZERO).all() && point.cmplt(DVec3::splat(self.bricks.into())).all();
        inside.then(|| morton(point.x as u32) | morton(point.y as u32) << 1 | morton(point.z as u32) << 2)
    }
}

/// An eye, and where it looks.
struct Camera {
    eye: DVec3,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    distance: f64,
}

impl Camera {
    fn around(edge: f64, frame: u32) -> Self {
        let middle = DVec3::splat(edge / 2.0);
        let distance = 0.75 * edge * f64::sqrt(3.0);
        let angle = (DEGREES_A_FRAME * f64::from(frame)).to_radians();
        let eye = middle + DVec3::new(distance * angle.sin(), 0.1 * edge, distance * angle.cos());
        let forward = (middle - eye).normalize();
        let right = forward.cross(DVec3::Y).normalize();
        Self { eye, forward, right, up: right.cross(forward), distance }
    }

    /// The direction of a place in the picture; both parts run from 0 to 1, down and to the right.
    fn direction(&self, x: f64, y: f64) -> DVec3 {
        let half_height = 22.5_f64.to_radians().tan();
        self.forward
            + self.right * ((2.0 * x - 1.0) * half_height)
            + self.up * ((1.0 - 2.0 * y) * half_height)
    }
}

/// Puts two zero bits between the ten lowest bits of a number.
const fn morton(number: u32) -> u32 {
    let number = number & 0x3FF;
    let number = (number | number << 16) & 0x0300_00FF;
    let number = (number | number << 8) & 0x0300_F00F;
    let number = (number | number << 4) & 0x030C_30C3;
    (number | number << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bricks_are_numbered_once_and_neighbours_are_near() {
        let mut numbers: Vec<u32> = Vec::new();
        for (x, y, z) in (0..512).map(|brick| (brick % 8, brick / 8 % 8, brick / 64)) {
            numbers.push(morton(x) | morton(y) << 1 | morton(z) << 2);
        }
        assert_eq!(numbers[0..3], [0, 1, 8]);
        numbers.sort_unstable();
        assert!(numbers.into_iter().eq(0..512));
    }

    #[test]
    fn a_frame_scans_most_of_the_volume_and_the_next_one_nearly_the_same() {
        let trace = Volume { bricks: 8, frames: 2, size: 128 }.trace();
        assert!(trace.pages_per_node_frame() > 0.9 * 512.0, "{}", trace.pages_per_node_frame());
        assert_ne!(trace.frames[0], trace.frames[1]);
    }
}
