//! Beams through **volumes**: the isosurfaces that a tile shows.
//!
//! # How it goes
//! 1. At a branch of the tree of ranges two compares tell which of its 64 children an isovalue may lie in. Their boxes are
//!    projected into the plane of the tile, sixteen at a time; those that show are visited front to back, unless each of
//!    their pixels shows something nearer by then ([`walk`]).
//! 2. A brick that a ray enters is made ready once for all rays of the tile: its samples as numbers, and a bit for each cell
//!    with samples on both sides of an isovalue ([`brick_cells`]).
//! 3. The pixels of a block are a *packet* of sixteen rays ([`packet`]). Each ray steps through the cells of the brick until
//!    it is in one whose bit is set; when all are, or have left, their cubics are made ([`cells`], [`cubics`]).
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
mod walk;

use core::marker::PhantomData;

use super::frustum::Frustum;
use super::points::POINTS_MAX;
use super::sample_tests::Shadows as MeshShadows;
use super::samples::Samples;
use super::sphere_samples::SphereRoom;
use super::surface::{Lighting, Met, directions, meet as meet_mesh, shade};
use super::walk::{Beam, walk as walk_mesh};
use super::{Lit, Projection, see, write};
use crate::blocks::BLOCKS;
use crate::count::{Count, TileCounts};
use crate::grid_ray::GridRay;
use crate::isosurface::Isosurfaces;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::scale::Scale;
use crate::shade::{ALBEDO, AMBIENT, BACKGROUND, byte};
use crate::simd::{LANES, Lanes, Part, Simd, Task};
use crate::tile::{Depths, Tile, TileView};
use crate::volume_memo::TileMemo;
use crate::walk::walk as walk_by_ray;
use pixels::{Found, Pixels};
use shadows::Shadows;
use surface::{by_sought, meet};
use walk::walk;

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
        let camera = &view.frame.camera;
        let projection = Projection::of_tile(camera, view.eye, tile)?;
        let mesh = match view.scene.header().needs.has_primitives() {
            true => see::<S, M, C, K>(s, view, tile, work)?.ok()?,
            false => None,
        };
        let mut t_max = [s.splat(f32::INFINITY); BLOCKS];
        if let Some(mesh) = &mesh {
            for (block, t_max) in t_max.iter_mut().enumerate().filter(|(block, _)| mesh.hit[*block] != 0) {
                *t_max = s.select(mesh.hit[block], meet_mesh(s, mesh, block, camera, tile).ok()?.t, *t_max);
            }
        }
        let mut found = [Found::nothing(s); BLOCKS];
        let seeing = See { view, surfaces, projection: &projection, tile, t_max: &t_max, found: &mut found, work };
        s.apart(seeing)?;
        let lighting = Lighting { eye: view.eye, light: view.light, shadow_offset: view.shadow_offset };
        let (mut lit, mut depths, mut dark) = (Lit::new(), Depths::new(), [[0.0; LANES]; BLOCKS]);
        let mut hits = 0;
        for block in 0..BLOCKS {
            let by_mesh = mesh.as_ref().map_or(0, |mesh| mesh.hit[block]) & !found[block].lanes;
            let hit = by_mesh | found[block].lanes;
            if hit == 0 {
                continue;
            }
            hits += u64::from(hit.count_ones());
            let (mut met, mut albedo) = (Met::nothing(s, directions(s, camera, tile, block)), s.splat(ALBEDO));
            if found[block].lanes != 0 {
                met = meet(s, surfaces, &found[block], met.direction);
                albedo = albedo_of(s, view, surfaces, &found[block]);
            }
            if let Some(mesh) = mesh.as_ref().filter(|_| by_mesh != 0) {
                let of_mesh = meet_mesh(s, mesh, block, camera, tile).ok()?;
                met = met.with(s, by_mesh, &of_mesh);
                albedo = s.select(by_mesh, s.splat(ALBEDO), albedo);
            }
            let seen = shade(s, &met, albedo, &lighting);
            s.store(s.select(hit, seen.t, s.splat(0.0)), depths.block(block));
            let unlit = s.mul(albedo, s.splat(AMBIENT));
            s.store(unlit, &mut dark[block]);
            lit.add(s, block, hit, &seen, unlit);
        }
        let counts = TileCounts { primary: tile.pixels() as u64, hits, ..TileCounts::default() };
        if hits == 0 {
            bytes.fill(byte(BACKGROUND));
            return Some(counts);
        }
        let shadow = if view.frame.has_shadows() { lit.points.count as u64 } else { 0 };
        let mut shadowed = 0;
        if shadow != 0 {
            let in_shadow = s.apart(Shade::<_, _, K> { view, surfaces, lit: &lit, work, kinds: PhantomData })?;
            shadowed = lit.darken(&in_shadow, |block, lane| dark[block][lane]);
        }
        write(s, &lit.grey, tile, bytes);
        let t_sum = depths.sum(view.scene.header().scale().inverse());
        Some(TileCounts { shadow, lit: shadow - shadowed, t_sum, ..counts })
    }
}

/// The grey of the isosurface that each pixel shows.
#[inline(always)]
fn albedo_of<S: Simd, M: SceneMemory>(
    s: S,
    view: &TileView<'_, M>,
    surfaces: &Isosurfaces<'_, M>,
    found: &Found<S::D, S::F>,
) -> S::F {
    let of_frame = view.frame.isosurfaces();
    let number = |index: usize| surfaces.sought()[index].surface as usize;
    by_sought(s, surfaces, found.sought, |index| {
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
    found: &'a mut [Found<S::D, S::F>; BLOCKS],
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
    fn run(mut self, s: S) -> Self::Output {
        match self.lit.points.projection(s, self.view.light) {
            Some(projection) => self.by_beam(s, &projection),
            None => self.by_rays(s),
        }
    }
}

impl<M: SceneMemory, C: Count, K: Kinds> Shade<'_, M, C, K> {
    #[inline(always)]
    fn by_beam<S: Simd>(&mut self, s: S, projection: &Projection) -> Option<[bool; POINTS_MAX]> {
        let Self { view, surfaces, lit, work, .. } = self;
        let mut samples = Samples::new(s, &lit.points, projection);
        if view.scene.header().needs.has_primitives() {
            let frustum = Frustum::new(s, projection, &view.scene.header().grid)?;
            let spheres = if K::SPHERES { Some(SphereRoom::new()) } else { None };
            let mut by_mesh = MeshShadows::new(samples, spheres);
            let beam = Beam { projection, frustum: &frustum };
            walk_mesh::<S, M, C, K, _>(s, view.scene, &beam, &mut by_mesh, *work).ok()?;
            samples = by_mesh.samples;
        }
        s.apart(Cast { surfaces, projection, samples: &mut samples, work: *work })?;
        Some(samples.shadowed)
    }

    #[inline(always)]
    fn by_rays<S: Simd>(&mut self, s: S) -> Option<[bool; POINTS_MAX]> {
        let Self { view, surfaces, lit, work, .. } = self;
        let (mut shadowed, mut memo) = ([false; POINTS_MAX], TileMemo::new());
        for (index, shadowed) in shadowed.iter_mut().take(lit.points.count).enumerate() {
            let point = lit.points.get(index);
            let to_light = view.light - point;
            if view.scene.header().needs.has_primitives()
                && let Some(ray) = GridRay::new(point, to_light, 1.0, Scale::ONE, &view.scene.header().grid)
            {
                let nearest = walk_by_ray::<S, M, C, K, true>(s, view.scene, &ray, *work).ok()?;
                *shadowed = nearest.surface.is_some();
            }
            if !*shadowed && let Some(ray) = surfaces.place.ray(point, to_light) {
                *shadowed = surfaces.first_root(&ray, 1.0, &mut memo, *work).ok()?.is_some();
            }
        }
        Some(shadowed)
    }
}
