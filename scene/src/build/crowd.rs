//! Chooses a slack with which no part of the scene is crowded.

use core::iter;

use rayon::prelude::*;
use rt_core::grid::GridShape;

use super::keys::Curve;
use super::prepare::{corners, is_collapsed};
use crate::mesh::Mesh;

/// The largest slack, `wanted` or smaller by powers of 4, with which hardly a triangle lies in a crowd; or
/// `wanted` when there is none.
///
/// The slack pads the cells of all levels alike, so none is narrower than twice the slack. Typical edges of a
/// scene of one scale make that a few triangles. But a statue of small triangles in a landscape of large ones
/// would lie in few cells, thousands of triangles each. With less slack its cells are narrower; the price is
/// copies of the large triangles. (0.1 million triangles in a metre amid 2 million in a kilometre: 159 us a ray
/// before, 4 us so.)
pub(super) fn uncrowded(mesh: &Mesh, grid: &GridShape, wanted: f32) -> f32 {
    let sample = Sample::new(mesh, grid);
    let slacks = iter::successors(Some(wanted), |slack| Some(slack * 0.25));
    let mut useful = slacks.take_while(|&slack| slack >= grid.size * SLACK_MIN);
    useful.find(|slack| sample.crowded_share(grid, slack * 2.0) <= CROWDED_SHARE).unwrap_or(wanted)
}

/// Some triangles, evenly from the order of the mesh.
struct Sample {
    /// For each, the place of its middle along the Morton curve and its extent; sorted by place.
    triangles: Vec<(u64, f32)>,
    /// How many triangles each stands for.
    triangles_each: usize,
}

impl Sample {
    fn new(mesh: &Mesh, grid: &GridShape) -> Self {
        let curve = Curve::new(grid);
        let triangles_each = mesh.triangles.len().div_ceil(SAMPLES).max(1);
        let sampled = mesh.triangles.par_iter().step_by(triangles_each);
        let kept = sampled.filter(|&&triangle| !is_collapsed(mesh, triangle));
        let mut triangles: Vec<(u64, f32)> = kept
            .map(|&triangle| {
                let [a, b, c] = corners(mesh, triangle);
                (curve.code([a, b, c]), (a.max(b).max(c) - a.min(b).min(c)).max_element())
            })
            .collect();
        triangles.par_sort_unstable_by_key(|&(code, _)| code);
        Self { triangles, triangles_each }
    }

    /// Share of the triangles that lie in a crowd when cells are at least `edge` wide.
    ///
    /// Only triangles that narrower cells would tell apart count: those far smaller than the cell.
    fn crowded_share(&self, grid: &GridShape, edge: f32) -> f32 {
        let shift = 3 * (2 * grid.levels - halvings_down_to(grid, edge));
        let is_small = |&&(_, extent): &&(u64, f32)| extent <= edge * 0.25;
        let cells = self.triangles.chunk_by(|a, b| a.0 >> shift == b.0 >> shift);
        let is_crowd = |samples: &usize| *samples >= SAMPLES_MIN && samples * self.triangles_each > CROWD;
        let crowded: usize = cells.map(|cell| cell.iter().filter(is_small).count()).filter(is_crowd).sum();
        crowded as f32 / self.triangles.len().max(1) as f32
    }
}

/// How often the grid can be halved until a cell would be narrower than `edge`.
fn halvings_down_to(grid: &GridShape, edge: f32) -> u32 {
    let mut halvings = 0;
    let mut cell = grid.size * 0.5;
    while halvings < 2 * grid.levels && cell >= edge {
        halvings += 1;
        cell *= 0.5;
    }
    halvings
}

/// So many triangles in one cell are a crowd: some thirty clusters, which a ray tests in turn.
const CROWD: usize = 1024;

/// Share of the triangles that may lie in crowds.
const CROWDED_SHARE: f32 = 1.0 / 256.0;

/// Triangles that are looked at, or up to half as many.
const SAMPLES: usize = 1 << 13;

/// Fewer samples than this in one cell may be chance.
const SAMPLES_MIN: usize = 8;

/// Smallest slack that is tried, as a share of the grid: an eighth of what [`rt_core::walk`] allows for
/// rounding. Cells that are much narrower are not told apart by rays.
const SLACK_MIN: f32 = 1.0 / 2_097_152.0;
