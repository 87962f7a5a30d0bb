//! The **packet** kernel: sixteen rays through the grid together.
//!
//! # How it goes
//! A branch is read once for all rays that enter it. Its 64 cells are culled against the bounds of the whole packet; the
//! cells that are left are taken front to back as most rays meet them, and each is tested against sixteen rays at once: an
//! inner cell by the cell, a run by its leaf's tight box. A cluster is tested for the rays whose bit is left,
//! [triangle by triangle](crate::packet_cluster), or ray by ray when they are few.
//!
//! Where few rays enter a branch, each goes on from there [alone](crate::walk). Rays that do not run mainly along the same
//! axis, the same way, are not brought here at all: so rays that have nothing in common cost little more in a packet.
//!
//! # Why it finds what each ray finds alone
//! Both find what testing every triangle and sphere finds: culling errs towards entering by the allowances of
//! [`walk`](crate::walk), triangles are tested by the same arithmetic, and of hits at the same distance
//! [`Nearest`] holds the same one whatever the order of visits.

use glam::Vec3;
use heapless::Vec;

use crate::cluster::{Cluster, Nearest};
use crate::count::Count;
use crate::grid::{BoxFrame, Branch, ClusterRef, LEVELS_MAX, LeafContent, SpheresRef, flip_cells};
use crate::grid_ray::GridRay;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::packet_cluster::WoopPacket;
use crate::packet_rays::{PacketRays, Padding};
use crate::simd::{LANES, Mask, Part, Simd};
use crate::sphere::SphereCluster;
use crate::triangle_woop::WoopRay;
use crate::view::{Damaged, SceneView};
use crate::walk::{Budget, Place, Walk};

/// Rays in their lanes, all along the same axis, and what each has hit so far.
pub(crate) struct Packet<'a> {
    /// A ray for every lane; those of lanes that are not active are copies.
    pub(crate) rays: &'a [GridRay; LANES],
    pub(crate) active: Mask,
    pub(crate) nearest: [Nearest; LANES],
}

impl<'a> Packet<'a> {
    /// The rays that are there, one at least.
    pub(crate) fn new(rays: &'a [GridRay; LANES], active: Mask) -> Self {
        let mut nearest = [Nearest::none(0.0); LANES];
        for (nearest, ray) in nearest.iter_mut().zip(rays) {
            nearest.crossing.t = ray.t_max();
        }
        Self { rays, active, nearest }
    }
}

/// Finds the nearest hits of the rays of a packet, or with `ANY` some hit of each, among primitives of the kinds `K`.
///
/// # Bounds
/// At most as many branches and leaves are read as the image has, once for the packet and once for each ray.
///
/// # Errors
/// As [`walk`](crate::walk).
#[inline(always)]
pub(crate) fn walk_packet<S: Simd, M: SceneMemory, C: Count, K: Kinds, const ANY: bool>(
    s: S,
    scene: &SceneView<M>,
    packet: &mut Packet<'_>,
    count: &mut C,
) -> Result<(), Damaged> {
    let Some(root) = Place::root(scene.header()) else { return Ok(()) };
    let &mut Packet { rays, active, ref mut nearest } = packet;
    let budget = Budget::of(scene.header());
    let alone = [budget; LANES];
    let mut t = [0.0; LANES];
    for (t, ray) in t.iter_mut().zip(rays) {
        *t = ray.t_max();
    }
    let (culling, woop) = (PacketRays::new(rays), WoopPacket::new(rays));
    PacketWalk { s, scene, rays, culling, woop, count, nearest, t, active, budget, alone }.run::<K, ANY>(root)
}

/// A walk under way.
struct PacketWalk<'a, S, M, C> {
    s: S,
    scene: &'a SceneView<M>,
    rays: &'a [GridRay; LANES],
    culling: PacketRays,
    woop: WoopPacket,
    count: &'a mut C,
    nearest: &'a mut [Nearest; LANES],
    /// Distance of each ray's nearest hit so far.
    t: [f32; LANES],
    /// Rays that still look for something.
    active: Mask,
    /// For what is read together, and for what each ray reads alone.
    budget: Budget,
    alone: [Budget; LANES],
}

/// A branch that some of the rays are in.
#[derive(Clone, Copy)]
struct Visit {
    branch: Branch,
    place: Place,
    /// The rays that enter the branch.
    rays: Mask,
    /// Cells still to visit, flipped.
    left: u64,
    /// Runs that were visited, one bit each.
    done: u64,
}

impl<S: Simd, M: SceneMemory, C: Count> PacketWalk<'_, S, M, C> {
    #[inline(always)]
    fn run<K: Kinds, const ANY: bool>(&mut self, root: Place) -> Result<(), Damaged> {
        let levels = self.scene.header().grid.levels;
        let mut visit = self.enter(root, self.active)?;
        let mut above = Vec::<Visit, LEVELS_MAX>::new();
        loop {
            visit.rays &= self.active;
            if visit.left == 0 || visit.rays == 0 {
                let Some(last) = above.pop() else { return Ok(()) };
                visit = last;
                continue;
            }
            let cell = visit.left.trailing_zeros() ^ self.culling.flip();
            visit.left &= visit.left - 1;
            if visit.branch.inner >> cell & 1 != 0 {
                let child = visit.place.child(&visit.branch, cell, levels)?;
                let entering = self.entering_cell(&child) & visit.rays;
                if entering.count_ones() < TOGETHER_MIN {
                    self.go_alone::<K, ANY>(child, entering)?;
                } else {
                    if visit.left != 0 {
                        above.push(visit).map_err(|_| Damaged::Depth)?;
                    }
                    visit = self.enter(child, entering)?;
                }
            } else {
                let run = visit.branch.run_of(cell).ok_or(Damaged::Leaf(u32::MAX))?;
                if visit.done >> run & 1 == 0 {
                    visit.done |= 1 << run;
                    self.visit_run::<K, ANY>(&visit, run)?;
                }
            }
        }
    }

    /// Reads a branch and culls its cells.
    #[inline(always)]
    fn enter(&mut self, place: Place, rays: Mask) -> Result<Visit, Damaged> {
        Budget::spend(&mut self.budget.branches)?;
        let branch = self.scene.branch(place.index)?;
        self.count.branch();
        let s = self.s;
        // The farthest of the hits: nothing behind it is of interest to any.
        let farthest = -s.least(s.select(rays, s.sub(s.splat(0.0), s.load(&self.t)), s.splat(0.0)));
        let entered = self.culling.cells_entered(s, place.corner, place.cell, farthest);
        let left = flip_cells(branch.occupied, self.culling.flip()) & entered;
        Ok(Visit { branch, place, rays, left, done: 0 })
    }

    /// The rays that enter the cube of a branch.
    #[inline(always)]
    fn entering_cell(&self, place: &Place) -> Mask {
        let cube = (Vec3::ZERO, Vec3::splat(place.cell * 4.0));
        self.culling.entering(self.s, place.corner, cube, Padding::Cell, &self.t)
    }

    /// Tests what a run holds, against all rays that are in the branch: each enters the run by a cell of its own.
    #[inline(always)]
    fn visit_run<K: Kinds, const ANY: bool>(&mut self, visit: &Visit, run: u32) -> Result<(), Damaged> {
        let index = visit.branch.leaf.checked_add(run).ok_or(Damaged::Leaf(u32::MAX))?;
        let Some((first, count)) = self.visit_leaf::<K, ANY>(visit, index)? else { return Ok(()) };
        for leaf in first..first.checked_add(count).ok_or(Damaged::Leaf(first))? {
            if self.visit_leaf::<K, ANY>(visit, leaf)?.is_some() {
                return Err(Damaged::Leaf(leaf));
            }
        }
        Ok(())
    }

    /// Tests the cluster of a leaf against the rays that enter its box; if it is a list, tells its first leaf and their
    /// number.
    #[inline(always)]
    fn visit_leaf<K: Kinds, const ANY: bool>(
        &mut self,
        visit: &Visit,
        index: u32,
    ) -> Result<Option<(u32, u32)>, Damaged> {
        Budget::spend(&mut self.budget.leaves)?;
        let leaf = self.scene.leaf(index)?;
        self.count.leaf();
        let frame = BoxFrame::new(visit.place.cell, self.scene.header().grid.slack);
        let bounds = frame.decode(leaf.bounds);
        let entering = self.culling.entering(self.s, visit.place.corner, bounds, Padding::Box, &self.t);
        let rays = entering & visit.rays & self.active;
        if rays == 0 {
            return Ok(None);
        }
        match leaf.content().ok_or(Damaged::Leaf(index))? {
            LeafContent::Cluster(place) if K::TRIANGLES => self.visit_cluster::<ANY>(&place, rays)?,
            LeafContent::Spheres(place) if K::SPHERES => self.visit_spheres::<ANY>(&place, rays)?,
            LeafContent::List { first, count } => return Ok(Some((first, count))),
            _ => return Err(Damaged::Leaf(index)),
        }
        self.note_hits::<ANY>(rays);
        Ok(None)
    }

    #[inline(always)]
    fn visit_cluster<const ANY: bool>(&mut self, place: &ClusterRef, rays: Mask) -> Result<(), Damaged> {
        let record = self.scene.cluster(place)?;
        let cluster = Cluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        self.count.triangles(u32::from(place.triangles));
        if rays.count_ones() >= TOGETHER_MIN {
            self.woop.intersect::<S, ANY>(self.s, &cluster, rays, self.nearest);
        } else {
            for lane in lanes(rays) {
                let ray = self.rays[lane].woop();
                cluster.intersect_filtered::<S, (), ANY>(self.s, &ray, &mut self.nearest[lane], &mut ());
            }
        }
        Ok(())
    }

    #[inline(always)]
    fn visit_spheres<const ANY: bool>(&mut self, place: &SpheresRef, rays: Mask) -> Result<(), Damaged> {
        let record = self.scene.spheres(place)?;
        let cluster = SphereCluster::new(&record, place).ok_or(Damaged::Cluster { offset: place.offset })?;
        self.count.cluster();
        self.count.spheres(u32::from(place.count));
        for lane in lanes(rays) {
            let ray = self.rays[lane].sphere_ray();
            cluster.intersect_filtered::<S, (), ANY>(self.s, &ray, &mut self.nearest[lane], &mut ());
        }
        Ok(())
    }

    /// Takes note of what these rays have hit by now; with `ANY`, a hit ends a ray's way.
    #[inline(always)]
    fn note_hits<const ANY: bool>(&mut self, rays: Mask) {
        for lane in lanes(rays) {
            self.t[lane] = self.nearest[lane].crossing.t;
            if ANY && self.nearest[lane].surface.is_some() {
                self.active &= !(1 << lane);
            }
        }
    }

    /// Takes these rays through a branch and all below it, one after the other.
    #[inline(always)]
    fn go_alone<K: Kinds, const ANY: bool>(&mut self, place: Place, rays: Mask) -> Result<(), Damaged> {
        for lane in lanes(rays) {
            let s = self.s;
            s.apart(Alone::<_, K, ANY> { walk: self, place, lane, kinds: core::marker::PhantomData })?;
        }
        self.note_hits::<ANY>(rays);
        Ok(())
    }
}

/// A ray that leaves the packet at a branch, as a function of its own.
struct Alone<'a, W, K, const ANY: bool> {
    walk: &'a mut W,
    place: Place,
    lane: usize,
    kinds: core::marker::PhantomData<K>,
}

impl<S: Simd, M: SceneMemory, C: Count, K: Kinds, const ANY: bool> Part<S>
    for Alone<'_, PacketWalk<'_, S, M, C>, K, ANY>
{
    type Output = Result<(), Damaged>;

    #[inline(always)]
    fn run(self, s: S) -> Result<(), Damaged> {
        let Self { walk: PacketWalk { scene, rays, count, nearest, alone, .. }, place, lane, .. } = self;
        let (ray, nearest, budget) = (&rays[lane], &mut nearest[lane], &mut alone[lane]);
        let test = ray.test::<K::Test<WoopRay>>();
        let mut walk =
            Walk { s, scene, ray, test, filter: &mut (), count: *count, nearest: *nearest, budget: *budget };
        walk.run::<K, ANY>(place)?;
        (*nearest, *budget) = (walk.nearest, walk.budget);
        Ok(())
    }
}

/// The lanes whose bits are set, lowest first.
pub(crate) fn lanes(mut rays: Mask) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let lane = rays.trailing_zeros() as usize;
        rays &= rays.checked_sub(1)?;
        Some(lane)
    })
}

/// Fewer rays than this go on one by one.
pub(crate) const TOGETHER_MIN: u32 = 4;
