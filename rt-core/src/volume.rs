//! Volumes: samples on a regular lattice, cut into bricks, under a tree of ranges.
//!
//! Eight neighbouring samples bound a *voxel cell*. Inside it the value is the trilinear interpolant of the eight.
//!
//! # Bricks
//! A *brick* is 8x8x8 samples, x fastest, then y, then z, hence 7x7x7 voxel cells: bricks share the samples of their
//! common border, so no cell ever needs two bricks. A sample is a `u8`, a `u16` or an `f32`, so a brick is 512, 1024 or
//! 2048 bytes, a page holds whole bricks and nothing else, and no brick crosses a page of any size. Samples beyond the
//! volume are stored as 0 and never looked at. Bricks lie in Morton order. A brick whose samples are all the same
//! shows no surface, and is not stored: empty space costs no page beyond the tree.
//!
//! # Tree of ranges
//! [`RangeBranch`]: a cube of 4x4x4 children, bricks on the lowest level and branches above it, with the lowest and
//! the highest sample of each as a byte. The children that an isovalue may lie in are two compares of 64 bytes away,
//! whatever the isovalue: changing it costs nothing. Bytes count [`VolumeTable::edges`], numbers between the lowest
//! and the highest sample chosen so that about as many samples lie between any two.
//!
//! # Coordinates
//! *Cell units*: sample `(i, j, k)` is at `(i, j, k)`, and cell `(i, j, k)` spans one unit from there. All numbers of
//! bricks, branches and bytes have 64 bits.

use bytemuck::{Pod, Zeroable};

use crate::grid::cell_index;
use crate::image::Bounds;

/// What the header of an image says of its volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// Samples along x, y and z, `1..=SAMPLES_MAX`.
    pub dims: [u32; 3],
    /// What is stored for a sample.
    pub sample: SampleKind,
    /// Levels of branches, `1..=RANGE_LEVELS_MAX`; the root spans `4^levels` bricks a side.
    pub levels: u32,
    /// Place of the first sample, in world units.
    pub origin: [f64; 3],
    /// Distance of neighbouring samples along each axis, in world units; positive.
    pub spacing: [f64; 3],
    /// The value of a stored sample `s` is `slope * s + intercept`; not 0.
    pub slope: f64,
    /// See [`slope`](Self::slope).
    pub intercept: f64,
    /// Lowest stored sample that is finite.
    pub low: f32,
    /// Highest stored sample that is finite.
    pub high: f32,
    /// Records in the segment of ranges; 0 when all samples are the same.
    pub branches: u64,
    /// Records in the segment of bricks.
    pub bricks: u64,
}

/// A number as it is stored for one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleKind {
    /// Unsigned, 8 bits.
    U8 = 1,
    /// Unsigned, 16 bits.
    U16 = 2,
    /// Single precision. A voxel cell with a corner that is NaN, infinite or beyond `±VALUE_MAX` is absent: no
    /// surface is in it.
    F32 = 4,
}

/// The ranges of 64 children, in Morton order: bricks, or branches of the next level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct RangeBranch {
    /// For each child the last edge that is not above its lowest sample.
    pub low: [u8; 64],
    /// For each child the first edge that is not below its highest sample.
    pub high: [u8; 64],
    /// Children whose samples are not all the same, one bit each; the others are not stored.
    pub present: u64,
    /// Index of the first child that is present; the others follow in Morton order.
    pub first: u64,
}

/// What ranges count in, and how samples are spread.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct VolumeTable {
    /// The stored samples that bytes of ranges stand for, in ascending order: the lowest first, the highest last.
    pub edges: [f32; TABLE_EDGES],
    /// Samples in each of equal parts of `histogram_low..=histogram_high`; what lies outside counts at its end.
    pub histogram: [u64; HISTOGRAM_BINS],
    /// Stored sample at which the histogram begins.
    pub histogram_low: f32,
    /// Stored sample at which the histogram ends.
    pub histogram_high: f32,
    /// Samples that are NaN, infinite or beyond `±VALUE_MAX`.
    pub absent: u64,
}

/// An isovalue among the edges: how many of them lie below it.
///
/// A child may hold the surface only when its low byte is below this number, and its high byte is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threshold(u32);

impl Volume {
    /// Whether all numbers are in range and fit each other.
    pub(crate) fn is_proper(&self) -> bool {
        let finite = |numbers: [f64; 3]| numbers.into_iter().all(f64::is_finite);
        self.dims.into_iter().all(|count| (1..=SAMPLES_MAX).contains(&count))
            && self.levels == levels_for(self.dims)
            && finite(self.origin)
            && finite(self.spacing)
            && self.spacing.into_iter().all(|spacing| spacing > SPACING_MIN)
            && self.slope.is_finite()
            && self.slope != 0.0
            && self.intercept.is_finite()
            && self.low.abs() <= VALUE_MAX
            && self.high.abs() <= VALUE_MAX
            && self.branches <= RECORDS_MAX
            && self.bricks <= RECORDS_MAX
            && (self.branches == 0) == (self.bricks == 0)
            && self.bounds().is_some()
    }

    /// Voxel cells along each axis.
    pub fn cells(&self) -> [i32; 3] {
        self.dims.map(|count| (count - 1).cast_signed())
    }

    /// The box of all samples in world units, each corner rounded to single precision; `None` when that overflows.
    pub fn bounds(&self) -> Option<Bounds> {
        let at = |count: u32, axis: usize| self.origin[axis] + self.spacing[axis] * f64::from(count);
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
        let corner = |last: [u32; 3]| [0, 1, 2].map(|axis| at(last[axis], axis) as f32);
        let bounds =
            Bounds { low: corner([0; 3]).into(), high: corner(self.dims.map(|count| count - 1)).into() };
        bounds.is_proper().then_some(bounds)
    }

    /// The number that an isovalue is looked for as among stored samples.
    pub fn stored(&self, value: f32) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "rounded once, to the precision of a sample")]
        let stored = ((f64::from(value) - self.intercept) / self.slope) as f32;
        stored
    }

    /// The value of a stored sample.
    pub fn value(&self, stored: f32) -> f64 {
        self.slope * f64::from(stored) + self.intercept
    }

    /// Offset of a brick in its segment.
    pub const fn brick_offset(&self, index: u64) -> u64 {
        index * self.sample.brick_bytes() as u64
    }
}

impl SampleKind {
    /// Length of one sample.
    pub const fn bytes(self) -> usize {
        self as usize
    }

    /// Length of a brick.
    pub const fn brick_bytes(self) -> usize {
        self.bytes() * BRICK_SAMPLES
    }

    pub(crate) const fn from_bits(bits: u32) -> Option<Self> {
        match bits {
            1 => Some(Self::U8),
            2 => Some(Self::U16),
            4 => Some(Self::F32),
            _ => None,
        }
    }
}

impl Threshold {
    /// One that activates nothing.
    pub const NONE: Self = Self(0);

    /// How many of some edges lie below a stored isovalue.
    pub(crate) fn among(edges: impl Iterator<Item = f32>, stored: f32) -> Self {
        // Counted one by one: edges of a table that lies need not ascend.
        Self(edges.fold(0, |below, edge| below + u32::from(edge < stored)))
    }
}

impl RangeBranch {
    /// Children that are present and whose range the isovalue lies in, one bit each.
    #[inline]
    pub fn active(&self, Threshold(below): Threshold) -> u64 {
        let (Ok(above), Some(Ok(highest))) = (u8::try_from(below), below.checked_sub(1).map(u8::try_from))
        else {
            return 0;
        };
        let mut active = [0_u8; 64];
        for (active, (low, high)) in active.iter_mut().zip(self.low.iter().zip(&self.high)) {
            *active = u8::from(*low <= highest) & u8::from(*high >= above);
        }
        self.present & bits(&active)
    }

    /// Index of a child that is present, or `None` on overflow.
    #[inline]
    pub const fn child_of(&self, cell: u32) -> Option<u64> {
        self.first.checked_add((self.present & ((1 << cell) - 1)).count_ones() as u64)
    }
}

impl VolumeTable {
    /// Where a stored isovalue lies among the edges.
    pub fn threshold(&self, stored: f32) -> Threshold {
        Threshold::among(self.edges.into_iter(), stored)
    }

    /// The byte that stands for the lowest sample of a child: the last edge that is not above it.
    pub fn low_byte(&self, sample: f32) -> u8 {
        let beyond = self.edges.partition_point(|&edge| edge <= sample);
        u8::try_from(beyond.saturating_sub(1)).unwrap_or(u8::MAX)
    }

    /// The byte that stands for the highest sample of a child: the first edge that is not below it.
    pub fn high_byte(&self, sample: f32) -> u8 {
        u8::try_from(self.edges.partition_point(|&edge| edge < sample)).unwrap_or(u8::MAX)
    }
}

/// One bit for each of up to 64 bytes that are 0 or 1.
#[inline]
pub(crate) fn bits(bytes: &[u8]) -> u64 {
    let mut mask = 0;
    for (i, &eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        // The product moves the bit of byte `k` to bit `56 + k`; what is below does not carry.
        let product = u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080);
        mask |= product >> 56 << (8 * i);
    }
    mask
}

/// Levels of branches that span this many samples.
pub const fn levels_for(dims: [u32; 3]) -> u32 {
    let mut levels = 1;
    let mut axis = 0;
    while axis < 3 {
        let bricks = bricks_along(dims[axis]) as u64;
        while 1 << (2 * levels) < bricks {
            levels += 1;
        }
        axis += 1;
    }
    levels
}

/// Bricks that hold this many samples along an axis; none for a single sample, which bounds no cell.
pub const fn bricks_along(samples: u32) -> u32 {
    samples.saturating_sub(1).div_ceil(BRICK_CELLS.cast_unsigned())
}

/// Number of a brick in the Morton order of all bricks, stored or not. Of branches on level `l` above the bricks it
/// is this number of any brick below, divided by `64^l`.
pub const fn morton([x, y, z]: [u32; 3]) -> u128 {
    let mut index = 0;
    let mut level = 0;
    while level < RANGE_LEVELS_MAX {
        let digit = cell_index([x >> (2 * level) & 3, y >> (2 * level) & 3, z >> (2 * level) & 3]);
        index |= (digit as u128) << (6 * level);
        level += 1;
    }
    index
}

/// Offset of a range branch in its segment: [`RANGES_PER_GROUP`] in every 4 KB, so that none crosses a page.
#[inline]
pub const fn range_offset(index: u64) -> u64 {
    let per_group = RANGES_PER_GROUP as u64;
    index / per_group * GROUP_BYTES as u64 + index % per_group * RANGE_BYTES as u64
}

/// Length of the segment with this many range branches.
pub const fn ranges_bytes(count: u64) -> u64 {
    if count == 0 { 0 } else { range_offset(count - 1) + RANGE_BYTES as u64 }
}

/// Samples along an edge of a brick.
pub const BRICK_EDGE: usize = 8;

/// Voxel cells along an edge of a brick.
pub const BRICK_CELLS: i32 = 7;

/// Samples of a brick.
pub const BRICK_SAMPLES: usize = BRICK_EDGE * BRICK_EDGE * BRICK_EDGE;

/// Length of a [`RangeBranch`].
pub const RANGE_BYTES: usize = size_of::<RangeBranch>();

/// Length of a [`VolumeTable`].
pub const TABLE_BYTES: usize = size_of::<VolumeTable>();

/// Edges that ranges count in.
pub const TABLE_EDGES: usize = 256;

/// Range branches in each 4 KB of their segment; 64 bytes are left over.
pub const RANGES_PER_GROUP: usize = GROUP_BYTES as usize / RANGE_BYTES;

/// Parts of a histogram.
pub const HISTOGRAM_BINS: usize = 128;

/// Most samples along an axis.
pub const SAMPLES_MAX: u32 = 1 << 30;

/// Most levels of range branches.
pub const RANGE_LEVELS_MAX: u32 = 14;

/// Samples and isovalues beyond this are taken as infinite, so that their differences are finite.
pub const VALUE_MAX: f32 = crate::scale::power_of_two(120);

/// Spacings below this are refused.
const SPACING_MIN: f64 = 1.0e-60;

/// Most records of a segment, so that offsets cannot overflow.
const RECORDS_MAX: u64 = 1 << 48;

const GROUP_BYTES: u32 = 4096;

const _: () = assert!(RANGE_BYTES == 144 && RANGES_PER_GROUP == 28 && TABLE_BYTES <= 4096);
const _: () = assert!(levels_for([SAMPLES_MAX; 3]) == RANGE_LEVELS_MAX);

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> VolumeTable {
        let edges = core::array::from_fn(|i| i as f32);
        VolumeTable { edges, ..VolumeTable::zeroed() }
    }

    #[test]
    fn only_ranges_that_an_isovalue_lies_in_are_active() {
        let table = table();
        for (low, high) in [(0.0, 255.0), (10.0, 10.0), (10.0, 11.0), (3.5, 3.75), (254.5, 255.0)] {
            let mut branch = RangeBranch { present: 1 << 9, ..RangeBranch::zeroed() };
            branch.low[9] = table.low_byte(low);
            branch.high[9] = table.high_byte(high);
            for iso in (-8..=2080).map(|eighths| eighths as f32 / 8.0) {
                let active = branch.active(table.threshold(iso)) != 0;
                assert!(active || !(low < iso && iso <= high), "{low}..{high} at {iso}");
                // Whole numbers are edges, so nothing is taken for active that is not.
                let whole = low.trunc() == low && high.trunc() == high;
                assert!(!active || !whole || low < iso && iso <= high, "{low}..{high} at {iso}");
            }
        }
    }

    #[test]
    fn an_isovalue_outside_the_edges_or_none_activates_nothing() {
        let branch = RangeBranch { low: [0; 64], high: [255; 64], present: u64::MAX, first: 0 };
        for iso in [-1.0, 0.0, 255.5, f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert_eq!(branch.active(table().threshold(iso)), 0, "{iso}");
        }
        assert_eq!(branch.active(table().threshold(255.0)), u64::MAX);
    }

    #[test]
    fn children_are_counted_among_those_present() {
        let branch = RangeBranch { present: 0b1101, first: u64::MAX - 3, ..RangeBranch::zeroed() };
        assert_eq!(branch.child_of(0), Some(u64::MAX - 3));
        assert_eq!(branch.child_of(3), Some(u64::MAX - 1));
        assert_eq!(RangeBranch { first: u64::MAX, ..branch }.child_of(2), None);
    }

    #[test]
    fn branches_never_cross_4_kb_and_offsets_have_64_bits() {
        for index in (0..1000).chain((1 << 40)..(1 << 40) + 100) {
            let (first, last) = (range_offset(index), range_offset(index) + RANGE_BYTES as u64 - 1);
            assert_eq!(first / 4096, last / 4096);
            assert!(range_offset(index + 1) > last);
        }
        assert_eq!(ranges_bytes(0), 0);
        assert_eq!(ranges_bytes(29), 4096 + 144);
    }

    #[test]
    fn levels_span_all_bricks() {
        assert_eq!(levels_for([1, 1, 1]), 1);
        assert_eq!(levels_for([29, 1, 1]), 1);
        assert_eq!(levels_for([30, 2, 2]), 2);
        assert_eq!(levels_for([256; 3]), 3);
        assert_eq!(levels_for([5120; 3]), 5);
        assert_eq!((bricks_along(1), bricks_along(2), bricks_along(8), bricks_along(9)), (0, 1, 1, 2));
    }

    #[test]
    fn morton_numbers_do_not_wrap_at_32_or_64_bits() {
        assert_eq!(morton([3, 0, 0]), 0b1001);
        assert_eq!(morton([4, 0, 0]), 64);
        let last = bricks_along(SAMPLES_MAX) - 1;
        assert!(morton([last; 3]) > u128::from(u64::MAX));
    }
}
