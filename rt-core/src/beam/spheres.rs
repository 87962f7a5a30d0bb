//! Clusters of spheres as beams name them, and sixteen spheres at a time.

use core::marker::PhantomData;

use glam::Vec3;

use crate::grid::{ClusterRef, SpheresRef};
use crate::kinds::Kinds;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};
use crate::sphere::SphereCluster;

/// A cluster of spheres where clusters of triangles are named too: it is one without vertices.
#[inline(always)]
pub(super) const fn name_of(place: &SpheresRef) -> ClusterRef {
    ClusterRef { offset: place.offset, vertices: 0, triangles: place.count, first: place.first }
}

/// The cluster of spheres that is named, or `None` when it is one of triangles.
#[inline(always)]
pub(super) const fn spheres_of<K: Kinds>(name: &ClusterRef) -> Option<SpheresRef> {
    if K::SPHERES && (!K::TRIANGLES || name.vertices == 0) {
        return Some(SpheresRef { offset: name.offset, count: name.triangles, first: name.first });
    }
    None
}

/// Sixteen spheres, one in each lane, or one in all.
#[derive(Clone, Copy)]
pub(super) struct Balls<F> {
    /// Centres.
    pub(super) centre: [F; 3],
    pub(super) radius: F,
}

/// All spheres of a cluster, sixteen in each half.
pub(super) struct AllBalls<F> {
    halves: [Balls<F>; 2],
    pub(super) count: usize,
}

impl<F: Copy> AllBalls<F> {
    #[inline(always)]
    pub(super) fn of<S: Simd<F = F>>(s: S, cluster: &SphereCluster<'_>) -> Self {
        let halves = each!(2: [0, LANES], first => {
            let [x, y, z, radius] = each!(4: cluster.lanes(), from => {
                s.load_le(&from[from.len().min(first)..from.len().min(first + LANES)])
            });
            Balls { centre: [x, y, z], radius }
        });
        Self { halves, count: usize::from(cluster.place().count) }
    }

    /// Half of them, and the lanes that hold a sphere that can be hit.
    #[inline(always)]
    pub(super) fn half<S: Simd<F = F>>(&self, s: S, half: usize) -> (&Balls<F>, Mask) {
        let balls = &self.halves[half];
        (balls, first_lanes(self.count.saturating_sub(half * LANES)) & s.lt(s.splat(0.0), balls.radius))
    }

    /// Spheres by number in the cluster.
    #[inline(always)]
    pub(super) fn named<S: Simd<F = F>>(&self, s: S, names: S::I) -> Balls<F> {
        let [a, b] = &self.halves;
        let centre = each!(3: [0, 1, 2], axis => s.pick_of_two([a.centre[axis], b.centre[axis]], names));
        Balls { centre, radius: s.pick_of_two([a.radius, b.radius], names) }
    }
}

impl<F: Copy> Balls<F> {
    /// The centres, from a point.
    #[inline(always)]
    pub(super) fn from<S: Simd<F = F>>(&self, s: S, point: Vec3) -> [F; 3] {
        let point = s.splat3(point);
        each!(3: [0, 1, 2], axis => s.sub(self.centre[axis], point[axis]))
    }
}

/// Spheres that a tile has been through with, some of them: large ones are stored in many clusters, and once is enough.
pub(super) struct Mailbox<K> {
    spheres: [[u32; 4]; SEEN],
    kinds: PhantomData<K>,
}

/// How many are kept.
const SEEN: usize = 64;

impl<K: Kinds> Mailbox<K> {
    pub(super) const fn new() -> Self {
        Self { spheres: [[0; 4]; SEEN], kinds: PhantomData }
    }

    /// Notes spheres of half a cluster, and tells those that are not known to have been seen.
    #[inline(always)]
    pub(super) fn new_ones(&mut self, cluster: &SphereCluster<'_>, half: usize, lanes: Mask) -> Mask {
        let (mut left, mut fresh) = (lanes, lanes);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let from = cluster.lanes().map(|from| from.get(half * LANES + lane));
            let sphere = from.map(|bytes| bytes.map_or(0, |&bytes| u32::from_le_bytes(bytes)));
            let [x, y, z, radius] = sphere;
            let hash = (x ^ y.rotate_left(11) ^ z.rotate_left(22) ^ radius).wrapping_mul(0x9e37_79b1);
            let kept = &mut self.spheres[(hash >> 26) as usize % SEEN];
            fresh &= !(Mask::from(*kept == sphere) << lane);
            *kept = sphere;
        }
        fresh
    }
}
