//! Sorts primitives along the Morton curve, and finds out down to which level a cell can hold them.

use rayon::prelude::*;
use rt_core::grid::GridShape;
use rt_core::surface::Surface;

use super::prepare::ids;
use super::surfaces::{bits, extent, is_collapsed};
use crate::model::Model;

/// A primitive on its place along the Morton curve.
///
/// # Invariants
/// Sorted by `key`, then `id`, so that equal triangles keep the order they have in the mesh, and spheres come after
/// triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry {
    /// Six bits per level, coarsest first: the index of the cell that holds the primitive's middle. Then
    /// [`DEPTH_BITS`] bits: the deepest level on which the padded cell holds all of it; 0 is the
    /// root.
    key: u64,
    /// Number in the model.
    pub(super) id: u32,
}

impl Entry {
    /// Index of the primitive's cell on `level` (1 below the root), of `levels`.
    #[inline]
    pub(super) const fn cell(&self, level: u32, levels: u32) -> u32 {
        (self.key >> (DEPTH_BITS + 6 * (levels - level)) & 63) as u32
    }

    /// The deepest level on which the primitive is resident.
    #[inline]
    pub(super) const fn depth(&self) -> u32 {
        (self.key & ((1 << DEPTH_BITS) - 1)) as u32
    }
}

/// All primitives of the model that are not collapsed, sorted.
pub(super) fn sorted(model: &Model, grid: &GridShape) -> Vec<Entry> {
    let curve = Curve::new(grid);
    let numbered = ids(model).map(|id| (model.surface(id), id));
    let kept = numbered.filter(|(surface, _)| !is_collapsed(surface));
    let mut entries: Vec<Entry> = kept.map(|(surface, id)| curve.entry(&surface, id)).collect();
    entries.par_sort_unstable();
    entries
}

/// Drops every triangle that has the same corners, in the same order, as an earlier one of the mesh, and every
/// sphere that equals an earlier one; returns how many.
///
/// A ray would hit both at the same `t`, and the earlier one wins ties, so the later one could never be seen.
pub(super) fn drop_repeated(model: &Model, entries: &mut Vec<Entry>) -> u64 {
    let mut repeated = Vec::new();
    for group in entries.chunk_by(|a, b| a.key == b.key).filter(|group| group.len() > 1) {
        let mut sorted: Vec<_> =
            group.iter().map(|entry| (bits(&model.surface(entry.id)), entry.id)).collect();
        sorted.sort_unstable();
        repeated.extend(sorted.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1));
    }
    repeated.sort_unstable();
    if !repeated.is_empty() {
        entries.retain(|entry| repeated.binary_search(&entry.id).is_err());
    }
    repeated.len() as u64
}

/// The grid's cells along the Morton curve, in `f64`: sums of coordinates and cell edges are exact there.
struct Curve {
    origin: [f64; 3],
    /// Edge of a finest cell.
    finest: f64,
    slack: f64,
    levels: u32,
}

impl Curve {
    fn new(grid: &GridShape) -> Self {
        Self {
            origin: grid.origin.to_array().map(f64::from),
            finest: f64::from(grid.size) / f64::from(1_u32 << (2 * grid.levels)),
            slack: f64::from(grid.slack),
            levels: grid.levels,
        }
    }

    fn entry(&self, surface: &Surface, id: u32) -> Entry {
        let (low, high) = extent(surface);
        let mut code = 0;
        let mut depth = self.levels;
        for axis in 0..3 {
            let (low, high) = (low[axis] - self.origin[axis], high[axis] - self.origin[axis]);
            let cell = self.finest_cell((low + high) * 0.5);
            code |= spread(cell) << axis;
            while depth > 0 && !self.holds(cell, depth, low, high) {
                depth -= 1;
            }
        }
        Entry { key: code << DEPTH_BITS | u64::from(depth), id }
    }

    fn finest_cell(&self, position: f64) -> u32 {
        let last = (1_u32 << (2 * self.levels)) - 1;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast of a float saturates, as wanted"
        )]
        let cell = (position / self.finest) as u32;
        cell.min(last)
    }

    /// Whether the padded cell on `level` above the finest cell `cell` holds `low..=high`, on one axis.
    fn holds(&self, cell: u32, level: u32, low: f64, high: f64) -> bool {
        let above = 2 * (self.levels - level);
        let edge = self.finest * f64::from(1_u32 << above);
        let start = f64::from(cell >> above) * edge;
        start - self.slack <= low && high <= start + edge + self.slack
    }
}

/// Spreads the low 21 bits of `value` to every third bit.
const fn spread(value: u32) -> u64 {
    let mut bits = value as u64 & 0x1f_ffff;
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// Bits of a key that hold the depth; six for each of ten levels are left.
const DEPTH_BITS: u32 = 4;
