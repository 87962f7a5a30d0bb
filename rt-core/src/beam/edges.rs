//! Triangles against points of the projection plane: who certainly covers whom, and at what depth.
//!
//! A point is *covered* when the three edge functions of a triangle around it do not have strictly opposite signs.
//! Projection is rounded, so each edge function is uncertain by `margin`. Lanes whose functions are all beyond it are
//! *sure*; those that could be covered are *candidates*. A candidate that is not sure is decided by its ray.

use super::projection::Projected;
use crate::simd::{LANES, Mask, Simd, each};

/// A triangle in each lane, ready to be tested at points.
#[derive(Clone, Copy)]
pub(super) struct Edges<F> {
    pub(super) corners: [Projected<F>; 3],
    pub(super) margins: Margins<F>,
}

/// What is the same for all points that a triangle is tested at.
#[derive(Clone, Copy)]
pub(super) struct Margins<F> {
    /// Uncertainty of the edge functions.
    pub(super) edge: F,
    /// Times one over the sum of the edge functions: uncertainty of the inverse depth from that of the edges.
    pub(super) depth: F,
}

/// [`Edges`] lane by lane, to take single triangles out of.
pub(super) struct EdgesByLane {
    corners: [[[f32; LANES]; 3]; 3],
    margins: [[f32; LANES]; 2],
}

/// Points against triangles, or spheres, lane by lane.
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

    /// The triangles with their margins for points inside the box.
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
    pub(super) fn edges<S: Simd<F = F>>(&self, s: S, corners: &[Projected<F>; 3], delta: f32) -> Edges<F> {
        let size = s.add(s.sub(self.right, self.left), s.sub(self.bottom, self.top));
        let edge = s.add(s.mul(size, s.splat(delta * 2.125)), s.splat(delta * delta * 4.0));
        let [a, b, c] = *corners;
        let (from_b, from_c) = (s.sub(b.w, a.w), s.sub(c.w, a.w));
        let slope_x = edge_of(s, [from_b, s.sub(b.y, a.y)], [from_c, s.sub(c.y, a.y)]);
        let slope_y = edge_of(s, [from_b, s.sub(b.x, a.x)], [from_c, s.sub(c.x, a.x)]);
        let slopes = s.add(s.abs(slope_x), s.abs(slope_y));
        let rounding = s.mul(s.mul(size, size), s.mul(s.sub(self.near, self.far), s.splat(ROUNDING)));
        let depth = s.add(s.mul(slopes, s.splat(delta * 1.125)), rounding);
        Edges { corners: *corners, margins: Margins { edge, depth } }
    }
}

impl<F: Copy> Edges<F> {
    #[inline(always)]
    pub(super) fn by_lane<S: Simd<F = F>>(&self, s: S) -> EdgesByLane {
        EdgesByLane {
            corners: each!(3: self.corners, corner => [s.array(corner.x), s.array(corner.y), s.array(corner.w)]),
            margins: [s.array(self.margins.edge), s.array(self.margins.depth)],
        }
    }

    /// Tests points `(x, y)` against the triangles, lane by lane.
    #[inline(always)]
    pub(super) fn cover<S: Simd<F = F>>(&self, s: S, (x, y): (F, F), depth_epsilon: f32) -> Covered<F> {
        let [ax, bx, cx] = each!(3: self.corners, corner => s.sub(corner.x, x));
        let [ay, by, cy] = each!(3: self.corners, corner => s.sub(corner.y, y));
        let weights =
            [edge_of(s, [bx, by], [cx, cy]), edge_of(s, [cx, cy], [ax, ay]), edge_of(s, [ax, ay], [bx, by])];
        let (least, greatest) = (s.min3(weights), s.max3(weights));
        let margin = self.margins.edge;
        let below = s.sub(s.splat(0.0), margin);
        let per_sum = s.div(s.splat(1.0), s.add(s.add(weights[0], weights[1]), weights[2]));
        let inverse_depth = s.mul(s.dot(weights, each!(3: self.corners, corner => corner.w)), per_sum);
        let unsure = s.abs(s.mul(self.margins.depth, per_sum));
        let unsure = s.add(unsure, s.mul(inverse_depth, s.splat(depth_epsilon)));
        Covered {
            candidates: s.le(below, least) | s.le(greatest, margin),
            sure: s.lt(margin, least) | s.lt(greatest, below),
            low: s.sub(inverse_depth, unsure),
            high: s.add(inverse_depth, unsure),
        }
    }
}

impl<F: Copy> Edges<F> {
    /// The lanes whose triangle may cover, or nearly cover, a pixel of the block in this column and row of blocks.
    ///
    /// Edge functions are affine: on the block, one differs from its value in the middle by at most 1.5 times the sum of its
    /// slopes. Away from the triangle their own rounding grows; a second margin has room for it.
    #[inline(always)]
    pub(super) fn may_cover_block<S: Simd<F = F>>(&self, s: S, [column, row]: [F; 2]) -> Mask {
        let [x, y] = each!(2: [column, row], place => s.add(s.mul(place, s.splat(4.0)), s.splat(1.5)));
        let [ax, bx, cx] = each!(3: self.corners, corner => s.sub(corner.x, x));
        let [ay, by, cy] = each!(3: self.corners, corner => s.sub(corner.y, y));
        let margin = s.mul(self.margins.edge, s.splat(2.0));
        let mut may = [Mask::MAX; 2];
        for (p, q) in [([bx, by], [cx, cy]), ([cx, cy], [ax, ay]), ([ax, ay], [bx, by])] {
            let slopes = s.add(s.abs(s.sub(p[0], q[0])), s.abs(s.sub(p[1], q[1])));
            let reach = s.add(s.mul(slopes, s.splat(1.500_1)), margin);
            let middle = edge_of(s, p, q);
            may[0] &= s.le(s.sub(s.splat(0.0), reach), middle);
            may[1] &= s.le(middle, reach);
        }
        may[0] | may[1]
    }
}

impl EdgesByLane {
    /// One triangle, in all lanes.
    #[inline(always)]
    pub(super) fn splat<S: Simd>(&self, s: S, lane: usize) -> Edges<S::F> {
        Edges {
            corners: each!(3: &self.corners, [x, y, w] => Projected {
                x: s.splat(x[lane]),
                y: s.splat(y[lane]),
                w: s.splat(w[lane]),
            }),
            margins: Margins { edge: s.splat(self.margins[0][lane]), depth: s.splat(self.margins[1][lane]) },
        }
    }
}

/// The edge function of two corners around 0. Products are rounded apart, so swapping the corners negates it exactly.
#[inline(always)]
fn edge_of<S: Simd>(s: S, p: [S::F; 2], q: [S::F; 2]) -> S::F {
    s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]))
}

/// `16 * 2^-24`.
const ROUNDING: f32 = 1.0 / 1_048_576.0;
