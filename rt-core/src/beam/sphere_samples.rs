//! The spheres of a cluster against the shadow samples of a tile.
//!
//! Which spheres reach over which groups of samples, which samples lie within the box of which sphere, and then these
//! *pairs*, sixteen at a time, as for triangles.

use super::boxes::{BoundsByLane, Boxes};
use super::pixel_tests::{chunk, pack};
use super::projection::Projection;
use super::sample_tests::{Around, bits};
use super::samples::{GROUPS, Samples};
use super::sphere_cover::SHARE;
use super::sphere_pixels::NUMBERS;
use super::spheres::{AllBalls, Mailbox};
use super::triangles::Bounds;
use crate::kinds::OnlySpheres;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};
use crate::sphere::SphereCluster;

/// What testing spheres needs: which were tested, and room for pairs.
pub(super) struct SphereRoom {
    seen: Mailbox<OnlySpheres>,
    pairs: Pairs,
}

/// Pairs of a sample and a sphere.
struct Pairs {
    names: [f32; CAPACITY],
    /// Sixteen times the group, plus the lane.
    samples: [f32; CAPACITY],
    count: usize,
}

/// Enough that tests seldom lack pairs.
const CAPACITY: usize = 272;

impl SphereRoom {
    pub(super) const fn new() -> Self {
        let pairs = Pairs { names: [0.0; CAPACITY], samples: [0.0; CAPACITY], count: 0 };
        Self { seen: Mailbox::new(), pairs }
    }

    /// Tests the spheres of a cluster.
    #[inline(always)]
    pub(super) fn test<S: Simd>(
        &mut self,
        s: S,
        samples: &mut Samples<'_>,
        projection: &Projection,
        cluster: &SphereCluster<'_>,
    ) {
        let all = AllBalls::of(s, cluster);
        let mut half = 0;
        while half * LANES < all.count {
            let (balls, lanes) = all.half(s, half);
            let boxes = projection.boxes_of_balls(s, balls.from(s, projection.eye), balls.radius);
            let lanes = lanes & projection.shows(s, &boxes, samples.least(s));
            let lanes = self.seen.new_ones(cluster, half, lanes);
            if lanes != 0 {
                self.find_pairs(s, samples, cluster, &all, (half, lanes, &boxes));
            }
            half += 1;
        }
        self.test_pairs(s, samples, cluster, &all);
    }

    /// Finds the pairs of half a cluster.
    #[inline(always)]
    fn find_pairs<S: Simd>(
        &mut self,
        s: S,
        samples: &mut Samples<'_>,
        cluster: &SphereCluster<'_>,
        all: &AllBalls<S::F>,
        (half, lanes, boxes): (usize, Mask, &Boxes<S::F>),
    ) {
        let around = Around::of_boxes(boxes);
        let by_lane: BoundsByLane = boxes.by_lane(s);
        for group in bits(samples.interest(s, &bounds_of(s, lanes, boxes))) {
            let reaching = around.reaches(s, &samples.corners_of_group(s, group)) & lanes;
            let places = samples.group(s, group);
            let numbers = s.add(s.load(&NUMBERS), s.splat((group * LANES) as f32));
            for lane in bits(reaching.into()) {
                let covered = Around::of(s, &by_lane.of(lane)).reaches(s, &[places; 2]);
                self.pairs.add(s, covered, numbers, s.splat((half * LANES + lane) as f32));
                if self.pairs.count > CAPACITY - LANES {
                    self.test_pairs(s, samples, cluster, all);
                }
            }
        }
    }

    /// Tests all pairs, and forgets them.
    ///
    /// A sphere that the sample lies outside of is missed when it lies behind, and hit when the line passes
    /// its centre within the radius and before the light.
    #[inline(always)]
    fn test_pairs<S: Simd>(
        &mut self,
        s: S,
        samples: &mut Samples<'_>,
        cluster: &SphereCluster<'_>,
        all: &AllBalls<S::F>,
    ) {
        for first in (0..self.pairs.count).step_by(LANES) {
            let balls = all.named(s, s.to_int(s.load(chunk(&self.pairs.names, first))));
            let numbers = s.to_int(s.load(chunk(&self.pairs.samples, first)));
            let point = samples.points_numbered(s, numbers);
            let light = s.splat3(samples.light);
            let to_light = each!(3: [0, 1, 2], axis => s.sub(light[axis], point[axis]));
            let outline = balls.seen_from(s, point);
            let square = s.dot(to_light, to_light);
            let along = s.dot(outline.centre, to_light);
            let across = outline.across(s, to_light);
            let zero = s.splat(0.0);
            let underflow = s.splat(f32::MIN_POSITIVE);
            let missed = s.lt(s.add(s.mul(outline.outer, square), underflow), across)
                | s.lt(along, zero) & outline.outside;
            let hit = outline.outside
                & s.lt(across, s.mul(outline.inner, square))
                & s.lt(zero, along)
                & s.lt(along, s.mul(square, s.splat(1.0 - 4.0 * SHARE)));
            let mut undecided = !missed & first_lanes(self.pairs.count - first);
            while undecided != 0 {
                let lane = undecided.trailing_zeros() as usize;
                undecided &= undecided - 1;
                let number = self.pairs.samples[first + lane] as usize;
                let sample = (number / LANES % GROUPS, number % LANES);
                let name = self.pairs.names[first + lane] as usize;
                if samples.is_open(sample)
                    && (hit >> lane & 1 != 0 || samples.is_shadowed_by(sample, &cluster.sphere(name)))
                {
                    samples.close(s, sample);
                }
            }
        }
        self.pairs.count = 0;
    }
}

impl Pairs {
    /// Adds pairs of a sphere, one for each lane of the mask.
    #[inline(always)]
    fn add<S: Simd>(&mut self, s: S, lanes: Mask, samples: S::F, names: S::F) {
        let mut count = self.count;
        pack(s, lanes, names, &mut self.names, &mut count);
        pack(s, lanes, samples, &mut self.samples, &mut self.count);
    }
}

impl<F: Copy> Around<F> {
    /// Around the boxes, one in each lane.
    #[inline(always)]
    const fn of_boxes(boxes: &Boxes<F>) -> Self {
        let &Boxes { left, right, top, bottom, near } = boxes;
        Self { left, right, top, bottom, near }
    }
}

/// The bounds of some boxes together.
#[inline(always)]
fn bounds_of<S: Simd>(s: S, lanes: Mask, boxes: &Boxes<S::F>) -> Bounds {
    let (zero, infinite) = (s.splat(0.0), s.splat(f32::INFINITY));
    let [left, top] = each!(2: [boxes.left, boxes.top], end => s.least(s.select(lanes, end, infinite)));
    let [right, bottom, near] = each!(3: [boxes.right, boxes.bottom, boxes.near], end => {
        -s.least(s.select(lanes, s.sub(zero, end), infinite))
    });
    Bounds { left, right, top, bottom, near }
}
