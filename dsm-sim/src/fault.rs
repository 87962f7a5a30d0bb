//! What goes wrong, when: by a schedule, and by chance.

use dsm_core::id::NodeId;

use crate::chance::Chance;
use crate::time::Moment;

/// Something that goes wrong, or gets well again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A node stops: all it knew and all it was about to do is gone. Down already: nothing.
    Crash(NodeId),
    /// A node that is down starts again, knowing nothing: a new incarnation. Up already: nothing.
    Restart(NodeId),
    /// These nodes and all others no longer hear each other. It replaces an earlier cut.
    Cut(Vec<NodeId>),
    /// Everybody hears everybody again.
    Heal,
    /// All a node does takes so many per cent of its time; 100 is as usual.
    Slow {
        /// The node.
        node: NodeId,
        /// Per cent of the usual time.
        percent: u32,
    },
    /// A node does nothing for a while, and then all that came meanwhile, in order.
    Stall {
        /// The node.
        node: NodeId,
        /// How long.
        ns: u64,
    },
    /// A node's clock jumps, forwards or, when negative, backwards.
    ClockJump {
        /// The node.
        node: NodeId,
        /// Microseconds.
        us: i64,
    },
}

/// All that goes wrong in a run.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// What happens at which moment.
    pub schedule: Vec<(Moment, Fault)>,
    /// What happens by chance.
    pub chances: Chances,
    /// How long after a crash the others are told of it, as the supervisor of processes on one machine does; `None`:
    /// they have to find out by themselves.
    pub tell_deaths_after_ns: Option<u64>,
}

/// What goes wrong by chance. The times between two of a kind are between 0 and twice their mean; a mean of 0 is never.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chances {
    /// Mean time between crashes, each of any node.
    pub crash_every_ns: u64,
    /// How long a crashed node stays down; 0: for ever.
    pub restart_after_ns: u64,
    /// Nodes that are down at the same time, at most. A crash that would be one too many does not happen.
    pub down_max: u16,
    /// Mean time between cuts of the network. There is one cut at a time.
    pub cut_every_ns: u64,
    /// How long a cut stays.
    pub heal_after_ns: u64,
    /// Mean time between stalls, each of any node.
    pub stall_every_ns: u64,
    /// How long a node stalls at most.
    pub stall_ns: u64,
    /// Mean time between jumps of a clock, each of any node's.
    pub jump_every_ns: u64,
    /// How far a clock jumps at most, either way.
    pub jump_us: u32,
}

impl Chances {
    /// Nothing ever.
    pub const NONE: Self = Self {
        crash_every_ns: 0,
        restart_after_ns: 0,
        down_max: 1,
        cut_every_ns: 0,
        heal_after_ns: 0,
        stall_every_ns: 0,
        stall_ns: 0,
        jump_every_ns: 0,
        jump_us: 0,
    };

    /// The time to the next event of a kind, or `None` when there is none.
    pub(crate) fn wait(&self, kind: ChanceKind, chance: &mut Chance) -> Option<u64> {
        let every_ns = match kind {
            ChanceKind::Crash => self.crash_every_ns,
            ChanceKind::Cut => self.cut_every_ns,
            ChanceKind::Stall => self.stall_every_ns,
            ChanceKind::Jump => self.jump_every_ns,
        };
        (every_ns > 0).then(|| 1 + chance.below(every_ns.saturating_mul(2)))
    }
}

impl Default for Chances {
    fn default() -> Self {
        Self::NONE
    }
}

/// The kinds of [`Chances`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ChanceKind {
    Crash,
    Cut,
    Stall,
    Jump,
}

impl ChanceKind {
    pub(crate) const ALL: [Self; 4] = [Self::Crash, Self::Cut, Self::Stall, Self::Jump];
}
