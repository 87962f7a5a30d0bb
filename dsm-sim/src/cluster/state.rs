//! What the world knows: the moment, what is to happen, and each node from outside.

use crate::chance::Chance;
use crate::fault::ChanceKind;
use crate::queue::Queue;
use crate::time::Moment;
use crate::wires::Wires;

#[derive(Debug)]
pub(super) struct Core<M, T> {
    pub(super) now: Moment,
    pub(super) steps: u64,
    pub(super) queue: Queue<Event<M, T>>,
    pub(super) wires: Wires,
    pub(super) stations: Vec<Station>,
}

/// A node as the world sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Station {
    pub(super) incarnation: u16,
    pub(super) is_up: bool,
    pub(super) is_busy: bool,
    pub(super) slow_percent: u32,
    pub(super) stalled_until: Moment,
    /// How far its clock is ahead. It starts at a value of its own, as clocks do.
    pub(super) clock_ahead_us: u64,
    pub(super) grace_ns: u64,
}

#[derive(Clone, Copy, Debug, Hash)]
pub(super) struct Event<M, T> {
    pub(super) node: u16,
    /// Tasks of an incarnation that is gone are dropped.
    pub(super) incarnation: u16,
    pub(super) what: What<M, T>,
}

#[derive(Clone, Copy, Debug, Hash)]
pub(super) enum What<M, T> {
    /// Its last bit is at the receiver's card.
    Arrive {
        from: u16,
        bytes: u32,
        message: M,
    },
    /// The receiver's card has taken it in.
    Deliver {
        from: u16,
        message: M,
    },
    Task(T),
    /// The node is told that another, in that incarnation, is dead.
    PeerDown {
        peer: u16,
        incarnation: u16,
    },
    Fault(Strike),
}

#[derive(Clone, Copy, Debug, Hash)]
pub(super) enum Strike {
    /// The schedule's entry of this number.
    Scheduled(u32),
    Chance(ChanceKind),
    /// The end of a crash or a cut that came by chance.
    Restart(u16),
    Heal,
}

impl<M: Copy, T: Copy> Core<M, T> {
    pub(super) fn push_strike(&mut self, at: Moment, strike: Strike) {
        self.queue.push(at, Event { node: 0, incarnation: 0, what: What::Fault(strike) });
    }
}

impl Station {
    pub(super) fn new(chance: &mut Chance) -> Self {
        Self {
            incarnation: 0,
            is_up: false,
            is_busy: false,
            slow_percent: 100,
            stalled_until: Moment::ZERO,
            clock_ahead_us: chance.below(CLOCK_AHEAD_US_MAX),
            grace_ns: 0,
        }
    }
}

/// More events than this at one moment are a circle: each causes the next, and no time passes.
pub(super) const STEPS_A_MOMENT_MAX: u64 = 1 << 20;

/// Clocks start up to this far apart: 12 days.
const CLOCK_AHEAD_US_MAX: u64 = 1 << 40;
