//! The walk of a beam through the grid, front to back.

mod far;

use core::marker::PhantomData;

use glam::Vec3;

use super::boxes::SeenBox;
use super::far_queue::FarQueue;
use super::frustum::Frustum;
use super::projection::Projection;
use super::queue::{Queue, Waiting};
use super::spheres::{name_of, spheres_of};
use super::triangles::{Bounds, Triangles};
use crate::cluster::{CLUSTER_BYTES_MAX, Cluster};
use crate::count::Count;
use crate::grid::{
    ALL_AXES, BoxFrame, Branch, ClusterRef, LEVELS_MAX, LeafContent, SpheresRef, cell_coordinates, flip_cells,
};
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{LANES, Part, Simd, each, first_lanes};
use crate::sphere::SphereCluster;
use crate::view::{Damaged, SceneView};
use crate::walk::Budget;

/// What a beam looks for: the nearest triangle of every pixel, or any between samples and the light.
pub(super) trait Targets<S: Simd> {
    /// Whether any hit will do, not only the nearest.
    const ANY: bool = false;

    /// What has a smaller inverse depth than this does not matter; infinite when nothing matters any more.
    fn least(&mut self, s: S) -> f32;

    /// Whether anything within these bounds may matter; with the box that shows there, whether anything within that.
    fn wants(&mut self, s: S, bounds: &Bounds, seen: Option<&SeenBox>) -> bool;

    /// Tests the triangles of a cluster.
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>);

    /// Tests a cluster that cannot be projected, or has a few large triangles.
    fn test_far(&mut self, s: S, cluster: &Cluster<'_>);

    /// Tests the spheres of a cluster.
    fn test_spheres(&mut self, s: S, projection: &Projection, cluster: &SphereCluster<'_>);
}

/// A beam: where it looks from and what it may enter.
pub(super) struct Beam<'a> {
    pub(super) projection: &'a Projection,
    pub(super) frustum: &'a Frustum,
}

/// Leads every triangle and sphere that the beam may meet to its targets.
///
/// # Errors
/// [`Damaged`], as [`walk`](crate::walk::walk).
#[inline(always)]
pub(super) fn walk<S: Simd, M: SceneMemory, C: Count, K: Kinds, T: Targets<S>>(
    s: S,
    scene: &SceneView<M>,
    beam: &Beam<'_>,
    targets: &mut T,
    count: &mut C,
) -> Result<(), Damaged> {
    let budget = Budget::of(scene.header());
    let frame = BoxFrame::new(scene.header().grid.size * 0.25, scene.header().grid.slack);
    let leaves = Leaves {
        clusters: [ClusterRef::NONE; LANES],
        boxes: [[0; LANES]; 6],
        count: 0,
        corner: Vec3::ZERO,
        frame,
    };
    let (queue, far_queue, kinds) = (Queue::new(s), FarQueue::new(), PhantomData);
    let is_from_afar = T::ANY && !scene.memory().is_all_at_hand();
    let mut walk = Walk::<S, M, C, K, T> {
        s,
        scene,
        beam,
        targets,
        count,
        budget,
        leaves,
        queue,
        far_queue,
        is_from_afar,
        kinds,
    };
    walk.run()?;
    walk.visit_before(f32::NEG_INFINITY)
}

/// A walk under way.
struct Walk<'a, S: Simd, M, C, K, T> {
    s: S,
    scene: &'a SceneView<M>,
    beam: &'a Beam<'a>,
    targets: &'a mut T,
    count: &'a mut C,
    budget: Budget,
    leaves: Leaves,
    queue: Queue<S::F>,
    far_queue: FarQueue,
    /// Whether the beam is followed from its far end. Rays to the light start there, and mostly end soon, at what their own
    /// surface is made of; so what is far from the light is tested first where pages may have to be fetched. Where none has, it
    /// would take longer.
    is_from_afar: bool,
    kinds: PhantomData<K>,
}

/// The clusters of up to sixteen leaves of one branch.
struct Leaves {
    clusters: [ClusterRef; LANES],
    /// The coordinates of their boxes.
    boxes: [[u8; LANES]; 6],
    count: usize,
    /// The branch's lowest corner, and the coordinates of the leaves' boxes.
    corner: Vec3,
    frame: BoxFrame,
}

/// A branch that the beam is in.
#[derive(Clone, Copy)]
struct Visit {
    branch: Branch,
    corner: Vec3,
    cell: f32,
    /// Inner cells still to visit, flipped so that the lowest bit is about the first.
    left: u64,
}

impl<S: Simd, M: SceneMemory, C: Count, K: Kinds, T: Targets<S>> Walk<'_, S, M, C, K, T> {
    #[inline(always)]
    fn run(&mut self) -> Result<(), Damaged> {
        let grid = self.scene.header().grid;
        let flip = self.flip();
        let mut visit = self.enter(0, grid.origin, grid.size * 0.25)?;
        let mut above = [visit; LEVELS_MAX];
        let mut depth = 0;
        loop {
            if visit.left == 0 {
                if depth == 0 {
                    return Ok(());
                }
                depth -= 1;
                visit = above[depth];
                continue;
            }
            let cell = visit.left.trailing_zeros() ^ flip;
            visit.left &= visit.left - 1;
            let corner = visit.corner + Vec3::from(cell_coordinates(cell).map(|i| i as f32)) * visit.cell;
            let child = visit.branch.child_of(cell).ok_or(Damaged::Branch(u32::MAX))?;
            if !self.may_enter(corner, visit.cell, self.scene.has_branch_at_hand(child))? {
                continue;
            }
            above[depth] = visit;
            depth += 1;
            if depth >= grid.levels as usize {
                return Err(Damaged::Depth);
            }
            visit = self.enter(child, corner, visit.cell * 0.25)?;
        }
    }

    /// Along which axes the walk goes backwards, as bits of a cell index.
    #[inline(always)]
    fn flip(&self) -> u32 {
        if self.is_from_afar { self.beam.frustum.flip ^ ALL_AXES } else { self.beam.frustum.flip }
    }

    /// Of what has its nearest point at an inverse depth of `near`; what has a greater rank is tested first.
    #[inline(always)]
    pub(super) fn rank(&self, near: f32) -> f32 {
        if self.is_from_afar { 1.0 / near } else { near }
    }

    /// Whether anything in a cell may matter. If what it leads to may be far away, a closer look is taken.
    #[inline(always)]
    fn may_enter(&mut self, corner: Vec3, cell: f32, is_at_hand: bool) -> Result<bool, Damaged> {
        let half = cell * 0.5;
        let centre = (corner + half - self.beam.projection.eye).to_array();
        let seen = SeenBox { centre, half: [half + self.beam.frustum.cell_pad; 3] };
        let [centre, half] =
            each!(2: [seen.centre, seen.half], ends => each!(3: ends, end => self.s.splat(end)));
        let boxes = self.beam.projection.boxes(self.s, centre, half);
        let bounds = boxes.by_lane(self.s).of(0);
        if !is_at_hand {
            self.visit_before(self.rank(bounds.near))?;
        }
        let least = self.targets.least(self.s);
        Ok(self.beam.projection.shows(self.s, &boxes, least) != 0
            && self.targets.wants(self.s, &bounds, (!is_at_hand).then_some(&seen)))
    }

    /// Reads a branch, culls its cells, and has the clusters of its leaves wait.
    #[inline(always)]
    fn enter(&mut self, index: u32, corner: Vec3, cell: f32) -> Result<Visit, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        let branch = self.scene.branch(index)?;
        self.count.branch();
        let frustum = self.beam.frustum;
        let farthest = farthest(self.targets.least(self.s));
        let entered = frustum.cells_entered(self.s, &branch, corner, cell, farthest);
        self.leaves.corner = corner;
        self.leaves.frame = BoxFrame::new(cell, self.scene.header().grid.slack);
        let mut runs = entered & !branch.inner;
        while runs != 0 {
            let first = runs.trailing_zeros();
            let run = runs & branch.cells_of_run(first);
            runs &= !run;
            let leaf = branch.leaf_of(first).ok_or(Damaged::Leaf(u32::MAX))?;
            if self.scene.has_leaf_at_hand(leaf) || self.may_enter_any(corner, cell, run)? {
                self.gather(leaf)?;
            }
        }
        self.sift()?;
        Ok(Visit { branch, corner, cell, left: flip_cells(entered & branch.inner, self.flip()) })
    }

    /// Reads a leaf, or those of its list.
    #[inline(always)]
    fn gather(&mut self, leaf: u32) -> Result<(), Damaged> {
        let (mut next, mut end, mut in_list) = (leaf, leaf.checked_add(1).ok_or(Damaged::Leaf(leaf))?, false);
        while next < end {
            let index = next;
            next += 1;
            Budget::spend(&mut self.budget.leaves)?;
            let leaf = self.scene.leaf(index)?;
            self.count.leaf();
            match leaf.content().ok_or(Damaged::Leaf(index))? {
                LeafContent::Cluster(place) if K::TRIANGLES => self.collect(place, leaf.bounds)?,
                LeafContent::Spheres(place) if K::SPHERES => self.collect(name_of(&place), leaf.bounds)?,
                LeafContent::Cluster(_) | LeafContent::Spheres(_) => return Err(Damaged::Leaf(index)),
                LeafContent::List { .. } if in_list => return Err(Damaged::Leaf(index)),
                LeafContent::List { first, count } => {
                    (next, end, in_list) =
                        (first, first.checked_add(count).ok_or(Damaged::Leaf(first))?, true);
                }
            }
        }
        Ok(())
    }

    /// Adds a leaf to those that are culled next.
    #[inline(always)]
    fn collect(&mut self, place: ClusterRef, bounds: [u8; 6]) -> Result<(), Damaged> {
        if self.leaves.count == LANES {
            self.sift()?;
        }
        self.leaves.push(place, bounds);
        Ok(())
    }

    /// Has the clusters wait of those leaves whose box shows.
    #[inline(always)]
    fn sift(&mut self) -> Result<(), Damaged> {
        let lanes = first_lanes(core::mem::take(&mut self.leaves.count));
        if lanes == 0 {
            return Ok(());
        }
        let (centre, half) = self.leaves.boxes(self.s, self.beam);
        let boxes = self.beam.projection.boxes(self.s, centre, half);
        let least = self.targets.least(self.s);
        let mut left = self.beam.projection.shows(self.s, &boxes, least) & lanes;
        let bounds = boxes.by_lane(self.s);
        let (centre, half) =
            (each!(3: centre, at => self.s.array(at)), each!(3: half, at => self.s.array(at)));
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let seen = SeenBox {
                centre: each!(3: [0, 1, 2], axis => centre[axis][lane]),
                half: each!(3: [0, 1, 2], axis => half[axis][lane]),
            };
            let place = self.leaves.clusters[lane];
            let bounds = bounds.of(lane);
            self.enqueue(Waiting { place, bounds, seen, rank: self.rank(bounds.near) })?;
        }
        Ok(())
    }

    /// Has a cluster wait, and visits the first if there is no room.
    #[inline(always)]
    fn enqueue(&mut self, next: Waiting) -> Result<(), Damaged> {
        if !self.has_at_hand(&next.place) {
            return self.enqueue_far(next);
        }
        if self.queue.is_full()
            && let Some(first) = self.queue.take_first(self.s)
        {
            self.visit(&first)?;
        }
        match spheres_of::<K>(&next.place) {
            Some(place) => self.scene.prefetch_spheres(&place),
            None => self.scene.prefetch_cluster(&next.place),
        }
        self.queue.push(self.s, next);
        Ok(())
    }

    #[inline(always)]
    fn has_at_hand(&self, place: &ClusterRef) -> bool {
        match spheres_of::<K>(place) {
            Some(place) => self.scene.has_spheres_at_hand(&place),
            None => self.scene.has_cluster_at_hand(place),
        }
    }

    /// Tests a cluster, unless by now it does not matter. Only here its page is touched; if that may be far away, it is
    /// looked at more closely whether it matters.
    #[inline(always)]
    fn visit(&mut self, Waiting { place, bounds, seen, .. }: &Waiting) -> Result<(), Damaged> {
        let seen = (!self.has_at_hand(place)).then_some(seen);
        if !self.targets.wants(self.s, bounds, seen) {
            return Ok(());
        }
        if let Some(place) = spheres_of::<K>(place) {
            return self.visit_spheres(&place);
        }
        let record = self.scene.cluster(place)?;
        if M::HOLDS_NOTHING {
            return self.test(&record, place);
        }
        let copy = Copied::of(&record).ok_or(Damaged::Cluster { offset: place.offset })?;
        drop(record);
        self.test(copy.bytes(), place)
    }

    #[inline(always)]
    fn test(&mut self, record: &[u8], place: &ClusterRef) -> Result<(), Damaged> {
        let cluster = Cluster::new(record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        self.count.triangles(place.triangles.into());
        self.s.apart(Test { targets: self.targets, projection: self.beam.projection, cluster: &cluster });
        Ok(())
    }
}

impl<S: Simd, M: SceneMemory, C: Count, K: Kinds, T: Targets<S>> Walk<'_, S, M, C, K, T> {
    /// The same for a cluster of spheres.
    #[inline(always)]
    fn visit_spheres(&mut self, place: &SpheresRef) -> Result<(), Damaged> {
        let record = self.scene.spheres(place)?;
        if M::HOLDS_NOTHING {
            return self.test_spheres(&record, place);
        }
        let copy = Copied::of(&record).ok_or(Damaged::Cluster { offset: place.offset })?;
        drop(record);
        self.test_spheres(copy.bytes(), place)
    }

    #[inline(always)]
    fn test_spheres(&mut self, record: &[u8], place: &SpheresRef) -> Result<(), Damaged> {
        let cluster = SphereCluster::new(record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        self.count.spheres(place.count.into());
        let projection = self.beam.projection;
        self.s.apart(TestSpheres { targets: self.targets, projection, cluster: &cluster });
        Ok(())
    }
}

/// A copy of a cluster's record: a pixel in doubt looks up what it shows, and no two records may be held at a time.
struct Copied {
    bytes: [u8; CLUSTER_BYTES_MAX],
    length: usize,
}

impl Copied {
    /// A copy, or `None` of a record longer than any cluster's.
    fn of(record: &[u8]) -> Option<Self> {
        let mut copied = Self { bytes: [0; CLUSTER_BYTES_MAX], length: record.len() };
        copied.bytes.get_mut(..record.len())?.copy_from_slice(record);
        Some(copied)
    }

    fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// The test of a cluster of spheres.
struct TestSpheres<'a, T> {
    targets: &'a mut T,
    projection: &'a Projection,
    cluster: &'a SphereCluster<'a>,
}

impl<S: Simd, T: Targets<S>> Part<S> for TestSpheres<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        self.targets.test_spheres(s, self.projection, self.cluster);
    }
}

/// The test of a cluster, kept apart: it needs all registers.
struct Test<'a, T> {
    targets: &'a mut T,
    projection: &'a Projection,
    cluster: &'a Cluster<'a>,
}

impl<S: Simd, T: Targets<S>> Part<S> for Test<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        let Self { targets, projection, cluster } = self;
        match projection.triangles(s, cluster) {
            Some(triangles) if !triangles.are_large() => targets.test(s, &triangles),
            _ => targets.test_far(s, cluster),
        }
    }
}

impl Leaves {
    /// Adds a leaf where there is room.
    #[inline(always)]
    fn push(&mut self, cluster: ClusterRef, bounds: [u8; 6]) {
        let lane = self.count % LANES;
        self.clusters[lane] = cluster;
        for (boxes, coordinate) in self.boxes.iter_mut().zip(bounds) {
            boxes[lane] = coordinate;
        }
        self.count += 1;
    }

    /// Middles of the boxes, from the eye, and halves of their edges, with some margin.
    #[inline(always)]
    fn boxes<S: Simd>(&self, s: S, beam: &Beam<'_>) -> ([S::F; 3], [S::F; 3]) {
        let (low, step) = (s.splat(self.frame.low()), s.splat(self.frame.step()));
        let from_eye = self.corner - beam.projection.eye;
        let pad = s.splat(beam.frustum.box_pad);
        let ends = each!(3: [0, 1, 2], axis => {
            let first = s.to_float(s.bytes(&self.boxes[axis]));
            let last = s.add(s.to_float(s.bytes(&self.boxes[axis + 3])), s.splat(1.0));
            let low = s.add(s.mul(first, step), low);
            let half = s.mul(s.mul(s.sub(last, first), step), s.splat(0.5));
            (s.add(s.splat(from_eye[axis]), s.add(low, half)), s.add(half, pad))
        });
        (ends.map(|(centre, _)| centre), ends.map(|(_, half)| half))
    }
}

/// What is deeper does not matter, where the least inverse depth that does is known; below 0 when nothing matters.
#[inline(always)]
fn farthest(least: f32) -> f32 {
    if least == f32::INFINITY { -1.0 } else { (1.0 + 1.0 / 65_536.0) / least }
}
