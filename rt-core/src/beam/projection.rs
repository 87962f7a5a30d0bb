//! Where points lie as seen from one point: the eye, or the light.

use glam::{DVec3, Vec3};

use crate::camera::Camera;
use crate::simd::{Simd, each};
use crate::tile::Tile;

/// Projects points of the grid onto a plane, in *units*: pixels of a tile, or bins of its shadow samples.
///
/// A point `p` lies at `(v.x / v.z, v.y / v.z)`, `v = p - eye` in terms of the rows. What is decided from it
/// is uncertain by `delta`.
///
/// # How large `delta` must be
/// Let `e = 2^-24`, and take lengths as seen from the eye, over the depth `v.z`. The Euclidean length of a row
/// is at most `k`, that of `v` at most `slant`.
/// 1. `p - eye`, the rounded rows, and the sum of three products: `5 e k slant`. The depth does the same to
///    a coordinate `s`: `5 e |s| slant`; the division and the product: `2 e |s|`.
/// 2. The rays that decide have rounded directions of their own: off by `4 e slant`, so `4 e k slant`.
/// 3. They shear corners: `4 e |v|` on two axes, so `6 e k slant`.
/// 4. Shadow samples are projected too, as in 1: `5 e k slant`.
///
/// Together `20 e k slant` and `7 e |s| slant`; taken are `28` and `16`.
///
/// # Inverse depths
/// The depth is off by `5 e slant`, its inverse by `e` more, and six operations between corners by `6 e`. What it is
/// compared with is a ray's parameter, off by `9 e slant + 4 e`, or the inverse depth of a sample, off by `5 e slant +
/// e`. Together `14 e slant + 11 e`; taken are `18` and `14`. What uncertain edges do comes on top, see
/// [`edges`](super::edges).
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    pub(super) eye: Vec3,
    pub(super) rows: [Vec3; 3],
    /// Lengths of the rows, or a little more.
    pub(super) lengths: [f32; 3],
    /// What is looked at lies between 0 and this.
    pub(super) end: [f32; 2],
    /// Uncertainty of coordinates within ±[`NEAR`].
    pub(super) delta: f32,
    /// Uncertainty of coordinates within ±`wide`.
    pub(super) delta_wide: f32,
    /// Points farther out are not projected.
    pub(super) wide: f32,
    /// Relative uncertainty of inverse depths.
    pub(super) depth_epsilon: f32,
}

/// Points of sixteen lanes, projected.
#[derive(Clone, Copy)]
pub(super) struct Projected<F> {
    pub(super) x: F,
    pub(super) y: F,
    /// One over the depth.
    pub(super) w: F,
}

impl Projection {
    /// The pixels of a tile, the first at `(0, 0)`. `None` when the camera is not one that a beam can follow:
    /// askew, wider than 120 degrees, or without width.
    pub(super) fn of_tile(camera: &Camera, eye: Vec3, tile: Tile) -> Option<Self> {
        let [right, up, forward] = [camera.right, camera.up, camera.forward].map(Vec3::as_dvec3);
        let determinant = right.dot(up.cross(forward));
        // Nearly a rotation, or a reflection.
        let is_sane = [right, up, forward].iter().all(|axis| (0.8..1.25).contains(&axis.length_squared()))
            && determinant.abs() > 0.8;
        if !is_sane {
            return None;
        }
        let per_determinant = 1.0 / determinant;
        let inverse = |a: DVec3, b: DVec3| a.cross(b) * per_determinant;
        let depth = inverse(right, up);
        let row = |across: DVec3, first: f32, step: f32, at: u32| {
            let (first, per_step) = (f64::from(first), 1.0 / f64::from(step));
            across * per_step - depth * (first * per_step + f64::from(at))
        };
        let x = row(inverse(up, forward), camera.x_first, camera.x_step, tile.x);
        let y = row(inverse(forward, right), camera.y_first, camera.y_step, tile.y);
        let corners = [(0, 0), (tile.width, 0), (0, tile.height), (tile.width, tile.height)];
        let slant = corners.iter().fold(0.0_f32, |slant, (x, y)| {
            let direction = camera.direction(camera.row(tile.y + y), tile.x + x);
            slant.max(direction.as_dvec3().length() as f32)
        });
        let unit = camera.x_step.abs().max(camera.y_step.abs());
        let end = [tile.width, tile.height].map(|length| length as f32 - 1.0);
        Self::new(eye, [x, y, depth].map(DVec3::as_vec3), end, unit, slant)
    }

    /// A projection by these rows of what lies between 0 and `end`. `unit` is the length of the longer unit at depth 1, `slant` the greatest
    /// length of a vector to what is looked at, over its depth. `None` when numbers are out of range.
    pub(super) fn new(eye: Vec3, rows: [Vec3; 3], end: [f32; 2], unit: f32, slant: f32) -> Option<Self> {
        let long = rows[0].as_dvec3().length().max(rows[1].as_dvec3().length()) as f32;
        // Comparisons are written so that a NaN anywhere fails them.
        let usable = unit > 1.0e-6 && unit < 1.0 && slant > 0.0 && slant < SLANT_MAX && long < LONG_MAX;
        if !usable || !eye.is_finite() {
            return None;
        }
        let wide = (8.0 / unit).min(4096.0);
        let delta = |reach: f32| {
            // `1.5` for axes that are not quite at right angles.
            let slant = slant + reach * unit * 1.5;
            EPSILON * slant * (28.0 * long + 16.0 * reach)
        };
        let lengths = rows.map(|row| row.as_dvec3().length() as f32 * (1.0 + 1.0 / 1_048_576.0));
        let depth_epsilon = EPSILON * (18.0 * (slant + NEAR * unit * 1.5) + 14.0);
        Some(Self {
            eye,
            rows,
            lengths,
            end,
            delta: delta(NEAR),
            delta_wide: delta(wide),
            wide,
            depth_epsilon,
        })
    }

    /// About the direction from the eye through the middle of what is looked at.
    pub(super) fn middle(&self) -> Vec3 {
        let [x, y, depth] = self.rows;
        let [across, down] = self.end.map(|end| end * 0.5);
        let along = (x - depth * across).cross(y - depth * down);
        if along.dot(depth) < 0.0 { -along } else { along }
    }

    /// Projects sixteen points.
    #[inline(always)]
    pub(super) fn project<S: Simd>(&self, s: S, point: [S::F; 3]) -> Projected<S::F> {
        let eye = s.splat3(self.eye);
        let v = [s.sub(point[0], eye[0]), s.sub(point[1], eye[1]), s.sub(point[2], eye[2])];
        let [x, y, z] = each!(3: self.rows, row => s.dot(v, s.splat3(row)));
        let w = s.div(s.splat(1.0), z);
        Projected { x: s.mul(x, w), y: s.mul(y, w), w }
    }
}

/// Coordinates within this are as exact as they get.
pub(super) const NEAR: f32 = 64.0;

/// 2^-24.
const EPSILON: f32 = 1.0 / 16_777_216.0;

/// Beams wider than this, as a length over a depth, are traced by rays.
const SLANT_MAX: f32 = 2.0;

/// Longest row: finer units are no longer told apart.
const LONG_MAX: f32 = 65_536.0;
