//! Beams through **volumes**: the isosurfaces that a tile shows.
//!
//! # How it goes
//! 1. At a branch of the tree of ranges two compares tell which of its 64 children an isovalue may lie in. Their boxes are
//!    projected into the plane of the tile, sixteen at a time; those that show are visited front to back, unless each of
//!    their pixels shows something nearer by then ([`walk`]).
//! 2. A brick that a ray enters is made ready once for all rays of the tile: its samples as numbers, and a bit for each cell
//!    with samples on both sides of an isovalue ([`brick_cells`]).
//! 3. The pixels of a block are a *packet* of sixteen rays ([`packet`]). Those that enter the brick, of whichever packet,
//!    take turns in sixteen lanes ([`waiting`]): when half of the lanes are free, others take their places. Each ray steps
//!    through the cells until it is in one whose bit is set; when enough are, their cubics are made ([`cross`], [`cells`],
//!    [`cubics`]).
//! 4. A cubic that changes once between inside and outside has one root, which is all a shadow ray wants to know. What a
//!    pixel wants to know of it is found out when the tile is done, sixteen at a time ([`surface`]).
//! 5. Shadows: the same, with rays from the lit points to the light and the light as the eye ([`shadows`]).
//!
//! # Why it draws what rays draw
//! Culling by projection is conservative. Everything else is the arithmetic of the ray kernel in double precision, lane
//! by lane: which cells a ray is in, where it enters and leaves them, and the cubic. What is rare (two changes of sign,
//! roots of two isosurfaces in a cell) is handed to the ray kernel's own functions.

mod brick_cells;
mod cells;
mod cross;
mod cubics;
mod packet;
mod pixels;
mod shadows;
mod surface;
mod waiting;
mod walk;

use core::marker::PhantomData;

use glam::Vec3;

use super::frustum::Frustum;
use super::pixels::Pixels as MeshPixels;
use super::points::{POINTS_MAX, Points};
use super::samples::Samples;
use super::surface::{Lighting, Met, directions, meet as meet_mesh, shade};
use super::walk::{Beam, walk as walk_mesh};
use super::{Lit, Projection, enters, fill_with_background, shadowed, write};
use crate::blocks::{BLOCKS, ByBlock};
use crate::count::{Count, TileCounts};
use crate::isosurface::Isosurfaces;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::shade::{ALBEDO, AMBIENT};
use crate::simd::{LANES, Lanes, Mask, Part, Simd, Task};
use crate::tile::{Depths, Tile, TileView};
use crate::volume_memo::TileMemo;
use pixels::{FoundByLane, Pixels};
use shadows::Shadows;
use surface::{by_sought, meet};
use walk::{shows, walk};

/// Draws a tile by beams, or tells that it has to be drawn by rays.
pub(crate) fn draw<M: SceneMemory, C: Count, K: Kinds>(
    lanes: Lanes,
    view: &TileView<'_, M>,
    surfaces: &Isosurfaces<'_, M>,
    tile: Tile,
    pixels: &mut [u8],
    work: &mut C,
) -> Option<TileCounts> {
    lanes.run(Draw::<M, C, K> { view, surfaces, tile, pixels, work, kinds: PhantomData })
}

struct Draw<'a, M, C, K> {
    view: &'a TileView<'a, M>,
    surfaces: &'a Isosurfaces<'a, M>,
    tile: Tile,
    pixels: &'a mut [u8],
    work: &'a mut C,
    kinds: PhantomData<K>,
}

impl<M: SceneMemory, C: Count, K: Kinds> Task for Draw<'_, M, C, K> {
    type Output = Option<TileCounts>;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Option<TileCounts> {
        let Self { view, surfaces, tile, pixels: bytes, work, .. } = self;
        let projection = Projection::of_tile(&view.frame.camera, view.eye, tile)?;
        let mesh = match view.scene.header().needs.has_primitives() {
            true => see_mesh::<S, M, C, K>(s, view, &projection, tile, work)?,
            false => None,
        };
        if mesh.is_none() && !shows(s, surfaces, &projection) {
            return Some(fill_with_background(tile, bytes));
        }
        let picture = Picture { view, surfaces, tile, mesh };
        let t_max = picture.depths_of_mesh(s)?;
        let mut found = [FoundByLane::NOTHING; BLOCKS];
        let projection = &projection;
        s.apart(See { view, surfaces, projection, tile, t_max: &t_max, found: &mut found, work })?;
        let mut painted = picture.paint(s, &found)?;
        if painted.hits == 0 {
            return Some(fill_with_background(tile, bytes));
        }
        let lit = &mut painted.lit;
        let shadow = if view.frame.has_shadows() { lit.points.count as u64 } else { 0 };
        let mut dark = 0;
        if shadow != 0 {
            let in_shadow = s.apart(Shade::<_, _, K> { view, surfaces, lit, work, kinds: PhantomData })?;
            dark = lit.darken(&in_shadow, |block, lane| painted.dark[block][lane]);
        }
        write(s, &lit.grey, tile, bytes);
        let t_sum = painted.depths.sum(view.scene.header().scale().inverse());
        let (primary, hits) = (tile.pixels() as u64, painted.hits);
        Some(TileCounts { primary, hits, shadow, lit: shadow - dark, damaged: 0, t_sum })
    }
}

/// What the pixels of a tile show of triangles and spheres, if anything; `None` when rays have to draw the tile.
#[inline(always)]
fn see_mesh<'a, S: Simd, M: SceneMemory, C: Count, K: Kinds>(
    s: S,
    view: &'a TileView<'a, M>,
    projection: &Projection,
    tile: Tile,
    work: &mut C,
) -> Option<Option<MeshPixels<'a, M, K>>> {
    let frustum = Frustum::new(s, projection, &view.scene.header().grid)?;
    if !enters(s, view, &frustum).ok()? {
        return Some(None);
    }
    let mut pixels = MeshPixels::new(view, tile, projection.depth_epsilon);
    walk_mesh::<S, M, C, K, _>(s, view.scene, &Beam { projection, frustum: &frustum }, &mut pixels, work)
        .ok()?;
    Some(pixels.found_anything().ok()?.then_some(pixels))
}

/// A tile, and what its pixels show of triangles and spheres.
struct Picture<'a, M, K> {
    view: &'a TileView<'a, M>,
    surfaces: &'a Isosurfaces<'a, M>,
    tile: Tile,
    mesh: Option<MeshPixels<'a, M, K>>,
}

/// The pixels of a tile before shadows fall on them.
struct Painted {
    lit: Lit,
    depths: Depths,
    /// Their greys where no light falls.
    dark: ByBlock<f32>,
    hits: u64,
}

impl<M: SceneMemory, K: Kinds> Picture<'_, M, K> {
    /// Depths of triangles and spheres; infinite where there is none.
    #[inline(always)]
    fn depths_of_mesh<S: Simd>(&self, s: S) -> Option<[S::F; BLOCKS]> {
        let mut depths = [s.splat(f32::INFINITY); BLOCKS];
        if let Some(mesh) = &self.mesh {
            for (block, depth) in depths.iter_mut().enumerate() {
                let hit = mesh.hit[block];
                if hit != 0 {
                    let met = meet_mesh(s, mesh, block, &self.view.frame.camera, self.tile).ok()?;
                    *depth = s.select(hit, met.t, *depth);
                }
            }
        }
        Some(depths)
    }

    #[inline(always)]
    fn paint<S: Simd>(&self, s: S, found: &[FoundByLane; BLOCKS]) -> Option<Painted> {
        let &TileView { eye, light, shadow_offset, .. } = self.view;
        let lighting = Lighting { eye, light, shadow_offset };
        let dark = [[0.0; LANES]; BLOCKS];
        let mut painted = Painted { lit: Lit::new(), depths: Depths::new(), dark, hits: 0 };
        for (block, found) in found.iter().enumerate() {
            let by_mesh = self.mesh.as_ref().map_or(0, |mesh| mesh.hit[block]) & !found.lanes;
            let hit = by_mesh | found.lanes;
            if hit != 0 {
                let (met, albedo) = self.meet(s, block, found, by_mesh)?;
                let seen = shade(s, &met, albedo, &lighting);
                let dark = s.mul(albedo, s.splat(AMBIENT));
                s.store(s.select(hit, seen.t, s.splat(0.0)), painted.depths.block(block));
                s.store(dark, &mut painted.dark[block]);
                painted.lit.add(s, block, hit, &seen, dark);
                painted.hits += u64::from(hit.count_ones());
            }
        }
        Some(painted)
    }

    /// What the pixels of a block meet, and its greys; those of `by_mesh` meet triangles or spheres.
    #[inline(always)]
    fn meet<S: Simd>(
        &self,
        s: S,
        block: usize,
        found: &FoundByLane,
        by_mesh: Mask,
    ) -> Option<(Met<S::F>, S::F)> {
        let camera = &self.view.frame.camera;
        let (mut met, mut albedo) =
            (Met::nothing(s, directions(s, camera, self.tile, block)), s.splat(ALBEDO));
        if found.lanes != 0 {
            met = meet(s, self.surfaces, &found.load(s), met.direction);
            albedo = albedo_of(s, self.view, self.surfaces, s.load(&found.sought));
        }
        if let Some(mesh) = self.mesh.as_ref().filter(|_| by_mesh != 0) {
            met = met.with(s, by_mesh, &meet_mesh(s, mesh, block, camera, self.tile).ok()?);
            albedo = s.select(by_mesh, s.splat(ALBEDO), albedo);
        }
        Some((met, albedo))
    }
}

/// The grey of the isosurface that each pixel shows.
#[inline(always)]
fn albedo_of<S: Simd, M: SceneMemory>(
    s: S,
    view: &TileView<'_, M>,
    surfaces: &Isosurfaces<'_, M>,
    sought: S::F,
) -> S::F {
    let of_frame = view.frame.isosurfaces();
    let number = |index: usize| surfaces.sought()[index].surface as usize;
    by_sought(s, surfaces, sought, |index| {
        of_frame.get(number(index)).map_or(ALBEDO, |surface| surface.albedo)
    })
}

/// What the pixels of a tile see of the volume.
struct See<'a, S: Simd, M, C> {
    view: &'a TileView<'a, M>,
    surfaces: &'a Isosurfaces<'a, M>,
    projection: &'a Projection,
    tile: Tile,
    t_max: &'a [S::F; BLOCKS],
    found: &'a mut [FoundByLane; BLOCKS],
    work: &'a mut C,
}

impl<S: Simd, M: SceneMemory, C: Count> Part<S> for See<'_, S, M, C> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self, s: S) -> Option<()> {
        let Self { view, surfaces, projection, tile, t_max, found, work } = self;
        walk(s, surfaces, projection, &mut Pixels::new(s, view, tile, found, t_max), work)
    }
}

/// The shadows that the volume casts on samples.
struct Cast<'a, 'b, M, C> {
    surfaces: &'a Isosurfaces<'a, M>,
    projection: &'a Projection,
    samples: &'a mut Samples<'b>,
    work: &'a mut C,
}

impl<S: Simd, M: SceneMemory, C: Count> Part<S> for Cast<'_, '_, M, C> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self, s: S) -> Option<()> {
        let Self { surfaces, projection, samples, work } = self;
        walk(s, surfaces, projection, &mut Shadows(samples), work)
    }
}

/// Which of the lit points of a tile lie in shadow.
struct Shade<'a, M, C, K> {
    view: &'a TileView<'a, M>,
    surfaces: &'a Isosurfaces<'a, M>,
    lit: &'a Lit,
    work: &'a mut C,
    kinds: PhantomData<K>,
}

impl<S: Simd, M: SceneMemory, C: Count, K: Kinds> Part<S> for Shade<'_, M, C, K> {
    type Output = Option<[bool; POINTS_MAX]>;

    #[inline(always)]
    fn run(self, s: S) -> Self::Output {
        let Self { view, surfaces, lit, work, .. } = self;
        let points = &lit.points;
        let mut in_shadow = [false; POINTS_MAX];
        if view.scene.header().needs.has_primitives() {
            in_shadow = shadowed::<S, M, C, K>(s, points, view, work).ok()?;
        }
        let Some(projection) = points.projection(s, view.light) else {
            return ByRays { surfaces, points, light: view.light, work }.add_to(in_shadow);
        };
        let mut samples = Samples::new(points, projection.eye);
        samples.place(s, &projection);
        samples.close_those(s, &in_shadow);
        s.apart(Cast { surfaces, projection: &projection, samples: &mut samples, work })?;
        Some(samples.shadowed)
    }
}

/// The shadows that the volume casts on points where the light is not for beams.
struct ByRays<'a, M, C> {
    surfaces: &'a Isosurfaces<'a, M>,
    points: &'a Points,
    light: Vec3,
    work: &'a mut C,
}

impl<M: SceneMemory, C: Count> ByRays<'_, M, C> {
    /// Adds them to others.
    fn add_to(self, mut in_shadow: [bool; POINTS_MAX]) -> Option<[bool; POINTS_MAX]> {
        let mut memo = TileMemo::new();
        for (index, in_shadow) in in_shadow.iter_mut().take(self.points.count).enumerate() {
            let point = self.points.get(index);
            if !*in_shadow && let Some(ray) = self.surfaces.place.ray(point, self.light - point) {
                *in_shadow = self.surfaces.first_root(&ray, 1.0, &mut memo, self.work).ok()?.is_some();
            }
        }
        Some(in_shadow)
    }
}
