//! The **ray** kernel: one ray, any origin, through the grid front to back.
//!
//! # How it goes
//! At a branch the 64 cells are culled at once: slab intervals per axis, then an interval per cell, then a
//! bit per cell that the ray may enter. The bits are flipped so that the lowest is the nearest, and taken one
//! by one. An inner cell is descended into; for a run the leaf's tight box is tested and then its cluster,
//! all of it, and the rest of the run's bits are cleared. Once something is hit, cells and boxes entered
//! later are skipped.
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
//! 3. *Slabs*: a plane is exact, its difference to the origin, the inverse direction, their product, the step
//!    to the next plane, and the padding round once each: `14 e reach` at most.
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

use glam::Vec3;

use crate::cluster::{Cluster, Nearest};
use crate::count::Count;
use crate::filter::Filter;
use crate::grid::{
    BoxFrame, Branch, ClusterRef, LEVELS_MAX, LeafContent, SpheresRef, cell_coordinates, flip_cells,
};
use crate::grid_ray::GridRay;
use crate::image::Header;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::sphere::SphereCluster;
use crate::triangle_test::TriangleTest;
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
#[inline]
pub fn walk<M: SceneMemory, C: Count, K: Kinds, const ANY: bool>(
    scene: &SceneView<M>,
    ray: &GridRay,
    count: &mut C,
) -> Result<Nearest, Damaged> {
    walk_with::<M, WoopRay, (), C, K, ANY>(scene, ray, &mut (), count)
}

/// As [`walk`], with any triangle test, and only hits that `filter` accepts.
///
/// # Errors
/// As [`walk`].
#[inline]
pub fn walk_with<M: SceneMemory, T: TriangleTest, F: Filter, C: Count, K: Kinds, const ANY: bool>(
    scene: &SceneView<M>,
    ray: &GridRay,
    filter: &mut F,
    count: &mut C,
) -> Result<Nearest, Damaged> {
    let (nearest, budget) = (Nearest::none(ray.t_max()), Budget::of(scene.header()));
    let mut walk = Walk { scene, ray, test: ray.test::<K::Test<T>>(), filter, count, nearest, budget };
    walk.run::<K, ANY>()?;
    Ok(walk.nearest)
}

/// A walk under way.
struct Walk<'a, M, T, F, C> {
    scene: &'a SceneView<M>,
    ray: &'a GridRay,
    /// The ray as the triangle test wants it.
    test: T,
    filter: &'a mut F,
    count: &'a mut C,
    nearest: Nearest,
    budget: Budget,
}

/// A branch that the ray is in.
#[derive(Clone, Copy)]
struct Visit {
    branch: Branch,
    corner: Vec3,
    cell: f32,
    frame: BoxFrame,
    /// Cells still to visit, flipped so that the lowest bit is the nearest.
    left: u64,
}

impl Visit {
    /// Takes the nearest cell that is left.
    #[inline]
    const fn next_cell(&mut self, flip: u32) -> Option<u32> {
        if self.left == 0 {
            return None;
        }
        let cell = self.left.trailing_zeros() ^ flip;
        self.left &= self.left - 1;
        Some(cell)
    }

    /// Lowest corner of a cell; exact.
    #[inline]
    fn corner_of(&self, cell: u32) -> Vec3 {
        self.corner + Vec3::from(cell_coordinates(cell).map(|i| i as f32)) * self.cell
    }
}

impl<M: SceneMemory, T: TriangleTest, F: Filter, C: Count> Walk<'_, M, T, F, C> {
    fn run<K: Kinds, const ANY: bool>(&mut self) -> Result<(), Damaged> {
        if self.scene.header().branches == 0 {
            return Ok(());
        }
        let grid = self.scene.header().grid;
        let mut visit = self.enter(0, grid.origin, grid.size * 0.25)?;
        let mut above = [visit; LEVELS_MAX];
        let mut depth = 0;
        loop {
            let Some(cell) = visit.next_cell(self.ray.flip()) else {
                if depth == 0 {
                    return Ok(());
                }
                depth -= 1;
                visit = above[depth];
                continue;
            };
            let corner = visit.corner_of(cell);
            if self.is_hidden(corner, visit.cell) {
                continue;
            }
            if visit.branch.inner >> cell & 1 != 0 {
                let child = visit.branch.child_of(cell).ok_or(Damaged::Branch(u32::MAX))?;
                above[depth] = visit;
                depth += 1;
                if depth >= grid.levels as usize {
                    return Err(Damaged::Depth);
                }
                visit = self.enter(child, corner, visit.cell * 0.25)?;
            } else {
                visit.left &= !flip_cells(visit.branch.run_of(cell), self.ray.flip());
                self.visit_run::<K, ANY>(&visit, cell)?;
                if ANY && self.nearest.surface.is_some() {
                    return Ok(());
                }
            }
        }
    }

    /// Whether the ray enters a cell only behind the nearest hit.
    #[inline]
    fn is_hidden(&self, corner: Vec3, cell: f32) -> bool {
        self.nearest.surface.is_some() && self.ray.t_enter(corner, cell) > self.nearest.crossing.t
    }

    /// Reads a branch and culls its cells.
    #[inline]
    fn enter(&mut self, index: u32, corner: Vec3, cell: f32) -> Result<Visit, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        let branch = self.scene.branch(index)?;
        self.count.branch();
        let entered = self.ray.cells_entered(corner, cell, self.nearest.crossing.t) & branch.occupied;
        let frame = BoxFrame::new(cell, self.scene.header().grid.slack);
        Ok(Visit { branch, corner, cell, frame, left: flip_cells(entered, self.ray.flip()) })
    }

    /// Tests what the run of `cell` holds.
    #[inline]
    fn visit_run<K: Kinds, const ANY: bool>(&mut self, visit: &Visit, cell: u32) -> Result<(), Damaged> {
        let leaf = visit.branch.leaf_of(cell).ok_or(Damaged::Leaf(u32::MAX))?;
        match self.visit_leaf::<K, ANY>(visit, leaf)? {
            None | Some(LeafContent::Cluster(_) | LeafContent::Spheres(_)) => Ok(()),
            Some(LeafContent::List { first, count }) => self.visit_list::<K, ANY>(visit, first, count),
        }
    }

    /// Tests the leaves of a list, which hold a cluster each.
    fn visit_list<K: Kinds, const ANY: bool>(
        &mut self,
        visit: &Visit,
        first: u32,
        count: u32,
    ) -> Result<(), Damaged> {
        for leaf in first..first.checked_add(count).ok_or(Damaged::Leaf(first))? {
            if let Some(LeafContent::List { .. }) = self.visit_leaf::<K, ANY>(visit, leaf)? {
                return Err(Damaged::Leaf(leaf));
            }
            if ANY && self.nearest.surface.is_some() {
                break;
            }
        }
        Ok(())
    }

    /// Tests the cluster of a leaf whose box the ray enters, and tells what the leaf holds; `None` when it
    /// passes by the box.
    #[inline]
    fn visit_leaf<K: Kinds, const ANY: bool>(
        &mut self,
        visit: &Visit,
        index: u32,
    ) -> Result<Option<LeafContent>, Damaged> {
        Budget::spend(&mut self.budget.leaves)?;
        let leaf = self.scene.leaf(index)?;
        self.count.leaf();
        if !self.ray.enters_box(visit.corner, &visit.frame, leaf.bounds, self.nearest.crossing.t) {
            return Ok(None);
        }
        let content = leaf.content().ok_or(Damaged::Leaf(index))?;
        match &content {
            LeafContent::Cluster(place) if K::TRIANGLES => self.visit_cluster::<ANY>(place)?,
            LeafContent::Spheres(place) if K::SPHERES => self.visit_spheres::<ANY>(place)?,
            LeafContent::List { .. } => {}
            _ => return Err(Damaged::Leaf(index)),
        }
        Ok(Some(content))
    }

    #[inline]
    fn visit_cluster<const ANY: bool>(&mut self, place: &ClusterRef) -> Result<(), Damaged> {
        let record = self.scene.cluster(place)?;
        let cluster = Cluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.test.intersect_cluster::<ANY>(&cluster, &mut self.nearest, self.filter, self.count);
        Ok(())
    }

    #[inline]
    fn visit_spheres<const ANY: bool>(&mut self, place: &SpheresRef) -> Result<(), Damaged> {
        let record = self.scene.spheres(place)?;
        let cluster = SphereCluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        let ray = self.ray.sphere_ray();
        cluster.intersect_filtered::<ANY>(&ray, &mut self.nearest, self.filter, self.count);
        Ok(())
    }
}

/// How many records a ray may still read; a valid image never runs out, since a ray meets each at most once.
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
