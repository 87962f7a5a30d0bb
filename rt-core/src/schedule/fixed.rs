//! Tiles dealt by a fixed rule, the same in every frame.

use super::curve::along_curve;
use crate::tile::{TileId, Tiles};

/// A fixed assignment of tiles to nodes, the same in every frame.
///
/// # Shape
/// Tiles are dealt to the nodes in turn along each row; every row begins a stride further on. The stride has no
/// common divisor with the number of nodes and is close to the golden section of it, so a node's tiles are spread
/// evenly in all directions, and costly parts of the picture are shared out.
///
/// # Invariants
/// Every tile belongs to exactly one node; which one depends on the picture's size and the number of nodes
/// alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Static {
    tiles: Tiles,
    nodes: u32,
    stride: u32,
}

impl Static {
    /// Deals the tiles of a picture to `nodes` nodes; 0 is taken as 1.
    pub fn new(tiles: Tiles, nodes: u32) -> Self {
        let nodes = nodes.max(1);
        Self { tiles, nodes, stride: stride_for(nodes) }
    }

    /// The node, in `0..nodes`, that draws a tile.
    pub fn node_of(&self, TileId(id): TileId) -> u32 {
        let columns = self.tiles.columns().max(1);
        let (x, y) = (u64::from(id % columns), u64::from(id / columns));
        let node = (x + y * u64::from(self.stride)) % u64::from(self.nodes);
        #[expect(clippy::cast_possible_truncation, reason = "a remainder below a u32")]
        let node = node as u32;
        node
    }

    /// The tiles that `node` draws, in the order in which it does in this frame.
    ///
    /// They lie on a Hilbert curve, so that tiles drawn soon after each other are neighbours and touch the same pages. Odd
    /// frames run along it backwards: a frame begins where the one before ended, with the pages that are
    /// still there. In rows, and always forwards, a cache of 16 % misses up to twice as often; see `bench -- replacement`.
    pub fn drawing_order(&self, node: u32, frame: u32) -> impl Iterator<Item = TileId> + use<> {
        let schedule = *self;
        along_curve(self.tiles, !frame.is_multiple_of(2)).filter(move |&tile| schedule.node_of(tile) == node)
    }

    /// The tiles that `node` draws, row by row.
    pub fn tiles_of(&self, node: u32) -> impl Iterator<Item = TileId> + use<> {
        let schedule = *self;
        self.tiles.ids().filter(move |&tile| schedule.node_of(tile) == node)
    }
}

/// The number closest to `nodes` times the golden section that shares no divisor with `nodes`.
fn stride_for(nodes: u32) -> u32 {
    let golden = (u64::from(nodes) * 618 + 500) / 1000;
    let fits = |stride: &u32| greatest_common_divisor(*stride, nodes) == 1;
    (1..=nodes).filter(fits).min_by_key(|&stride| u64::from(stride).abs_diff(golden)).unwrap_or(1)
}

fn greatest_common_divisor(mut a: u32, mut b: u32) -> u32 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::TILE_SIZE;

    #[test]
    fn every_tile_belongs_to_exactly_one_node() {
        for columns in 1..=9 {
            for rows in 1..=9 {
                let tiles = Tiles::of(columns * TILE_SIZE - 3, rows * TILE_SIZE);
                for nodes in 0..=20 {
                    let schedule = Static::new(tiles, nodes);
                    let mut owners = [0_u8; 81];
                    for node in 0..nodes.max(1) {
                        schedule.tiles_of(node).for_each(|TileId(id)| owners[id as usize] += 1);
                    }
                    assert!(owners[..tiles.count() as usize].iter().all(|&owners| owners == 1));
                }
            }
        }
    }

    #[test]
    fn a_node_draws_each_of_its_tiles_once_and_backwards_in_odd_frames() {
        for (width, height) in [(1, 1), (512, 512), (640, 96), (17, 400)] {
            let tiles = Tiles::of(width, height);
            for nodes in [1, 3, 4] {
                let schedule = Static::new(tiles, nodes);
                for node in 0..nodes {
                    let forwards: std::vec::Vec<_> = schedule.drawing_order(node, 0).collect();
                    let mut backwards: std::vec::Vec<_> = schedule.drawing_order(node, 7).collect();
                    backwards.reverse();
                    assert_eq!(forwards, backwards);
                    let mut sorted = forwards;
                    sorted.sort_unstable();
                    assert!(
                        sorted.into_iter().eq(schedule.tiles_of(node)),
                        "{width}x{height}, {nodes} nodes"
                    );
                }
            }
        }
    }

    #[test]
    fn tiles_drawn_after_each_other_are_neighbours() {
        let tiles = Tiles::of(512, 512);
        let (order, columns) = (Static::new(tiles, 1).drawing_order(0, 0), tiles.columns());
        let order: std::vec::Vec<_> = order.collect();
        for pair in order.windows(2) {
            let [(ax, ay), (bx, by)] = [pair[0], pair[1]].map(|TileId(id)| (id % columns, id / columns));
            assert_eq!(ax.abs_diff(bx) + ay.abs_diff(by), 1, "{pair:?}");
        }
    }

    #[test]
    fn no_node_has_much_more_than_its_share() {
        let tiles = Tiles::of(512, 512);
        for nodes in 1..=16 {
            let schedule = Static::new(tiles, nodes);
            let most = (0..nodes).map(|node| schedule.tiles_of(node).count()).max().expect("a node");
            let share = tiles.count() as usize / nodes as usize;
            assert!(most <= share + share / 10, "{nodes} nodes: {most} tiles, share {share}");
        }
    }

    #[test]
    fn neighbours_belong_to_different_nodes() {
        let tiles = Tiles::of(512, 512);
        for nodes in 2..=16 {
            let schedule = Static::new(tiles, nodes);
            let at = |x: u32, y: u32| schedule.node_of(TileId(y * tiles.columns() + x));
            assert_ne!(at(4, 6), at(5, 6));
            assert_ne!(at(4, 6), at(4, 7));
        }
    }

    #[test]
    fn the_stride_is_near_the_golden_section() {
        assert_eq!([1, 2, 3, 4, 5, 8, 16].map(stride_for), [1, 1, 2, 1, 3, 5, 9]);
    }
}
