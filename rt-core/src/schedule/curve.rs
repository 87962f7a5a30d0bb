//! The order in which tiles are drawn.

use crate::tile::{TileId, Tiles};

/// All tiles of a picture along a Hilbert curve, from its end when `backwards`.
///
/// Neighbours on the curve are neighbours in the picture, and a piece of the curve is a compact part of it.
pub fn along_curve(tiles: Tiles, backwards: bool) -> impl Iterator<Item = TileId> + use<> {
    let (columns, rows) = (tiles.columns(), tiles.rows());
    let order = columns.max(rows).next_power_of_two().trailing_zeros();
    let length = 1_u64 << (2 * order);
    (0..length).filter_map(move |step| {
        let place = if backwards { length - 1 - step } else { step };
        let (x, y) = on_hilbert_curve(order, place);
        (x < columns && y < rows).then_some(TileId(y * columns + x))
    })
}

/// Where place `place` of the Hilbert curve through a square of `2^order` by `2^order` lies.
///
/// Two bits of the place, the highest first, choose a quarter; each quarter holds the curve mirrored and turned so that
/// the ends meet. Hilbert, "Ueber die stetige Abbildung einer Linie auf ein Flaechenstueck", 1891.
const fn on_hilbert_curve(order: u32, place: u64) -> (u32, u32) {
    let (mut x, mut y) = (0, 0);
    let mut level = 0;
    while level < order {
        let quarter = (place >> (2 * level)) & 3;
        let (right, down) = (quarter >> 1 == 1, (quarter ^ (quarter >> 1)) & 1 == 1);
        let side = 1_u32 << level;
        if !down {
            if right {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            (x, y) = (y, x);
        }
        if right {
            x += side;
        }
        if down {
            y += side;
        }
        level += 1;
    }
    (x, y)
}
