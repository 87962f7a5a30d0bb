//! Chooses a slack with which no part of the scene is crowded.

use core::iter;

use rayon::prelude::*;
use rt_core::grid::GridShape;

use super::keys::Curve;
use super::prepare::ids;
use super::surfaces::{extent, is_collapsed};
use crate::model::Model;

/// The largest slack, `wanted` or smaller by powers of 4, with which hardly a triangle or sphere lies in a crowd; or
/// `wanted` when there is none.
///
/// The slack pads the cells of all levels alike, so none is narrower than twice the slack. Typical edges of a
/// scene of one scale make that a few triangles. But a statue of small triangles in a landscape of large ones
/// would lie in few cells, thousands of triangles each. With less slack its cells are narrower; the price is
/// copies of the large triangles. (0.1 million triangles in a metre amid 2 million in a kilometre: 159 us a ray
/// before, 4 us so.)
pub(super) fn uncrowded(model: &Model, grid: &GridShape, wanted: f32) -> f32 {
    let sample = Sample::new(model, grid);
    let slacks = iter::successors(Some(wanted), |slack| Some(slack * 0.25));
    let mut useful = slacks.take_while(|&slack| slack >= grid.size * SLACK_MIN);
    useful.find(|slack| sample.crowded_share(grid, slack * 2.0) <= CROWDED_SHARE).unwrap_or(wanted)
}

/// Some triangles and spheres, evenly from the order of the model.
struct Sample {
    /// For each, the place of its middle along the Morton curve and its extent; sorted by place.
    primitives: Vec<(u64, f64)>,
    /// How many primitives each stands for.
    primitives_each: usize,
}

impl Sample {
    fn new(model: &Model, grid: &GridShape) -> Self {
        let curve = Curve::new(grid);
        let primitives_each = model.count().div_ceil(SAMPLES).max(1);
        let sampled = ids(model).step_by(primitives_each).map(|id| model.surface(id));
        let kept = sampled.filter(|surface| !is_collapsed(surface));
        let mut primitives: Vec<(u64, f64)> = kept
            .map(|surface| {
                let (low, high) = extent(&surface);
                let widest = (0..3).fold(0.0, |widest: f64, axis| widest.max(high[axis] - low[axis]));
                (curve.code(&surface), widest)
            })
            .collect();
        primitives.par_sort_unstable_by_key(|&(code, _)| code);
        Self { primitives, primitives_each }
    }

    /// Share of the primitives that lie in a crowd when cells are at least `edge` wide.
    ///
    /// Only those count that narrower cells would tell apart: those far smaller than the cell.
    fn crowded_share(&self, grid: &GridShape, edge: f32) -> f32 {
        let shift = 3 * (2 * grid.levels - halvings_down_to(grid, edge));
        let is_small = |&&(_, extent): &&(u64, f64)| extent <= f64::from(edge) * 0.25;
        let cells = self.primitives.chunk_by(|a, b| a.0 >> shift == b.0 >> shift);
        let is_crowd = |samples: &usize| *samples >= SAMPLES_MIN && samples * self.primitives_each > CROWD;
        let crowded: usize = cells.map(|cell| cell.iter().filter(is_small).count()).filter(is_crowd).sum();
        crowded as f32 / self.primitives.len().max(1) as f32
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

/// So many primitives in one cell are a crowd: some thirty clusters, which a ray tests in turn.
const CROWD: usize = 1024;

/// Share of the primitives that may lie in crowds.
const CROWDED_SHARE: f32 = 1.0 / 256.0;

/// Triangles and spheres that are looked at, or up to half as many.
const SAMPLES: usize = 1 << 13;

/// Fewer samples than this in one cell may be chance.
const SAMPLES_MIN: usize = 8;

/// Smallest slack that is tried, as a share of the grid: an eighth of what [`rt_core::walk`] allows for
/// rounding. Cells that are much narrower are not told apart by rays.
const SLACK_MIN: f32 = 1.0 / 2_097_152.0;
