//! What a simulated paging cluster must know before it starts.

use core::fmt;

use dsm_core::id::{MAX_NODES, NodeId};
use dsm_core::node;
use dsm_core::placement::{PlacementError, Stripes};
use dsm_core::wire::{HEADER_BYTES, fragment_bytes};

use super::workload::{EXPONENT_MAX, Workload};
use crate::cluster::Checks;
use crate::fault::{Fault, Faults};
use crate::network::Network;
use crate::time::{Moment, us};

/// What a simulated paging cluster must know before it starts. Everything but the seed.
#[derive(Clone, Debug)]
pub struct Config {
    /// Nodes, those that only own pages included.
    pub nodes: u16,
    /// Nodes that have threads: the first so many.
    pub renderers: u16,
    /// Threads of each of them.
    pub threads: u8,
    /// Pages that a thread touches before it is done.
    pub touches: u32,
    /// Which pages they touch.
    pub workload: Workload,
    /// Mean time from one touch to the next; mostly less, now and then much more.
    pub think_ns: u64,
    /// Slots of each node.
    pub slots: u32,
    /// What each node is told, but for its own number: placement, page length, times.
    pub node: node::Config,
    /// Bytes of a page that one message can carry; 0: all. Longer pages come in fragments, if `node` takes them.
    pub message_room: u32,
    /// Grants, in a million, beside which a message strays in that looks like them and carries other bytes.
    pub strays_ppm: u32,
    /// How long work takes.
    pub costs: Costs,
    /// What lies between the nodes.
    pub network: Network,
    /// What goes wrong.
    pub faults: Faults,
    /// How often invariants are checked.
    pub checks: Checks,
    /// When a run ends at the latest.
    pub until: Moment,
}

/// How long work takes. A slow node needs more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Costs {
    /// From the touch of an absent page to the request.
    pub trap_ns: u64,
    /// To answer a request; an owner answers one after the other.
    pub serve_ns: u64,
    /// To put a page that came in its place.
    pub fill_ns: u64,
    /// To take a victim away.
    pub unmap_ns: u64,
    /// To wake a thread.
    pub wake_ns: u64,
}

/// Why no simulation came of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ConfigError {
    /// No node, or more than a cluster can have.
    Nodes(u16),
    /// More nodes with threads than nodes.
    Renderers {
        /// Nodes with threads asked for.
        renderers: u16,
        /// Nodes there are.
        nodes: u16,
    },
    /// The placement gives pages to a node that there is not.
    Owner {
        /// That node.
        owner: NodeId,
        /// Nodes there are.
        nodes: u16,
    },
    /// The placement contradicts itself.
    Placement(PlacementError),
    /// The state machine refuses its part.
    Node(node::ConfigError),
    /// A page does not come in fragments so short, or `node` takes none.
    MessageRoom(u32),
    /// The workload has no page to touch, one that there is not, or an exponent that is too large.
    Workload,
    /// A fault is to strike a node that there is not.
    Fault(NodeId),
}

impl Config {
    /// A cluster of `nodes`, each of which owns its part of `pages` and has threads, on a network of today, with
    /// slots for an eighth of the pages.
    ///
    /// # Errors
    /// There are no nodes or no pages, or more than there can be.
    pub fn new(nodes: u16, pages: u32) -> Result<Self, ConfigError> {
        Self::with_stores(nodes, 0, pages)
    }

    /// The same with `stores` further nodes, if there are any, that own all pages and have no threads.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_stores(renderers: u16, stores: u16, pages: u32) -> Result<Self, ConfigError> {
        let nodes = renderers.saturating_add(stores);
        if nodes == 0 || nodes > MAX_NODES {
            return Err(ConfigError::Nodes(nodes));
        }
        let (first_owner, owners) = if stores == 0 { (0, renderers) } else { (renderers, stores) };
        let placement =
            Stripes::new(pages, 1, NodeId(first_owner), owners).map_err(ConfigError::Placement)?;
        let is_small = u64::from(nodes) * u64::from(pages) <= SMALL;
        Ok(Self {
            nodes,
            renderers,
            threads: 2,
            touches: 100,
            workload: Workload::Uniform,
            think_ns: us(10),
            slots: (pages / 8).max(1),
            node: node::Config::new(NodeId(0), placement, 16384),
            message_room: 0,
            strays_ppm: 0,
            costs: Costs::MEASURED,
            network: Network::hundred_gigabit(),
            faults: Faults::default(),
            checks: if is_small { Checks::EveryStep } else { Checks::OneIn(1024) },
            until: Moment::NEVER,
        })
    }

    /// Requests that a node can have under way: one for each of its threads, and twice as many as its threads ask for ahead,
    /// since that may take half of them.
    pub(super) fn requests(&self) -> usize {
        usize::from(self.threads.max(1)) * (1 + 2 * self.node.neighbours_max as usize)
    }

    /// Bytes of a page that a message carries.
    pub(super) fn fragment_bytes(&self) -> Result<u32, ConfigError> {
        let (page_bytes, room) = (self.node.page_bytes, self.message_room);
        match fragment_bytes(page_bytes, room) {
            _ if room == 0 => Ok(page_bytes),
            Some(bytes) if bytes == page_bytes || self.node.fragments => Ok(bytes),
            _ => Err(ConfigError::MessageRoom(room)),
        }
    }

    /// Says whether the parts fit together.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let Self { nodes, renderers, .. } = *self;
        if nodes == 0 || nodes > MAX_NODES {
            return Err(ConfigError::Nodes(nodes));
        }
        if renderers > nodes {
            return Err(ConfigError::Renderers { renderers, nodes });
        }
        let is_none = |node: &NodeId| node.0 >= nodes;
        if let Some(owner) = self.node.placement.owner_ids().find(is_none) {
            return Err(ConfigError::Owner { owner, nodes });
        }
        if let Some(node) = self.faults.schedule.iter().flat_map(|(_, fault)| struck(fault)).find(is_none) {
            return Err(ConfigError::Fault(node));
        }
        let pages = self.node.placement.page_count();
        let has_pages = match &self.workload {
            Workload::Uniform => true,
            Workload::Zipf { exponent } => (0.0..=EXPONENT_MAX).contains(exponent),
            Workload::Window { pages, .. } => *pages > 0,
            Workload::Trace(lists) => {
                let is_good = |list: &Vec<_>| !list.is_empty();
                !lists.is_empty()
                    && lists.iter().all(is_good)
                    && lists.iter().flatten().all(|page| page.0 < pages)
            }
        };
        if has_pages { Ok(()) } else { Err(ConfigError::Workload) }
    }
}

impl Costs {
    /// What was measured on Linux with `userfaultfd` for pages of 16 KB (bench/README.md, `table1`): a trap 1 us, a page put in place
    /// 2 us, a victim 0.5 us, a thread woken 10 us. To answer takes 2 us.
    pub const MEASURED: Self =
        Self { trap_ns: 1_000, serve_ns: 2_000, fill_ns: 2_000, unmap_ns: 500, wake_ns: 10_000 };

    /// Work takes no time.
    pub const NONE: Self = Self { trap_ns: 0, serve_ns: 0, fill_ns: 0, unmap_ns: 0, wake_ns: 0 };
}

/// The nodes that a fault names.
fn struck(fault: &Fault) -> Vec<NodeId> {
    match fault {
        Fault::Crash(node) | Fault::Restart(node) => vec![*node],
        Fault::Slow { node, .. } | Fault::Stall { node, .. } | Fault::ClockJump { node, .. } => vec![*node],
        Fault::Cut(nodes) => nodes.clone(),
        Fault::Heal => Vec::new(),
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nodes(nodes) => write!(f, "{nodes} nodes, and a cluster has 1 to {MAX_NODES}"),
            Self::Renderers { renderers, nodes } => {
                write!(f, "{renderers} nodes are to have threads, and there are {nodes}")
            }
            Self::Owner { owner, nodes } => {
                write!(f, "the placement gives pages to {owner}, and there are {nodes} nodes")
            }
            Self::Placement(error) => write!(f, "{error}"),
            Self::Node(error) => write!(f, "{error}"),
            Self::MessageRoom(room) => {
                write!(
                    f,
                    "pages cannot come in fragments of {room} bytes, or the nodes do not take fragments"
                )
            }
            Self::Workload => {
                write!(f, "the workload touches no page, one that there is not, or is too steep")
            }
            Self::Fault(node) => write!(f, "a fault is to strike {node}, which there is not"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// Nodes times pages up to which invariants are checked after every step.
const SMALL: u64 = 1024;

/// Bytes of a message that carries no page.
#[expect(clippy::cast_possible_truncation, reason = "some dozens")]
pub(super) const MESSAGE_BYTES: u32 = HEADER_BYTES as u32;
