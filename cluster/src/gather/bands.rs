//! Which display puts which part of the picture together.

use core::ops::Range;

use rt_core::{TileId, Tiles};

/// A picture divided among displays: each has a band of rows of tiles, as high as the others or one row less.
///
/// Tiles that a thread draws lie together, so most of its tiles of a frame go to one display, in one parcel. Were rows
/// dealt to the displays in turn, each thread would send a parcel to each display, and more displays would have no less to
/// do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bands {
    tiles: Tiles,
    displays: usize,
}

impl Bands {
    /// The bands of a picture for so many displays; 0 is taken as 1.
    pub(super) fn of(tiles: Tiles, displays: usize) -> Self {
        Self { tiles, displays: displays.max(1) }
    }

    /// The display that a tile goes to.
    pub(super) fn display_of(self, TileId(id): TileId) -> usize {
        let row = (id / self.tiles.columns().max(1)) as usize;
        row * self.displays / self.rows().max(1)
    }

    /// The rows of tiles of a display's band; none where there are more displays than rows.
    pub(super) fn rows_of(self, display: usize) -> Range<usize> {
        let start = |display: usize| (display * self.rows()).div_ceil(self.displays);
        start(display)..start(display + 1)
    }

    fn rows(self) -> usize {
        self.tiles.rows() as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::TILE_SIZE;

    #[test]
    fn every_row_of_tiles_lies_in_the_band_of_its_display() {
        for (rows, displays) in [(1, 1), (4, 3), (5, 5), (3, 7), (17, 16)] {
            let tiles = Tiles::of(2 * TILE_SIZE, rows * TILE_SIZE);
            let bands = Bands::of(tiles, displays);
            let all: Vec<usize> = (0..displays).flat_map(|display| bands.rows_of(display)).collect();
            assert!(all.into_iter().eq(0..rows as usize), "{rows} rows, {displays} displays");
            for id in tiles.ids() {
                let row = (id.0 / tiles.columns()) as usize;
                assert!(
                    bands.rows_of(bands.display_of(id)).contains(&row),
                    "{id:?} of {rows} rows, {displays}"
                );
            }
        }
    }
}
