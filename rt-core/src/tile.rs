//! Tiles: how a picture is cut, and how one is drawn.

use glam::Vec3;

use crate::count::{Count, TileCounts};
use crate::frame::Frame;
use crate::grid::GridShape;
use crate::grid_ray::GridRay;
use crate::kinds::{ForKinds, Kinds, dispatch};
use crate::memory::SceneMemory;
use crate::scale::Scale;
use crate::shade::{self, LitPoint};
use crate::view::{Damaged, SceneView};
use crate::walk::walk;

/// Edge of a tile in pixels; tiles at the right and lower edge of a picture may be smaller.
pub const TILE_SIZE: u32 = 16;

/// Number of a tile, row by row from the upper left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TileId(pub u32);

/// A rectangle of the picture, in pixels from the upper left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns, `1..=TILE_SIZE`.
    pub width: u32,
    /// Rows, `1..=TILE_SIZE`.
    pub height: u32,
}

/// The tiles of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiles {
    width: u32,
    height: u32,
}

impl Tiles {
    /// The tiles of a picture of `width` by `height` pixels.
    pub const fn of(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Tiles in a row.
    pub const fn columns(&self) -> u32 {
        self.width.div_ceil(TILE_SIZE)
    }

    /// Rows of tiles.
    pub const fn rows(&self) -> u32 {
        self.height.div_ceil(TILE_SIZE)
    }

    /// Number of tiles.
    pub const fn count(&self) -> u32 {
        self.columns() * self.rows()
    }

    /// All numbers of tiles, in order.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = TileId> + use<> {
        (0..self.count()).map(TileId)
    }

    /// The tile with this number, or `None` past the end.
    pub fn get(&self, TileId(id): TileId) -> Option<Tile> {
        if id >= self.count() {
            return None;
        }
        let (x, y) = (id % self.columns() * TILE_SIZE, id / self.columns() * TILE_SIZE);
        Some(Tile { x, y, width: TILE_SIZE.min(self.width - x), height: TILE_SIZE.min(self.height - y) })
    }
}

impl Tile {
    /// Number of pixels.
    pub const fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// Draws one tile: a grey byte per pixel, row by row, into `pixels`.
///
/// Each pixel is one ray from the eye, flat shading, and a hard shadow of the point light. The bytes depend
/// on the scene and the frame alone.
///
/// # Edge cases
/// A pixel whose rays end in [`Damaged`] shows the background and is counted.
///
/// # Panics
/// When `pixels` is not `tile.pixels()` long.
pub fn render_tile<M: SceneMemory, C: Count>(
    scene: &SceneView<M>,
    frame: &Frame,
    tile: Tile,
    pixels: &mut [u8],
    work: &mut C,
) -> TileCounts {
    assert_eq!(pixels.len(), tile.pixels(), "the pixels lent do not fit the tile");
    dispatch(scene.header().needs, DrawTile { scene, frame, tile, pixels, work })
}

/// What [`render_tile`] was called with.
struct DrawTile<'a, M, C> {
    scene: &'a SceneView<M>,
    frame: &'a Frame,
    tile: Tile,
    pixels: &'a mut [u8],
    work: &'a mut C,
}

impl<M: SceneMemory, C: Count> ForKinds for DrawTile<'_, M, C> {
    type Output = TileCounts;

    fn run<K: Kinds>(self) -> TileCounts {
        let Self { scene, frame, tile, pixels, work } = self;
        let mut painter = Painter::new(scene, frame, work);
        for (y, row) in (tile.y..).zip(pixels.chunks_exact_mut(tile.width as usize)) {
            let row_direction = frame.camera.row(y);
            for (x, pixel) in (tile.x..).zip(row) {
                let grey = painter.grey::<K>(frame.camera.direction(row_direction, x)).unwrap_or_else(|_| {
                    painter.counts.damaged += 1;
                    shade::BACKGROUND
                });
                *pixel = shade::byte(grey);
            }
        }
        painter.counts
    }
}

/// The frame in grid units, and what was counted so far.
struct Painter<'a, M, C> {
    scene: &'a SceneView<M>,
    work: &'a mut C,
    grid: &'a GridShape,
    eye: Vec3,
    light: Vec3,
    shadow_offset: f32,
    counts: TileCounts,
}

impl<'a, M: SceneMemory, C: Count> Painter<'a, M, C> {
    fn new(scene: &'a SceneView<M>, frame: &Frame, work: &'a mut C) -> Self {
        let scale = scene.header().scale();
        Self {
            scene,
            work,
            grid: &scene.header().grid,
            eye: scale.apply_to(frame.camera.eye),
            light: scale.apply_to(frame.light),
            shadow_offset: scale.apply(frame.shadow_offset),
            counts: TileCounts::default(),
        }
    }

    /// Grey of the pixel whose ray goes along `direction`.
    #[inline]
    fn grey<K: Kinds>(&mut self, direction: Vec3) -> Result<f32, Damaged> {
        self.counts.primary += 1;
        // In grid units throughout: `t` here is in grid lengths of the direction.
        let Some(ray) = GridRay::new(self.eye, direction, f32::INFINITY, Scale::ONE, self.grid) else {
            return Ok(shade::BACKGROUND);
        };
        let nearest = walk::<M, C, K, false>(self.scene, &ray, self.work)?;
        let Some(hit) = ray.hit::<K>(&nearest) else { return Ok(shade::BACKGROUND) };
        self.counts.hits += 1;
        self.counts.t_sum += f64::from(self.scene.header().scale().inverse().apply(hit.t));
        let at = self.eye + direction * hit.t;
        match LitPoint::new(at, hit.normal, direction, self.light, self.shadow_offset) {
            Some(point) if self.reaches_light::<K>(&point)? => Ok(point.lit_grey()),
            _ => Ok(shade::SHADOW),
        }
    }

    #[inline]
    fn reaches_light<K: Kinds>(&mut self, point: &LitPoint) -> Result<bool, Damaged> {
        self.counts.shadow += 1;
        let blocked = match GridRay::new(point.point, point.to_light, 1.0, Scale::ONE, self.grid) {
            Some(ray) => walk::<M, C, K, true>(self.scene, &ray, self.work)?.surface.is_some(),
            None => false,
        };
        self.counts.lit += u64::from(!blocked);
        Ok(!blocked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_each_pixel_once() {
        for (width, height) in [(1, 1), (15, 33), (16, 16), (17, 64), (100, 3)] {
            let tiles = Tiles::of(width, height);
            let mut covered = [[0_u8; 128]; 128];
            for tile in tiles.ids().map(|id| tiles.get(id).expect("below the count")) {
                assert!(tile.width <= TILE_SIZE && tile.height <= TILE_SIZE && tile.pixels() > 0);
                for y in tile.y..tile.y + tile.height {
                    for x in tile.x..tile.x + tile.width {
                        covered[y as usize][x as usize] += 1;
                    }
                }
            }
            for (y, row) in (0_u32..).zip(&covered) {
                for (x, &times) in (0_u32..).zip(row) {
                    assert_eq!(times, u8::from(x < width && y < height), "pixel {x} {y} of {width}x{height}");
                }
            }
            assert_eq!(tiles.get(TileId(tiles.count())), None);
        }
    }
}
