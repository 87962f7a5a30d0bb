//! The **ray** kernel: one ray, any origin, through the grid front to back.
//!
//! # How it goes
//! At a branch the 64 cells are culled at once, sixteen to a register: slab intervals per axis, then an interval per
//! cell, then a bit per cell that the ray may enter. Cells are counted from the corner where the ray comes in, so the
//! lowest bit is the nearest; they are taken one by one. An inner cell is descended into; for a run, once, the
//! leaf's tight box is tested and then its cluster: all vertices at once, then sixteen triangles at a time. Once
//! something is hit, cells and boxes entered later are skipped.
//!
//! It is written over [lanes](crate::Lanes). Culling rounds in one stated order with all of them and the tests of
//! triangles are those of the plain version, so the lanes do not show; nor would it matter if culling differed.
//!
//! # Why it agrees with testing every triangle and sphere
//! Cells are padded by the slack, and all intervals by a *rounding allowance* on top, per axis. Let `e =
//! 2^-24`, and let `reach` be `|origin - grid origin| + size` on that axis: no corner of a triangle or cell
//! is farther from the ray's origin. When the triangle test reports a hit at `t`, its exact weights belong to
//! a point `q` of the true triangle, and:
//! 1. *Shearing* a corner errs by at most `e (2 |v - o| + 4 |s| |v_z - o_z|)` across the ray, `s` being the
//!    shear. The second product is at most `reach + 2 size`, since the sheared triangle surrounds 0. So the
//!    ray passes within `14 e reach` of `q`.
//! 2. *`t`* is the mean of three corner heights, each off by `3 e`, with exact weights, rounded once: `4 e
//!    reach` along the ray's main axis, and at most `13 e reach` on any axis, by the argument of 1.
//! 3. *Slabs*: a plane is exact, its difference to the origin, the inverse direction, their product, the padding,
//!    the way to the cell and the width of the padded cell round once each, and so do two sums: `14 e reach` at most.
//! 4. *Boxes* count from the branch's corner; decoding and moving them to the origin round three times: `10 e
//!    reach`.
//!
//! Together 51, so an allowance of `64 e reach = 2^-18 reach` suffices: the computed `t` of every hit lies
//! inside the computed interval of a leaf box that holds its triangle, and of all cells above. A cell that
//! begins behind the nearest `t` so far cannot hold a hit before it, nor at the same `t`; so the nearest hit,
//! ties included, is that of brute force, for every ray. The allowance grows with the distance: beyond 2^18
//! sizes it is larger than the scene, and on that axis nothing is culled any more; slow, never wrong.
//!
//! A direction component below 2^-60 of the largest is culled as if it were that; over the reach it moves the
//! ray by less than `2^-59 reach`. (The triangle test sees the true component.) A hit of a sphere is off by
//! `2^-47` of the largest reach (see [`sphere`](crate::sphere)), the rounding of its `t` by `e reach` along each
//! axis, and then 3 and 4 apply: 25 of the 64. The allowance has `2^-46` of the largest reach on top, for both.

use core::marker::PhantomData;

use glam::Vec4;
use heapless::Vec;

use crate::cluster::{Cluster, Nearest};
use crate::count::Count;
use crate::filter::Filter;
use crate::grid::{
    BoxFrame, Branch, CELL_CORNERS, ClusterRef, LEVELS_MAX, LeafContent, SpheresRef, flip_cells,
};
use crate::grid_ray::{GridRay, of_quarters};
use crate::image::Header;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Part, Simd, each};
use crate::sphere::SphereCluster;
use crate::triangle_test::{InLanes, TriangleTest};
use crate::triangle_woop::WoopRay;
use crate::view::{Damaged, SceneView};

/// Finds the nearest hit of `ray`, or with `ANY` some hit, among primitives of the kinds `K`.
///
/// # Bounds
/// At most as many branches and leaves are read as the image has, and no branch below its last level.
///
/// # Errors
/// [`Damaged`] at the first index or record that cannot be, a cluster of another kind included, or when a bound
/// is reached.
#[inline(always)]
pub(crate) fn walk<S: Simd, M: SceneMemory, C: Count, K: Kinds, const ANY: bool>(
    s: S,
    scene: &SceneView<M>,
    ray: &GridRay,
    count: &mut C,
) -> Result<Nearest, Damaged> {
    walk_with::<S, M, WoopRay, (), C, K, ANY>(s, scene, ray, &mut (), count)
}

/// As [`walk`], with any triangle test, and only hits that `filter` accepts.
///
/// # Errors
/// As [`walk`].
#[inline(always)]
pub(crate) fn walk_with<S, M, T, F, C, K, const ANY: bool>(
    s: S,
    scene: &SceneView<M>,
    ray: &GridRay,
    filter: &mut F,
    count: &mut C,
) -> Result<Nearest, Damaged>
where
    S: Simd,
    M: SceneMemory,
    T: TriangleTest,
    F: Filter,
    C: Count,
    K: Kinds,
{
    let (nearest, budget) = (Nearest::none(ray.t_max()), Budget::of(scene.header()));
    let mut walk = Walk { s, scene, ray, test: ray.test::<K::Test<T>>(), filter, count, nearest, budget };
    if let Some(root) = Place::root(scene.header()) {
        walk.run::<K, ANY>(root)?;
    }
    Ok(walk.nearest)
}

/// A walk under way.
pub(crate) struct Walk<'a, S, M, T, F, C> {
    pub(crate) s: S,
    pub(crate) scene: &'a SceneView<M>,
    pub(crate) ray: &'a GridRay,
    /// The ray as the triangle test wants it.
    pub(crate) test: T,
    pub(crate) filter: &'a mut F,
    pub(crate) count: &'a mut C,
    pub(crate) nearest: Nearest,
    pub(crate) budget: Budget,
}

/// Where a branch is: its index, and the cube that the way down leads to.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) index: u32,
    /// Its lowest corner.
    pub(crate) corner: Vec4,
    /// Edge of its cells.
    pub(crate) cell: f32,
    /// Levels of branches above.
    pub(crate) depth: u32,
}

impl Place {
    /// The root, unless the grid is empty.
    pub(crate) fn root(header: &Header) -> Option<Self> {
        let (corner, cell) = (header.grid.origin.extend(0.0), header.grid.size * 0.25);
        (header.branches > 0).then_some(Self { index: 0, corner, cell, depth: 0 })
    }

    /// The branch in the inner cell `cell` of `branch`, which is here.
    ///
    /// # Errors
    /// [`Damaged`] when there cannot be one.
    #[inline(always)]
    pub(crate) fn child(&self, branch: &Branch, cell: u32, levels: u32) -> Result<Self, Damaged> {
        let index = branch.child_of(cell).ok_or(Damaged::Branch(u32::MAX))?;
        let depth = self.depth + 1;
        if depth >= levels {
            return Err(Damaged::Depth);
        }
        Ok(Self { index, corner: self.corner_of(cell), cell: self.cell * 0.25, depth })
    }

    /// Lowest corner of a cell; exact.
    #[inline(always)]
    pub(crate) fn corner_of(&self, cell: u32) -> Vec4 {
        self.corner + CELL_CORNERS[cell as usize % 64] * self.cell
    }
}

/// A branch that the ray is in.
struct Visit {
    branch: Branch,
    place: Place,
    /// Cells still to visit, flipped so that the lowest bit is the nearest.
    left: u64,
    /// Runs that were visited, one bit each.
    done: u64,
}

/// When the ray enters each cell of a branch, in the order of `left`.
type Enter = [[f32; LANES]; 4];

impl Visit {
    /// Takes the nearest cell that is left and that the ray enters before `t_max`, which with `ANY` is what it was when the
    /// cells were culled.
    #[inline(always)]
    fn next_cell<S: Simd, const ANY: bool>(
        &mut self,
        s: S,
        enter: &Enter,
        flip: u32,
        t_max: f32,
    ) -> Option<u32> {
        while self.left != 0 {
            let nearest = self.left.trailing_zeros();
            self.left &= self.left - 1;
            if ANY || enter[nearest as usize / LANES % 4][nearest as usize % LANES] <= t_max {
                return Some(nearest ^ flip);
            }
            // Where one cell lies behind a hit, others will, too.
            let t_max = s.splat(t_max);
            self.left &= of_quarters(each!(4: enter, enter => s.le(s.load(enter), t_max)));
        }
        None
    }
}

impl<S: Simd, M: SceneMemory, T: TriangleTest, F: Filter, C: Count> Walk<'_, S, M, T, F, C> {
    /// Goes through the branch at `start` and all below it.
    #[inline(always)]
    pub(crate) fn run<K: Kinds, const ANY: bool>(&mut self, start: Place) -> Result<(), Damaged> {
        let levels = self.scene.header().grid.levels;
        let mut above = Vec::<Visit, LEVELS_MAX>::new();
        let mut enters = Vec::<Enter, LEVELS_MAX>::new();
        let mut visit = self.enter(start, &mut enters)?;
        loop {
            let (flip, t_max) = (self.ray.flip(), self.nearest.crossing.t);
            let Some(enter) = enters.last() else { return Ok(()) };
            let Some(cell) = visit.next_cell::<S, ANY>(self.s, enter, flip, t_max) else {
                let Some(last) = above.pop() else { return Ok(()) };
                enters.pop();
                visit = last;
                continue;
            };
            if visit.branch.inner >> cell & 1 != 0 {
                let child = visit.place.child(&visit.branch, cell, levels)?;
                above.push(visit).map_err(|_| Damaged::Depth)?;
                visit = self.enter(child, &mut enters)?;
                continue;
            }
            let run = visit.branch.run_of(cell).ok_or(Damaged::Leaf(u32::MAX))?;
            if visit.done >> run & 1 != 0 {
                continue;
            }
            visit.done |= 1 << run;
            let leaf = visit.branch.leaf.checked_add(run).ok_or(Damaged::Leaf(u32::MAX))?;
            self.visit_run::<K, ANY>(&visit.place, leaf)?;
            if ANY && self.nearest.surface.is_some() {
                return Ok(());
            }
        }
    }

    /// Reads a branch and culls its cells.
    #[inline(always)]
    fn enter(&mut self, place: Place, enters: &mut Vec<Enter, LEVELS_MAX>) -> Result<Visit, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        let branch = self.scene.branch(place.index)?;
        self.count.branch();
        let t_max = self.nearest.crossing.t;
        let (entered, enter) = self.ray.cells_entered(self.s, place.corner, place.cell, t_max);
        enters.push(enter).map_err(|_| Damaged::Depth)?;
        let left = flip_cells(branch.occupied, self.ray.flip()) & entered;
        Ok(Visit { branch, place, left, done: 0 })
    }

    /// Tests what a run holds.
    #[inline(always)]
    fn visit_run<K: Kinds, const ANY: bool>(&mut self, place: &Place, index: u32) -> Result<(), Damaged> {
        let frame = BoxFrame::new(place.cell, self.scene.header().grid.slack);
        let (s, corner) = (self.s, place.corner);
        match self.visit_leaf::<K, ANY>(corner, &frame, index)? {
            None => Ok(()),
            Some((first, count)) => {
                s.apart(List::<_, K, ANY> { walk: self, corner, frame, first, count, kinds: PhantomData })
            }
        }
    }

    /// Tests the cluster of a leaf whose box the ray enters; if it is a list, tells its first leaf and their number.
    #[inline(always)]
    fn visit_leaf<K: Kinds, const ANY: bool>(
        &mut self,
        corner: Vec4,
        frame: &BoxFrame,
        index: u32,
    ) -> Result<Option<(u32, u32)>, Damaged> {
        Budget::spend(&mut self.budget.leaves)?;
        let leaf = self.scene.leaf(index)?;
        self.count.leaf();
        if !self.ray.enters_box(self.s, corner, frame, &leaf, self.nearest.crossing.t) {
            return Ok(None);
        }
        match leaf.content().ok_or(Damaged::Leaf(index))? {
            LeafContent::Cluster(place) if K::TRIANGLES => self.visit_cluster::<ANY>(&place)?,
            LeafContent::Spheres(place) if K::SPHERES => self.visit_spheres::<ANY>(&place)?,
            LeafContent::List { first, count } => return Ok(Some((first, count))),
            _ => return Err(Damaged::Leaf(index)),
        }
        Ok(None)
    }

    #[inline(always)]
    fn visit_cluster<const ANY: bool>(&mut self, place: &ClusterRef) -> Result<(), Damaged> {
        let record = self.scene.cluster(place)?;
        let cluster = Cluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        self.count.triangles(u32::from(place.triangles));
        match self.test.in_lanes() {
            InLanes::Woop(ray) => {
                cluster.intersect_filtered::<S, F, ANY>(self.s, ray, &mut self.nearest, self.filter);
            }
            InLanes::Moller(ray) => {
                cluster.intersect_moller::<S, F, ANY>(self.s, ray, &mut self.nearest, self.filter);
            }
            InLanes::OneByOne => {
                self.test.intersect_cluster::<ANY>(&cluster, &mut self.nearest, self.filter);
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn visit_spheres<const ANY: bool>(&mut self, place: &SpheresRef) -> Result<(), Damaged> {
        let record = self.scene.spheres(place)?;
        let cluster = SphereCluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        let ray = self.ray.sphere_ray();
        self.count.cluster();
        self.count.spheres(u32::from(place.count));
        cluster.intersect_filtered::<S, F, ANY>(self.s, &ray, &mut self.nearest, self.filter);
        Ok(())
    }
}

/// Leaves of a list, to be tested apart: there are few.
struct List<'a, W, K, const ANY: bool> {
    walk: &'a mut W,
    corner: Vec4,
    frame: BoxFrame,
    first: u32,
    count: u32,
    kinds: PhantomData<K>,
}

impl<S, M, T, F, C, K, const ANY: bool> Part<S> for List<'_, Walk<'_, S, M, T, F, C>, K, ANY>
where
    S: Simd,
    M: SceneMemory,
    T: TriangleTest,
    F: Filter,
    C: Count,
    K: Kinds,
{
    type Output = Result<(), Damaged>;

    #[inline(always)]
    fn run(self, _: S) -> Result<(), Damaged> {
        let Self { walk, corner, frame, first, count, .. } = self;
        for leaf in first..first.checked_add(count).ok_or(Damaged::Leaf(first))? {
            if walk.visit_leaf::<K, ANY>(corner, &frame, leaf)?.is_some() {
                return Err(Damaged::Leaf(leaf));
            }
            if ANY && walk.nearest.surface.is_some() {
                break;
            }
        }
        Ok(())
    }
}

/// How many records a ray may still read; a valid image never runs out, since a ray meets each at most once.
#[derive(Clone, Copy)]
pub(crate) struct Budget {
    pub(crate) branches: u32,
    pub(crate) leaves: u32,
}

impl Budget {
    pub(crate) const fn of(header: &Header) -> Self {
        Self { branches: header.branches, leaves: header.leaves }
    }

    #[inline]
    pub(crate) fn spend(left: &mut u32) -> Result<(), Damaged> {
        *left = left.checked_sub(1).ok_or(Damaged::Cycle)?;
        Ok(())
    }
}
