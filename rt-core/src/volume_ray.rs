//! A ray among the cells of a volume: where it enters each, and where in it it is.
//!
//! Places are computed in double precision: in single precision a sample's index alone may need all 24 bits. Values
//! between samples are single precision.
//!
//! # The way of a ray
//! The planes between cells are numbered like the samples on them. The ray is on plane `k` of an axis at `t = (k -
//! origin) * inverse`, rounded twice and never accumulated, so it is a function of ray and plane alone; it never falls
//! as planes are crossed in order. A cell's interval is from the last of its three near planes to the first of its
//! three far ones. That is the whole definition: every way of walking, skipping and culling meets the same cells with
//! the same intervals, and two cells that share a face share the `t` of it, bit for bit.
//!
//! `VolumeRay::place` is the place in a cell at some `t`: on a plane of the cell it is 0 or 1 exactly, else
//! computed and clamped. So on a shared face both cells see the same four samples with the same two weights.

use glam::Vec3;

use crate::scale::Scale;
use crate::volume::Volume;

/// A ray in cell units; see [`volume`](crate::volume).
#[derive(Clone, Copy, Debug)]
pub struct VolumeRay {
    pub(crate) origin: [f64; 3],
    pub(crate) direction: [f64; 3],
    /// One over the direction, 0 taken as [`TINY`].
    pub(crate) inverse: [f64; 3],
    /// 1 where the ray runs forwards, else 0: which of a cell's two planes is the far one.
    pub(crate) far_side: [i32; 3],
}

/// Where a volume lies in the space that rays are in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VolumePlace {
    /// Place of the first sample.
    pub(crate) origin: [f64; 3],
    /// Cells per unit of length.
    pub(crate) per_length: [f64; 3],
}

impl VolumePlace {
    /// The place in world units times `scale`.
    pub(crate) fn new(volume: &Volume, scale: Scale) -> Self {
        let factor = libm::scalbn(1.0, scale.exponent());
        Self {
            origin: volume.origin.map(|x| x * factor),
            per_length: volume.spacing.map(|spacing| 1.0 / (spacing * factor)),
        }
    }

    /// The ray in cell units; `t` stays. `None` when the direction is zero or something is not finite.
    pub(crate) fn ray(&self, origin: Vec3, direction: Vec3) -> Option<VolumeRay> {
        let (from, along) = (origin.to_array().map(f64::from), direction.to_array().map(f64::from));
        let origin = [0, 1, 2].map(|axis| (from[axis] - self.origin[axis]) * self.per_length[axis]);
        let direction = [0, 1, 2].map(|axis| along[axis] * self.per_length[axis]);
        let finite = |numbers: [f64; 3]| numbers.into_iter().all(f64::is_finite);
        let usable = finite(origin) && finite(direction) && direction != [0.0; 3];
        usable.then(|| VolumeRay::new(origin, direction))
    }
}

impl VolumeRay {
    fn new(origin: [f64; 3], direction: [f64; 3]) -> Self {
        let inverse = direction.map(|d| 1.0 / if d.abs() < TINY { TINY.copysign(d) } else { d });
        let far_side = inverse.map(|inverse| i32::from(inverse > 0.0));
        Self { origin, direction, inverse, far_side }
    }

    /// Where the ray is on plane `k` of an axis.
    #[inline]
    pub(crate) fn plane(&self, axis: usize, k: i32) -> f64 {
        (f64::from(k) - self.origin[axis]) * self.inverse[axis]
    }

    /// Where the ray enters and leaves a box of cells.
    #[inline]
    pub(crate) fn interval(&self, low: [i32; 3], high: [i32; 3]) -> (f64, f64) {
        let (mut enter, mut exit) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            let forwards = self.far_side[axis] != 0;
            let (near, far) = if forwards { (low[axis], high[axis]) } else { (high[axis], low[axis]) };
            enter = larger(enter, self.plane(axis, near));
            exit = smaller(exit, self.plane(axis, far));
        }
        (enter, exit)
    }

    /// The place of `t` in a cell, from its lowest corner; in `0..=1`.
    #[inline]
    pub(crate) fn place(&self, t: f64, cell: [i32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|axis| {
            if t == self.plane(axis, cell[axis]) {
                return 0.0;
            }
            if t == self.plane(axis, cell[axis] + 1) {
                return 1.0;
            }
            let inside = self.origin[axis] + t * self.direction[axis] - f64::from(cell[axis]);
            #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
            let inside = inside as f32;
            clamp(inside)
        })
    }
}

/// Steps through a cube of `N` boxes a side, in the order in which a ray meets them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steps<const N: i32> {
    /// Coordinates of the box in the cube, in `0..N`.
    pub(crate) at: [i32; 3],
    /// Where the ray enters it.
    pub(crate) enter: f64,
    /// Where it crosses the far planes of the box.
    far: [f64; 3],
    corner: [i32; 3],
    edge: i32,
}

impl<const N: i32> Steps<N> {
    /// The box that the ray is in after `enter`, which lies in the cube; boxes are `edge` cells wide.
    #[inline]
    pub(crate) fn new(ray: &VolumeRay, corner: [i32; 3], edge: i32, enter: f64) -> Self {
        let at = [0, 1, 2].map(|axis| {
            let forwards = ray.far_side[axis] != 0;
            let crossed = |k: &i32| ray.plane(axis, corner[axis].wrapping_add(edge * k)) <= enter;
            (1..N).fold(0, |behind, k| behind + i32::from(crossed(&k) == forwards))
        });
        let mut steps = Self { at, enter, far: [0.0; 3], corner, edge };
        steps.far = [0, 1, 2].map(|axis| steps.far_plane(ray, axis));
        steps
    }

    /// Where the ray leaves the box.
    #[inline]
    pub(crate) fn exit(&self) -> f64 {
        smaller(smaller(self.far[0], self.far[1]), self.far[2])
    }

    /// Goes on to the next box; `false` when the ray leaves the cube.
    #[inline]
    pub(crate) fn advance(&mut self, ray: &VolumeRay) -> bool {
        self.enter = self.exit();
        // Each axis by its own code: what is chosen by an index has to go through memory.
        if self.far[0] == self.enter {
            self.cross::<0>(ray)
        } else if self.far[1] == self.enter {
            self.cross::<1>(ray)
        } else {
            self.cross::<2>(ray)
        }
    }

    #[inline(always)]
    fn cross<const AXIS: usize>(&mut self, ray: &VolumeRay) -> bool {
        self.at[AXIS] += 2 * ray.far_side[AXIS] - 1;
        self.far[AXIS] = self.far_plane(ray, AXIS);
        (0..N).contains(&self.at[AXIS])
    }

    /// Lowest corner of the box.
    #[inline]
    pub(crate) fn corner(&self) -> [i32; 3] {
        [0, 1, 2].map(|axis| self.corner[axis].wrapping_add(self.at[axis] * self.edge))
    }

    #[inline(always)]
    fn far_plane(&self, ray: &VolumeRay, axis: usize) -> f64 {
        let k = self.at[axis] + ray.far_side[axis];
        ray.plane(axis, self.corner[axis].wrapping_add(k * self.edge))
    }
}

#[inline]
pub(crate) fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline]
pub(crate) fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Brings a number into `0..=1`; NaN becomes 0.
#[inline]
fn clamp(value: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < 1.0 { value } else { 1.0 }
}

/// What a direction of zero is taken as where it is divided by: a plane is then either far away, or at 0 where the
/// ray lies in it.
pub(crate) const TINY: f64 = 1.0e-200;

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: [f64; 3], direction: [f64; 3]) -> VolumeRay {
        VolumeRay::new(origin, direction)
    }

    /// All cells of a cube of 28 that the steps of cubes within cubes meet, with their intervals.
    fn nested(ray: &VolumeRay) -> std::vec::Vec<([i32; 3], f64, f64)> {
        let mut cells = std::vec::Vec::new();
        let (enter, exit) = ray.interval([0; 3], [28; 3]);
        if enter.max(0.0) >= exit {
            return cells;
        }
        let mut bricks = Steps::<4>::new(ray, [0; 3], 7, enter.max(0.0));
        loop {
            let mut steps = Steps::<7>::new(ray, bricks.corner(), 1, bricks.enter);
            while steps.enter < bricks.exit() {
                if steps.enter < steps.exit() {
                    cells.push((steps.corner(), steps.enter, steps.exit()));
                }
                if !steps.advance(ray) {
                    break;
                }
            }
            if !bricks.advance(ray) {
                return cells;
            }
        }
    }

    /// The same from each cell's own interval, sorted.
    fn defined(ray: &VolumeRay) -> std::vec::Vec<([i32; 3], f64, f64)> {
        let mut cells = std::vec::Vec::new();
        for z in 0..28 {
            for y in 0..28 {
                for x in 0..28 {
                    let (enter, exit) = ray.interval([x, y, z], [x + 1, y + 1, z + 1]);
                    if enter.max(0.0) < exit {
                        cells.push(([x, y, z], enter.max(0.0), exit));
                    }
                }
            }
        }
        cells.sort_by(|a, b| a.1.total_cmp(&b.1));
        cells
    }

    #[test]
    fn steps_meet_exactly_the_cells_whose_own_interval_is_not_empty() {
        let rays = [
            ray([-5.0, 3.2, 4.1], [1.0, 0.3, 0.2]),
            ray([30.0, 27.9, 20.3], [-1.0, -0.7, -0.01]),
            ray([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]),
            ray([-1.0, 7.0, 14.0], [1.0, 0.0, 0.0]),
            ray([-1.0, 7.0, 14.0], [1.0, -0.0, -0.0]),
            ray([29.0, 29.0, 14.0], [-1.0, -1.0, 0.0]),
            ray([13.7, 6.2, 21.0], [0.1, 1.0, -0.4]),
            ray([14.0, 14.0, 14.0], [-1.0, 0.5, 0.25]),
            ray([1.0e9, 3.0e8, 1.3], [-1.0e9, -3.0e8, 1.0]),
        ];
        for ray in rays {
            let (nested, defined) = (nested(&ray), defined(&ray));
            assert!(!defined.is_empty(), "{ray:?}");
            assert_eq!(nested, defined, "{ray:?}");
            for pair in nested.windows(2) {
                assert_eq!(pair[0].2, pair[1].1, "no gap: {ray:?}");
            }
        }
    }

    #[test]
    fn on_a_shared_face_both_cells_see_the_same_place() {
        let ray = ray([-3.1, 2.7, 9.9], [1.0, 0.37, -0.21]);
        for pair in nested(&ray).windows(2) {
            let (a, b) = (ray.place(pair[0].2, pair[0].0), ray.place(pair[1].1, pair[1].0));
            for axis in 0..3 {
                let moved = pair[1].0[axis] - pair[0].0[axis];
                match moved {
                    0 => assert_eq!(a[axis].to_bits(), b[axis].to_bits()),
                    1 => assert_eq!((a[axis], b[axis]), (1.0, 0.0)),
                    _ => assert_eq!((a[axis], b[axis]), (0.0, 1.0)),
                }
            }
        }
    }
}
