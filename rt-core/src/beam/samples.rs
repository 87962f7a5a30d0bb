//! The shadow samples of a tile, seen from the light: each looks for anything between itself and the light.

use glam::Vec3;

use super::edges::{Extent, Margins, cover};
use super::frustum::{Borders, Depths};
use super::points::{POINTS_MAX, Points};
use super::projection::{Projected, Projection};
use super::walk::{Bounds, Targets, Triangles};
use crate::cluster::{Cluster, Nearest};
use crate::simd::{LANES, Mask, Part, Simd, each, first_lanes};
use crate::triangle_woop::WoopRay;

/// The samples, in the order of a space-filling curve through the projection plane, in *groups* of sixteen.
pub(super) struct Samples<'a> {
    points: &'a Points,
    light: Vec3,
    /// Places on the plane and inverse depths, by group; infinite once a sample is shadowed, and beyond the end.
    x: [[f32; LANES]; GROUPS],
    y: [[f32; LANES]; GROUPS],
    w: [[f32; LANES]; GROUPS],
    /// Which point a sample is.
    point: [[u8; LANES]; GROUPS],
    /// Samples of each group that are open.
    open: [Mask; GROUPS],
    /// The boxes of the groups, and the least inverse depth of an open sample.
    left: [f32; GROUPS],
    right: [f32; GROUPS],
    top: [f32; GROUPS],
    bottom: [f32; GROUPS],
    far: [f32; GROUPS],
    pub(super) shadowed: [bool; POINTS_MAX],
    depths: Depths,
    /// Samples shadowed since the depths were found, and samples that are open.
    news: u32,
    left_open: u32,
}

/// Groups of samples.
const GROUPS: usize = POINTS_MAX / LANES;

/// Rows and columns of the plane, along which samples are sorted.
const LINES: usize = 8;

impl<'a> Samples<'a> {
    #[inline(always)]
    pub(super) fn new<S: Simd>(s: S, points: &'a Points, projection: &Projection) -> Self {
        let mut place = [[[f32::INFINITY; LANES]; GROUPS]; 3];
        for first in (0..points.count).step_by(LANES) {
            let Projected { x, y, w } = projection.project(s, points.load(s, first));
            s.store(x, &mut place[0][first / LANES]);
            s.store(y, &mut place[1][first / LANES]);
            s.store(w, &mut place[2][first / LANES]);
        }
        let mut samples = Self {
            points,
            light: projection.eye,
            x: [[0.0; LANES]; GROUPS],
            y: [[0.0; LANES]; GROUPS],
            w: [[f32::INFINITY; LANES]; GROUPS],
            point: [[0; LANES]; GROUPS],
            open: [0; GROUPS],
            left: [f32::INFINITY; GROUPS],
            right: [f32::NEG_INFINITY; GROUPS],
            top: [f32::INFINITY; GROUPS],
            bottom: [f32::NEG_INFINITY; GROUPS],
            far: [f32::INFINITY; GROUPS],
            shadowed: [false; POINTS_MAX],
            depths: Depths::new([f32::INFINITY; LANES]),
            news: 0,
            left_open: points.count as u32,
        };
        samples.sort(&place);
        samples.find_boxes(s);
        samples.find_depths();
        samples
    }

    /// The borders of the blocks into which the plane is cut: two lines each.
    pub(super) fn borders() -> [Borders; 2] {
        [Borders { first: [0.0, 2.0, 4.0, 6.0], last: [2.0, 4.0, 6.0, 8.0] }; 2]
    }

    /// Puts the samples in order: a counting sort.
    #[inline(always)]
    fn sort(&mut self, place: &[[[f32; LANES]; GROUPS]; 3]) {
        let [x, y, w] = place.each_ref().map(|values| values.as_flattened());
        let (mut bins, mut next) = ([0_u8; POINTS_MAX], [0_u16; LINES * LINES]);
        for index in 0..self.points.count {
            let bin = CURVE[line(x[index])] | CURVE[line(y[index])] << 1;
            bins[index] = bin;
            next[usize::from(bin)] += 1;
        }
        let mut sum = 0;
        for next in &mut next {
            (*next, sum) = (sum, sum + *next);
        }
        for index in 0..self.points.count {
            let next = &mut next[usize::from(bins[index])];
            let (group, lane) = (usize::from(*next) / LANES % GROUPS, usize::from(*next) % LANES);
            *next += 1;
            (self.x[group][lane], self.y[group][lane], self.w[group][lane]) = (x[index], y[index], w[index]);
            self.point[group][lane] = index as u8;
        }
    }

    /// Finds the boxes of the groups.
    #[inline(always)]
    fn find_boxes<S: Simd>(&mut self, s: S) {
        let zero = s.splat(0.0);
        for group in 0..self.points.count.div_ceil(LANES) {
            let lanes = first_lanes(self.points.count - group * LANES);
            let (x, y) = (s.load(&self.x[group]), s.load(&self.y[group]));
            let [left, right, top, bottom] = each!(4: [x, s.sub(zero, x), y, s.sub(zero, y)], value => {
                s.least(s.select(lanes, value, s.splat(f32::INFINITY)))
            });
            (self.left[group], self.right[group]) = (left, -right);
            (self.top[group], self.bottom[group]) = (top, -bottom);
            self.far[group] = s.least(s.load(&self.w[group]));
            self.open[group] = lanes;
        }
    }

    /// Finds anew what blocks wait for.
    #[inline(always)]
    fn find_depths(&mut self) {
        let mut blocks = [f32::INFINITY; LANES];
        for group in 0..GROUPS {
            let mut open = self.open[group];
            while open != 0 {
                let lane = open.trailing_zeros() as usize;
                open &= open - 1;
                let block = line(self.y[group][lane]) / 2 * 4 + line(self.x[group][lane]) / 2;
                let (w, block) = (self.w[group][lane], &mut blocks[block]);
                *block = if w < *block { w } else { *block };
            }
        }
        self.depths = Depths::new(blocks);
        self.news = 0;
    }

    /// Notes that samples of a group lie in shadow.
    #[inline(always)]
    fn close<S: Simd>(&mut self, s: S, group: usize, samples: Mask) {
        let mut closing = samples & self.open[group];
        while closing != 0 {
            let lane = closing.trailing_zeros() as usize;
            closing &= closing - 1;
            self.w[group][lane] = f32::INFINITY;
            self.shadowed[usize::from(self.point[group][lane])] = true;
            self.left_open -= 1;
            self.news += 1;
        }
        self.open[group] &= !samples;
        self.far[group] = s.least(s.load(&self.w[group]));
    }

    /// The ray of a sample to the light.
    #[inline]
    fn ray(&self, group: usize, lane: usize) -> WoopRay {
        let point = self.points.get(usize::from(self.point[group][lane]));
        WoopRay::new(point, self.light - point)
    }

    /// Whether, by the sample's ray, a triangle shadows it.
    #[inline(never)]
    fn is_shadowed(&self, (group, lane): (usize, usize), corners: [Vec3; 3]) -> bool {
        self.ray(group, lane).intersect(corners, 1.0).is_some()
    }

    /// The open samples of a group that lie within some bounds.
    #[inline(always)]
    fn open_within<S: Simd>(&self, s: S, group: usize, bounds: &Bounds) -> Mask {
        let (x, y) = (s.load(&self.x[group]), s.load(&self.y[group]));
        s.le(s.splat(bounds.left), x)
            & s.le(x, s.splat(bounds.right))
            & s.le(s.splat(bounds.top), y)
            & s.le(y, s.splat(bounds.bottom))
            & s.lt(s.load(&self.w[group]), s.splat(bounds.near))
    }

    /// Tests the triangles of some lanes against a sample: for many triangles that are small.
    #[inline(always)]
    fn test_sample<S: Simd>(&mut self, s: S, (group, lane): (usize, usize), batch: &Batch<'_, '_, S>) {
        let place = (s.splat(self.x[group][lane]), s.splat(self.y[group][lane]));
        let depth = s.splat(self.w[group][lane]);
        let lanes = s.le(batch.left, place.0)
            & s.le(place.0, batch.right)
            & s.le(batch.top, place.1)
            & s.le(place.1, batch.bottom)
            & s.lt(depth, batch.near)
            & batch.triangles.lanes;
        if lanes == 0 {
            return;
        }
        let Some(covered) = cover(s, batch.triangles, place, &batch.margins, lanes) else { return };
        let mut undecided = covered.candidates & s.le(depth, covered.high);
        if undecided & covered.sure & s.lt(depth, covered.low) != 0 {
            self.close(s, group, 1 << lane);
            return;
        }
        while undecided != 0 {
            let at = undecided.trailing_zeros() as usize;
            undecided &= undecided - 1;
            if self.is_shadowed((group, lane), batch.triangles.corners_of(at)) {
                self.close(s, group, 1 << lane);
                return;
            }
        }
    }

    /// Tests one triangle against the samples of a group: for triangles that are large.
    #[inline(always)]
    fn test_group<S: Simd>(
        &mut self,
        s: S,
        group: usize,
        at: usize,
        batch: &Batch<'_, '_, S>,
        lanes: &Lanes,
    ) {
        let place = (s.load(&self.x[group]), s.load(&self.y[group]));
        let depth = s.load(&self.w[group]);
        let triangles = batch.triangles;
        let corners = each!(3: lanes.corners, [x, y, w] => Projected {
            x: s.splat(x[at]),
            y: s.splat(y[at]),
            w: s.splat(w[at]),
        });
        let margins = Margins { edge: s.splat(lanes.edge[at]), depth: s.splat(lanes.depth[at]) };
        let one = Triangles { corners, ..*triangles };
        let open = s.lt(depth, s.splat(lanes.near[at]))
            & s.le(s.splat(lanes.left[at]), place.0)
            & s.le(place.0, s.splat(lanes.right[at]))
            & s.le(s.splat(lanes.top[at]), place.1)
            & s.le(place.1, s.splat(lanes.bottom[at]));
        if open == 0 {
            return;
        }
        let Some(covered) = cover(s, &one, place, &margins, open) else { return };
        let candidates = covered.candidates & s.le(depth, covered.high);
        let mut closing = candidates & covered.sure & s.lt(depth, covered.low);
        let mut undecided = candidates & !closing;
        while undecided != 0 {
            let lane = undecided.trailing_zeros() as usize;
            undecided &= undecided - 1;
            let is_shadowed = self.is_shadowed((group, lane), triangles.corners_of(at));
            closing |= Mask::from(is_shadowed) << lane;
        }
        if closing != 0 {
            self.close(s, group, closing);
        }
    }
}

/// Sixteen triangles under test.
struct Batch<'a, 'b, S: Simd> {
    triangles: &'a Triangles<'b, S>,
    margins: Margins<S::F>,
    /// Their boxes, and greatest inverse depths, and a little more.
    left: S::F,
    right: S::F,
    top: S::F,
    bottom: S::F,
    near: S::F,
}

impl<S: Simd> Batch<'_, '_, S> {
    /// Bounds of all its triangles.
    #[inline(always)]
    fn around(&self, s: S) -> Bounds {
        let zero = s.splat(0.0);
        let [right, bottom, near] =
            each!(3: [self.right, self.bottom, self.near], end => -s.least(s.sub(zero, end)));
        Bounds { left: s.least(self.left), right, top: s.least(self.top), bottom, near }
    }
}

/// A batch, lane by lane.
struct Lanes {
    corners: [[[f32; LANES]; 3]; 3],
    edge: [f32; LANES],
    depth: [f32; LANES],
    near: [f32; LANES],
    left: [f32; LANES],
    right: [f32; LANES],
    top: [f32; LANES],
    bottom: [f32; LANES],
}

impl Lanes {
    #[inline(always)]
    fn of<S: Simd>(s: S, batch: &Batch<'_, '_, S>) -> Self {
        let corners = batch.triangles.corners;
        Self {
            corners: each!(3: corners, corner => [s.array(corner.x), s.array(corner.y), s.array(corner.w)]),
            edge: s.array(batch.margins.edge),
            depth: s.array(batch.margins.depth),
            near: s.array(batch.near),
            left: s.array(batch.left),
            right: s.array(batch.right),
            top: s.array(batch.top),
            bottom: s.array(batch.bottom),
        }
    }
}

impl<S: Simd> Targets<S> for Samples<'_> {
    #[inline(always)]
    fn depths(&mut self, _: S) -> &Depths {
        if self.news > 8 + self.left_open / 4 || self.left_open == 0 && self.news > 0 {
            self.find_depths();
        }
        &self.depths
    }

    /// The groups that the cluster reaches over.
    #[inline(always)]
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64 {
        let groups = s.le(s.load(&self.left), s.splat(bounds.right))
            & s.le(s.splat(bounds.left), s.load(&self.right))
            & s.le(s.load(&self.top), s.splat(bounds.bottom))
            & s.le(s.splat(bounds.top), s.load(&self.bottom))
            & s.lt(s.load(&self.far), s.splat(bounds.near));
        u64::from(groups)
    }

    /// Whether there is an open sample within the bounds.
    #[inline(always)]
    fn wants(&mut self, s: S, bounds: &Bounds) -> bool {
        let mut groups = self.interest(s, bounds);
        while groups != 0 {
            let group = groups.trailing_zeros() as usize % GROUPS;
            groups &= groups - 1;
            if self.open_within(s, group, bounds) != 0 {
                return true;
            }
        }
        false
    }

    #[inline(always)]
    fn test(&mut self, s: S, triangles: &Triangles<'_, S>) {
        s.apart(Test { samples: self, triangles });
    }

    fn test_by_rays(&mut self, s: S, cluster: &Cluster<'_>) {
        for group in 0..GROUPS {
            let mut open = self.open[group];
            while open != 0 {
                let lane = open.trailing_zeros() as usize;
                open &= open - 1;
                let mut nearest = Nearest::none(1.0);
                cluster.intersect::<S, true>(s, &self.ray(group, lane), &mut nearest);
                if nearest.surface.is_some() {
                    self.close(s, group, 1 << lane);
                }
            }
        }
    }
}

/// The test of sixteen triangles, kept apart: it needs all registers.
struct Test<'a, 'b, 'c, S: Simd> {
    samples: &'a mut Samples<'b>,
    triangles: &'a Triangles<'c, S>,
}

impl<S: Simd> Part<S> for Test<'_, '_, '_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        self.samples.test_batch(s, self.triangles);
    }
}

impl Samples<'_> {
    #[inline(always)]
    fn test_batch<S: Simd>(&mut self, s: S, triangles: &Triangles<'_, S>) {
        let extent = Extent::of(s, &triangles.corners);
        let delta = s.splat(triangles.delta);
        let batch = Batch {
            triangles,
            margins: extent.margins(s, triangles),
            left: s.sub(extent.left, delta),
            right: s.add(extent.right, delta),
            top: s.sub(extent.top, delta),
            bottom: s.add(extent.bottom, delta),
            near: s.mul(extent.near, s.splat(1.0 + triangles.depth_epsilon)),
        };
        let around = batch.around(s);
        let mut by_lane = None;
        let mut groups = triangles.interest;
        while groups != 0 {
            let group = groups.trailing_zeros() as usize % GROUPS;
            groups &= groups - 1;
            let mut lanes = s.le(batch.left, s.splat(self.right[group]))
                & s.le(s.splat(self.left[group]), batch.right)
                & s.le(batch.top, s.splat(self.bottom[group]))
                & s.le(s.splat(self.top[group]), batch.bottom)
                & s.lt(s.splat(self.far[group]), batch.near)
                & triangles.lanes;
            if lanes.count_ones() > FEW {
                let mut open = self.open_within(s, group, &around);
                while open != 0 {
                    self.test_sample(s, (group, open.trailing_zeros() as usize), &batch);
                    open &= open - 1;
                }
            } else if lanes != 0 {
                let by_lane = by_lane.get_or_insert_with(|| Lanes::of(s, &batch));
                while lanes != 0 {
                    self.test_group(s, group, lanes.trailing_zeros() as usize, &batch, by_lane);
                    lanes &= lanes - 1;
                }
            }
        }
    }
}

/// So many triangles are tested one by one against a whole group; more of them, sample by sample.
const FEW: u32 = 5;

/// The bits of a number below 8, apart.
const CURVE: [u8; LINES] = [0, 1, 4, 5, 16, 17, 20, 21];

/// The row, or column, of a place.
#[inline(always)]
fn line(place: f32) -> usize {
    place.max(0.0).min(LINES as f32 - 1.0) as usize
}
