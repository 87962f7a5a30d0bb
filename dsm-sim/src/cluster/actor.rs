//! The machine of a node, and what it can do to the world.

use core::fmt;
use core::hash::Hash;

use dsm_core::id::NodeId;
use dsm_core::time::Instant;

use super::state::{Core, Event, Station, What};
use crate::time::Moment;

/// The machine of one node: what it does when something happens to it.
///
/// It must be deterministic: no clock, no chance and no memory addresses but those of [`Io`].
pub trait Actor {
    /// What nodes send each other. Small and [`Copy`]: the bytes of a page are a number that stands for them.
    type Message: Copy + Hash + fmt::Debug;
    /// What a node sets itself to do later: a timer, a piece of work that takes time.
    type Task: Copy + Hash + fmt::Debug;

    /// The node starts, for the first time or anew after a crash.
    fn handle_start(&mut self, io: &mut Io<'_, Self::Message, Self::Task>);

    /// A message arrived.
    fn handle_message(
        &mut self,
        io: &mut Io<'_, Self::Message, Self::Task>,
        from: NodeId,
        message: Self::Message,
    );

    /// The moment of a task has come.
    fn handle_task(&mut self, io: &mut Io<'_, Self::Message, Self::Task>, task: Self::Task);

    /// The node stops; its tasks are gone already. It hears nothing until it is started again.
    fn handle_crash(&mut self);

    /// Somebody who knows says that `peer` is dead. See
    /// [`tell_deaths_after_ns`](crate::fault::Faults::tell_deaths_after_ns).
    fn handle_peer_down(&mut self, _io: &mut Io<'_, Self::Message, Self::Task>, _peer: NodeId) {}

    /// Whether it has done all that it is there for. The run ends when every node that is up, or will be, says so.
    fn is_done(&self) -> bool;

    /// Checks what must always hold.
    ///
    /// # Panics
    /// When something does not; the message begins with its name.
    fn check_invariants(&self, _view: View) {}
}

/// What a check may know of the world.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The moment.
    pub now: Moment,
    /// How long this node was held up by faults of the world so far: stalls, and jumps of its clock.
    pub grace_ns: u64,
}

/// What an actor can do to the world while it handles something.
#[derive(Debug)]
pub struct Io<'a, M, T> {
    pub(super) me: NodeId,
    pub(super) core: &'a mut Core<M, T>,
}

impl<M: Copy, T: Copy> Io<'_, M, T> {
    /// Sends a message of so many bytes. It may be lost, doubled or overtaken.
    pub fn send(&mut self, to: NodeId, bytes: u32, message: M) {
        if to.index() >= self.core.stations.len() {
            return;
        }
        let event =
            Event { node: to.0, incarnation: 0, what: What::Arrive { from: self.me.0, bytes, message } };
        let sent = self.core.wires.send(self.core.now, self.me, to, bytes);
        for arrives in [sent.arrives, sent.arrives_again].into_iter().flatten() {
            self.core.queue.push(arrives, event);
        }
    }

    /// Has a task done after so many nanoseconds of work, more when the node is slow.
    pub fn work(&mut self, ns: u64, task: T) {
        let ns = self.time_of_work(ns);
        self.at(self.core.now.after(ns), task);
    }

    /// How long so many nanoseconds of work take this node.
    #[must_use]
    pub fn time_of_work(&self, ns: u64) -> u64 {
        ns.saturating_mul(u64::from(self.station().slow_percent)) / 100
    }

    /// Has a task done when this node's clock shows at least `instant`. If the clock jumps meanwhile, that is not
    /// noticed: the task comes early or late.
    pub fn at_clock(&mut self, instant: Instant, task: T) {
        self.at(self.moment_of(instant), task);
    }

    /// Has a task done at a moment, or now when that is past.
    pub fn at(&mut self, moment: Moment, task: T) {
        let event =
            Event { node: self.me.0, incarnation: self.station().incarnation, what: What::Task(task) };
        self.core.queue.push(moment.max(self.core.now), event);
    }

    /// The moment, as only the world knows it.
    #[must_use]
    pub const fn now(&self) -> Moment {
        self.core.now
    }

    /// What this node's clock shows.
    #[must_use]
    pub fn clock(&self) -> Instant {
        Instant::from_micros(self.core.now.as_ns() / 1_000).after(self.station().clock_ahead_us)
    }

    /// The moment at which this node's clock will show at least `instant`, unless it jumps.
    #[must_use]
    pub fn moment_of(&self, instant: Instant) -> Moment {
        let us = instant.as_micros().saturating_sub(self.station().clock_ahead_us);
        Moment::from_ns(us.saturating_mul(1_000))
    }

    /// This node's number.
    #[must_use]
    pub const fn me(&self) -> NodeId {
        self.me
    }

    /// The how manieth start of this node this is, from 1.
    #[must_use]
    pub fn incarnation(&self) -> u16 {
        self.station().incarnation
    }

    fn station(&self) -> &Station {
        &self.core.stations[self.me.index()]
    }
}
