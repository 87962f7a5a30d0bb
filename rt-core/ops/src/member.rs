//! One node with the smallest driver that is correct, and the memory of all.

use rt_core::TileId;
use rt_core::schedule::ledger::{DealtNode, DealtTile};
use rt_core::schedule::worker::{PeerEntry, TileEntry};
use rt_core::schedule::{LedgerStorage, Worker, WorkerStorage};

use crate::setup::Setup;

/// The memory that the state machines of a world work in.
#[derive(Debug)]
pub struct Memory {
    pub(crate) dealt_tiles: Vec<DealtTile>,
    pub(crate) order: Vec<u32>,
    pub(crate) dealt_nodes: Vec<DealtNode>,
    pub(crate) nodes: Vec<NodeMemory>,
}

#[derive(Debug)]
pub(crate) struct NodeMemory {
    tiles: Vec<TileEntry>,
    order: Vec<u32>,
    peers: Vec<PeerEntry>,
}

/// One node: its state machine, and the tiles that its threads draw.
#[derive(Debug)]
pub(crate) struct Member<'m> {
    /// `None` while it is dead.
    pub(crate) worker: Option<Worker<'m>>,
    /// What a dead node's worker worked in.
    pub(crate) storage: Option<WorkerStorage<'m>>,
    /// Frames and tiles that its threads draw.
    pub(crate) drawing: Vec<(u32, TileId)>,
    pub(crate) lives: u64,
}

impl Memory {
    /// Memory for a world of this make-up.
    #[must_use]
    pub fn new(setup: &Setup) -> Self {
        let (tiles, nodes) = (setup.tiles().count() as usize, usize::from(setup.nodes));
        let node = |_| NodeMemory {
            tiles: vec![TileEntry::EMPTY; tiles],
            order: vec![0; tiles],
            peers: vec![PeerEntry::EMPTY; nodes + 1],
        };
        Self {
            dealt_tiles: vec![DealtTile::EMPTY; tiles],
            order: vec![0; tiles],
            dealt_nodes: vec![DealtNode::EMPTY; nodes],
            nodes: (0..nodes).map(node).collect(),
        }
    }

    pub(crate) fn lend(&mut self) -> (LedgerStorage<'_>, impl Iterator<Item = WorkerStorage<'_>>) {
        let Self { dealt_tiles: tiles, order, dealt_nodes, nodes } = self;
        let ledger = LedgerStorage { tiles, order, nodes: dealt_nodes };
        (ledger, nodes.iter_mut().map(NodeMemory::lend))
    }
}

impl NodeMemory {
    fn lend(&mut self) -> WorkerStorage<'_> {
        let Self { tiles, order, peers } = self;
        WorkerStorage { tiles, order, peers }
    }
}

impl Member<'_> {
    pub(crate) const fn is_alive(&self) -> bool {
        self.worker.is_some()
    }
}
