//! Tiles: how a picture is cut, and how one is drawn.

use core::marker::PhantomData;

use glam::Vec3;

use crate::beam;
use crate::blocks::{BLOCKS, ByBlock, block_and_lane};
use crate::count::{Count, TileCounts};
use crate::frame::Frame;
use crate::grid_ray::GridRay;
use crate::kernel::Kernel;
use crate::kinds::{BuiltKinds, ForKinds, Kinds, dispatch};
use crate::memory::SceneMemory;
#[cfg(feature = "volumes")]
use crate::needs::SceneNeeds;
use crate::scale::Scale;
use crate::shade::{self, LitPoint};
use crate::simd::{LANES, Simd, Task};
use crate::triangle_moller::MollerRay;
use crate::triangle_test::{TriangleTest, TriangleTestKind};
use crate::triangle_woop::WoopRay;
use crate::view::{Damaged, SceneView};
use crate::walk::walk_with;

/// Edge of a tile in pixels; tiles at the right and lower edge of a picture may be smaller.
pub const TILE_SIZE: u32 = 32;

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
/// on the scene and the frame alone, not on the kernel. Beams take some 200 KB of stack, and through volumes some 300 KB. The
/// isosurfaces of a volume are those of the frame.
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
    kernel: Kernel,
    pixels: &mut [u8],
    work: &mut C,
) -> TileCounts {
    assert_eq!(pixels.len(), tile.pixels(), "the pixels lent do not fit the tile");
    let view = TileView::new(scene, frame);
    #[cfg(feature = "volumes")]
    if scene.header().needs.contains(SceneNeeds::VOLUME) {
        return crate::volume_tile::draw(&view, tile, kernel, pixels, work);
    }
    if frame.triangle_test() == TriangleTestKind::Moller {
        let (Kernel::Beams(lanes) | Kernel::Rays(lanes)) = kernel;
        let instance = PhantomData::<(BuiltKinds, MollerRay)>;
        return lanes.run(DrawByRays { view: &view, tile, pixels, work, instance });
    }
    dispatch(scene.header().needs, DrawTile { view: &view, tile, kernel, pixels, work })
}

/// A tile, and how to draw it.
struct DrawTile<'a, M, C> {
    view: &'a TileView<'a, M>,
    tile: Tile,
    kernel: Kernel,
    pixels: &'a mut [u8],
    work: &'a mut C,
}

impl<M: SceneMemory, C: Count> ForKinds for DrawTile<'_, M, C> {
    type Output = TileCounts;

    fn run<K: Kinds>(self) -> TileCounts {
        let Self { view, tile, kernel, pixels, work } = self;
        let by_beams = match kernel {
            Kernel::Beams(lanes) => beam::draw::<M, C, K>(lanes, view, tile, pixels, work),
            Kernel::Rays(_) => None,
        };
        let (Kernel::Beams(lanes) | Kernel::Rays(lanes)) = kernel;
        let instance = PhantomData::<(K, WoopRay)>;
        by_beams.unwrap_or_else(|| lanes.run(DrawByRays { view, tile, pixels, work, instance }))
    }
}

/// A tile, to be drawn one ray after the other.
struct DrawByRays<'a, M, C, K, T> {
    view: &'a TileView<'a, M>,
    tile: Tile,
    pixels: &'a mut [u8],
    work: &'a mut C,
    instance: PhantomData<(K, T)>,
}

impl<M: SceneMemory, C: Count, K: Kinds, T: TriangleTest> Task for DrawByRays<'_, M, C, K, T> {
    type Output = TileCounts;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> TileCounts {
        let Self { view, tile, pixels, work, .. } = self;
        draw_by_rays::<S, M, C, K, T>(s, view, tile, pixels, work)
    }
}

#[inline(always)]
fn draw_by_rays<S: Simd, M: SceneMemory, C: Count, K: Kinds, T: TriangleTest>(
    s: S,
    view: &TileView<'_, M>,
    tile: Tile,
    pixels: &mut [u8],
    work: &mut C,
) -> TileCounts {
    let (scene, frame) = (view.scene, view.frame);
    let mut painter = Painter { view, work, counts: TileCounts::default(), depths: Depths::new() };
    for (y, row) in (0_u32..).zip(pixels.chunks_exact_mut(tile.width as usize)) {
        let row_direction = frame.camera.row(tile.y + y);
        for (x, pixel) in (0_u32..).zip(row) {
            let direction = frame.camera.direction(row_direction, tile.x + x);
            *pixel = shade::byte(match painter.grey::<S, K, T>(s, (x as usize, y as usize), direction) {
                Ok(grey) => grey,
                Err(_) => {
                    painter.counts.damaged += 1;
                    shade::BACKGROUND
                }
            });
        }
    }
    let t_sum = painter.depths.sum(scene.header().scale().inverse());
    TileCounts { t_sum, ..painter.counts }
}

/// A scene, and a frame of it in grid units.
pub(crate) struct TileView<'a, M> {
    pub(crate) scene: &'a SceneView<M>,
    pub(crate) frame: &'a Frame,
    pub(crate) eye: Vec3,
    pub(crate) light: Vec3,
    pub(crate) shadow_offset: f32,
}

impl<'a, M: SceneMemory> TileView<'a, M> {
    fn new(scene: &'a SceneView<M>, frame: &'a Frame) -> Self {
        let scale = scene.header().scale();
        Self {
            scene,
            frame,
            eye: scale.apply_to(frame.camera.eye),
            light: scale.apply_to(frame.light),
            shadow_offset: scale.apply(frame.shadow_offset),
        }
    }
}

/// Depths of the pixels of a tile in grid units; 0 where nothing is hit.
pub(crate) struct Depths(ByBlock<f32>);

impl Depths {
    pub(crate) const fn new() -> Self {
        Self([[0.0; LANES]; BLOCKS])
    }

    pub(crate) const fn block(&mut self, block: usize) -> &mut [f32; LANES] {
        &mut self.0[block]
    }

    /// Sum of all depths, in world units; always added in the same order.
    pub(crate) fn sum(&self, world_from_grid: Scale) -> f64 {
        let mut sums = [0.0; LANES];
        for block in &self.0 {
            for (sum, &t) in sums.iter_mut().zip(block) {
                *sum += f64::from(world_from_grid.apply(t));
            }
        }
        sums.iter().sum()
    }
}

/// A tile being drawn ray by ray, and what was counted so far.
struct Painter<'a, M, C> {
    view: &'a TileView<'a, M>,
    work: &'a mut C,
    counts: TileCounts,
    depths: Depths,
}

impl<M: SceneMemory, C: Count> Painter<'_, M, C> {
    /// Grey of the pixel at `(x, y)` of the tile, whose ray goes along `direction`.
    #[inline(always)]
    fn grey<S: Simd, K: Kinds, T: TriangleTest>(
        &mut self,
        s: S,
        (x, y): (usize, usize),
        direction: Vec3,
    ) -> Result<f32, Damaged> {
        let &TileView { scene, eye, light, shadow_offset, .. } = self.view;
        self.counts.primary += 1;
        // In grid units throughout: `t` here is in grid lengths of the direction.
        let Some(ray) = GridRay::new(eye, direction, f32::INFINITY, Scale::ONE, &scene.header().grid) else {
            return Ok(shade::BACKGROUND);
        };
        let nearest = walk_with::<S, M, T, (), C, K, false>(s, scene, &ray, &mut (), self.work)?;
        let Some(hit) = ray.hit::<K>(&nearest) else { return Ok(shade::BACKGROUND) };
        self.counts.hits += 1;
        let (block, lane) = block_and_lane(x, y);
        self.depths.block(block)[lane] = hit.t;
        let at = eye + direction * hit.t;
        match LitPoint::new(at, hit.normal, direction, light, shadow_offset) {
            Some(point) if !self.view.frame.has_shadows() || self.reaches_light::<S, K, T>(s, &point)? => {
                Ok(point.lit_grey())
            }
            _ => Ok(shade::SHADOW),
        }
    }

    #[inline(always)]
    fn reaches_light<S: Simd, K: Kinds, T: TriangleTest>(
        &mut self,
        s: S,
        point: &LitPoint,
    ) -> Result<bool, Damaged> {
        self.counts.shadow += 1;
        let scene = self.view.scene;
        let blocked = match GridRay::new(point.point, point.to_light, 1.0, Scale::ONE, &scene.header().grid) {
            Some(ray) => {
                walk_with::<S, M, T, (), C, K, true>(s, scene, &ray, &mut (), self.work)?.surface.is_some()
            }
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
