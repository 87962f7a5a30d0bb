//! What a beam may enter: cells of a branch.
//!
//! Everything here culls, and errs towards entering.

use glam::Vec3;

use super::projection::Projection;
use crate::grid::{Branch, FLIP_AXIS, GridShape, cell_coordinates};
use crate::simd::{LANES, Simd, each};

/// The pyramid of a beam.
///
/// A plane through the eye is a normal `n`; a point is inside when `n . (p - eye) >= 0`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frustum {
    eye: Vec3,
    depth: Vec3,
    /// Normals of the left, right, upper and lower border.
    borders: [Vec3; 4],
    /// For the four borders and for the depth: how far inside (in front) the nearest corner of each cell of a branch lies
    /// from the branch's lowest corner, in cells.
    patterns: [[[f32; LANES]; 4]; 5],
    /// Padding of cells.
    pub(super) cell_pad: f32,
    /// Padding of boxes: what their coordinates are off by.
    pub(super) box_pad: f32,
    /// Axes along which the beam runs backwards, as bits of a cell index.
    pub(super) flip: u32,
}

impl Frustum {
    /// The pyramid of a projection; `None` when its eye is so far from the grid that little could be culled.
    #[inline(always)]
    pub(super) fn new<S: Simd>(s: S, projection: &Projection, grid: &GridShape) -> Option<Self> {
        let [x, y, depth] = projection.rows;
        let [right, bottom] = projection.end;
        let margin = projection.delta * 4.0 + 0.02;
        let borders = [
            x + depth * margin,
            depth * (margin + right) - x,
            y + depth * margin,
            depth * (margin + bottom) - y,
        ];
        let eye = projection.eye;
        let reach = ((eye - grid.origin).abs() + grid.size).max_element();
        if reach > grid.size * REACH_MAX {
            return None;
        }
        let allowance = reach * (1.0 / 65_536.0);
        // Along the tile's own middle, which may go the other way than the camera's axis where that is about level.
        let along = projection.middle();
        let negative = |axis: usize| if along[axis] < 0.0 { FLIP_AXIS[axis] } else { 0 };
        let [a, b, c, d] = borders;
        let mut patterns = [[[0.0; LANES]; 4]; 5];
        for (pattern, (n, sign)) in
            patterns.iter_mut().zip([(a, 1.0), (b, 1.0), (c, 1.0), (d, 1.0), (depth, -1.0)])
        {
            *pattern = corners_of_cells(s, n, sign);
        }
        Some(Self {
            eye,
            depth,
            borders,
            patterns,
            cell_pad: grid.slack + allowance,
            box_pad: allowance,
            flip: negative(0) | negative(1) | negative(2),
        })
    }

    /// The cells of a branch that the beam enters at no more than `farthest` deep, in Morton order.
    #[inline(always)]
    pub(super) fn cells_entered<S: Simd>(
        &self,
        s: S,
        branch: &Branch,
        corner: Vec3,
        cell: f32,
        farthest: f32,
    ) -> u64 {
        let from_eye = corner - self.eye;
        let per_cell = 1.0 / cell;
        let borders = each!(4: self.borders, n => {
            s.splat((n.dot(from_eye) + self.cell_pad * n.abs().element_sum()) * -per_cell)
        });
        let deep = farthest - self.depth.dot(from_eye) + self.cell_pad * self.depth.abs().element_sum();
        let deep = s.splat(deep * per_cell);
        let mut entered = 0;
        for quarter in 0..4 {
            let mut mask = s.le(s.load(&self.patterns[4][quarter]), deep);
            for (border, pattern) in borders.iter().zip(&self.patterns) {
                mask &= s.le(*border, s.load(&pattern[quarter]));
            }
            entered |= u64::from(mask) << (LANES * quarter);
        }
        entered & branch.occupied
    }
}

/// Farthest eye, in sizes of the grid.
const REACH_MAX: f32 = 4096.0;

/// For each cell of a branch, `n` at its corner farthest along `sign * n`.
#[inline(always)]
fn corners_of_cells<S: Simd>(s: S, n: Vec3, sign: f32) -> [[f32; LANES]; 4] {
    let far = n * sign;
    let reach = (far.max(Vec3::ZERO)).element_sum() * sign;
    let mut pattern = [[0.0; LANES]; 4];
    for (quarter, lanes) in pattern.iter_mut().enumerate() {
        let value = s.dot(each!(3: [0, 1, 2], axis => s.load(&CELLS[axis][quarter])), s.splat3(n));
        s.store(s.add(value, s.splat(reach)), lanes);
    }
    pattern
}

/// Coordinates of the 64 cells, by axis.
pub(super) const CELLS: [[[f32; LANES]; 4]; 3] = {
    let mut cells = [[[0.0; LANES]; 4]; 3];
    let mut cell = 0;
    while cell < 64 {
        let at = cell_coordinates(cell as u32);
        let mut axis = 0;
        while axis < 3 {
            cells[axis][cell / LANES][cell % LANES] = at[axis] as f32;
            axis += 1;
        }
        cell += 1;
    }
    cells
};
