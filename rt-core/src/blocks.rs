//! How the pixels of a tile are numbered: 8x8 *blocks* of 4x4 pixels, row by row, and within a block row by row.

use crate::simd::LANES;

/// Blocks of a tile.
pub(crate) const BLOCKS: usize = 64;

/// A value for each pixel of a tile.
pub(crate) type ByBlock<T> = [[T; LANES]; BLOCKS];

/// The block in a column and row of blocks, each taken modulo eight.
#[inline(always)]
pub(crate) const fn block_at(column: usize, row: usize) -> usize {
    row % 8 * 8 + column % 8
}

/// Column and row of a block's first pixel.
#[inline(always)]
pub(crate) const fn first_pixel(block: usize) -> (usize, usize) {
    (block % 8 * 4, block / 8 % 8 * 4)
}

/// Block and lane of a pixel.
#[inline(always)]
pub(crate) const fn block_and_lane(x: usize, y: usize) -> (usize, usize) {
    (block_at(x / 4, y / 4), y % 4 * 4 + x % 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_has_a_place_of_its_own() {
        let mut seen = [0_u16; BLOCKS];
        for (x, y) in (0..32).flat_map(|y| (0..32).map(move |x| (x, y))) {
            let (block, lane) = block_and_lane(x, y);
            assert_eq!(seen[block] >> lane & 1, 0);
            seen[block] |= 1 << lane;
            let (column, row) = first_pixel(block);
            assert_eq!((column + lane % 4, row + lane / 4), (x, y));
        }
    }
}
