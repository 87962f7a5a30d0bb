//! Tiles of scenes with a volume.

use core::marker::PhantomData;

use glam::Vec3;

use crate::beam;
use crate::blocks::block_and_lane;
use crate::count::{Count, TileCounts};
use crate::grid_ray::GridRay;
use crate::isosurface::{Isosurfaces, single};
use crate::kernel::Kernel;
use crate::kinds::{ForKinds, Kinds, dispatch_beside_volume};
use crate::memory::SceneMemory;
use crate::scale::Scale;
use crate::shade::{self, ALBEDO, AMBIENT, LitPoint};
use crate::simd::{Simd, Task};
use crate::tile::{Depths, Tile, TileView};
use crate::view::Damaged;
use crate::volume_memo::TileMemo;
use crate::walk::walk;

/// Draws a tile of a scene with a volume, and perhaps triangles and spheres besides: of both the nearer is seen, and
/// each throws shadows on the other.
pub(crate) fn draw<M: SceneMemory, C: Count>(
    view: &TileView<'_, M>,
    tile: Tile,
    kernel: Kernel,
    pixels: &mut [u8],
    work: &mut C,
) -> TileCounts {
    let mut values = [0.0; crate::frame::ISOVALUES_MAX];
    let surfaces = view.frame.isosurfaces();
    values.iter_mut().zip(surfaces).for_each(|(value, surface)| *value = surface.value);
    let Ok(isosurfaces) = view.scene.isosurfaces(&values[..surfaces.len()], view.frame.solver()) else {
        pixels.fill(shade::byte(shade::BACKGROUND));
        let rays = pixels.len() as u64;
        return TileCounts { primary: rays, damaged: rays, ..TileCounts::default() };
    };
    dispatch_beside_volume(
        view.scene.header().needs,
        DrawTile { view, isosurfaces, tile, kernel, pixels, work },
    )
}

/// A tile, and how to draw it.
struct DrawTile<'a, M, C> {
    view: &'a TileView<'a, M>,
    isosurfaces: Option<Isosurfaces<'a, M>>,
    tile: Tile,
    kernel: Kernel,
    pixels: &'a mut [u8],
    work: &'a mut C,
}

impl<M: SceneMemory, C: Count> ForKinds for DrawTile<'_, M, C> {
    type Output = TileCounts;

    fn run<K: Kinds>(self) -> TileCounts {
        let Self { view, isosurfaces, tile, kernel, pixels, work } = self;
        let by_beams = match (kernel, &isosurfaces) {
            (Kernel::Beams(lanes), Some(surfaces)) => {
                beam::volume::draw::<M, C, K>(lanes, view, surfaces, tile, pixels, work)
            }
            (Kernel::Beams(lanes), None) if view.scene.header().needs.has_primitives() => {
                beam::draw::<M, C, K>(lanes, view, tile, pixels, work)
            }
            _ => None,
        };
        let (Kernel::Beams(lanes) | Kernel::Rays(lanes)) = kernel;
        let tile = DrawTile { view, isosurfaces, tile, kernel, pixels, work };
        by_beams.unwrap_or_else(|| lanes.run(DrawByRays { tile, kinds: PhantomData::<K> }))
    }
}

/// A tile, to be drawn one ray after the other.
struct DrawByRays<'a, M, C, K> {
    tile: DrawTile<'a, M, C>,
    kinds: PhantomData<K>,
}

impl<M: SceneMemory, C: Count, K: Kinds> Task for DrawByRays<'_, M, C, K> {
    type Output = TileCounts;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> TileCounts {
        let DrawTile { view, isosurfaces, tile, pixels, work, .. } = self.tile;
        let counts = TileCounts::default();
        let mut painter =
            Painter { s, view, isosurfaces, memo: TileMemo::new(), work, counts, depths: Depths::new() };
        for (y, row) in (0_u32..).zip(pixels.chunks_exact_mut(tile.width as usize)) {
            let row_direction = view.frame.camera.row(tile.y + y);
            for (x, pixel) in (0_u32..).zip(row) {
                let direction = view.frame.camera.direction(row_direction, tile.x + x);
                *pixel = shade::byte(match painter.grey::<K>((x as usize, y as usize), direction) {
                    Ok(grey) => grey,
                    Err(_) => {
                        painter.counts.damaged += 1;
                        shade::BACKGROUND
                    }
                });
            }
        }
        let t_sum = painter.depths.sum(view.scene.header().scale().inverse());
        TileCounts { t_sum, ..painter.counts }
    }
}

/// A tile being drawn ray by ray, and what was counted so far.
struct Painter<'a, S, M, C> {
    s: S,
    view: &'a TileView<'a, M>,
    isosurfaces: Option<Isosurfaces<'a, M>>,
    memo: TileMemo,
    work: &'a mut C,
    counts: TileCounts,
    depths: Depths,
}

/// What a pixel shows.
struct Seen {
    t: f32,
    normal: Vec3,
    albedo: f32,
}

impl<S: Simd, M: SceneMemory, C: Count> Painter<'_, S, M, C> {
    /// Grey of the pixel at `(x, y)` of the tile, whose ray goes along `direction`.
    #[inline]
    fn grey<K: Kinds>(&mut self, (x, y): (usize, usize), direction: Vec3) -> Result<f32, Damaged> {
        let &TileView { eye, light, shadow_offset, frame, .. } = self.view;
        self.counts.primary += 1;
        let Some(seen) = self.nearest::<K>(eye, direction)? else { return Ok(shade::BACKGROUND) };
        self.counts.hits += 1;
        let (block, lane) = block_and_lane(x, y);
        self.depths.block(block)[lane] = seen.t;
        let at = eye + direction * seen.t;
        match LitPoint::new(at, seen.normal, direction, light, shadow_offset) {
            Some(point) if !frame.has_shadows() || self.reaches_light::<K>(&point)? => {
                Ok(point.lit_grey_of(seen.albedo))
            }
            _ => Ok(seen.albedo * AMBIENT),
        }
    }

    /// The nearest of triangles, spheres and isosurfaces; at one place the isosurface comes last.
    #[inline]
    fn nearest<K: Kinds>(&mut self, eye: Vec3, direction: Vec3) -> Result<Option<Seen>, Damaged> {
        let scene = self.view.scene;
        let mut seen = None;
        if scene.header().needs.has_primitives()
            && let Some(ray) = GridRay::new(eye, direction, f32::INFINITY, Scale::ONE, &scene.header().grid)
        {
            let nearest = walk::<S, M, C, K, false>(self.s, scene, &ray, self.work)?;
            seen = ray.hit::<K>(&nearest).map(|hit| Seen { t: hit.t, normal: hit.normal, albedo: ALBEDO });
        }
        let Some(isosurfaces) = &self.isosurfaces else { return Ok(seen) };
        let t_max = seen.as_ref().map_or(f64::INFINITY, |seen| f64::from(seen.t));
        if let Some(ray) = isosurfaces.place.ray(eye, direction)
            && let Some(root) = isosurfaces.first_root(&ray, t_max, &mut self.memo, self.work)?
        {
            let surface = isosurfaces.sought()[root.index].surface as usize;
            let albedo = self.view.frame.isosurfaces().get(surface).map_or(ALBEDO, |surface| surface.albedo);
            seen = Some(Seen {
                t: single(root.t()),
                normal: isosurfaces.normal(&ray, &root, direction),
                albedo,
            });
        }
        Ok(seen)
    }

    #[inline]
    fn reaches_light<K: Kinds>(&mut self, point: &LitPoint) -> Result<bool, Damaged> {
        self.counts.shadow += 1;
        let blocked = self.is_blocked::<K>(point)?;
        self.counts.lit += u64::from(!blocked);
        Ok(!blocked)
    }

    #[inline]
    fn is_blocked<K: Kinds>(&mut self, point: &LitPoint) -> Result<bool, Damaged> {
        let scene = self.view.scene;
        if scene.header().needs.has_primitives()
            && let Some(ray) =
                GridRay::new(point.point, point.to_light, 1.0, Scale::ONE, &scene.header().grid)
            && walk::<S, M, C, K, true>(self.s, scene, &ray, self.work)?.surface.is_some()
        {
            return Ok(true);
        }
        match self.isosurfaces.as_ref().and_then(|s| Some((s, s.place.ray(point.point, point.to_light)?))) {
            Some((isosurfaces, ray)) => {
                Ok(isosurfaces.first_root(&ray, 1.0, &mut self.memo, self.work)?.is_some())
            }
            None => Ok(false),
        }
    }
}
