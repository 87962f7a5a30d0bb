//! Clusters: up to 64 triangles over up to 32 vertices of their own, tested together.
//!
//! # Layout
//! With `v` vertices and `t` triangles, each rounded up to a multiple of 4 (`v4`, `t4`): `x: [f32; v4]`, `y`,
//! `z`, then the triangles' corners `a: [u8; t4]`, `b`, `c`, then padding to a multiple of 16 bytes. Lanes
//! beyond the counts repeat the last vertex, or are triangles of it alone. The counts stand in the leaf, so
//! one record is one read. A cluster begins at a multiple of 16 bytes and never crosses a page.

use glam::Vec3;

use crate::count::Count;
use crate::filter::Filter;
use crate::grid::{ClusterRef, TRIANGLES_MAX, VERTICES_MAX};
use crate::ray::Primitive;
use crate::surface::Surface;
use crate::triangle_woop::{Crossing, Sheared, WoopRay, cross};

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
    axes: [&'a [[u8; 4]]; 3],
    corners: [&'a [u8]; 3],
    place: ClusterRef,
}

impl<'a> Cluster<'a> {
    /// Splits the record of the cluster at `place`, or `None` when the record is too short.
    #[inline]
    pub fn new(record: &'a [u8], place: &ClusterRef) -> Option<Self> {
        let (v4, t4) = (quads(place.vertices), quads(place.triangles));
        let (xyz, rest) = record.split_at_checked(v4 * 12)?;
        let abc = rest.get(..t4 * 3)?;
        let (floats, _) = xyz.as_chunks::<4>();
        Some(Self {
            axes: [&floats[..v4], &floats[v4..v4 * 2], &floats[v4 * 2..]],
            corners: [&abc[..t4], &abc[t4..t4 * 2], &abc[t4 * 2..]],
            place: *place,
        })
    }

    /// Where the cluster lies and how large it is.
    pub const fn place(&self) -> &ClusterRef {
        &self.place
    }

    /// The vertices' coordinates, by axis; a multiple of four each.
    #[inline]
    pub(crate) const fn axes(&self) -> [&'a [[u8; 4]]; 3] {
        self.axes
    }

    /// The triangles' first, second and third corners, as vertices; a multiple of four each.
    #[inline]
    pub(crate) const fn corners(&self) -> [&'a [u8]; 3] {
        self.corners
    }

    /// Address-order index of triangle `index`.
    #[inline]
    pub fn primitive(&self, index: usize) -> Primitive {
        #[expect(clippy::cast_possible_truncation, reason = "an index below 64")]
        Primitive(self.place.first.wrapping_add(index as u32))
    }

    /// Corners of triangle `index`, in grid units; a corner that the record does not have is the origin.
    pub fn triangle(&self, index: usize) -> [Vec3; 3] {
        self.corners.map(|corners| corners.get(index).map_or(Vec3::ZERO, |&vertex| self.vertex(vertex)))
    }

    /// A vertex, in grid units; one that the record does not have is the origin.
    #[inline]
    pub(crate) fn vertex(&self, vertex: u8) -> Vec3 {
        let lane = |axis: usize| {
            self.axes[axis].get(usize::from(vertex)).map_or(0.0, |&bytes| f32::from_le_bytes(bytes))
        };
        Vec3::new(lane(0), lane(1), lane(2))
    }

    /// Offers every triangle that the ray hits to `nearest`; with `ANY`, stops at the first.
    ///
    /// The plain way to the same result is [`WoopRay::intersect`] for each triangle.
    #[inline]
    pub fn intersect<const ANY: bool>(&self, ray: &WoopRay, nearest: &mut Nearest, count: &mut impl Count) {
        self.intersect_filtered::<ANY>(ray, nearest, &mut (), count);
    }

    /// As [`intersect`](Self::intersect), for the triangles whose hits `filter` accepts.
    pub fn intersect_filtered<const ANY: bool>(
        &self,
        ray: &WoopRay,
        nearest: &mut Nearest,
        filter: &mut impl Filter,
        count: &mut impl Count,
    ) {
        count.cluster();
        count.triangles(u32::from(self.place.triangles));
        let sheared = self.shear(ray, nearest.crossing.t);
        let mut candidates = self.candidates(&sheared.sides);
        while candidates != 0 {
            let index = candidates.trailing_zeros() as usize;
            candidates &= candidates - 1;
            let [a, b, c] = self.corners.map(|corners| sheared.corner(corners[index]));
            if let Some(crossing) = cross(a, b, c, nearest.crossing.t) {
                let (primitive, surface) = (self.primitive(index), Surface::Triangle(self.triangle(index)));
                if !filter.accepts(&crossing, primitive, &surface) {
                    continue;
                }
                nearest.offer(crossing, primitive, surface);
                if ANY {
                    return;
                }
            }
        }
    }

    /// Shears all vertices, and notes on which sides of the ray each lies.
    #[inline]
    fn shear(&self, ray: &WoopRay, t_max: f32) -> ShearedCluster {
        let mut sheared = ShearedCluster::ZERO;
        let [xs, ys, zs] = ray.axes.map(|axis| self.axes[axis]);
        let lanes = xs.len().min(ys.len()).min(zs.len()).min(LANES);
        for lane in 0..lanes {
            let corner = [xs[lane], ys[lane], zs[lane]].map(f32::from_le_bytes);
            let Sheared { x, y, t } = ray.shear(corner);
            sheared.x[lane] = x;
            sheared.y[lane] = y;
            sheared.t[lane] = t;
            sheared.sides[lane] = u32::from(x < 0.0)
                | u32::from(x > 0.0) << 1
                | u32::from(y < 0.0) << 2
                | u32::from(y > 0.0) << 3
                | u32::from(t <= 0.0) << 4
                | u32::from(t > t_max) << 5;
        }
        sheared
    }

    /// The triangles whose corners do not all lie on one side of the ray, one bit each.
    #[inline]
    fn candidates(&self, sides: &[u32; LANES]) -> u64 {
        let count = usize::from(self.place.triangles);
        let [Some(a), Some(b), Some(c)] = self.corners.map(|corners| corners.get(..count)) else { return 0 };
        let mut candidates = 0;
        for index in 0..count {
            let common = sides[lane_of(a[index])] & sides[lane_of(b[index])] & sides[lane_of(c[index])];
            candidates |= u64::from(common == 0) << index;
        }
        candidates
    }
}

/// The vertices of a cluster in the sheared space of a ray. A lane that the cluster does not have is 0.
struct ShearedCluster {
    x: [f32; LANES],
    y: [f32; LANES],
    t: [f32; LANES],
    sides: [u32; LANES],
}

impl ShearedCluster {
    const ZERO: Self = Self { x: [0.0; LANES], y: [0.0; LANES], t: [0.0; LANES], sides: [0; LANES] };

    #[inline]
    fn corner(&self, vertex: u8) -> Sheared {
        let lane = lane_of(vertex);
        Sheared { x: self.x[lane], y: self.y[lane], t: self.t[lane] }
    }
}

/// The lane of a vertex; an index that no valid cluster has wraps around, so that a lie stays in bounds.
#[inline]
fn lane_of(vertex: u8) -> usize {
    usize::from(vertex) % LANES
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

const LANES: usize = VERTICES_MAX as usize;

const _: () = assert!(LANES.is_power_of_two() && TRIANGLES_MAX as u32 <= u64::BITS);
