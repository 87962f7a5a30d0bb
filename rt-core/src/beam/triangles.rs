//! The triangles of a cluster, projected.

use glam::Vec3;

use super::projection::{NEAR, Projected, Projection};
use crate::cluster::Cluster;
use crate::simd::{LANES, Mask, Simd, each, first_lanes};

/// A cluster, and where its vertices lie on the projection plane.
///
/// Tests first go over all triangles, sixteen at a time, and write down which need a closer look; so a triangle is named by
/// its [`Corners`].
pub(super) struct Triangles<'a, S: Simd> {
    pub(super) cluster: &'a Cluster<'a>,
    /// Places of the vertices and inverse depths; those that the cluster does not have are anything.
    x: [S::F; 2],
    y: [S::F; 2],
    w: [S::F; 2],
    /// Uncertainty of the places.
    pub(super) delta: f32,
    /// Relative uncertainty of inverse depths.
    pub(super) depth_epsilon: f32,
    pub(super) bounds: Bounds,
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

/// Up to sixteen triangles.
pub(super) struct Batch<F> {
    pub(super) corners: [Projected<F>; 3],
    /// Names of the triangles.
    pub(super) names: F,
    /// Lanes that hold a triangle.
    pub(super) lanes: Mask,
}

/// A triangle of a cluster, named by its three vertices, five bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corners(u32);

impl Corners {
    /// Number of names.
    pub(super) const COUNT: u32 = 1 << 15;

    /// The name of a triangle by its place in the cluster.
    pub(super) fn of_triangle(cluster: &Cluster<'_>, index: usize) -> Self {
        let [a, b, c] = cluster.vertices_of(index).map(|vertex| u32::from(vertex % 32));
        Self(a | b << 5 | c << 10)
    }

    /// From the lower bits of a larger number.
    #[inline(always)]
    pub(super) const fn of(name: u32) -> Self {
        Self(name % Self::COUNT)
    }

    #[inline(always)]
    pub(super) const fn name(self) -> u32 {
        self.0
    }

    /// The corners, in grid units.
    #[inline(always)]
    pub(super) fn points(self, cluster: &Cluster<'_>) -> [Vec3; 3] {
        [self.0 & 31, self.0 >> 5 & 31, self.0 >> 10].map(|vertex| cluster.vertex(vertex as u8))
    }
}

impl Projection {
    /// Projects the vertices of a cluster; `None` when one lies behind the eye or too far out.
    #[inline(always)]
    pub(super) fn triangles<'a, S: Simd>(&self, s: S, cluster: &'a Cluster<'a>) -> Option<Triangles<'a, S>> {
        let mut triangles = Triangles {
            cluster,
            x: [s.splat(0.0); 2],
            y: [s.splat(0.0); 2],
            w: [s.splat(0.0); 2],
            delta: self.delta,
            depth_epsilon: self.depth_epsilon,
            bounds: Bounds { left: 0.0, right: 0.0, top: 0.0, bottom: 0.0, near: 0.0 },
        };
        let count = usize::from(cluster.place().vertices);
        let mut fits = true;
        // Least coordinates, least negated coordinates and inverse depth.
        let mut least = [s.splat(f32::INFINITY); 5];
        let mut half = 0;
        while half < 2 && half * LANES < count {
            let from = half * LANES;
            let point =
                each!(3: cluster.axes(), axis => s.load_le(&axis[from..axis.len().min(from + LANES)]));
            let Projected { x, y, w } = self.project(s, point);
            let out = s.max(s.abs(x), s.abs(y));
            let lanes = first_lanes(count - from);
            let is_sound = s.lt(s.splat(0.0), w) & s.le(out, s.splat(self.wide)) & s.lt(w, s.splat(W_MAX));
            fits &= is_sound & lanes == lanes;
            let zero = s.splat(0.0);
            let ends = [x, s.sub(zero, x), y, s.sub(zero, y), s.sub(zero, w)];
            for (least, end) in least.iter_mut().zip(ends) {
                *least = s.min(s.select(lanes, end, *least), *least);
            }
            triangles.x[half] = x;
            triangles.y[half] = y;
            triangles.w[half] = w;
            half += 1;
        }
        let [left, right] = [s.least(least[0]), -s.least(least[1])];
        let [top, bottom] = [s.least(least[2]), -s.least(least[3])];
        let near = -s.least(least[4]);
        if left.min(top) < -NEAR || right.max(bottom) > NEAR {
            triangles.delta = self.delta_wide;
        }
        let margin = triangles.delta;
        triangles.bounds = Bounds {
            left: left - margin,
            right: right + margin,
            top: top - margin,
            bottom: bottom + margin,
            near: near * (1.0 + self.depth_epsilon),
        };
        fits.then_some(triangles)
    }
}

impl<S: Simd> Triangles<'_, S> {
    /// Triangles `first..first + 16`.
    #[inline(always)]
    pub(super) fn batch(&self, s: S, first: usize) -> Batch<S::F> {
        let vertices = each!(3: self.cluster.corners(), corners => {
            s.bytes(&corners[first.min(corners.len())..corners.len().min(first + LANES)])
        });
        let [a, b, c] = each!(3: vertices, vertex => s.to_float(vertex));
        Batch {
            corners: each!(3: vertices, vertex => self.vertices(s, vertex)),
            names: s.add(a, s.add(s.mul(b, s.splat(32.0)), s.mul(c, s.splat(1024.0)))),
            lanes: first_lanes(self.count() - first),
        }
    }

    /// The corners of the triangles of these names.
    #[inline(always)]
    pub(super) fn named(&self, s: S, names: S::I) -> [Projected<S::F>; 3] {
        each!(3: [names, s.shift_right::<5>(names), s.shift_right::<10>(names)], vertex => self.vertices(s, vertex))
    }

    #[inline(always)]
    pub(super) fn count(&self) -> usize {
        usize::from(self.cluster.place().triangles)
    }

    /// Vertices by the lower five bits.
    #[inline(always)]
    fn vertices(&self, s: S, vertex: S::I) -> Projected<S::F> {
        Projected {
            x: s.pick_of_two(self.x, vertex),
            y: s.pick_of_two(self.y, vertex),
            w: s.pick_of_two(self.w, vertex),
        }
    }
}

/// Largest inverse depth, in grid units: nearer to the eye than 2^-20 of the scene rays take over.
const W_MAX: f32 = 1_048_576.0;
