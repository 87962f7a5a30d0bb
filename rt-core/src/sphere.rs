//! Spheres: the ray-sphere test, and clusters of up to 32 spheres tested together.
//!
//! # The test
//! With `f` from the ray's origin to the centre and `d` the direction, the ray passes the centre nearest at `m =
//! f.d / d.d`, at a distance of `|f - m d|`; it meets the sphere at `m -+ sqrt((r^2 - |f - m d|^2) / d.d)`. The
//! first of the two that is above 0, rounded to single precision, is the hit: from inside it is the second, and
//! so it is from the surface itself.
//!
//! As for triangles, *single precision rejects, double precision decides*. The textbook's discriminant, `(f.d)^2 -
//! d.d (f.f - r^2)`, loses all digits of `r` when the origin is far away; the distance from the ray loses
//! none.
//!
//! # Error
//! Let `e = 2^-53` and `X = |f|`, or `r` if that is larger. `m d` is off by `8 e X`, along the ray; the distance
//! to the ray by `4 e X`; both roots together by `20 e X` across the surface, or less. So before it is rounded to
//! single precision, **a hit lies within `2^-47` of the largest coordinate of `f` (or of `r`) from the true
//! sphere**, also where the ray touches it and its place along the ray is ill-defined. [`walk`](crate::walk)
//! relies on that.
//!
//! # Layout of a cluster
//! With `n` spheres, rounded up to a multiple of 4 (`n4`): `x: [f32; n4]`, `y`, `z`, `radius`. Lanes beyond the
//! count repeat the last sphere. The count stands in the leaf. A cluster begins at a multiple of 16 bytes and
//! never crosses a page.
//!
//! # Source
//! Haines, Günther and Akenine-Möller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems,
//! 2019, chapter 7. We differ: in double precision their second remedy, for roots that cancel, is not needed.

use glam::Vec3;

use crate::cluster::Nearest;
use crate::cluster::quads;
use crate::filter::Filter;
use crate::grid::SpheresRef;
use crate::ray::Primitive;
use crate::shade::{difference, unit};
use crate::simd::{LANES, Mask, Part, Simd, each, first_lanes};
use crate::surface::Surface;
use crate::triangle_woop::Crossing;

/// A sphere: the points at `radius` from `centre`.
///
/// # Edge cases
/// A radius that is 0, negative or NaN makes a sphere that no ray hits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sphere {
    /// The middle.
    pub centre: Vec3,
    /// Distance of the surface from it.
    pub radius: f32,
}

/// A ray as the test wants it. The largest component of the direction is in `1..2`.
#[derive(Clone, Copy, Debug)]
pub struct SphereRay {
    origin: Vec3,
    direction: Vec3,
}

impl SphereRay {
    /// Prepares a ray, whose direction is normalised by a power of two.
    #[inline]
    pub const fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction }
    }

    /// Where the ray meets the sphere with `0 < t <= t_max`; from outside and from inside. The weights are 0.
    ///
    /// # Edge cases
    /// A ray that touches the sphere hits it. One that starts on it may meet its other side, not where it
    /// starts.
    #[inline]
    pub fn intersect(&self, sphere: &Sphere, t_max: f32) -> Option<Crossing> {
        let t = single(self.root(sphere)?);
        (t > 0.0 && t <= t_max).then_some(Crossing { t, u: 0.0, v: 0.0 })
    }

    /// Unit normal, outwards, where the ray meets the sphere.
    ///
    /// The hit less the centre, before the hit is rounded: so it is exact for a speck far away too. Against the
    /// ray where there is none.
    pub fn normal(&self, sphere: &Sphere) -> Vec3 {
        let to_centre = difference(sphere.centre, self.origin);
        let direction = double(self.direction);
        let t = self.root(sphere).unwrap_or(0.0);
        match [0, 1, 2].map(|axis| t * direction[axis] - to_centre[axis]) {
            [0.0, 0.0, 0.0] => unit(direction.map(|component| -component)),
            outwards => unit(outwards),
        }
    }

    /// The first root above 0, in `f64`; or what is left when there is none.
    #[inline]
    fn root(&self, sphere: &Sphere) -> Option<f64> {
        let direction = double(self.direction);
        let to_centre = difference(sphere.centre, self.origin);
        let radius = f64::from(sphere.radius);
        let length_squared = dot(direction, direction);
        let middle = dot(to_centre, direction) / length_squared;
        let across = [0, 1, 2].map(|axis| to_centre[axis] - middle * direction[axis]);
        let under = radius * radius - dot(across, across);
        // Written so that a NaN anywhere fails it.
        if !(radius > 0.0 && under >= 0.0) {
            return None;
        }
        let half = libm::sqrt(under / length_squared);
        let first = middle - half;
        Some(if single(first) > 0.0 { first } else { middle + half })
    }
}

/// The arrays of a cluster of spheres, borrowed from a record of [`spheres_bytes`] bytes.
#[derive(Clone, Copy, Debug)]
pub struct SphereCluster<'a> {
    /// Centres' coordinates, then radii.
    lanes: [&'a [[u8; 4]]; 4],
    place: SpheresRef,
}

impl<'a> SphereCluster<'a> {
    /// Splits the record of the cluster at `place`, or `None` when the record is too short.
    #[inline]
    pub fn new(record: &'a [u8], place: &SpheresRef) -> Option<Self> {
        let n4 = quads(place.count);
        let (floats, _) = record.get(..n4 * 16)?.as_chunks::<4>();
        let lanes = [0, 1, 2, 3].map(|lane| &floats[n4 * lane..n4 * (lane + 1)]);
        Some(Self { lanes, place: *place })
    }

    /// Where the cluster lies and how large it is.
    pub const fn place(&self) -> &SpheresRef {
        &self.place
    }

    /// Centres' coordinates by axis, then radii; a multiple of four each.
    #[inline]
    pub(crate) const fn lanes(&self) -> [&'a [[u8; 4]]; 4] {
        self.lanes
    }

    /// Address-order index of sphere `index`.
    #[inline]
    pub fn primitive(&self, index: usize) -> Primitive {
        #[expect(clippy::cast_possible_truncation, reason = "an index below 32")]
        Primitive(self.place.first.wrapping_add(index as u32))
    }

    /// Sphere `index`, in grid units; one that the record does not have has no radius.
    #[inline]
    pub fn sphere(&self, index: usize) -> Sphere {
        let [x, y, z, radius] =
            self.lanes.map(|lane| lane.get(index).map_or(0.0, |&bytes| f32::from_le_bytes(bytes)));
        Sphere { centre: Vec3::new(x, y, z), radius }
    }

    /// Offers every sphere that the ray hits and `filter` accepts to `nearest`; with `ANY`, stops at the first.
    ///
    /// The plain way to the same result is [`SphereRay::intersect`] for each sphere.
    #[inline(always)]
    pub(crate) fn intersect_filtered<S: Simd, F: Filter, const ANY: bool>(
        &self,
        s: S,
        ray: &SphereRay,
        nearest: &mut Nearest,
        filter: &mut F,
    ) {
        s.apart(Intersect::<F, ANY> { cluster: self, ray, nearest, filter });
    }

    /// Of sixteen spheres from `first` on those that single precision cannot reject.
    ///
    /// `|f x d| > r |d|` rejects, and so does a sphere that lies behind the origin or beyond `t_max`. With `e =
    /// 2^-24` and `s = |f_x| + |f_y| + |f_z|`, the cross product is off by at most `6 e s |d|` and `f.d` by `5 e s
    /// d.d`, so `16 e s` more for the radius makes up for both; a millionth on top for the squares, and a
    /// smallest number for squares that underflow. A NaN rejects nothing.
    #[inline(always)]
    fn candidates<S: Simd>(&self, s: S, ray: &SphereRay, first: usize, t_max: f32) -> Mask {
        let count = (self.lanes[0].len() - first).min(LANES);
        let [x, y, z, radius] = each!(4: self.lanes, lane => s.load_le(&lane[first..][..count]));
        let (origin, direction) = (s.splat3(ray.origin), s.splat3(ray.direction));
        let length_squared = ray.direction.dot(ray.direction);
        let [x, y, z] = [s.sub(x, origin[0]), s.sub(y, origin[1]), s.sub(z, origin[2])];
        let size = s.add(s.add(s.abs(x), s.abs(y)), s.abs(z));
        let reach = s.mul(s.add(radius, s.mul(size, s.splat(MARGIN))), s.splat(1.0 + MARGIN));
        let from = [x, y, z];
        let across = each!(3: [(1, 2), (2, 0), (0, 1)], (i, j) => {
            s.sub(s.mul(from[i], direction[j]), s.mul(from[j], direction[i]))
        });
        let across = s.dot(across, across);
        let along = s.dot(from, direction);
        let ahead = s.mul(reach, s.splat(length_squared));
        let passes = s.lt(s.add(s.mul(reach, ahead), s.splat(f32::MIN_POSITIVE)), across);
        let is_behind = s.lt(s.add(along, ahead), s.splat(0.0));
        let is_beyond = s.lt(s.splat(t_max * length_squared), s.sub(along, ahead));
        !(passes | is_behind | is_beyond)
    }
}

/// A cluster to be tested, as a function of its own.
struct Intersect<'a, F, const ANY: bool> {
    cluster: &'a SphereCluster<'a>,
    ray: &'a SphereRay,
    nearest: &'a mut Nearest,
    filter: &'a mut F,
}

impl<S: Simd, F: Filter, const ANY: bool> Part<S> for Intersect<'_, F, ANY> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        let Self { cluster, ray, nearest, filter } = self;
        let spheres = usize::from(cluster.place.count);
        let mut first = 0;
        while first < spheres {
            let candidates = cluster.candidates(s, ray, first, nearest.crossing.t);
            let mut candidates = candidates & first_lanes(spheres - first);
            while candidates != 0 {
                let index = first + candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let sphere = cluster.sphere(index);
                let Some(crossing) = ray.intersect(&sphere, nearest.crossing.t) else { continue };
                let (primitive, surface) = (cluster.primitive(index), Surface::Sphere(sphere));
                if filter.accepts(&crossing, primitive, &surface) {
                    nearest.offer(crossing, primitive, surface);
                    if ANY {
                        return;
                    }
                }
            }
            first += LANES;
        }
    }
}

/// Length of the record of a cluster of spheres in bytes, a multiple of 16.
#[inline]
pub const fn spheres_bytes(count: u8) -> usize {
    quads(count) * 16
}

#[inline]
fn double(vector: Vec3) -> [f64; 3] {
    vector.to_array().map(f64::from)
}

#[inline]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
const fn single(value: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "rounding to single precision is the result")]
    let single = value as f32;
    single
}

/// `16 e`, and about a millionth.
const MARGIN: f32 = crate::scale::power_of_two(-20);

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: Sphere = Sphere { centre: Vec3::new(1.0, 2.0, 3.0), radius: 0.5 };

    fn down(x: f32, y: f32, z: f32) -> SphereRay {
        SphereRay::new(Vec3::new(x, y, z), Vec3::NEG_Z)
    }

    fn t(ray: &SphereRay, sphere: &Sphere) -> Option<f32> {
        ray.intersect(sphere, f32::INFINITY).map(|crossing| crossing.t)
    }

    #[test]
    fn from_outside_the_near_side_from_inside_the_far_one() {
        assert_eq!(t(&down(1.0, 2.0, 5.0), &BALL), Some(1.5));
        assert_eq!(t(&down(1.0, 2.0, 3.25), &BALL), Some(0.75));
        assert_eq!(t(&down(1.0, 2.0, 2.0), &BALL), None);
        assert_eq!(down(1.0, 2.0, 5.0).normal(&BALL), Vec3::Z);
        assert_eq!(down(1.0, 2.0, 3.25).normal(&BALL), Vec3::NEG_Z);
    }

    #[test]
    fn a_ray_that_starts_on_it_meets_its_other_side() {
        assert_eq!(t(&down(1.0, 2.0, 3.5), &BALL), Some(1.0));
        assert_eq!(t(&down(1.0, 2.0, 2.5), &BALL), None);
    }

    #[test]
    fn a_ray_that_touches_it_hits_and_the_next_one_misses() {
        assert_eq!(t(&down(1.5, 2.0, 5.0), &BALL), Some(2.0));
        assert_eq!(t(&down(1.5_f32.next_up(), 2.0, 5.0), &BALL), None);
        assert_eq!(down(1.5, 2.0, 5.0).normal(&BALL), Vec3::X);
    }

    #[test]
    fn t_max_is_inclusive() {
        let ray = down(1.0, 2.0, 5.0);
        assert!(ray.intersect(&BALL, 1.5).is_some() && ray.intersect(&BALL, 1.5_f32.next_down()).is_none());
    }

    #[test]
    fn what_is_no_sphere_is_never_hit() {
        for radius in [0.0, -0.0, -0.5, f32::NAN, f32::NEG_INFINITY] {
            assert_eq!(t(&down(1.0, 2.0, 5.0), &Sphere { radius, ..BALL }), None, "radius {radius}");
        }
        let nowhere = Sphere { centre: Vec3::NAN, radius: 1.0 };
        assert_eq!(t(&down(1.0, 2.0, 5.0), &nowhere), None);
    }

    #[test]
    fn a_speck_far_away_is_as_round_as_a_ball_nearby() {
        // Its radius is a thousandth of the last bit of its distance, in single precision.
        let speck = Sphere { centre: Vec3::new(0.0, 0.0, -8.0e6), radius: 2.0_f32.powi(-11) };
        let ray = SphereRay::new(Vec3::new(2.0_f32.powi(-12), 0.0, 0.0), Vec3::NEG_Z);
        assert_eq!(t(&ray, &speck), Some(8.0e6));
        let expected = Vec3::new(0.5, 0.0, libm::sqrtf(0.75));
        assert!((ray.normal(&speck) - expected).abs().max_element() < 1.0e-6, "{}", ray.normal(&speck));
        let beside = SphereRay::new(Vec3::new(2.0_f32.powi(-11).next_up(), 0.0, 0.0), Vec3::NEG_Z);
        assert_eq!(t(&beside, &speck), None);
    }
}
