//! Where boxes show on the projection plane, sixteen at a time.
//!
//! Everything here culls, and errs towards showing.

use super::projection::Projection;
use super::triangles::Bounds;
use crate::simd::{LANES, Mask, Simd, each};

/// Bounds of boxes on the projection plane, and their greatest inverse depths, one box in each lane. A box that reaches
/// behind the eye is everywhere and infinitely near.
#[derive(Clone, Copy)]
pub(super) struct Boxes<F> {
    pub(super) left: F,
    pub(super) right: F,
    pub(super) top: F,
    pub(super) bottom: F,
    pub(super) near: F,
}

/// One box, as the eye sees it: its middle from there, and halves of its edges, with some margin.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenBox {
    pub(super) centre: [f32; 3],
    pub(super) half: [f32; 3],
}

impl SeenBox {
    /// The lanes whose rays from the eye meet the box, and that no later than at one over `least`.
    ///
    /// A line along `d` through the eye misses a box around `c` when its distance from the middle, looked at along one of
    /// the axes, is more than the box reaches. It enters the slab of an axis where it has gone `(c d - h |d|) / d^2`.
    #[inline(always)]
    pub(super) fn met_by<S: Simd>(&self, s: S, d: [S::F; 3], least: S::F) -> Mask {
        let (c, h) = (each!(3: self.centre, at => s.splat(at)), each!(3: self.half, at => s.splat(at)));
        let size = each!(3: d, along => s.abs(along));
        let met = each!(3: [(0, 1), (1, 2), (2, 0)], (i, j) => {
            let aside = s.abs(s.sub(s.mul(d[i], c[j]), s.mul(d[j], c[i])));
            s.le(aside, s.add(s.mul(h[i], size[j]), s.mul(h[j], size[i])))
        });
        let in_time = each!(3: [0, 1, 2], axis => {
            let gone = s.sub(s.mul(c[axis], d[axis]), s.mul(h[axis], size[axis]));
            s.le(s.mul(gone, least), s.mul(d[axis], d[axis]))
        });
        met[0] & met[1] & met[2] & in_time[0] & in_time[1] & in_time[2]
    }
}

impl Projection {
    /// Where the boxes around `centre`, given from the eye, show that reach as far as `half` each way.
    ///
    /// What is left of the middle of a coordinate, and of the depth, is not off by more than `2^-20` of the length of the
    /// way there; that much is added.
    #[inline(always)]
    pub(super) fn boxes<S: Simd>(&self, s: S, centre: [S::F; 3], half: [S::F; 3]) -> Boxes<S::F> {
        let away = each!(3: [0, 1, 2], axis => s.add(s.abs(centre[axis]), half[axis]));
        let away = s.mul(s.add(s.add(away[0], away[1]), away[2]), s.splat(ROUNDING));
        let [x, y, depth] = each!(3: self.rows, row => {
            let (row, size) = (s.splat3(row), s.splat3(row.abs()));
            let reach = s.add(s.dot(size, half), s.mul(away, s.add(s.add(size[0], size[1]), size[2])));
            (s.dot(row, centre), reach)
        });
        self.quotients(s, [x, y, depth])
    }

    /// The same for balls of these radii: from a row's direction a ball looks no larger than from any other.
    #[inline(always)]
    pub(super) fn boxes_of_balls<S: Simd>(&self, s: S, centre: [S::F; 3], radius: S::F) -> Boxes<S::F> {
        let away = each!(3: centre, value => s.abs(value));
        let away = s.mul(s.add(s.add(s.add(away[0], away[1]), away[2]), radius), s.splat(ROUNDING));
        let [x, y, depth] = each!(3: [0, 1, 2], row => {
            let (length, row) = (s.splat(self.lengths[row]), self.rows[row]);
            let reach = s.add(s.mul(length, radius), s.mul(away, s.splat(row.abs().element_sum())));
            (s.dot(s.splat3(row), centre), reach)
        });
        self.quotients(s, [x, y, depth])
    }

    /// Boxes from middles and reaches of the two coordinates, not yet divided by the depth, and of the depth.
    #[inline(always)]
    fn quotients<S: Simd>(&self, s: S, [x, y, depth]: [(S::F, S::F); 3]) -> Boxes<S::F> {
        let [zero, one, infinite] = each!(3: [0.0, 1.0, f32::INFINITY], value => s.splat(value));
        let near = s.sub(depth.0, depth.1);
        let per_near = s.div(one, near);
        let per_far = s.div(one, s.add(depth.0, depth.1));
        let margin = s.splat(self.delta_wide);
        let [x, y] = each!(2: [x, y], (middle, reach) => {
            let (low, high) = (s.sub(middle, reach), s.add(middle, reach));
            let low = s.min(s.mul(low, per_near), s.mul(low, per_far));
            let high = s.max(s.mul(high, per_near), s.mul(high, per_far));
            [s.sub(low, margin), s.add(high, margin)]
        });
        let is_in_front = s.lt(zero, near);
        let everywhere = s.sub(zero, infinite);
        Boxes {
            left: s.select(is_in_front, x[0], everywhere),
            right: s.select(is_in_front, x[1], infinite),
            top: s.select(is_in_front, y[0], everywhere),
            bottom: s.select(is_in_front, y[1], infinite),
            near: s.select(is_in_front, s.mul(per_near, s.splat(1.0 + 4.0 * self.depth_epsilon)), infinite),
        }
    }

    /// The boxes that show on the plane and are no deeper than an inverse depth of `least`.
    #[inline(always)]
    pub(super) fn shows<S: Simd>(&self, s: S, boxes: &Boxes<S::F>, least: f32) -> Mask {
        let zero = s.splat(0.0);
        // Comparisons are written so that a NaN anywhere shows.
        let is_out = s.lt(boxes.right, zero)
            | s.lt(s.splat(self.end[0]), boxes.left)
            | s.lt(boxes.bottom, zero)
            | s.lt(s.splat(self.end[1]), boxes.top)
            | s.lt(boxes.near, s.splat(least));
        !is_out
    }
}

impl<F: Copy> Boxes<F> {
    #[inline(always)]
    pub(super) fn by_lane<S: Simd<F = F>>(&self, s: S) -> BoundsByLane {
        let [left, right, top, bottom] =
            each!(4: [self.left, self.right, self.top, self.bottom], end => s.array(end));
        BoundsByLane { left, right, top, bottom, near: s.array(self.near) }
    }
}

/// Bounds of boxes, one in each lane.
pub(super) struct BoundsByLane {
    left: [f32; LANES],
    right: [f32; LANES],
    top: [f32; LANES],
    bottom: [f32; LANES],
    near: [f32; LANES],
}

impl BoundsByLane {
    #[inline(always)]
    pub(super) const fn of(&self, lane: usize) -> Bounds {
        Bounds {
            left: self.left[lane],
            right: self.right[lane],
            top: self.top[lane],
            bottom: self.bottom[lane],
            near: self.near[lane],
        }
    }
}

/// `2^-20`.
const ROUNDING: f32 = 1.0 / 1_048_576.0;
