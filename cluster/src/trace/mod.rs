//! Page touches of a session: what `memsavvy trace` records, and what policies are compared on.
//!
//! | module | what it holds |
//! |---|---|
//! | `record` | drawing a session and writing down every page that is read |
//! | `file` | the file: as written and as read |

mod file;
mod record;

pub use file::TraceError;
pub use record::{Options, record};

use rt_core::TileId;

/// The pages that the tiles of a session touch, frame by frame, node by node, in the order in which they are drawn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    /// Length of a page.
    pub page_bytes: u32,
    /// Pages of the scene image; every touch is of one of them.
    pub page_count: u32,
    /// Nodes that the tiles are dealt to.
    pub nodes: u16,
    /// Pictures' width and height in pixels.
    pub size: [u32; 2],
    /// For each frame, what each node touches.
    pub frames: Vec<Vec<NodeFrame>>,
}

/// What one node touches in one frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NodeFrame {
    /// The tiles in the order in which they are drawn, and where in `touches` those of each end.
    tiles: Vec<(TileId, usize)>,
    touches: Vec<u32>,
}

impl NodeFrame {
    /// Adds a tile, drawn after those that are there: the pages it touches, in order, none twice in a row.
    pub fn push(&mut self, tile: TileId, touches: &[u32]) {
        self.touches.extend_from_slice(touches);
        self.tiles.push((tile, self.touches.len()));
    }

    /// The tiles in the order in which they are drawn, and the pages that each touches.
    pub fn tiles(&self) -> impl ExactSizeIterator<Item = (TileId, &[u32])> + DoubleEndedIterator {
        let end_of = |index: usize| index.checked_sub(1).map_or(0, |before| self.tiles[before].1);
        let tiles = self.tiles.iter().enumerate();
        tiles.map(move |(index, (tile, end))| (*tile, &self.touches[end_of(index)..*end]))
    }

    /// All touches of the frame.
    #[must_use]
    pub fn touches(&self) -> &[u32] {
        &self.touches
    }
}

impl Trace {
    /// Touches of all nodes in all frames.
    #[must_use]
    pub fn touch_count(&self) -> u64 {
        self.frames.iter().flatten().map(|frame| frame.touches.len() as u64).sum()
    }

    /// Pages that somebody touches.
    #[must_use]
    pub fn distinct_pages(&self) -> u64 {
        distinct(self.page_count, self.frames.iter().flatten().flat_map(|frame| &frame.touches))
    }

    /// Pages that a node touches in a frame, the mean over nodes and frames.
    #[must_use]
    pub fn pages_per_node_frame(&self) -> f64 {
        let each = self.frames.iter().flatten().map(|frame| distinct(self.page_count, &frame.touches));
        let (sum, count) = each.fold((0, 0u32), |(sum, count), pages| (sum + pages, count + 1));
        sum as f64 / f64::from(count.max(1))
    }

    /// Pages that a tile touches, the mean over all tiles.
    #[must_use]
    pub fn pages_per_tile(&self) -> f64 {
        let tiles = self.frames.iter().flatten().flat_map(NodeFrame::tiles);
        let (mut sum, mut count) = (0, 0u32);
        let mut pages = Vec::new();
        for (_, touches) in tiles {
            pages.clear();
            pages.extend_from_slice(touches);
            pages.sort_unstable();
            pages.dedup();
            sum += pages.len();
            count += 1;
        }
        sum as f64 / f64::from(count.max(1))
    }
}

fn distinct<'a>(page_count: u32, touches: impl IntoIterator<Item = &'a u32>) -> u64 {
    let mut seen = vec![false; page_count as usize];
    touches.into_iter().filter(|page| !core::mem::replace(&mut seen[**page as usize], true)).count() as u64
}
