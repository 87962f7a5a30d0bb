//! Sixteen rays in a brick, each stepping through its own voxel cells.
//!
//! [`Steps`](crate::volume_ray::Steps), lane by lane. Where a ray crosses several planes at once it crosses them in one
//! step; the cells between have no stretch of the ray.

use super::packet::{CellBox, Packet, Stretch};
use crate::simd::{Mask, Simd, each};
use crate::volume::BRICK_CELLS;

/// Where sixteen rays are in a box of cells.
pub(super) struct Cells<S: Simd> {
    /// Numbers of the far planes of the rays' cells, by axis.
    far: [S::D; 3],
    /// Where the rays cross them.
    crossing: [S::D; 3],
    /// What an axis' number grows by with each step: 1 or -1.
    one: [S::D; 3],
    /// The same for `index`.
    stride: [S::I; 3],
    /// Number of the cell in the brick: `x + 8 y + 64 z`.
    pub(super) index: S::I,
    /// Where the rays enter their cells, and leave the box.
    pub(super) enter: S::D,
    leave: S::D,
    /// Rays that are in the box.
    live: S::M,
}

/// Where rays are in voxel cells, one each.
#[derive(Clone, Copy)]
pub(super) struct InCells<D, F> {
    pub(super) enter: D,
    pub(super) exit: D,
    /// The places of both in the cell, in `0..=1`.
    pub(super) from: [F; 3],
    pub(super) to: [F; 3],
    /// Rays whose stretch is not empty.
    pub(super) lanes: Mask,
}

impl<S: Simd> Cells<S> {
    /// No rays.
    #[inline(always)]
    pub(super) fn none(s: S) -> Self {
        let (zero, zeros) = (s.splat_f64(0.0), [s.splat_f64(0.0); 3]);
        let index = s.splat_int(0);
        let live = s.wide_mask(0);
        Self {
            far: zeros,
            crossing: zeros,
            one: zeros,
            stride: [index; 3],
            index,
            enter: zero,
            leave: zero,
            live,
        }
    }

    /// The cells in which rays with these stretches enter a box of cells of a brick with this lowest corner.
    #[inline(always)]
    pub(super) fn new(
        s: S,
        packet: &Packet<S>,
        stretch: &Stretch<S::D>,
        cells: &CellBox,
        corner: [i32; 3],
    ) -> Self {
        let ends = packet.ends(s, cells);
        let (minus, zero, plus) = (s.splat_f64(-1.0), s.splat_f64(0.0), s.splat_f64(1.0));
        let one = each!(3: packet.forwards, lanes => s.select_f64(lanes, plus, minus));
        // A guess, which is nearly always right, of the cell; then its far planes.
        let far = each!(3: [0, 1, 2], axis => {
            let at = s.add_f64(packet.origin[axis], s.mul_f64(stretch.enter, packet.direction[axis]));
            let last = s.splat_f64(f64::from(cells.high[axis] - 1));
            let at = s.max_f64(s.min_f64(s.floor_f64(at), last), s.splat_f64(f64::from(cells.low[axis])));
            s.add_f64(at, s.select_f64(packet.forwards[axis], plus, zero))
        });
        let (far, crossing) = in_box(s, packet, (far, one), &ends, stretch);
        let [x, y, z] = each!(3: [0, 1, 2], axis => {
            let low = s.select_f64(packet.forwards[axis], s.sub_f64(far[axis], plus), far[axis]);
            s.sub_f64(low, s.splat_f64(f64::from(corner[axis])))
        });
        let eight = s.splat_f64(8.0);
        let index = s.add_f64(x, s.mul_f64(eight, s.add_f64(y, s.mul_f64(eight, z))));
        let strides = [one[0], s.mul_f64(eight, one[1]), s.mul_f64(s.splat_f64(64.0), one[2])];
        Self {
            far,
            crossing,
            one,
            stride: each!(3: strides, stride => s.to_int(s.narrow(stride))),
            index: s.to_int(s.narrow(index)),
            enter: stretch.enter,
            leave: stretch.leave,
            live: s.wide_mask(stretch.lanes),
        }
    }

    /// Puts the live rays of others into their lanes.
    #[inline(always)]
    pub(super) fn put(&mut self, s: S, others: &Self) {
        let (wide, lanes) = (others.live, s.narrow_mask(others.live));
        for axis in 0..3 {
            self.far[axis] = s.select_f64(wide, others.far[axis], self.far[axis]);
            self.crossing[axis] = s.select_f64(wide, others.crossing[axis], self.crossing[axis]);
            self.one[axis] = s.select_f64(wide, others.one[axis], self.one[axis]);
            self.stride[axis] = s.select_int(lanes, others.stride[axis], self.stride[axis]);
        }
        self.index = s.select_int(lanes, others.index, self.index);
        self.enter = s.select_f64(wide, others.enter, self.enter);
        self.leave = s.select_f64(wide, others.leave, self.leave);
        self.live = s.wide_mask(lanes | s.narrow_mask(self.live));
    }

    /// The lanes whose rays are in the box.
    #[inline(always)]
    pub(super) fn live(&self, s: S) -> Mask {
        s.narrow_mask(self.live)
    }

    /// Has these rays leave the box.
    #[inline(always)]
    pub(super) fn end(&mut self, s: S, rays: Mask) {
        self.live = s.except(self.live, s.wide_mask(rays));
    }

    /// Has these rays go on to their next cells.
    #[inline(always)]
    pub(super) fn step(&mut self, s: S, packet: &Packet<S>, moving: Mask) {
        let moving = s.wide_mask(moving);
        let exit = self.exit(s);
        self.enter = s.select_f64(moving, exit, self.enter);
        // Others cross nothing.
        let exit = s.select_f64(moving, exit, s.splat_f64(f64::NEG_INFINITY));
        for axis in 0..3 {
            let crossed = s.le_f64(self.crossing[axis], exit);
            self.far[axis] = s.add_where_f64(crossed, self.far[axis], self.one[axis]);
            self.crossing[axis] = packet.planes(s, axis, self.far[axis]);
            self.index = s.add_where_int_wide(crossed, self.index, self.stride[axis]);
        }
        self.live = s.both(self.live, s.lt_f64(self.enter, self.leave));
    }

    /// Where the rays of `lanes` are in their cells.
    #[inline(always)]
    pub(super) fn places(&self, s: S, packet: &Packet<S>, lanes: Mask) -> InCells<S::D, S::F> {
        let exit = s.min_f64(self.exit(s), self.leave);
        let (zero, one) = (s.splat_f64(0.0), s.splat_f64(1.0));
        let (mut from, mut to) = ([s.splat(0.0); 3], [s.splat(0.0); 3]);
        for axis in 0..3 {
            let near = s.sub_f64(self.far[axis], self.one[axis]);
            let low = s.select_f64(packet.forwards[axis], near, self.far[axis]);
            // A ray enters behind no near plane and leaves before no far one, so on none but these can it be.
            let at_near = s.eq_f64(self.enter, packet.planes(s, axis, near));
            let at_far = s.eq_f64(exit, self.crossing[axis]);
            let near_side = s.select_f64(packet.forwards[axis], zero, one);
            let far_side = s.select_f64(packet.forwards[axis], one, zero);
            let entry = s.select_f64(at_near, near_side, Self::inside(s, packet, axis, (self.enter, low)));
            let end = s.select_f64(at_far, far_side, Self::inside(s, packet, axis, (exit, low)));
            (from[axis], to[axis]) = (clamp(s, entry), clamp(s, end));
        }
        InCells {
            enter: self.enter,
            exit,
            from,
            to,
            lanes: lanes & s.narrow_mask(s.lt_f64(self.enter, exit)),
        }
    }

    /// The place of `t` in cells along an axis, from their lowest corners.
    #[inline(always)]
    fn inside(s: S, packet: &Packet<S>, axis: usize, (t, low): (S::D, S::D)) -> S::D {
        s.sub_f64(s.add_f64(packet.origin[axis], s.mul_f64(t, packet.direction[axis])), low)
    }

    /// Where the rays leave their cells.
    #[inline(always)]
    fn exit(&self, s: S) -> S::D {
        s.min_f64(s.min_f64(self.crossing[0], self.crossing[1]), self.crossing[2])
    }

    /// Lowest corner of a ray's cell.
    pub(super) fn cell(&self, s: S, lane: usize, corner: [i32; 3]) -> [i32; 3] {
        let index = s.int_array(self.index)[lane];
        [corner[0] + (index & 7), corner[1] + (index >> 3 & 7), corner[2] + (index >> 6 & 7)]
    }
}

/// Moves cells, by their far planes, to those that the rays are in after they enter a box; and where they leave them.
#[inline(always)]
fn in_box<S: Simd>(
    s: S,
    packet: &Packet<S>,
    (mut far, one): ([S::D; 3], [S::D; 3]),
    [near_ends, far_ends]: &[[S::D; 3]; 2],
    stretch: &Stretch<S::D>,
) -> ([S::D; 3], [S::D; 3]) {
    let mut crossing = each!(3: [0, 1, 2], axis => packet.planes(s, axis, far[axis]));
    let lanes = s.wide_mask(stretch.lanes);
    // No more steps than there are cells.
    for _ in 0..BRICK_CELLS {
        let mut wrong = 0;
        for axis in 0..3 {
            let near = s.sub_f64(far[axis], one[axis]);
            let is_before = s.both(lanes, s.le_f64(crossing[axis], stretch.enter));
            let is_before = s.except(is_before, s.eq_f64(far[axis], far_ends[axis]));
            let is_behind = s.both(lanes, s.lt_f64(stretch.enter, packet.planes(s, axis, near)));
            let is_behind = s.except(is_behind, s.eq_f64(near, near_ends[axis]));
            wrong |= s.narrow_mask(is_before) | s.narrow_mask(is_behind);
            far[axis] = s.select_f64(is_behind, near, s.add_where_f64(is_before, far[axis], one[axis]));
        }
        if wrong == 0 {
            break;
        }
        crossing = each!(3: [0, 1, 2], axis => packet.planes(s, axis, far[axis]));
    }
    (far, crossing)
}

/// Single precision, in `0..=1`.
#[inline(always)]
fn clamp<S: Simd>(s: S, value: S::D) -> S::F {
    s.min(s.max(s.narrow(value), s.splat(0.0)), s.splat(1.0))
}
