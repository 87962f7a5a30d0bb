//! What a beam may enter: cells of a branch, boxes of leaves.
//!
//! Everything here culls, and errs towards entering.

use glam::Vec3;

use super::projection::Projection;
use crate::grid::{BoxFrame, Branch, FLIP_AXIS, GridShape, cell_coordinates};
use crate::simd::{LANES, Mask, Simd, each};

/// The pyramid of a beam, cut into 4x4 *blocks*.
///
/// A plane through the eye is a normal `n`; a point is inside when `n . (p - eye) >= 0`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frustum {
    eye: Vec3,
    depth: Vec3,
    /// Normals of the left borders of the columns, their right borders, the upper borders of the rows, their lower
    /// borders; by component.
    borders: [[f32; LANES]; 3],
    /// For the four outermost borders and for the depth: how far inside (in front) the nearest corner of each cell of
    /// a branch lies from the branch's lowest corner, in cells.
    patterns: [[[f32; LANES]; 4]; 5],
    outer: [Vec3; 4],
    /// Padding of cells, and of boxes.
    cell_pad: f32,
    box_pad: f32,
    /// Axes along which the beam runs backwards, as bits of a cell index.
    pub(super) flip: u32,
}

/// First and last coordinate of each column, or row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Borders {
    pub(super) first: [f32; 4],
    pub(super) last: [f32; 4],
}

/// What blocks of a beam still wait for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Depths {
    /// For each block, row by row: what has a smaller inverse depth does not matter.
    pub(super) blocks: [f32; LANES],
    /// The least of these.
    pub(super) least: f32,
    /// What is deeper matters to no block; below 0 when nothing matters any more.
    pub(super) farthest: f32,
}

/// Where a box may show.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Blocks that it may reach into, one bit each.
    pub(super) blocks: Mask,
    /// Depth at which it begins.
    pub(super) nearest: f32,
}

impl Depths {
    /// The blocks to which something as near as this may matter.
    #[inline(always)]
    pub(super) fn waiting<S: Simd>(&self, s: S, nearest: f32) -> Mask {
        let blocks = s.load(&self.blocks);
        let waiting = s.lt(blocks, s.splat(f32::INFINITY));
        if nearest <= 0.0 {
            waiting
        } else {
            s.lt(s.mul(blocks, s.splat(nearest)), s.splat(1.0 + CULLING_EPSILON)) & waiting
        }
    }

    pub(super) fn new(blocks: [f32; LANES]) -> Self {
        let mut depths = Self { blocks, least: 0.0, farthest: 0.0 };
        depths.refresh();
        depths
    }

    /// Finds the farthest depth anew.
    pub(super) fn refresh(&mut self) {
        self.least =
            self.blocks.iter().fold(f32::INFINITY, |least, &block| if block < least { block } else { least });
        self.farthest = if self.least == f32::INFINITY { -1.0 } else { (1.0 + CULLING_EPSILON) / self.least };
    }
}

impl Frustum {
    /// The pyramid of a projection; `None` when its eye is so far from the grid that little could be culled.
    #[inline(always)]
    pub(super) fn new<S: Simd>(
        s: S,
        projection: &Projection,
        columns: &Borders,
        rows: &Borders,
        grid: &GridShape,
    ) -> Option<Self> {
        let [x, y, depth] = projection.rows;
        let margin = projection.delta * 4.0 + 0.02;
        let mut borders = [[0.0; LANES]; 3];
        let mut outer = [Vec3::ZERO; 4];
        for (side, (row, edges, sign)) in
            [(x, columns.first, 1.0), (x, columns.last, -1.0), (y, rows.first, 1.0), (y, rows.last, -1.0)]
                .into_iter()
                .enumerate()
        {
            for (at, edge) in edges.into_iter().enumerate() {
                let normal = row * sign + depth * (margin - sign * edge);
                for axis in 0..3 {
                    borders[axis][side * 4 + at] = normal[axis];
                }
                let is_outermost = at == if sign > 0.0 { 0 } else { 3 };
                if is_outermost {
                    outer[side] = normal;
                }
            }
        }
        let eye = projection.eye;
        let reach = ((eye - grid.origin).abs() + grid.size).max_element();
        if reach > grid.size * REACH_MAX {
            return None;
        }
        let allowance = reach * (1.0 / 65_536.0);
        let negative = |axis: usize| if depth[axis] < 0.0 { FLIP_AXIS[axis] } else { 0 };
        let [a, b, c, d] = outer;
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
            outer,
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
        let borders = each!(4: self.outer, n => {
            s.splat((n.dot(from_eye) + self.cell_pad * n.abs().element_sum()) * -per_cell)
        });
        let deep = farthest - self.depth.dot(from_eye) + self.cell_pad * self.depth.abs().element_sum();
        let deep = s.splat(deep * per_cell);
        let mut entered = 0;
        for quarter in 0..4 {
            let load = |plane: usize| s.load(&self.patterns[plane][quarter]);
            let mask = s.le(borders[0], load(0))
                & s.le(borders[1], load(1))
                & s.le(borders[2], load(2))
                & s.le(borders[3], load(3))
                & s.le(load(4), deep);
            entered |= u64::from(mask) << (LANES * quarter);
        }
        entered & branch.occupied
    }

    /// Whether a cell begins deeper than `farthest`.
    #[inline(always)]
    pub(super) fn is_hidden(&self, corner: Vec3, cell: f32, farthest: f32) -> bool {
        let nearest = corner - self.cell_pad
            + Vec3::select(self.depth.cmplt(Vec3::ZERO), Vec3::splat(cell + 2.0 * self.cell_pad), Vec3::ZERO);
        self.depth.dot(nearest - self.eye) > farthest
    }

    /// Where a leaf's box may show.
    #[inline(always)]
    pub(super) fn box_entered<S: Simd>(&self, s: S, corner: Vec3, frame: &BoxFrame, bounds: [u8; 6]) -> Seen {
        let (low, high) = frame.decode(bounds);
        let half = (high - low) * 0.5;
        let centre = corner + (low + half) - self.eye;
        let half = half + self.box_pad;
        let centre_lanes = s.splat3(centre);
        let half_lanes = s.splat3(half);
        let borders = [s.load(&self.borders[0]), s.load(&self.borders[1]), s.load(&self.borders[2])];
        let inside = s
            .add(s.dot(borders, centre_lanes), s.dot(each!(3: borders, border => s.abs(border)), half_lanes));
        let inside = u32::from(s.le(s.splat(0.0), inside));
        let columns = inside & inside >> 4 & 0xf;
        let rows = inside >> 8 & inside >> 12 & 0xf;
        let rows = rows & 1 | (rows & 2) << 3 | (rows & 4) << 6 | (rows & 8) << 9;
        let nearest = self.depth.dot(centre) - self.depth.abs().dot(half);
        Seen { blocks: (rows * columns) as Mask, nearest }
    }
}

/// More than the relative error of any depth.
const CULLING_EPSILON: f32 = 1.0 / 65_536.0;

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
const CELLS: [[[f32; LANES]; 4]; 3] = {
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
