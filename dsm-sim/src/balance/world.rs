//! A cluster that balances, from its configuration to its report.

use dsm_core::id::NodeId;
use rt_core::schedule::ledger::{DealtNode, DealtTile, LedgerConfig};
use rt_core::schedule::worker::{PeerEntry, TileEntry, WorkerConfig};
use rt_core::schedule::{Balancer, Ledger, LedgerStorage, PageMap, Worker, WorkerStorage};
use rt_core::{TILE_SIZE, Tiles};

use super::display::Display;
use super::gather::{Gather, Talk};
use super::letters::{Letter, Letters, Task};
use super::node::Node;
use crate::cluster::{Actor, Checks, Cluster, Ended, Io, Setup, View};
use crate::fault::Faults;
use crate::network::Network;
use crate::time::Moment;

/// What it takes to draw tiles.
pub trait Workload {
    /// Nanoseconds that a tile of a frame takes on a node that is as fast as any.
    fn cost_ns(&self, frame: u32, tile: u32, node: u16) -> u64;

    /// Bytes of a tile's pixels on their way to a display, where they go in parcels; `is_known` when the display has the
    /// tile's pixels of the frame before from the same node.
    fn bytes(&self, _frame: u32, _tile: u32, _is_known: bool) -> u32 {
        1024
    }

    /// The pages that a tile uses.
    fn map(&self, _tile: u32) -> PageMap {
        PageMap::EMPTY
    }
}

/// A cluster: its nodes, and the display after them.
#[derive(Clone, Debug)]
pub struct Config {
    /// Nodes that draw.
    pub nodes: u16,
    /// Render threads of each.
    pub threads: u16,
    /// How many of them share a core, as far as nodes are told: in virtual time each has its own.
    pub threads_per_core: u16,
    /// Columns and rows of tiles.
    pub tiles: [u32; 2],
    /// How tiles come to nodes.
    pub balancer: Balancer,
    /// Frames to draw.
    pub frames: u32,
    /// First time after which something is said again, in microseconds; above a round trip.
    pub resend_us: u64,
    /// Bytes of a tile's pixels.
    pub pixels_bytes: u32,
    /// Tiles come in parcels, over links that lose nothing and from nodes that live; else each in a message of its own.
    pub gather: Option<Gather>,
    /// What lies between the nodes.
    pub network: Network,
    /// What goes wrong.
    pub faults: Faults,
    /// How often invariants are checked.
    pub checks: Checks,
    /// A run that takes longer is given up.
    pub until: Moment,
}

/// The memory that a cluster's state machines work in.
#[derive(Debug)]
pub struct Memory {
    dealt: Vec<DealtTile>,
    order: Vec<u32>,
    dealt_nodes: Vec<DealtNode>,
    nodes: Vec<(Vec<TileEntry>, Vec<u32>, Vec<PeerEntry>)>,
}

/// One frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameReport {
    /// From its first deal to its last tile.
    pub ns: u64,
    /// Tiles that came from another node than they were dealt to.
    pub moved: u32,
    /// Tiles that came when they were there already.
    pub again: u32,
    /// Tiles dealt anew because their node had died.
    pub dealt_anew: u32,
    /// Time that each node spent drawing.
    pub busy_ns: Vec<u64>,
    /// Tiles begun, over all nodes.
    pub begun: u32,
    /// What communication took of the display's time; nothing without [`Config::gather`].
    pub talk: Talk,
}

/// What a run has shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// How it ended: [`Ended::Done`] when all frames were displayed.
    pub ended: Ended,
    /// The frames that became whole, in order.
    pub frames: Vec<FrameReport>,
    /// All that has happened as one number.
    pub trace: u64,
    /// Things that have happened.
    pub steps: u64,
    /// Messages that the display sent and received.
    pub display_messages: u64,
}

/// One actor of the cluster.
#[derive(Debug)]
enum Member<'m, W> {
    Node(Box<Node<'m, W>>),
    Display(Box<Display<'m>>),
}

impl Config {
    /// So many nodes of one thread, 16 x 16 tiles, ten frames, a gigabit network in which nothing goes wrong.
    #[must_use]
    pub fn new(nodes: u16, balancer: Balancer) -> Self {
        Self {
            nodes,
            threads: 1,
            threads_per_core: 1,
            tiles: [16, 16],
            balancer,
            frames: 10,
            resend_us: 2_000,
            pixels_bytes: 1024,
            gather: None,
            network: Network::gigabit(),
            faults: Faults::default(),
            checks: Checks::AtEnd,
            until: Moment::NEVER,
        }
    }

    fn picture(&self) -> Tiles {
        let [columns, rows] = self.tiles;
        Tiles::of(columns * TILE_SIZE, rows * TILE_SIZE)
    }
}

impl Memory {
    /// Memory for such a cluster.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let tiles = config.picture().count() as usize;
        let nodes = usize::from(config.nodes);
        let node = |_| (vec![TileEntry::EMPTY; tiles], vec![0; tiles], vec![PeerEntry::EMPTY; nodes + 1]);
        Self {
            dealt: vec![DealtTile::EMPTY; tiles],
            order: vec![0; tiles],
            dealt_nodes: vec![DealtNode::EMPTY; nodes],
            nodes: (0..nodes).map(node).collect(),
        }
    }
}

/// Draws all frames, or as many as can be.
///
/// # Panics
/// When an invariant does not hold; the message names it.
pub fn run<W: Workload>(config: &Config, workload: &W, memory: &mut Memory, seed: u64) -> Report {
    let letters = Letters::default();
    let Memory { dealt, order, dealt_nodes, nodes } = memory;
    let workers = (0..).zip(nodes.iter_mut()).map(|(me, (tiles, order, peers))| {
        let storage = WorkerStorage { tiles, order, peers };
        let node = Node::new(
            worker_config(config, me, seed),
            storage,
            workload,
            letters.clone(),
            config.pixels_bytes,
            config.gather,
        );
        Member::Node(Box::new(node))
    });
    let mut members: Vec<Member<'_, W>> = workers.collect();
    let storage = LedgerStorage { tiles: dealt, order, nodes: dealt_nodes };
    let ledger = Ledger::new(ledger_config(config, seed), storage);
    let tiles = config.picture().count();
    let gather = config.gather.map(|gather| (gather, config.balancer));
    let display = Display::new(ledger, letters, (EPOCH, config.frames), config.nodes, tiles, gather);
    members.push(Member::Display(Box::new(display)));
    let setup =
        Setup { network: config.network.clone(), faults: config.faults.clone(), checks: config.checks, seed };
    let mut cluster = Cluster::new(setup, members);
    let ended = cluster.run(config.until);
    cluster.check_invariants();
    report(&cluster, config, ended)
}

fn report<W: Workload>(cluster: &Cluster<Member<'_, W>>, config: &Config, ended: Ended) -> Report {
    let mut frames = Vec::new();
    if let Some(Member::Display(display)) = cluster.actors().last() {
        frames.clone_from(&display.done);
    }
    for (index, frame) in (1..).zip(&mut frames) {
        for member in cluster.actors() {
            if let Member::Node(node) = member {
                frame.busy_ns.push(node.busy_ns.get(index).copied().unwrap_or(0));
                frame.begun += node.begun.get(index).copied().unwrap_or(0);
            }
        }
    }
    let traffic = cluster.traffic(NodeId(config.nodes));
    let display_messages = traffic.sent_messages + traffic.received_messages;
    Report { ended, frames, trace: cluster.trace(), steps: cluster.steps(), display_messages }
}

fn worker_config(config: &Config, me: u16, seed: u64) -> WorkerConfig {
    WorkerConfig {
        epoch: EPOCH,
        me,
        nodes: config.nodes,
        threads: config.threads,
        threads_per_core: config.threads_per_core,
        tiles: config.picture(),
        balancer: config.balancer,
        resend_us: config.resend_us,
        is_display_reliable: config.gather.is_some(),
        seed,
    }
}

fn ledger_config(config: &Config, seed: u64) -> LedgerConfig {
    LedgerConfig {
        epoch: EPOCH,
        nodes: config.nodes,
        threads: config.threads,
        threads_per_core: config.threads_per_core,
        tiles: config.picture(),
        balancer: config.balancer,
        resend_us: config.resend_us,
        confirms: config.gather.is_none(),
        seed,
    }
}

impl<W: Workload> Actor for Member<'_, W> {
    type Message = Letter;
    type Task = Task;

    fn handle_start(&mut self, io: &mut Io<'_, Letter, Task>) {
        match self {
            Self::Node(node) => node.start(io),
            Self::Display(display) => display.start(io),
        }
    }

    fn handle_message(&mut self, io: &mut Io<'_, Letter, Task>, from: NodeId, letter: Letter) {
        match self {
            Self::Node(node) => node.handle_message(io, letter),
            Self::Display(display) => display.handle_message(io, from, letter),
        }
    }

    fn handle_task(&mut self, io: &mut Io<'_, Letter, Task>, task: Task) {
        match self {
            Self::Node(node) => node.handle_task(io, task),
            Self::Display(display) => display.handle_task(io, task),
        }
    }

    fn handle_crash(&mut self) {
        if let Self::Node(node) = self {
            node.crash();
        }
    }

    fn handle_peer_down(&mut self, io: &mut Io<'_, Letter, Task>, peer: NodeId) {
        match self {
            Self::Node(node) => node.handle_peer_down(peer),
            Self::Display(display) => display.handle_peer_down(io, peer),
        }
    }

    fn is_done(&self) -> bool {
        match self {
            Self::Node(_) => true,
            Self::Display(display) => display.is_done(),
        }
    }

    fn check_invariants(&self, _view: View) {
        match self {
            Self::Node(node) => node.worker.iter().for_each(Worker::check_invariants),
            Self::Display(display) => display.ledger.check_invariants(),
        }
    }
}

/// The epoch of every run.
const EPOCH: u32 = 7;
