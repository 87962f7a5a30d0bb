//! Which node draws which tile.

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

    /// The tiles that `node` draws, in order.
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
