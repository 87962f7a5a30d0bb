//! Isosurfaces by **ray**: one ray through the tree of ranges, then the voxel cells, front to back.
//!
//! # How it goes
//! At a branch two compares tell which of its 64 children an isovalue may lie in; the ray steps through the children
//! in order and goes down where one may. In a brick it steps through the voxel cells, and solves the cubic of those
//! whose eight samples lie on both sides of an isovalue. The first root ends the ray: cells are met in order, and
//! their stretches of the ray do not overlap.
//!
//! # Why it shows no hole
//! The kind of a place, inside or outside, is the same seen from both cells that share it ([`volume_ray`] and
//! [`cubic`] say why), and a cell that is skipped, with all its brick or branch, is of one kind on all its faces. So a
//! ray whose ends are of different kind meets a root, exactly as often as the kind changes on its way from face to
//! face. Any way that visits every cell that cannot be skipped, and takes the first root, shows the same bits.
//!
//! # What there is no surface in
//! Cells with a corner that is absent (NaN, infinite or beyond `±VALUE_MAX`); the space outside the volume, where a
//! surface ends open; and a volume with a single sample along an axis, which has no cells.
//!
//! [`volume_ray`]: crate::volume_ray
//! [`cubic`]: crate::cubic

use glam::Vec3;

use crate::brick::Brick;
use crate::count::Count;
use crate::cubic::{Cubic, Solver, between};
use crate::frame::ISOVALUES_MAX;
use crate::grid::cell_index;
use crate::memory::SceneMemory;
use crate::ray::Ray;
use crate::scale::Scale;
use crate::shade;
use crate::view::{Damaged, SceneView};
use crate::volume::{BRICK_CELLS, Threshold, Volume};
use crate::volume_memo::{CellMask, Children, Memo};
use crate::volume_ray::{Steps, VolumePlace, VolumeRay, larger, smaller};

/// Some isosurfaces of the volume of a scene: what rays look for.
///
/// Made for a frame or a tile; nothing in the image depends on the isovalues.
#[derive(Clone, Copy, Debug)]
pub struct Isosurfaces<'a, M> {
    pub(crate) scene: &'a SceneView<M>,
    pub(crate) volume: Volume,
    pub(crate) place: VolumePlace,
    pub(crate) solver: Solver,
    sought: [Sought; ISOVALUES_MAX],
    count: usize,
}

/// One isovalue.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sought {
    /// Its number in the caller's list.
    pub(crate) surface: u32,
    /// The isovalue among stored samples.
    pub(crate) stored: f32,
    pub(crate) threshold: Threshold,
}

/// Where a ray meets an isosurface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IsoHit {
    /// Distance from the ray's origin, in lengths of its direction.
    pub t: f32,
    /// Which of the isovalues asked for.
    pub surface: u32,
    /// Unit normal: the gradient of the trilinear interpolant, towards lower stored samples; against the ray where
    /// it is zero.
    pub normal: Vec3,
    /// The voxel cell.
    pub cell: [u32; 3],
}

/// A root on a ray, as the kernels keep it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Root {
    /// Which of the isosurfaces sought.
    pub(crate) index: usize,
    pub(crate) cell: [i32; 3],
    /// The stretch of the ray in the cell.
    pub(crate) enter: f64,
    pub(crate) exit: f64,
    /// The root in the stretch, in `0..=1`.
    pub(crate) s: f32,
    pub(crate) samples: [f32; 8],
}

impl Root {
    /// Where on the ray it is.
    #[inline]
    pub(crate) fn t(&self) -> f64 {
        let t = self.enter + f64::from(self.s) * (self.exit - self.enter);
        if t < self.exit { t } else { self.exit }
    }
}

impl<M: SceneMemory> SceneView<M> {
    /// The isosurfaces of these values, in that order; values beyond the first [`ISOVALUES_MAX`] are left out. `None`
    /// when the scene shows none of them: it has no volume, or no sample on both sides of a value.
    ///
    /// # Errors
    /// [`Damaged`] when the volume's table cannot be read. Values outside the range of the samples do not need it.
    pub fn isosurfaces(
        &self,
        isovalues: &[f32],
        solver: Solver,
    ) -> Result<Option<Isosurfaces<'_, M>>, Damaged> {
        let Some(volume) = self.header().volume else { return Ok(None) };
        let nothing = Sought { surface: 0, stored: 0.0, threshold: Threshold::NONE };
        let mut found = Isosurfaces {
            scene: self,
            volume,
            place: VolumePlace::new(&volume, self.header().scale()),
            solver,
            sought: [nothing; ISOVALUES_MAX],
            count: 0,
        };
        if volume.branches == 0 {
            return Ok(None);
        }
        for (surface, &value) in (0..).zip(isovalues.iter().take(ISOVALUES_MAX)) {
            let stored = volume.stored(value);
            if volume.low < stored && stored <= volume.high {
                let threshold = self.threshold(stored)?;
                found.sought[found.count] = Sought { surface, stored, threshold };
                found.count += 1;
            }
        }
        Ok((found.count > 0).then_some(found))
    }
}

impl<M: SceneMemory> Isosurfaces<'_, M> {
    /// The nearest isosurface that a ray of world units meets.
    ///
    /// # Errors
    /// [`Damaged`] when the image lies or a page cannot be had.
    pub fn nearest(&self, ray: &Ray, count: &mut impl Count) -> Result<Option<IsoHit>, Damaged> {
        let place = VolumePlace::new(&self.volume, Scale::ONE);
        let Some(through) = place.ray(ray.origin, ray.direction) else { return Ok(None) };
        let root = self.first_root(&through, f64::from(ray.t_max), &mut (), count)?;
        Ok(root.map(|root| IsoHit {
            t: single(root.t()),
            surface: self.sought()[root.index].surface,
            normal: self.normal(&through, &root, ray.direction),
            cell: root.cell.map(i32::cast_unsigned),
        }))
    }

    /// Whether a ray of world units meets any of the isosurfaces.
    ///
    /// # Errors
    /// As [`nearest`](Self::nearest).
    pub fn any(&self, ray: &Ray, count: &mut impl Count) -> Result<bool, Damaged> {
        let place = VolumePlace::new(&self.volume, Scale::ONE);
        let Some(through) = place.ray(ray.origin, ray.direction) else { return Ok(false) };
        Ok(self.first_root(&through, f64::from(ray.t_max), &mut (), count)?.is_some())
    }

    #[inline]
    pub(crate) fn sought(&self) -> &[Sought] {
        &self.sought[..self.count]
    }

    /// The first root with `0 <= t <= t_max`.
    #[inline]
    pub(crate) fn first_root(
        &self,
        ray: &VolumeRay,
        t_max: f64,
        memo: &mut impl Memo,
        count: &mut impl Count,
    ) -> Result<Option<Root>, Damaged> {
        let (enter, exit) = ray.interval([0; 3], self.volume.cells());
        let (enter, end) = (larger(enter, 0.0), smaller(exit, t_max));
        if enter >= end || end.is_nan() {
            return Ok(None);
        }
        let budget = Budget { branches: self.volume.branches, bricks: self.volume.bricks };
        Walk { surfaces: self, ray, end, budget, memo, count }.branch(
            0,
            [0; 3],
            self.volume.levels - 1,
            enter,
        )
    }

    /// Unit normal at a root.
    #[inline]
    pub(crate) fn normal(&self, ray: &VolumeRay, root: &Root, direction: Vec3) -> Vec3 {
        let (from, to) = (ray.place(root.enter, root.cell), ray.place(root.exit, root.cell));
        let at = [0, 1, 2].map(|axis| between(from[axis], to[axis], root.s));
        let gradient = gradient(&root.samples, at);
        let per_length = self.place.per_length;
        match [0, 1, 2].map(|axis| -f64::from(gradient[axis]) * per_length[axis]) {
            [0.0, 0.0, 0.0] => shade::unit(direction.to_array().map(|x| -f64::from(x))),
            downwards => shade::unit(downwards),
        }
    }

    /// The children of a branch that any of the isosurfaces may be in.
    #[inline]
    pub(crate) fn children(&self, index: u64) -> Result<Children, Damaged> {
        let branch = self.scene.range_branch(index)?;
        let may_be_in = |active, sought: &Sought| active | branch.active(sought.threshold);
        let active = self.sought().iter().fold(0, may_be_in);
        Ok(Children { active, present: branch.present, first: branch.first })
    }
}

/// A walk under way.
struct Walk<'a, M, K, C> {
    surfaces: &'a Isosurfaces<'a, M>,
    ray: &'a VolumeRay,
    /// Where the ray ends, or leaves the volume.
    end: f64,
    budget: Budget,
    memo: &'a mut K,
    count: &'a mut C,
}

impl<M: SceneMemory, K: Memo, C: Count> Walk<'_, M, K, C> {
    /// Goes through a branch with `below` levels of branches under it, from `enter` on.
    fn branch(
        &mut self,
        index: u64,
        corner: [i32; 3],
        below: u32,
        enter: f64,
    ) -> Result<Option<Root>, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        self.count.branch();
        let surfaces = self.surfaces;
        let children = self.memo.branch(index, || surfaces.children(index))?;
        let mut steps = Steps::<4>::new(self.ray, corner, BRICK_CELLS << (2 * below), enter);
        while steps.enter < self.end {
            let child = cell_index(steps.at.map(i32::cast_unsigned));
            if children.active >> child & 1 != 0 && steps.enter < steps.exit() {
                let index = children.child_of(child).ok_or(Damaged::RangeBranch(u64::MAX))?;
                let root = match below.checked_sub(1) {
                    Some(below) => self.branch(index, steps.corner(), below, steps.enter)?,
                    None => self.brick(index, steps.corner(), steps.enter)?,
                };
                if root.is_some() {
                    return Ok(root);
                }
            }
            if !steps.advance(self.ray) {
                break;
            }
        }
        Ok(None)
    }

    /// Goes through the voxel cells of a brick, from `enter` on.
    fn brick(&mut self, index: u64, corner: [i32; 3], enter: f64) -> Result<Option<Root>, Damaged> {
        Budget::spend(&mut self.budget.bricks)?;
        let record = self.surfaces.scene.brick(index)?;
        let brick = Brick::new(self.surfaces.volume.sample, &record).ok_or(Damaged::Brick(index))?;
        self.count.brick();
        let mut steps = Steps::<{ BRICK_CELLS }>::new(self.ray, corner, 1, enter);
        while steps.enter < self.end {
            let exit = smaller(steps.exit(), self.end);
            let mask = || CellMask::new(&brick, self.surfaces.sought().iter().map(|sought| sought.stored));
            if steps.enter < exit && self.memo.may_hold(index, steps.at, mask) {
                self.count.voxel_cells(1);
                let samples = brick.corners(steps.at);
                let root = self.surfaces.root_in_cell(
                    self.ray,
                    steps.corner(),
                    (steps.enter, exit),
                    &samples,
                    self.count,
                );
                if root.is_some() {
                    return Ok(root);
                }
            }
            if !steps.advance(self.ray) {
                break;
            }
        }
        Ok(None)
    }
}

impl<M: SceneMemory> Isosurfaces<'_, M> {
    /// The first root in a stretch of a ray in a voxel cell with these samples; of several isosurfaces at one place the
    /// first.
    #[inline]
    pub(crate) fn root_in_cell(
        &self,
        ray: &VolumeRay,
        cell: [i32; 3],
        (enter, exit): (f64, f64),
        samples: &[f32; 8],
        count: &mut impl Count,
    ) -> Option<Root> {
        let mut first: Option<Root> = None;
        for (index, sought) in self.sought().iter().enumerate() {
            let inside = samples.map(|sample| sample >= sought.stored);
            if inside == [inside[0]; 8] {
                continue;
            }
            count.cubics(1);
            let (from, to) = (ray.place(enter, cell), ray.place(exit, cell));
            let cubic = Cubic::new(samples.map(|sample| sample - sought.stored), from, to);
            if let Some(s) = cubic.first_root(self.solver)
                && first.is_none_or(|first| s < first.s)
            {
                first = Some(Root { index, cell, enter, exit, s, samples: *samples });
            }
        }
        first
    }
}

/// How many records a ray may still read; a valid image never runs out, since a ray meets each at most once.
pub(crate) struct Budget {
    pub(crate) branches: u64,
    pub(crate) bricks: u64,
}

impl Budget {
    #[inline]
    pub(crate) fn spend(left: &mut u64) -> Result<(), Damaged> {
        *left = left.checked_sub(1).ok_or(Damaged::Cycle)?;
        Ok(())
    }
}

/// Gradient of the trilinear interpolant in a cell, in samples a cell.
#[inline]
pub(crate) fn gradient(samples: &[f32; 8], [x, y, z]: [f32; 3]) -> [f32; 3] {
    let face = |corners: [usize; 4], step: usize, u: f32, v: f32| {
        let [a, b, c, d] = corners.map(|corner| samples[corner + step] - samples[corner]);
        between(between(a, b, u), between(c, d, u), v)
    };
    [face([0, 2, 4, 6], 1, y, z), face([0, 1, 4, 5], 2, x, z), face([0, 1, 2, 3], 4, x, y)]
}

#[inline]
pub(crate) const fn single(t: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is the result")]
    let single = t as f32;
    single
}
