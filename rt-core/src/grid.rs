//! The multi-level grid: branches with 4x4x4 children, and leaves that name clusters of triangles or spheres.
//!
//! A *branch* is a cube cut into 64 *cells*. A cell is empty, or an *inner* cell (again a branch), or belongs
//! to a *run*: consecutive cells, in Morton order with inner cells skipped, that share one leaf. Nothing
//! stores the place of a branch; it follows from the way down. A cell of the grid has level 1 below the root,
//! and its edge is `size / 4^level`.
//!
//! # Morton order
//! The index of a cell has the bits `x0 y0 z0 x1 y1 z1`, lowest first, of its coordinates in `0..4`. Flipping
//! both bits of an axis reverses that axis, so `index ^ flip` is front to back for a ray whose negative axes
//! are in `flip`.
//!
//! # Bounded slack
//! A triangle is stored in every cell that it overlaps by more than [`slack`](GridShape::slack); all cells
//! are taken as padded by the slack. The slack is one length for all levels, so a padded cell lies in its
//! padded parent, and the hit of a ray lies in a padded cell that holds the triangle, and in all padded cells
//! above it. A sphere is stored where its surface is: a cell inside a sphere need not know of it.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use crate::simd::Simd;

/// A cube of the grid and which of its 64 cells lead where.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Branch {
    /// Cells that hold anything, one bit each in Morton order.
    pub occupied: u64,
    /// Cells that are branches again; a subset of `occupied`.
    pub inner: u64,
    /// First cell of every run; a subset of the occupied cells that are not inner.
    pub run_start: u64,
    /// Index of the first inner cell's branch; the others follow in Morton order.
    pub child: u32,
    /// Index of the first run's leaf; the others follow in Morton order.
    pub leaf: u32,
}

impl Branch {
    /// Index of the branch in the inner cell `cell`, or `None` on overflow.
    #[inline]
    pub const fn child_of(&self, cell: u32) -> Option<u32> {
        self.child.checked_add((self.inner & below(cell)).count_ones())
    }

    /// Number of the run that `cell` belongs to, among those of the branch; `None` when none starts at or before
    /// it.
    #[inline]
    pub const fn run_of(&self, cell: u32) -> Option<u32> {
        (self.run_start << (63 - cell % 64)).count_ones().checked_sub(1)
    }

    /// Index of the leaf of the run that `cell` belongs to, or `None` when no run starts at or before it.
    #[inline]
    pub fn leaf_of(&self, cell: u32) -> Option<u32> {
        self.leaf.checked_add(self.run_of(cell)?)
    }

    /// All cells of the run that `cell` belongs to.
    #[inline]
    pub const fn cells_of_run(&self, cell: u32) -> u64 {
        let until = up_to(cell);
        let start = 63_u32.saturating_sub((self.run_start & until).leading_zeros());
        let next = self.run_start & !until;
        let end = if next == 0 { u64::MAX } else { below(next.trailing_zeros()) };
        end & !below(start) & self.occupied & !self.inner
    }
}

/// What a run of cells holds: one cluster, or a list of further leaves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Leaf {
    /// Place of the cluster in its segment, in units of 16 bytes; or [`Self::LIST`] plus the index of the
    /// list's first leaf.
    pub cluster: u32,
    /// Address-order index of the cluster's first primitive; or the number of leaves in the list.
    pub first: u32,
    /// Tight box of what is inside the run's padded cells: lowest x, y, z and highest x, y, z in [`BoxFrame`]
    /// steps.
    pub bounds: [u8; 6],
    /// Vertices of a cluster of triangles, `1..=32`; [`Self::SPHERES`] for a cluster of spheres, 0 for a list.
    pub vertices: u8,
    /// Triangles of the cluster, `1..=64`, or spheres, `1..=32`; 0 for a list.
    pub count: u8,
}

/// What a [`Leaf`] leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeafContent {
    /// One cluster of triangles.
    Cluster(ClusterRef),
    /// One cluster of spheres.
    Spheres(SpheresRef),
    /// Cells that no splitting can separate, or that hold both kinds: a list of consecutive leaves, each with
    /// a cluster and a box of its own.
    List {
        /// Index of the first leaf of the list.
        first: u32,
        /// Number of leaves.
        count: u32,
    },
}

/// Where a cluster of triangles lies and how large it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClusterRef {
    /// Offset in the cluster segment, in bytes.
    pub offset: u64,
    /// Number of vertices, `1..=32`.
    pub vertices: u8,
    /// Number of triangles, `1..=64`.
    pub triangles: u8,
    /// Address-order index of the first triangle.
    pub first: u32,
}

impl ClusterRef {
    /// No cluster.
    pub(crate) const NONE: Self = Self { offset: 0, vertices: 0, triangles: 0, first: 0 };
}

/// Where a cluster of spheres lies and how large it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpheresRef {
    /// Offset in the cluster segment, in bytes.
    pub offset: u64,
    /// Number of spheres, `1..=32`.
    pub count: u8,
    /// Address-order index of the first sphere.
    pub first: u32,
}

impl Leaf {
    /// Bit of `cluster` that makes the leaf a list.
    pub const LIST: u32 = 1 << 31;

    /// Value of `vertices` that makes the cluster one of spheres.
    pub const SPHERES: u8 = 0x80;

    /// Decodes the leaf, or `None` when its counts are impossible.
    #[inline]
    pub fn content(&self) -> Option<LeafContent> {
        if self.cluster & Self::LIST != 0 {
            return Some(LeafContent::List { first: self.cluster & !Self::LIST, count: self.first });
        }
        let offset = u64::from(self.cluster) * 16;
        let Self { first, vertices, count, .. } = *self;
        if vertices == Self::SPHERES {
            let fits = (1..=SPHERES_MAX).contains(&count);
            return fits.then_some(LeafContent::Spheres(SpheresRef { offset, count, first }));
        }
        let fits = (1..=VERTICES_MAX).contains(&vertices) && (1..=TRIANGLES_MAX).contains(&count);
        fits.then_some(LeafContent::Cluster(ClusterRef { offset, vertices, triangles: count, first }))
    }
}

/// Where the grid lies. Lengths are in grid units: world units times the image's scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridShape {
    /// Lowest corner of the root branch, a multiple of the finest cell's edge, so that every cell corner is
    /// an exact `f32`.
    pub origin: Vec3,
    /// Edge of the root branch, a power of two.
    pub size: f32,
    /// By how much every cell is taken as padded, on all levels.
    pub slack: f32,
    /// Number of levels of branches, `1..=LEVELS_MAX`.
    pub levels: u32,
}

/// The coordinates in which the leaves of a branch store their boxes: 256 steps across the branch padded by
/// the slack.
///
/// Counted from the branch's lowest corner, so that nothing is lost where the grid lies far from 0; the same
/// on all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxFrame {
    low: f32,
    step: f32,
}

impl BoxFrame {
    /// The frame of a branch whose cells have the edge `cell`.
    #[inline]
    pub const fn new(cell: f32, slack: f32) -> Self {
        // A little more than the width, so that rounding leaves nothing of it out.
        Self { low: -slack, step: (cell * 4.0 + slack * 2.0) * ((1.0 + 1.0e-6) / 256.0) }
    }

    /// Where coordinate 0 lies.
    #[inline]
    pub(crate) const fn low(&self) -> f32 {
        self.low
    }

    /// Length of a step.
    #[inline]
    pub(crate) const fn step(&self) -> f32 {
        self.step
    }

    /// Lowest and highest corner of a stored box, from the branch's corner; off by the rounding of a product
    /// and a sum.
    #[inline]
    pub fn decode(&self, bounds: [u8; 6]) -> (Vec3, Vec3) {
        let [x0, y0, z0, x1, y1, z1] = bounds.map(f32::from);
        let low = Vec3::new(x0, y0, z0) * self.step + self.low;
        let high = Vec3::new(x1 + 1.0, y1 + 1.0, z1 + 1.0) * self.step + self.low;
        (low, high)
    }

    /// As [`decode`](Self::decode), of a leaf's box; the fourth lanes are anything finite.
    #[inline(always)]
    pub(crate) fn decode_leaf<S: Simd>(&self, s: S, leaf: &Leaf) -> (Vec4, Vec4) {
        let bytes = s.array(s.to_float(s.bytes(bytemuck::bytes_of(leaf))));
        let low = Vec4::new(bytes[8], bytes[9], bytes[10], bytes[11]);
        let high = Vec4::new(bytes[11], bytes[12], bytes[13], bytes[14]) + 1.0;
        (low * self.step + self.low, high * self.step + self.low)
    }

    /// The smallest storable box that contains the part of `low..=high` inside the frame, both from the
    /// branch's corner.
    pub fn encode(&self, low: [f64; 3], high: [f64; 3]) -> [u8; 6] {
        let mut bounds = [0; 6];
        for axis in 0..3 {
            bounds[axis] = self.quantise(low[axis]);
            bounds[axis + 3] = self.quantise(high[axis]);
            while bounds[axis] > 0 && f64::from(self.decode(bounds).0[axis]) > low[axis] {
                bounds[axis] -= 1;
            }
            while bounds[axis + 3] < u8::MAX && f64::from(self.decode(bounds).1[axis]) < high[axis] {
                bounds[axis + 3] += 1;
            }
        }
        bounds
    }

    fn quantise(&self, value: f64) -> u8 {
        let steps = (value - f64::from(self.low)) / f64::from(self.step);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast of a float saturates, as wanted"
        )]
        let step = steps as u8;
        step
    }
}

/// Coordinates in `0..4` of the cell with Morton index `cell`.
#[inline]
pub const fn cell_coordinates(cell: u32) -> [u32; 3] {
    [(cell & 1) | (cell >> 2 & 2), (cell >> 1 & 1) | (cell >> 3 & 2), (cell >> 2 & 1) | (cell >> 4 & 2)]
}

/// [`cell_coordinates`] of all cells, in the first three lanes.
pub(crate) const CELL_CORNERS: [Vec4; 64] = {
    let mut corners = [Vec4::ZERO; 64];
    let mut cell = 0;
    while cell < 64 {
        let [x, y, z] = cell_coordinates(cell);
        corners[cell as usize] = Vec4::new(x as f32, y as f32, z as f32, 0.0);
        cell += 1;
    }
    corners
};

/// Morton index of the cell at coordinates in `0..4`.
#[inline]
pub const fn cell_index([x, y, z]: [u32; 3]) -> u32 {
    (x & 1) | (y & 1) << 1 | (z & 1) << 2 | (x >> 1) << 3 | (y >> 1) << 4 | (z >> 1) << 5
}

/// Moves the bit of every cell `c` to place `c ^ flip`; `flip` is made of [`FLIP_AXIS`] values.
#[inline]
pub const fn flip_cells(mut cells: u64, flip: u32) -> u64 {
    if flip & FLIP_AXIS[0] != 0 {
        cells = swap(swap(cells, 1, 0x5555_5555_5555_5555), 8, 0x00ff_00ff_00ff_00ff);
    }
    if flip & FLIP_AXIS[1] != 0 {
        cells = swap(swap(cells, 2, 0x3333_3333_3333_3333), 16, 0x0000_ffff_0000_ffff);
    }
    if flip & FLIP_AXIS[2] != 0 {
        cells = swap(cells, 4, 0x0f0f_0f0f_0f0f_0f0f).rotate_left(32);
    }
    cells
}

/// Swaps the bits under `mask` with those `distance` places above them.
const fn swap(cells: u64, distance: u32, mask: u64) -> u64 {
    (cells >> distance & mask) | (cells & mask) << distance
}

/// The bits of all cells before `cell`.
#[inline]
const fn below(cell: u32) -> u64 {
    (1 << cell) - 1
}

/// The bits of `cell` and all cells before it.
#[inline]
const fn up_to(cell: u32) -> u64 {
    u64::MAX >> (63 - cell)
}

/// For each axis, the bits of a cell index that belong to it.
pub const FLIP_AXIS: [u32; 3] = [0b001_001, 0b010_010, 0b100_100];

/// All bits of a cell index.
pub(crate) const ALL_AXES: u32 = 0b111_111;

/// Most levels a grid may have: below, a cell is smaller than the rounding allowance of
/// [`walk`](crate::walk).
pub const LEVELS_MAX: usize = 10;

/// Most vertices of a cluster.
pub const VERTICES_MAX: u8 = 32;

/// Most triangles of a cluster.
pub const TRIANGLES_MAX: u8 = 64;

/// Most spheres of a cluster.
pub const SPHERES_MAX: u8 = 32;

/// Length of a [`Branch`] in bytes.
pub const BRANCH_BYTES: usize = size_of::<Branch>();

/// Length of a [`Leaf`] in bytes.
pub const LEAF_BYTES: usize = size_of::<Leaf>();

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_and_coordinates_are_inverse() {
        for cell in 0..64 {
            assert_eq!(cell_index(cell_coordinates(cell)), cell);
        }
        assert_eq!(cell_coordinates(0b001_001), [3, 0, 0]);
    }

    #[test]
    fn flipping_moves_each_cell_to_its_mirror_image() {
        for flip in [0, 9, 18, 27, 36, 45, 54, 63] {
            for cell in 0..64 {
                assert_eq!(flip_cells(1 << cell, flip), 1 << (cell ^ flip), "cell {cell}, flip {flip}");
            }
        }
    }

    #[test]
    fn runs_skip_inner_cells_and_empty_cells() {
        // Cells 1, 2 | 4 is inner | 5, 7 continue the first run | 9, 63 are the second.
        let cells = |list: &[u32]| list.iter().fold(0_u64, |bits, cell| bits | 1 << cell);
        let branch = Branch {
            occupied: cells(&[1, 2, 4, 5, 7, 9, 63]),
            inner: cells(&[4]),
            run_start: cells(&[1, 9]),
            child: 10,
            leaf: 20,
        };
        assert_eq!(branch.cells_of_run(5), cells(&[1, 2, 5, 7]));
        assert_eq!(branch.cells_of_run(63), cells(&[9, 63]));
        assert_eq!(
            (branch.leaf_of(1), branch.leaf_of(7), branch.leaf_of(63)),
            (Some(20), Some(20), Some(21))
        );
        assert_eq!(branch.leaf_of(0), None);
        assert_eq!(branch.child_of(4), Some(10));
        assert_eq!(Branch { child: u32::MAX, inner: u64::MAX, ..branch }.child_of(63), None);
    }

    #[test]
    fn a_stored_box_contains_what_was_stored() {
        let (cell, slack) = (0.125, 0.013_f32);
        let frame = BoxFrame::new(cell, slack);
        let width = f64::from(cell) * 4.0 + f64::from(slack) * 2.0;
        let all = ([f64::from(-slack); 3], [width - f64::from(slack); 3]);
        for i in 0..1000_u16 {
            let at = |shift: u16| f64::from((i * 37 + shift) % 1001) / 1000.0 * width - f64::from(slack);
            let (a, b) = ([at(0), at(13), at(500)], [at(211), at(77), at(0)]);
            let inside =
                ([0, 1, 2].map(|axis| a[axis].min(b[axis])), [0, 1, 2].map(|axis| a[axis].max(b[axis])));
            for (low, high) in [inside, all] {
                let stored = frame.decode(frame.encode(low, high));
                for axis in 0..3 {
                    let (below, above) =
                        (low[axis] - f64::from(stored.0[axis]), f64::from(stored.1[axis]) - high[axis]);
                    assert!(below >= 0.0 && above >= 0.0, "{low:?} {high:?} stored as {stored:?}");
                    assert!(below.max(above) <= width / 250.0, "{low:?} {high:?} stored as {stored:?}");
                }
            }
        }
    }
}
