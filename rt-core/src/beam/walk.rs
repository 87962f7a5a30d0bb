//! The walk of a beam through the grid, front to back.

use glam::Vec3;

use super::frustum::{Depths, Frustum, Seen};
use super::projection::{NEAR, Projected, Projection};
use crate::cluster::Cluster;
use crate::count::Count;
use crate::grid::{BoxFrame, Branch, ClusterRef, LEVELS_MAX, LeafContent, cell_coordinates, flip_cells};
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Part, Simd, each, first_lanes};
use crate::view::{Damaged, SceneView};
use crate::walk::Budget;

/// What a beam looks for: the nearest triangle of every pixel, or any between samples and the light.
pub(super) trait Targets<S: Simd> {
    /// What still matters.
    fn depths(&mut self, s: S) -> &Depths;

    /// Which parts of the targets triangles within these bounds may matter to; 0 when none.
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64;

    /// Whether anything within these bounds may matter, looked at closely.
    fn wants(&mut self, s: S, bounds: &Bounds) -> bool;

    /// Tests sixteen triangles.
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>);

    /// Tests a cluster that cannot be projected.
    fn test_by_rays(&mut self, s: S, cluster: &Cluster<'_>);
}

/// Up to sixteen triangles of a cluster, projected.
pub(super) struct Triangles<'a, S: Simd> {
    pub(super) corners: [Projected<S::F>; 3],
    /// Lanes that hold a triangle.
    pub(super) lanes: Mask,
    /// Uncertainty of the corners' coordinates.
    pub(super) delta: f32,
    /// Relative uncertainty of their inverse depths.
    pub(super) depth_epsilon: f32,
    /// What [`Targets::interest`] said of the cluster.
    pub(super) interest: u64,
    pub(super) cluster: &'a Cluster<'a>,
    /// Place of the first triangle in the cluster.
    pub(super) first: usize,
}

impl<S: Simd> Triangles<'_, S> {
    /// The corners of the triangle in a lane, in grid units.
    #[inline(always)]
    pub(super) fn corners_of(&self, lane: usize) -> [Vec3; 3] {
        self.cluster.triangle(self.first + lane)
    }
}

/// The box of a cluster on the projection plane, with some margin, and its greatest inverse depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) left: f32,
    pub(super) right: f32,
    pub(super) top: f32,
    pub(super) bottom: f32,
    pub(super) near: f32,
}

/// A beam: where it looks from and what it may enter.
pub(super) struct Beam<'a> {
    pub(super) projection: &'a Projection,
    pub(super) frustum: &'a Frustum,
}

/// Leads every triangle that the beam may meet to its targets.
///
/// # Errors
/// [`Damaged`], as [`walk`](crate::walk::walk).
#[inline(always)]
pub(super) fn walk<S: Simd, M: SceneMemory, C: Count, T: Targets<S>>(
    s: S,
    scene: &SceneView<M>,
    beam: &Beam<'_>,
    targets: &mut T,
    count: &mut C,
) -> Result<(), Damaged> {
    let budget = Budget::of(scene.header());
    let mut walk = Walk { s, scene, beam, targets, count, budget, queue: Queue::new() };
    walk.run()?;
    while let Some(next) = walk.queue.take() {
        walk.visit_waiting(&next)?;
    }
    Ok(())
}

/// A walk under way.
struct Walk<'a, S, M, C, T> {
    s: S,
    scene: &'a SceneView<M>,
    beam: &'a Beam<'a>,
    targets: &'a mut T,
    count: &'a mut C,
    budget: Budget,
    queue: Queue,
}

/// Clusters whose box is seen, first in first out. While they wait, their bytes come nearer.
struct Queue {
    waiting: [Waiting; Self::LENGTH],
    first: usize,
    count: usize,
}

/// A cluster whose box is seen.
#[derive(Clone, Copy)]
struct Waiting {
    place: ClusterRef,
    seen: Seen,
}

/// A branch that the beam is in.
#[derive(Clone, Copy)]
struct Visit {
    branch: Branch,
    corner: Vec3,
    cell: f32,
    /// Cells still to visit, flipped so that the lowest bit is about the nearest.
    left: u64,
}

impl<S: Simd, M: SceneMemory, C: Count, T: Targets<S>> Walk<'_, S, M, C, T> {
    #[inline(always)]
    fn run(&mut self) -> Result<(), Damaged> {
        let grid = self.scene.header().grid;
        let flip = self.beam.frustum.flip;
        let mut farthest = self.targets.depths(self.s).farthest;
        let mut visit = self.enter(0, grid.origin, grid.size * 0.25, farthest)?;
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
            if self.beam.frustum.is_hidden(corner, visit.cell, farthest) {
                continue;
            }
            if visit.branch.inner >> cell & 1 != 0 {
                let child = visit.branch.child_of(cell).ok_or(Damaged::Branch(u32::MAX))?;
                above[depth] = visit;
                depth += 1;
                if depth >= grid.levels as usize {
                    return Err(Damaged::Depth);
                }
                visit = self.enter(child, corner, visit.cell * 0.25, farthest)?;
            } else {
                visit.left &= !flip_cells(visit.branch.cells_of_run(cell), flip);
                self.visit_run(&visit, cell)?;
                farthest = self.targets.depths(self.s).farthest;
                if farthest < 0.0 {
                    return Ok(());
                }
            }
        }
    }

    /// Reads a branch and culls its cells.
    #[inline(always)]
    fn enter(&mut self, index: u32, corner: Vec3, cell: f32, farthest: f32) -> Result<Visit, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        let branch = self.scene.branch(index)?;
        self.count.branch();
        let entered = self.beam.frustum.cells_entered(self.s, &branch, corner, cell, farthest);
        Ok(Visit { branch, corner, cell, left: flip_cells(entered, self.beam.frustum.flip) })
    }

    /// Tests what the run of `cell` holds.
    #[inline(always)]
    fn visit_run(&mut self, visit: &Visit, cell: u32) -> Result<(), Damaged> {
        let leaf = visit.branch.leaf_of(cell).ok_or(Damaged::Leaf(u32::MAX))?;
        let (mut next, mut end, mut in_list) = (leaf, leaf.checked_add(1).ok_or(Damaged::Leaf(leaf))?, false);
        let frame = BoxFrame::new(visit.cell, self.scene.header().grid.slack);
        while next < end {
            let index = next;
            next += 1;
            Budget::spend(&mut self.budget.leaves)?;
            let leaf = self.scene.leaf(index)?;
            self.count.leaf();
            let depths = self.targets.depths(self.s);
            let seen = self.beam.frustum.box_entered(self.s, visit.corner, &frame, leaf.bounds);
            if seen.blocks & depths.waiting(self.s, seen.nearest) == 0 {
                continue;
            }
            match leaf.content().ok_or(Damaged::Leaf(index))? {
                LeafContent::Cluster(place) => self.enqueue(Waiting { place, seen })?,
                LeafContent::Spheres(_) => return Err(Damaged::Leaf(index)),
                LeafContent::List { .. } if in_list => return Err(Damaged::Leaf(index)),
                LeafContent::List { first, count } => {
                    (next, end, in_list) =
                        (first, first.checked_add(count).ok_or(Damaged::Leaf(first))?, true);
                }
            }
        }
        Ok(())
    }

    /// Has a cluster wait, and visits the one that has waited longest if there is no room.
    #[inline(always)]
    fn enqueue(&mut self, next: Waiting) -> Result<(), Damaged> {
        self.scene.prefetch_cluster(&next.place);
        match self.queue.push(next) {
            Some(first) => self.visit_waiting(&first),
            None => Ok(()),
        }
    }

    #[inline(always)]
    fn visit_waiting(&mut self, Waiting { place, seen }: &Waiting) -> Result<(), Damaged> {
        let depths = self.targets.depths(self.s);
        if seen.blocks & depths.waiting(self.s, seen.nearest) == 0 {
            return Ok(());
        }
        // The last look before its page is touched: whether the box reaches over any pixel to which it matters.
        match self.beam.projection.bounds(self.s, seen) {
            Some(bounds) if !self.targets.wants(self.s, &bounds) => Ok(()),
            _ => self.visit_cluster(place),
        }
    }

    #[inline(always)]
    fn visit_cluster(&mut self, place: &ClusterRef) -> Result<(), Damaged> {
        let record = self.scene.cluster(place)?;
        let cluster = Cluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        let Some(vertices) = Project { projection: self.beam.projection, cluster: &cluster }.run(self.s)
        else {
            self.targets.test_by_rays(self.s, &cluster);
            return Ok(());
        };
        let interest = self.targets.interest(self.s, &vertices.bounds);
        if interest == 0 {
            return Ok(());
        }
        let triangles = usize::from(place.triangles);
        self.count.triangles(triangles as u32);
        let mut first = 0;
        while first < triangles {
            let corners = each!(3: cluster.corners(), corners => {
                let index = self.s.bytes(&corners[first..corners.len().min(first + LANES)]);
                let [x, y, w] = [&vertices.x, &vertices.y, &vertices.w];
                Projected { x: self.s.lookup(x, index), y: self.s.lookup(y, index), w: self.s.lookup(w, index) }
            });
            let lanes = first_lanes(triangles - first);
            let batch = Triangles {
                corners,
                lanes,
                delta: vertices.delta,
                depth_epsilon: self.beam.projection.depth_epsilon,
                interest,
                cluster: &cluster,
                first,
            };
            self.targets.test(self.s, &batch);
            first += LANES;
        }
        Ok(())
    }
}

/// The projection of a cluster, kept apart.
struct Project<'a> {
    projection: &'a Projection,
    cluster: &'a Cluster<'a>,
}

impl<S: Simd> Part<S> for Project<'_> {
    type Output = Option<Vertices>;

    /// Projects the vertices of a cluster, or `None` when one lies behind the eye or too far out.
    #[inline(always)]
    fn run(self, s: S) -> Option<Vertices> {
        let Self { projection, cluster } = self;
        let mut vertices = Vertices {
            x: [[0.0; LANES]; 2],
            y: [[0.0; LANES]; 2],
            w: [[0.0; LANES]; 2],
            delta: projection.delta,
            bounds: Bounds { left: 0.0, right: 0.0, top: 0.0, bottom: 0.0, near: 0.0 },
        };
        let count = usize::from(cluster.place().vertices);
        let mut fits = true;
        // Least coordinates, least negated coordinates and inverse depth.
        let mut least = [s.splat(f32::INFINITY); 5];
        let mut half = 0;
        while half * LANES < count {
            let from = half * LANES;
            let point =
                each!(3: cluster.axes(), axis => s.load_le(&axis[from..axis.len().min(from + LANES)]));
            let Projected { x, y, w } = projection.project(s, point);
            let out = s.max(s.abs(x), s.abs(y));
            let lanes = first_lanes(count - from);
            let is_sound =
                s.lt(s.splat(0.0), w) & s.le(out, s.splat(projection.wide)) & s.lt(w, s.splat(W_MAX));
            fits &= is_sound & lanes == lanes;
            let zero = s.splat(0.0);
            let ends = [x, s.sub(zero, x), y, s.sub(zero, y), s.sub(zero, w)];
            for (least, end) in least.iter_mut().zip(ends) {
                *least = s.min(s.select(lanes, end, *least), *least);
            }
            s.store(x, &mut vertices.x[half]);
            s.store(y, &mut vertices.y[half]);
            s.store(w, &mut vertices.w[half]);
            half += 1;
        }
        let [left, right] = [s.least(least[0]), -s.least(least[1])];
        let [top, bottom] = [s.least(least[2]), -s.least(least[3])];
        let near = -s.least(least[4]);
        if left.min(top) < -NEAR || right.max(bottom) > NEAR {
            vertices.delta = projection.delta_wide;
        }
        let margin = vertices.delta;
        vertices.bounds = Bounds {
            left: left - margin,
            right: right + margin,
            top: top - margin,
            bottom: bottom + margin,
            near: near * (1.0 + projection.depth_epsilon),
        };
        fits.then_some(vertices)
    }
}

impl Queue {
    /// Long enough to hide the way from main memory behind the work on as many clusters.
    const LENGTH: usize = 4;

    const fn new() -> Self {
        let place = ClusterRef { offset: 0, vertices: 0, triangles: 0, first: 0 };
        let seen = Seen { blocks: 0, nearest: 0.0, centre: Vec3::ZERO, half: Vec3::ZERO };
        let none = Waiting { place, seen };
        Self { waiting: [none; Self::LENGTH], first: 0, count: 0 }
    }

    /// Adds a cluster; gives back the first when there is no room.
    #[inline(always)]
    fn push(&mut self, next: Waiting) -> Option<Waiting> {
        let pushed_out = if self.count == Self::LENGTH { self.take() } else { None };
        self.waiting[(self.first + self.count) % Self::LENGTH] = next;
        self.count += 1;
        pushed_out
    }

    #[inline(always)]
    fn take(&mut self) -> Option<Waiting> {
        if self.count == 0 {
            return None;
        }
        let first = self.waiting[self.first];
        self.first = (self.first + 1) % Self::LENGTH;
        self.count -= 1;
        Some(first)
    }
}

/// The vertices of a cluster, projected; a lane that the cluster does not have is anything.
struct Vertices {
    x: [[f32; LANES]; 2],
    y: [[f32; LANES]; 2],
    w: [[f32; LANES]; 2],
    delta: f32,
    bounds: Bounds,
}

/// Largest inverse depth, in grid units: nearer to the eye than 2^-20 of the scene rays take over.
const W_MAX: f32 = 1_048_576.0;
