//! The **beam** kernel: a tile of rays with one common origin goes through the grid as one pyramid.
//!
//! # How it goes
//! 1. At a branch the 64 cells are culled at once against the four sides of the pyramid and the farthest depth that
//!    still matters ([`frustum`]); inner cells are taken front to back ([`walk`]).
//! 2. The tight boxes of a branch's leaves are projected into the plane of the tile, sixteen at a time ([`boxes`]).
//!    Those that show wait ([`queue`]); the nearest is next, if by then some pixel does not see anything nearer.
//! 3. The vertices of a cluster are projected ([`triangles`]), its triangles taken sixteen at a time: most miss every
//!    pixel. Small ones are tested a pixel each, sixteen triangles at once; large ones against blocks of 4x4 pixels
//!    ([`pixel_tests`], [`edges`]). Pixels remember depths and names ([`pixels`], [`winners`]).
//! 4. Points, normals and light of sixteen pixels at a time ([`surface`]).
//! 5. Shadows: the same with the light as the eye and the lit points as the pixels ([`points`], [`samples`],
//!    [`sample_tests`]).
//!
//! # Spheres
//! They wait in the same queue. A sphere is held against pixels, or samples, that its box shows over, sixteen rays at a time
//! in single precision ([`spheres`], [`sphere_cover`], [`sphere_pixels`], [`sphere_samples`]); what is close to its outline
//! or to another surface is left to the ray. What is stored in many cells is tested once a tile. So are large triangles, such
//! as a ground, in space instead of on the plane ([`far_triangles`]).
//!
//! # What may be far away
//! A page may have to be fetched. So before a record of a page that is not [at hand](SceneMemory::is_at_hand) is read, all
//! that is nearer is tested, and then each ray is asked whether it meets the box ([`boxes`]); and clusters on such pages wait
//! longer than others ([`far_queue`]). Rays to the light start at their points, and most that are blocked are blocked close by;
//! so shadow beams then go from their far end towards the light. So beams read hardly more pages than rays do. Where all is at
//! hand nothing of this is compiled in.
//!
//! # What keeps it fast
//! Each step has full lanes and few branches that cannot be foretold: candidates are packed together before the next
//! step looks at them. A wrong guess of a branch costs as much as testing sixteen triangles.
//!
//! # Why it draws what rays draw
//! Projection is rounded, so it only *proposes*. Its uncertainty is bounded ([`Projection`](projection::Projection));
//! where a decision lies within it (a point next to an edge, two surfaces equally deep) the ray of that pixel
//! decides, with the very test of the ray kernel. That happens to some pixels in a hundred. What is then computed from the
//! triangle or sphere that a pixel shows is again the ray kernel's arithmetic, lane by lane. So a tile has the same bits by
//! beam, by rays, and with any lanes, and the order of visits does not show.
//!
//! # When rays take over
//! Whole tiles: a camera that is askew or very wide, an eye or light very far away, an image that lies. Shadows of a tile: lit
//! points that the light sees in a wide angle. Single pixels: where there is doubt.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of lanes, blocks, pixels and triangles of one tile; they are small and not negative"
)]

mod boxes;
mod edges;
mod far_queue;
mod far_triangles;
mod frustum;
mod pixel_tests;
mod pixels;
mod points;
mod projection;
mod queue;
mod sample_tests;
mod samples;
mod sphere_cover;
mod sphere_pixels;
mod sphere_samples;
mod sphere_surface;
mod spheres;
mod surface;
mod triangles;
#[cfg(feature = "volumes")]
pub(crate) mod volume;
mod walk;
mod winners;

use core::marker::PhantomData;

use crate::blocks::{BLOCKS, ByBlock, block_and_lane};
use crate::count::{Count, TileCounts};
use crate::grid_ray::GridRay;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::scale::Scale;
use crate::shade::{ALBEDO, BACKGROUND, SHADOW, byte};
use crate::simd::{LANES, Lanes, Mask, Simd, Task};
use crate::tile::{Depths, Tile, TileView};
use crate::view::Damaged;
use crate::walk::walk as walk_by_ray;
use frustum::Frustum;
use pixels::Pixels;
use points::{POINTS_MAX, Points};
use projection::Projection;
use sample_tests::Shadows;
use sphere_samples::SphereRoom;
use surface::{Lighting, meet, shade};
use walk::{Beam, walk};

/// Draws a tile by beams, or tells that it has to be drawn by rays.
pub(crate) fn draw<M: SceneMemory, C: Count, K: Kinds>(
    lanes: Lanes,
    view: &TileView<'_, M>,
    tile: Tile,
    pixels: &mut [u8],
    work: &mut C,
) -> Option<TileCounts> {
    lanes.run(Draw::<M, C, K> { view, tile, pixels, work, kinds: PhantomData })
}

struct Draw<'a, M, C, K> {
    view: &'a TileView<'a, M>,
    tile: Tile,
    pixels: &'a mut [u8],
    work: &'a mut C,
    kinds: PhantomData<K>,
}

impl<M: SceneMemory, C: Count, K: Kinds> Task for Draw<'_, M, C, K> {
    type Output = Option<TileCounts>;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Option<TileCounts> {
        let Self { view, tile, pixels: bytes, work, .. } = self;
        let projection = Projection::of_tile(&view.frame.camera, view.eye, tile)?;
        let frustum = Frustum::new(s, &projection, &view.scene.header().grid)?;
        if !enters(s, view, &frustum).ok()? {
            return Some(fill_with_background(tile, bytes));
        }
        // Large, and never moved.
        let mut pixels = Pixels::<M, K>::new(view, tile, projection.depth_epsilon);
        let beam = Beam { projection: &projection, frustum: &frustum };
        walk::<S, M, C, K, _>(s, view.scene, &beam, &mut pixels, work).ok()?;
        if !pixels.found_anything().ok()? {
            return Some(fill_with_background(tile, bytes));
        }
        let lighting = Lighting { eye: view.eye, light: view.light, shadow_offset: view.shadow_offset };
        let mut lit = Lit::new();
        let mut depths = Depths::new();
        for block in 0..BLOCKS {
            let hit = pixels.hit[block];
            if hit != 0 {
                let met = meet(s, &pixels, block, &view.frame.camera, tile).ok()?;
                let seen = shade(s, &met, s.splat(ALBEDO), &lighting);
                s.store(s.select(hit, seen.t, s.splat(0.0)), depths.block(block));
                lit.add(s, block, hit, &seen, s.splat(SHADOW));
            }
        }
        let shadow = if view.frame.has_shadows() { lit.points.count as u64 } else { 0 };
        let shadowed = if shadow == 0 { 0 } else { lit.cast_shadows::<S, M, C, K>(s, view, work).ok()? };
        write(s, &lit.grey, tile, bytes);
        Some(TileCounts {
            primary: tile.pixels() as u64,
            hits: pixels.hit.iter().map(|hit| u64::from(hit.count_ones())).sum(),
            shadow,
            lit: shadow - shadowed,
            damaged: 0,
            t_sum: depths.sum(view.scene.header().scale().inverse()),
        })
    }
}

/// Whether a beam enters the grid at all.
#[inline(always)]
fn enters<S: Simd, M: SceneMemory>(s: S, view: &TileView<'_, M>, frustum: &Frustum) -> Result<bool, Damaged> {
    let grid = &view.scene.header().grid;
    let root = view.scene.branch(0)?;
    Ok(frustum.cells_entered(s, &root, grid.origin, grid.size * 0.25, f32::MAX) != 0)
}

/// A tile that shows nothing.
fn fill_with_background(tile: Tile, bytes: &mut [u8]) -> TileCounts {
    bytes.fill(byte(BACKGROUND));
    TileCounts { primary: tile.pixels() as u64, ..TileCounts::default() }
}

/// What the pixels of a tile show, and where light may fall.
struct Lit {
    /// Greys; where `facing`, those of points that the light reaches.
    grey: ByBlock<f32>,
    facing: [Mask; BLOCKS],
    points: Points,
}

impl Lit {
    const fn new() -> Self {
        Self { grey: [[BACKGROUND; LANES]; BLOCKS], facing: [0; BLOCKS], points: Points::new() }
    }

    /// Adds the pixels of a block that hit something; `dark` are their greys where no light falls.
    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, block: usize, hit: Mask, seen: &surface::Surface<S::F>, dark: S::F) {
        let facing = seen.facing & hit;
        self.facing[block] = facing;
        let grey = s.select(facing, seen.grey, dark);
        s.store(s.select(hit, grey, s.splat(BACKGROUND)), &mut self.grey[block]);
        self.points.push(s, facing, seen.point);
    }

    /// Darkens the pixels that the light does not reach, and counts them.
    #[inline(always)]
    fn cast_shadows<S: Simd, M: SceneMemory, C: Count, K: Kinds>(
        &mut self,
        s: S,
        view: &TileView<'_, M>,
        work: &mut C,
    ) -> Result<u64, Damaged> {
        let shadowed = shadowed::<S, M, C, K>(s, &self.points, view, work)?;
        Ok(self.darken(&shadowed, |_, _| SHADOW))
    }

    /// Gives the pixels in shadow their greys where no light falls, by block and lane, and counts them.
    #[inline(always)]
    fn darken(&mut self, shadowed: &[bool; POINTS_MAX], dark: impl Fn(usize, usize) -> f32) -> u64 {
        let (mut index, mut count) = (0, 0);
        for (block, (grey, &facing)) in self.grey.iter_mut().zip(&self.facing).enumerate() {
            let mut left = facing;
            while left != 0 {
                let lane = left.trailing_zeros() as usize;
                left &= left - 1;
                if shadowed[index] {
                    grey[lane] = dark(block, lane);
                    count += 1;
                }
                index += 1;
            }
        }
        count
    }
}

/// Whether each point lies in the shadow of triangles or spheres.
#[inline(always)]
fn shadowed<S: Simd, M: SceneMemory, C: Count, K: Kinds>(
    s: S,
    points: &Points,
    view: &TileView<'_, M>,
    work: &mut C,
) -> Result<[bool; POINTS_MAX], Damaged> {
    let by_beam = match points.projection(s, view.light) {
        Some(projection) => by_beam::<S, M, C, K>(s, points, &projection, view, work)?,
        None => None,
    };
    match by_beam {
        Some(shadowed) => Ok(shadowed),
        None => by_rays::<S, M, C, K>(s, points, view, work),
    }
}

/// Whether each point lies in shadow; `None` when the light is not for beams.
#[inline(always)]
fn by_beam<S: Simd, M: SceneMemory, C: Count, K: Kinds>(
    s: S,
    points: &Points,
    projection: &Projection,
    view: &TileView<'_, M>,
    work: &mut C,
) -> Result<Option<[bool; POINTS_MAX]>, Damaged> {
    let Some(frustum) = Frustum::new(s, projection, &view.scene.header().grid) else {
        return Ok(None);
    };
    let spheres = if K::SPHERES { Some(SphereRoom::new()) } else { None };
    let mut shadows = Shadows::new(points, projection.eye, spheres);
    shadows.samples.place(s, projection);
    walk::<S, M, C, K, _>(s, view.scene, &Beam { projection, frustum: &frustum }, &mut shadows, work)?;
    Ok(Some(shadows.samples.shadowed))
}

#[inline(always)]
fn by_rays<S: Simd, M: SceneMemory, C: Count, K: Kinds>(
    s: S,
    points: &Points,
    view: &TileView<'_, M>,
    work: &mut C,
) -> Result<[bool; POINTS_MAX], Damaged> {
    let mut shadowed = [false; POINTS_MAX];
    for (index, shadowed) in shadowed.iter_mut().take(points.count).enumerate() {
        let point = points.get(index);
        let ray = GridRay::new(point, view.light - point, 1.0, Scale::ONE, &view.scene.header().grid);
        if let Some(ray) = ray {
            *shadowed = walk_by_ray::<S, M, C, K, true>(s, view.scene, &ray, work)?.surface.is_some();
        }
    }
    Ok(shadowed)
}

/// Turns greys into bytes, row by row, as [`byte`] does.
#[inline(always)]
fn write<S: Simd>(s: S, grey: &ByBlock<f32>, tile: Tile, bytes: &mut [u8]) {
    let mut found = [[0; LANES]; BLOCKS];
    for (grey, found) in grey.iter().zip(&mut found) {
        let scaled = s.add(s.mul(s.load(grey), s.splat(255.0)), s.splat(0.5));
        s.store_int(s.to_int(s.min(s.max(scaled, s.splat(0.0)), s.splat(255.0))), found);
    }
    for (y, row) in bytes.chunks_exact_mut(tile.width as usize).enumerate() {
        for (x, byte) in row.iter_mut().enumerate() {
            let (block, lane) = block_and_lane(x, y);
            *byte = found[block][lane] as u8;
        }
    }
}
