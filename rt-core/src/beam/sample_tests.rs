//! The triangles of a cluster against the shadow samples of a tile.
//!
//! In steps that have full lanes and few branches; what each finds is written down for the next. First, which triangles
//! reach over which *groups* of samples, and which samples the cluster reaches over: boxes against boxes. Then, triangle by
//! triangle against a group, or sample by sample against the triangles, whichever is less work, which samples lie within the
//! box of which triangle. Last, these *pairs* are tested, sixteen at a time. Most are of a lit sample and a triangle of the
//! surface it lies on, and decide nothing.

use glam::Vec3;

use super::boxes::SeenBox;
use super::edges::Extent;
use super::pixel_tests::pack;
use super::points::{POINTS_MAX, Points};
use super::projection::Projection;
use super::samples::{GROUPS, Places, Samples};
use super::sphere_samples::SphereRoom;
use super::triangles::{Bounds, Corners, Triangles};
use super::walk::Targets;
use crate::cluster::Cluster;
use crate::grid::TRIANGLES_MAX;
use crate::simd::{LANES, Mask, Simd, first_lanes};
use crate::sphere::SphereCluster;

/// The shadow samples of a tile, each looking for any triangle between it and the light.
pub(super) struct Shadows<'a> {
    pub(super) samples: Samples<'a>,
    room: Room,
    /// For scenes with spheres.
    spheres: Option<SphereRoom>,
}

/// Where samples must lie that a triangle can shadow: within its bounds, with some margin, and behind it.
#[derive(Clone, Copy)]
pub(super) struct Around<F> {
    pub(super) left: F,
    pub(super) right: F,
    pub(super) top: F,
    pub(super) bottom: F,
    pub(super) near: F,
}

/// [`Around`] each triangle of a cluster, and the triangles' names.
struct AroundAll {
    around: Around<[[f32; LANES]; BATCHES]>,
    names: [[f32; LANES]; BATCHES],
}

/// Room for what the steps write down.
struct Room {
    all: AroundAll,
    /// Groups with triangles that reach over them: the group times [`TRIANGLES`], plus the triangle. When there are
    /// more than there is room for, it is less work to go sample by sample.
    reaching: List,
    /// Samples that the cluster reaches over, by number.
    within: List,
    pairs: Pairs,
}

/// Up to as many numbers as there are samples. The count goes on beyond.
struct List {
    numbers: [f32; POINTS_MAX + LANES],
    count: usize,
}

/// Pairs of a sample and a triangle, waiting to be tested.
struct Pairs {
    names: [f32; CAPACITY],
    /// Sixteen times the group, plus the lane.
    samples: [f32; CAPACITY],
    count: usize,
}

/// Most triangles of a cluster, and batches of them.
const TRIANGLES: usize = TRIANGLES_MAX as usize;
const BATCHES: usize = TRIANGLES / LANES;

/// Enough that tests seldom lack pairs; apart from powers of two, so that the arrays do not compete for cache lines.
const CAPACITY: usize = 272;

impl<'a> Shadows<'a> {
    #[inline(always)]
    pub(super) const fn new(points: &'a Points, light: Vec3, spheres: Option<SphereRoom>) -> Self {
        const NONE: [[f32; LANES]; BATCHES] = [[0.0; LANES]; BATCHES];
        const MANY: [f32; CAPACITY] = [0.0; CAPACITY];
        let around = Around { left: NONE, right: NONE, top: NONE, bottom: NONE, near: NONE };
        let all = AroundAll { around, names: NONE };
        let pairs = Pairs { names: MANY, samples: MANY, count: 0 };
        let samples = Samples::new(points, light);
        Self { samples, room: Room { all, reaching: List::new(), within: List::new(), pairs }, spheres }
    }
}

impl<S: Simd> Targets<S> for Shadows<'_> {
    const ANY: bool = true;

    #[inline(always)]
    fn least(&mut self, s: S) -> f32 {
        self.samples.least(s)
    }

    /// Whether there is an open sample within the bounds, and the box between it and the light.
    #[inline(always)]
    fn wants(&mut self, s: S, bounds: &Bounds, seen: Option<&SeenBox>) -> bool {
        self.samples.wants(s, bounds, seen)
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let groups = self.samples.interest(s, &triangles.bounds);
        if groups == 0 {
            return;
        }
        let batches = self.room.all.fill(s, triangles);
        self.reach(s, groups, batches, &triangles.bounds);
        let by_triangle = self.room.reaching.count;
        if by_triangle <= POINTS_MAX.min(self.room.within.count * batches) {
            self.pair_by_triangle(s, triangles);
        } else {
            self.pair_by_sample(s, batches, triangles);
        }
        self.room.pairs.test(s, &mut self.samples, triangles);
    }

    fn test_far(&mut self, s: S, cluster: &Cluster<'_>) {
        self.samples.test_far_triangles(s, cluster);
    }

    #[inline(always)]
    fn test_spheres(&mut self, s: S, projection: &Projection, cluster: &SphereCluster<'_>) {
        if let Some(room) = &mut self.spheres {
            room.test(s, &mut self.samples, projection, cluster);
        }
    }
}

impl Shadows<'_> {
    /// Finds which triangles reach over which groups, and which samples the cluster reaches over.
    #[inline(always)]
    fn reach<S: Simd>(&mut self, s: S, groups: u64, batches: usize, bounds: &Bounds) {
        let Self { samples, room: Room { all, reaching, within, .. }, .. } = self;
        let cluster = Around::of(s, bounds);
        let numbers = s.load(&NUMBERS);
        (reaching.count, within.count) = (0, 0);
        for group in bits(groups) {
            let corners = samples.corners_of_group(s, group);
            for batch in 0..batches {
                let first = (group * TRIANGLES + batch * LANES) as f32;
                let lanes = all.batch(s, batch).reaches(s, &corners);
                reaching.add(s, lanes, s.add(numbers, s.splat(first)));
            }
            let places = samples.group(s, group);
            let lanes = cluster.reaches(s, &[places; 2]);
            within.add(s, lanes, s.add(numbers, s.splat((group * LANES) as f32)));
        }
    }

    /// Pairs each triangle with the samples of the groups that it reaches over.
    #[inline(always)]
    fn pair_by_triangle<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let Self { samples, room: Room { all, reaching, pairs, .. }, .. } = self;
        for &number in reaching.numbers.iter().take(reaching.count) {
            let (group, triangle) = (number as usize / TRIANGLES % GROUPS, number as usize % TRIANGLES);
            pairs.add_samples(s, &samples.group(s, group), group, all.one(s, triangle));
            pairs.test_if_full(s, samples, triangles);
        }
    }

    /// Pairs each sample that the cluster reaches over with the triangles that do.
    #[inline(always)]
    fn pair_by_sample<S: Simd>(&mut self, s: S, batches: usize, triangles: &Triangles<'_, S>) {
        let Self { samples, room: Room { all, within, pairs, .. }, .. } = self;
        for &number in within.numbers.iter().take(within.count) {
            let number = number as usize % POINTS_MAX;
            let place = samples.sample(s, (number / LANES, number % LANES));
            for batch in 0..batches {
                let names = s.load(&all.names[batch]);
                pairs.add_triangles(s, &place, number, (all.batch(s, batch), names));
                pairs.test_if_full(s, samples, triangles);
            }
        }
    }
}

impl List {
    const fn new() -> Self {
        Self { numbers: [0.0; POINTS_MAX + LANES], count: 0 }
    }

    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, lanes: Mask, numbers: S::F) {
        pack(s, lanes, numbers, &mut self.numbers, &mut self.count);
    }
}

impl AroundAll {
    /// Fills in the triangles of a cluster, and tells how many batches there are.
    #[inline(always)]
    fn fill<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) -> usize {
        let (delta, nearer) = (s.splat(triangles.delta), s.splat(1.0 + triangles.depth_epsilon));
        let batches = triangles.count().div_ceil(LANES).min(BATCHES);
        let Around { left, right, top, bottom, near } = &mut self.around;
        for at in 0..batches {
            let batch = triangles.batch(s, at * LANES);
            let extent = Extent::of(s, &batch.corners);
            s.store(s.sub(extent.left, delta), &mut left[at]);
            s.store(s.add(extent.right, delta), &mut right[at]);
            s.store(s.sub(extent.top, delta), &mut top[at]);
            s.store(s.add(extent.bottom, delta), &mut bottom[at]);
            // Lanes without a triangle are nowhere.
            s.store(s.select(batch.lanes, s.mul(extent.near, nearer), s.splat(0.0)), &mut near[at]);
            s.store(batch.names, &mut self.names[at]);
        }
        batches
    }

    #[inline(always)]
    fn batch<S: Simd>(&self, s: S, at: usize) -> Around<S::F> {
        let Around { left, right, top, bottom, near } = &self.around;
        Around {
            left: s.load(&left[at]),
            right: s.load(&right[at]),
            top: s.load(&top[at]),
            bottom: s.load(&bottom[at]),
            near: s.load(&near[at]),
        }
    }

    /// One triangle in all lanes, and its name.
    #[inline(always)]
    fn one<S: Simd>(&self, s: S, triangle: usize) -> (Around<S::F>, S::F) {
        let Around { left, right, top, bottom, near } = &self.around;
        let around = Around {
            left: s.splat(left.as_flattened()[triangle]),
            right: s.splat(right.as_flattened()[triangle]),
            top: s.splat(top.as_flattened()[triangle]),
            bottom: s.splat(bottom.as_flattened()[triangle]),
            near: s.splat(near.as_flattened()[triangle]),
        };
        (around, s.splat(self.names.as_flattened()[triangle]))
    }
}

impl<F: Copy> Around<F> {
    /// The same in all lanes.
    #[inline(always)]
    pub(super) fn of<S: Simd<F = F>>(s: S, bounds: &Bounds) -> Self {
        Self {
            left: s.splat(bounds.left),
            right: s.splat(bounds.right),
            top: s.splat(bounds.top),
            bottom: s.splat(bounds.bottom),
            near: s.splat(bounds.near),
        }
    }

    /// The lanes in which the box between two places reaches in.
    #[inline(always)]
    pub(super) fn reaches<S: Simd<F = F>>(&self, s: S, [low, high]: &[Places<F>; 2]) -> Mask {
        s.le(self.left, high.x)
            & s.le(low.x, self.right)
            & s.le(self.top, high.y)
            & s.le(low.y, self.bottom)
            & s.lt(low.w, self.near)
    }
}

impl Pairs {
    /// Adds the samples of a group that a triangle, the same in all lanes, may cover.
    #[inline(always)]
    fn add_samples<S: Simd>(
        &mut self,
        s: S,
        places: &Places<S::F>,
        group: usize,
        (around, name): (Around<S::F>, S::F),
    ) {
        let covered = around.reaches(s, &[*places; 2]);
        let numbers = s.add(s.load(&NUMBERS), s.splat((group * LANES) as f32));
        self.add(s, covered, numbers, name);
    }

    /// Adds the triangles of a batch that may cover a sample, the same in all lanes.
    #[inline(always)]
    fn add_triangles<S: Simd>(
        &mut self,
        s: S,
        place: &Places<S::F>,
        sample: usize,
        (around, names): (Around<S::F>, S::F),
    ) {
        let covering = around.reaches(s, &[*place; 2]);
        self.add(s, covering, s.splat(sample as f32), names);
    }

    /// Adds pairs, one for each lane of the mask.
    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, lanes: Mask, samples: S::F, names: S::F) {
        // There is room for sixteen; see `test_if_full`.
        let at = self.count.min(CAPACITY - LANES);
        for (to, value) in [(&mut self.names, names), (&mut self.samples, samples)] {
            if let Some(to) = to[at..].first_chunk_mut() {
                s.store_packed(lanes, value, to);
            }
        }
        self.count += lanes.count_ones() as usize;
    }

    #[inline(always)]
    fn test_if_full<S: Simd>(&mut self, s: S, samples: &mut Samples<'_>, triangles: &Triangles<'_, S>) {
        if self.count > CAPACITY - LANES {
            self.test(s, samples, triangles);
        }
    }

    /// Tests all pairs, and forgets them.
    #[inline(always)]
    fn test<S: Simd>(&mut self, s: S, samples: &mut Samples<'_>, triangles: &Triangles<'_, S>) {
        for first in (0..self.count).step_by(LANES) {
            let corners = triangles.named(s, s.to_int(s.load(chunk(&self.names, first))));
            let edges = Extent::of(s, &corners).edges(s, &corners, triangles.delta);
            let numbers = s.to_int(s.load(chunk(&self.samples, first)));
            let Places { x, y, w: depth } = samples.numbered(s, numbers);
            let covered = edges.cover(s, (x, y), triangles.depth_epsilon);
            let undecided = covered.candidates & s.le(depth, covered.high) & first_lanes(self.count - first);
            if undecided == 0 {
                continue;
            }
            let certain = undecided & covered.sure & s.lt(depth, covered.low);
            // First those that need no ray.
            for (pairs, is_certain) in [(certain, true), (undecided & !certain, false)] {
                for lane in bits(pairs.into()) {
                    let number = self.samples[first + lane] as usize;
                    let sample = (number / LANES % GROUPS, number % LANES);
                    let corners = || Corners::of(self.names[first + lane] as u32).points(triangles.cluster);
                    if samples.is_open(sample) && (is_certain || samples.is_shadowed(sample, corners())) {
                        samples.close(s, sample);
                    }
                }
            }
        }
        self.count = 0;
    }
}

/// The places of the bits that are set.
#[inline(always)]
pub(super) fn bits(mut mask: u64) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let at = mask.trailing_zeros() as usize;
        let is_left = mask != 0;
        mask &= mask.wrapping_sub(1);
        is_left.then_some(at % 64)
    })
}

/// Sixteen entries from `first` on.
#[inline(always)]
fn chunk(from: &[f32; CAPACITY], first: usize) -> &[f32; LANES] {
    // Pairs end before the last sixteen.
    let first = first.min(CAPACITY - LANES);
    from[first..].first_chunk().unwrap_or(&[0.0; LANES])
}

const NUMBERS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
