//! Triangles against points of the projection plane: who certainly covers whom, and at what depth.
//!
//! A point is *covered* when the three edge functions of a triangle around it do not have strictly opposite signs.
//! Projection is rounded, so each edge function is uncertain by `margin`. Lanes whose functions are all beyond it are
//! *sure*; those that could be covered are *candidates*. A candidate that is not sure is decided by its ray.

use super::projection::Projected;
use super::walk::Triangles;
use crate::simd::{Mask, Simd, each};

/// What is the same for all points that a triangle is tested at.
#[derive(Clone, Copy)]
pub(super) struct Margins<F> {
    /// Uncertainty of the edge functions.
    pub(super) edge: F,
    /// Times one over the sum of the edge functions: uncertainty of the inverse depth from that of the edges.
    pub(super) depth: F,
}

/// Points against triangles, lane by lane.
#[derive(Clone, Copy)]
pub(super) struct Covered<F> {
    /// Lanes that may be covered; where not even `sure`, a ray has to decide.
    pub(super) candidates: Mask,
    pub(super) sure: Mask,
    /// Least and greatest inverse depth that a ray can find here, if it finds anything.
    pub(super) low: F,
    pub(super) high: F,
}

/// The box of a triangle on the projection plane, and the range of its inverse depths.
#[derive(Clone, Copy)]
pub(super) struct Extent<F> {
    pub(super) left: F,
    pub(super) right: F,
    pub(super) top: F,
    pub(super) bottom: F,
    pub(super) far: F,
    pub(super) near: F,
}

impl<F: Copy> Extent<F> {
    #[inline(always)]
    pub(super) fn of<S: Simd<F = F>>(s: S, corners: &[Projected<F>; 3]) -> Self {
        let [x, y, w] = [corners.map(|c| c.x), corners.map(|c| c.y), corners.map(|c| c.w)];
        Self {
            left: s.min3(x),
            right: s.max3(x),
            top: s.min3(y),
            bottom: s.max3(y),
            far: s.min3(w),
            near: s.max3(w),
        }
    }

    /// Margins for points inside the box.
    ///
    /// An edge function is a difference of two products of coordinates, relative to the point, of two corners. Moving
    /// the coordinates by `delta` each changes it by at most `delta` times the sum of their sizes, which is at most
    /// twice the box's width and height, plus `2 delta^2`; its own rounding is far less.
    ///
    /// The inverse depth is an affine function on the plane. Where corners move by `delta` each way, what is
    /// interpolated between them moves by at most `delta` times the sum of its two slopes; each slope is a
    /// determinant of the corners over the sum of the edge functions. Those are rounded too: by `3 * 2^-24` of the
    /// square of the size each, times the range of inverse depths.
    #[inline(always)]
    pub(super) fn margins<S: Simd<F = F>>(&self, s: S, triangles: &Triangles<'_, S>) -> Margins<F> {
        let delta = triangles.delta;
        let size = s.add(s.sub(self.right, self.left), s.sub(self.bottom, self.top));
        let edge = s.add(s.mul(size, s.splat(delta * 2.125)), s.splat(delta * delta * 4.0));
        let [a, b, c] = triangles.corners;
        let (from_b, from_c) = (s.sub(b.w, a.w), s.sub(c.w, a.w));
        let slope_x = edge_of(s, [from_b, s.sub(b.y, a.y)], [from_c, s.sub(c.y, a.y)]);
        let slope_y = edge_of(s, [from_b, s.sub(b.x, a.x)], [from_c, s.sub(c.x, a.x)]);
        let slopes = s.add(s.abs(slope_x), s.abs(slope_y));
        let rounding = s.mul(s.mul(size, size), s.mul(s.sub(self.near, self.far), s.splat(ROUNDING)));
        Margins { edge, depth: s.add(s.mul(slopes, s.splat(delta * 1.125)), rounding) }
    }
}

/// Tests points `(x, y)` against triangles, lane by lane.
#[inline(always)]
pub(super) fn cover<S: Simd>(
    s: S,
    triangles: &Triangles<'_, S>,
    (x, y): (S::F, S::F),
    margins: &Margins<S::F>,
    lanes: Mask,
) -> Option<Covered<S::F>> {
    let corners = &triangles.corners;
    let [ax, bx, cx] = each!(3: *corners, corner => s.sub(corner.x, x));
    let [ay, by, cy] = each!(3: *corners, corner => s.sub(corner.y, y));
    let weights =
        [edge_of(s, [bx, by], [cx, cy]), edge_of(s, [cx, cy], [ax, ay]), edge_of(s, [ax, ay], [bx, by])];
    let (least, greatest) = (s.min3(weights), s.max3(weights));
    let below = s.sub(s.splat(0.0), margins.edge);
    let candidates = (s.le(below, least) | s.le(greatest, margins.edge)) & lanes;
    if candidates == 0 {
        return None;
    }
    let sure = (s.lt(margins.edge, least) | s.lt(greatest, below)) & lanes;
    let per_sum = s.div(s.splat(1.0), s.add(s.add(weights[0], weights[1]), weights[2]));
    let inverse_depth = s.mul(s.dot(weights, each!(3: *corners, corner => corner.w)), per_sum);
    let margin =
        s.add(s.abs(s.mul(margins.depth, per_sum)), s.mul(inverse_depth, s.splat(triangles.depth_epsilon)));
    Some(Covered { candidates, sure, low: s.sub(inverse_depth, margin), high: s.add(inverse_depth, margin) })
}

/// The edge function of two corners around 0. Products are rounded apart, so swapping the corners negates it exactly.
#[inline(always)]
fn edge_of<S: Simd>(s: S, p: [S::F; 2], q: [S::F; 2]) -> S::F {
    s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]))
}

/// `16 * 2^-24`.
const ROUNDING: f32 = 1.0 / 1_048_576.0;
