//! Sorts primitives along the Morton curve, and finds out down to which level a cell can hold them.

use rayon::prelude::*;
use rt_core::grid::GridShape;
use rt_core::surface::Surface;
use xxhash_rust::xxh3::xxh3_64;

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
///
/// Collapsed ones sort last and are cut off: so the entries are laid down once, in place.
pub(super) fn sorted(model: &Model, grid: &GridShape) -> Vec<Entry> {
    let curve = Curve::new(grid);
    let entry = |id: u32| match model.surface(id) {
        surface if is_collapsed(&surface) => Entry { key: COLLAPSED, id },
        surface => curve.entry(&surface, id),
    };
    let mut entries: Vec<Entry> = ids(model).map(entry).collect();
    entries.par_sort_unstable();
    entries.truncate(entries.partition_point(|entry| entry.key < COLLAPSED));
    entries
}

/// Drops every triangle that has the same corners, in the same order, as an earlier one of the mesh, and every
/// sphere that equals an earlier one; returns how many.
///
/// A ray would hit both at the same `t`, and the earlier one wins ties, so the later one could never be seen.
/// Works in place: where all triangles are equal, a copy of their corners would be larger than the mesh.
pub(super) fn drop_repeated(model: &Model, entries: &mut Vec<Entry>) -> u64 {
    let before = entries.len();
    for group in entries.chunk_by_mut(|a, b| a.key == b.key).filter(|group| group.len() > 1) {
        mark_repeated(model, group);
    }
    entries.retain(|entry| entry.key != REPEATED);
    (before - entries.len()) as u64
}

/// Gives every entry of a group of equal keys that repeats an earlier primitive the key [`REPEATED`].
fn mark_repeated(model: &Model, group: &mut [Entry]) {
    let bits_of = |entry: &Entry| bits(&model.surface(entry.id));
    let key = group[0].key;
    // Sort by a hash first: corners are far away in memory.
    group.iter_mut().for_each(|entry| entry.key = xxh3_64(bytemuck::bytes_of(&bits_of(entry))));
    group.sort_unstable();
    for suspects in group.chunk_by_mut(|a, b| a.key == b.key) {
        suspects.sort_unstable_by_key(|entry| (bits_of(entry), entry.id));
        let mut last = None;
        for entry in suspects {
            let bits = Some(bits_of(entry));
            entry.key = if bits == last { REPEATED } else { key };
            last = bits;
        }
    }
    group.sort_unstable_by_key(|entry| entry.id);
}

/// The grid's cells along the Morton curve, in `f64`: sums of coordinates and cell edges are exact there.
pub(super) struct Curve {
    origin: [f64; 3],
    /// Edge of a finest cell.
    finest: f64,
    slack: f64,
    levels: u32,
}

impl Curve {
    pub(super) fn new(grid: &GridShape) -> Self {
        Self {
            origin: grid.origin.to_array().map(f64::from),
            finest: f64::from(grid.size) / f64::from(1_u32 << (2 * grid.levels)),
            slack: f64::from(grid.slack),
            levels: grid.levels,
        }
    }

    /// Index of the finest cell that holds the surface's middle: three bits for each halving of the grid.
    pub(super) fn code(&self, surface: &Surface) -> u64 {
        self.entry(surface, 0).key >> DEPTH_BITS
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

/// The key of a collapsed primitive; no depth is that large.
const COLLAPSED: u64 = u64::MAX;

/// The key of a primitive that repeats an earlier one; no depth is that large.
const REPEATED: u64 = u64::MAX;

/// Bits of a key that hold the depth; six for each of ten levels are left.
const DEPTH_BITS: u32 = 4;
