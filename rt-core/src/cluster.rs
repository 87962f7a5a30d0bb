//! Clusters: up to 64 triangles over up to 32 vertices of their own, tested together.
//!
//! # Layout
//! With `v` vertices and `t` triangles, each rounded up to a multiple of 4 (`v4`, `t4`): `x: [f32; v4]`, `y`,
//! `z`, then the triangles' corners `a: [u8; t4]`, `b`, `c`, then padding to a multiple of 16 bytes. Lanes
//! beyond the counts repeat the last vertex, or are triangles of it alone. The counts stand in the leaf, so
//! one record is one read. A cluster begins at a multiple of 16 bytes and never crosses a page.

use glam::Vec3;

use crate::filter::Filter;
use crate::grid::{ClusterRef, TRIANGLES_MAX, VERTICES_MAX};
use crate::ray::Primitive;
use crate::simd::{LANES, Mask, Part, Simd, each, first_lanes};
use crate::surface::Surface;
use crate::triangle_moller::MollerRay;
use crate::triangle_test::TriangleTest;
use crate::triangle_woop::{Crossing, Sheared, WoopRay, cross_at};

/// The nearest hit so far; starts as a miss at `t_max`.
///
/// Of two hits at the same `t` a triangle comes before a sphere; of two triangles that one stays whose corners
/// come first, compared as numbers in order; of two spheres the one with the lowest centre, then the smallest
/// radius; and among equals the lowest primitive. So the winner does not depend on the order of visits, nor on
/// which copy of a triangle was met.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// Where the ray crosses the surface; `t` is the bound for what is still of interest.
    pub crossing: Crossing,
    /// What was hit, or `None` while nothing was.
    pub surface: Option<(Primitive, Surface)>,
}

impl Nearest {
    /// Nothing hit yet, nothing beyond `t_max` wanted.
    pub const fn none(t_max: f32) -> Self {
        Self { crossing: Crossing { t: t_max, u: 0.0, v: 0.0 }, surface: None }
    }

    /// Takes a hit with `crossing.t <= self.crossing.t` if it comes before the one so far.
    pub fn offer(&mut self, crossing: Crossing, primitive: Primitive, surface: impl Into<Surface>) {
        let surface = surface.into();
        let wins = match &self.surface {
            Some((held, held_surface)) if crossing.t == self.crossing.t => {
                (surface.order(), primitive) < (held_surface.order(), *held)
            }
            _ => true,
        };
        if wins {
            *self = Self { crossing, surface: Some((primitive, surface)) };
        }
    }
}

/// The arrays of a cluster, borrowed from a record of [`cluster_bytes`] bytes.
#[derive(Clone, Copy, Debug)]
pub struct Cluster<'a> {
    /// The vertices' coordinates, axis after axis.
    coordinates: &'a [[u8; 4]],
    /// The triangles' corners, as vertices: first, second and third.
    corners: &'a [u8],
    place: ClusterRef,
}

impl<'a> Cluster<'a> {
    /// Splits the record of the cluster at `place`, or `None` when the record is too short.
    #[inline(always)]
    pub fn new(record: &'a [u8], place: &ClusterRef) -> Option<Self> {
        let (v4, t4) = (quads(place.vertices), quads(place.triangles));
        let (coordinates, corners) = record.split_at_checked(v4 * 12)?;
        Some(Self { coordinates: coordinates.as_chunks().0, corners: corners.get(..t4 * 3)?, place: *place })
    }

    /// Where the cluster lies and how large it is.
    pub const fn place(&self) -> &ClusterRef {
        &self.place
    }

    /// The vertices' coordinates, by axis; a multiple of four each.
    #[inline(always)]
    pub(crate) fn axes(&self) -> [&'a [[u8; 4]]; 3] {
        let v4 = quads(self.place.vertices);
        let (x, rest) = self.coordinates.split_at(v4);
        let (y, z) = rest.split_at(v4);
        [x, y, z]
    }

    /// The triangles' first, second and third corners, as vertices; a multiple of four each.
    #[inline(always)]
    pub(crate) fn corners(&self) -> [&'a [u8]; 3] {
        let t4 = quads(self.place.triangles);
        let (a, rest) = self.corners.split_at(t4);
        let (b, c) = rest.split_at(t4);
        [a, b, c]
    }

    /// Address-order index of triangle `index`.
    #[inline]
    pub fn primitive(&self, index: usize) -> Primitive {
        #[expect(clippy::cast_possible_truncation, reason = "an index below 64")]
        Primitive(self.place.first.wrapping_add(index as u32))
    }

    /// Corners of triangle `index`, in grid units; a corner that the record does not have is the origin.
    #[inline]
    pub fn triangle(&self, index: usize) -> [Vec3; 3] {
        self.vertices_of(index).map(|vertex| self.vertex(vertex))
    }

    /// The corners of triangle `index`, as vertices.
    #[inline(always)]
    pub(crate) fn vertices_of(&self, index: usize) -> [u8; 3] {
        let t4 = quads(self.place.triangles);
        let corner = |first: usize| self.corners.get(first + index).copied().unwrap_or(0);
        [corner(0), corner(t4), corner(2 * t4)]
    }

    /// A vertex, in grid units; one that the record does not have is the origin.
    #[inline]
    pub(crate) fn vertex(&self, vertex: u8) -> Vec3 {
        let v4 = quads(self.place.vertices);
        let lane = |first: usize| {
            let bytes = self.coordinates.get(first + usize::from(vertex));
            bytes.map_or(0.0, |&bytes| f32::from_le_bytes(bytes))
        };
        Vec3::new(lane(0), lane(v4), lane(2 * v4))
    }

    /// Offers every triangle that the ray hits to `nearest`; with `ANY`, stops at the first.
    ///
    /// The plain way to the same result is [`WoopRay::intersect`] for each triangle.
    #[inline(always)]
    pub(crate) fn intersect<S: Simd, const ANY: bool>(&self, s: S, ray: &WoopRay, nearest: &mut Nearest) {
        self.intersect_filtered::<S, _, ANY>(s, ray, nearest, &mut ());
    }

    /// As [`intersect`](Self::intersect), for the triangles whose hits `filter` accepts.
    #[inline(always)]
    pub(crate) fn intersect_filtered<S: Simd, F: Filter, const ANY: bool>(
        &self,
        s: S,
        ray: &WoopRay,
        nearest: &mut Nearest,
        filter: &mut F,
    ) {
        s.apart(Intersect::<F, ANY> { cluster: self, ray, nearest, filter });
    }

    /// As [`intersect_filtered`](Self::intersect_filtered), by the test of Möller and Trumbore.
    #[inline(always)]
    pub(crate) fn intersect_moller<S: Simd, F: Filter, const ANY: bool>(
        &self,
        s: S,
        ray: &MollerRay,
        nearest: &mut Nearest,
        filter: &mut F,
    ) {
        s.apart(IntersectMoller::<F, ANY> { cluster: self, ray, nearest, filter });
    }

    /// The corners of sixteen triangles from `first` on, each by axis.
    #[inline(always)]
    fn corners_in_lanes<S: Simd>(&self, s: S, axes: &[[[f32; LANES]; 2]; 3], first: usize) -> [[S::F; 3]; 3] {
        let t4 = quads(self.place.triangles);
        let count = (t4 - first).min(LANES);
        each!(3: [first, first + t4, first + 2 * t4], first => {
            let index = s.bytes(&self.corners[first..][..count]);
            [s.lookup(&axes[0], index), s.lookup(&axes[1], index), s.lookup(&axes[2], index)]
        })
    }

    /// The vertices' coordinates by axis, in the lanes of their indices; lanes beyond are 0.
    #[inline(always)]
    fn axes_in_lanes<S: Simd>(&self, s: S) -> [[[f32; LANES]; 2]; 3] {
        let mut lanes = [[[0.0; LANES]; 2]; 3];
        for (axis, lanes) in self.axes().iter().zip(&mut lanes) {
            for (from, lanes) in axis.chunks(LANES).zip(lanes) {
                s.store(s.load_le(from), lanes);
            }
        }
        lanes
    }

    /// Shears all vertices; exactly as [`WoopRay::shear`] does.
    #[inline(always)]
    fn shear<S: Simd>(&self, s: S, ray: &WoopRay) -> ShearedCluster {
        let mut sheared = ShearedCluster::ZERO;
        let v4 = quads(self.place.vertices);
        let firsts = each!(3: ray.axes, axis => v4 * axis);
        let origin = each!(3: ray.origin, value => s.splat(value));
        let shear = each!(3: ray.shear, value => s.splat(value));
        let mut half = 0;
        while half < 2 && half * LANES < v4 {
            let count = (v4 - half * LANES).min(LANES);
            let [x, y, z] = each!(3: firsts, first => {
                s.load_le(&self.coordinates[first + half * LANES..][..count])
            });
            let height = s.sub(z, origin[2]);
            s.store(s.sub(s.sub(x, origin[0]), s.mul(shear[0], height)), &mut sheared.x[half]);
            s.store(s.sub(s.sub(y, origin[1]), s.mul(shear[1], height)), &mut sheared.y[half]);
            s.store(s.mul(shear[2], height), &mut sheared.t[half]);
            half += 1;
        }
        sheared
    }

    /// Of sixteen triangles those whose edges single precision cannot tell to pass the ray; as
    /// [`cross`](crate::triangle_woop::cross) decides it.
    #[inline(always)]
    fn candidates<S: Simd>(&self, s: S, sheared: &ShearedCluster, first: usize) -> Mask {
        let t4 = quads(self.place.triangles);
        let count = (t4 - first).min(LANES);
        let [a, b, c] = each!(3: [first, first + t4, first + 2 * t4], first => {
            let index = s.bytes(&self.corners[first..][..count]);
            [s.lookup(&sheared.x, index), s.lookup(&sheared.y, index)]
        });
        let weights = each!(3: [(c, b), (a, c), (b, a)], (p, q) => {
            s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]))
        });
        let zero = s.splat(0.0);
        !(s.lt(s.min3(weights), zero) & s.lt(zero, s.max3(weights)))
    }
}

/// A cluster to be tested, as a function of its own.
struct Intersect<'a, F, const ANY: bool> {
    cluster: &'a Cluster<'a>,
    ray: &'a WoopRay,
    nearest: &'a mut Nearest,
    filter: &'a mut F,
}

impl<S: Simd, F: Filter, const ANY: bool> Part<S> for Intersect<'_, F, ANY> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        let Self { cluster, ray, nearest, filter } = self;
        let sheared = cluster.shear(s, ray);
        let triangles = usize::from(cluster.place.triangles);
        let mut first = 0;
        while first < triangles {
            let mut candidates = cluster.candidates(s, &sheared, first) & first_lanes(triangles - first);
            while candidates != 0 {
                let index = first + candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let [a, b, c] = each!(3: cluster.vertices_of(index), vertex => sheared.corner(vertex));
                let Some(crossing) = cross_at(a, b, c, nearest.crossing.t) else { continue };
                let primitive = cluster.primitive(index);
                let surface = Surface::Triangle(cluster.triangle(index));
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

/// A cluster to be tested by [`MollerRay`], as a function of its own.
struct IntersectMoller<'a, F, const ANY: bool> {
    cluster: &'a Cluster<'a>,
    ray: &'a MollerRay,
    nearest: &'a mut Nearest,
    filter: &'a mut F,
}

impl<S: Simd, F: Filter, const ANY: bool> Part<S> for IntersectMoller<'_, F, ANY> {
    type Output = ();

    #[inline(always)]
    fn run(self, s: S) {
        let Self { cluster, ray, nearest, filter } = self;
        let axes = cluster.axes_in_lanes(s);
        let triangles = usize::from(cluster.place.triangles);
        let mut first = 0;
        while first < triangles {
            let corners = cluster.corners_in_lanes(s, &axes, first);
            let mut candidates = ray.candidates(s, corners) & first_lanes(triangles - first);
            while candidates != 0 {
                let index = first + candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let corners = cluster.triangle(index);
                let Some(crossing) = ray.intersect(corners, nearest.crossing.t) else { continue };
                let (primitive, surface) = (cluster.primitive(index), Surface::Triangle(corners));
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

/// The vertices of a cluster in the sheared space of a ray. A lane that the cluster does not have is 0.
struct ShearedCluster {
    x: [[f32; LANES]; 2],
    y: [[f32; LANES]; 2],
    t: [[f32; LANES]; 2],
}

impl ShearedCluster {
    const ZERO: Self = Self { x: [[0.0; LANES]; 2], y: [[0.0; LANES]; 2], t: [[0.0; LANES]; 2] };

    /// A vertex; an index that no valid cluster has wraps around, so that a lie stays in bounds.
    #[inline(always)]
    const fn corner(&self, vertex: u8) -> Sheared {
        let lane = vertex as usize % (2 * LANES);
        let (half, lane) = (lane / LANES, lane % LANES);
        Sheared { x: self.x[half][lane], y: self.y[half][lane], t: self.t[half][lane] }
    }
}

/// Length of the record of a cluster in bytes, a multiple of 16.
#[inline]
pub const fn cluster_bytes(vertices: u8, triangles: u8) -> usize {
    (quads(vertices) * 12 + quads(triangles) * 3).next_multiple_of(16)
}

/// `count` rounded up to a multiple of 4.
#[inline]
pub const fn quads(count: u8) -> usize {
    (count as usize).next_multiple_of(4)
}

const _: () = assert!(VERTICES_MAX as usize == 2 * LANES && TRIANGLES_MAX as u32 <= u64::BITS);
