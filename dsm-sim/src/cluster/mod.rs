//! Machines in virtual time: the event core, which knows nothing of pages.
//!
//! An [`Actor`] is one node's machine. It is given messages and its own tasks, one at a time, and sends messages and
//! sets itself tasks through [`Io`]. The cluster owns time, chance, the network and everything that goes wrong.

mod actor;
mod state;
mod step;
mod strikes;

pub use actor::{Actor, Io, View};
pub use step::{Ended, Happened, Step};

use core::hash::Hasher as _;

use dsm_core::id::NodeId;

use crate::chance::Chance;
use crate::fault::Faults;
use crate::network::{Network, Traffic};
use crate::queue::Queue;
use crate::time::Moment;
use crate::trace::Trace;
use crate::wires::{Received, Wires};
use state::{Core, Event, STEPS_A_MOMENT_MAX, Station, What};

/// All that a cluster needs besides its actors.
#[derive(Clone, Debug)]
pub struct Setup {
    /// What lies between the nodes.
    pub network: Network,
    /// What goes wrong.
    pub faults: Faults,
    /// How often invariants are checked.
    pub checks: Checks,
    /// Decides everything that chance decides.
    pub seed: u64,
}

/// How often the invariants of a node are checked. At the end of a run those of all nodes always are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checks {
    /// After every event, of the node it happened to.
    EveryStep,
    /// After one event of so many.
    OneIn(u32),
    /// Not on the way.
    AtEnd,
}

/// A cluster of actors.
#[derive(Debug)]
pub struct Cluster<A: Actor> {
    actors: Vec<A>,
    core: Core<A::Message, A::Task>,
    faults: Faults,
    chance: Chance,
    checks: Checks,
    until_check: u32,
    trace: Trace,
    /// The step at which the moment began.
    moment_began: u64,
    /// Nodes that are not done and are up or will be.
    busy: usize,
}

impl<A: Actor> Cluster<A> {
    /// A cluster of these nodes, each of which has been started.
    ///
    /// # Panics
    /// When there are more nodes than [`MAX_NODES`](dsm_core::id::MAX_NODES).
    pub fn new(setup: Setup, actors: Vec<A>) -> Self {
        assert!(actors.len() <= usize::from(dsm_core::id::MAX_NODES), "a cluster of {} nodes", actors.len());
        let Setup { network, mut faults, checks, seed } = setup;
        faults.schedule.sort_by_key(|(at, _)| *at);
        let count = u16::try_from(actors.len()).unwrap_or(u16::MAX);
        let mut chance = Chance::new(seed, stream::WORLD);
        let stations = (0..count).map(|_| Station::new(&mut chance)).collect();
        let wires = Wires::new(network, count, Chance::new(seed, stream::NETWORK));
        let core = Core { now: Moment::ZERO, steps: 0, queue: Queue::new(), wires, stations };
        let trace = Trace::default();
        let mut cluster =
            Self { busy: 0, actors, core, faults, chance, checks, until_check: 1, trace, moment_began: 0 };
        cluster.plan_faults();
        for node in (0..count).map(NodeId) {
            cluster.start(node);
        }
        cluster
    }

    /// Lets things happen until all are done, or until this moment.
    pub fn run(&mut self, until: Moment) -> Ended {
        loop {
            if self.busy == 0 {
                return Ended::Done;
            }
            match self.step() {
                None => return Ended::Stuck,
                Some(step) if step.at > until => return Ended::TimeOver,
                Some(_) => {}
            }
        }
    }

    /// Lets the next thing happen, or returns `None` when nothing ever will.
    ///
    /// # Panics
    /// When an invariant does not hold, and by the name of `TIME_MOVES_ON` when events follow each other for ever
    /// without any time passing.
    pub fn step(&mut self) -> Option<Step<A::Message, A::Task>> {
        let (at, event) = self.core.queue.pop()?;
        self.count_step(at);
        self.trace.record(&(at.as_ns(), event));
        let node = NodeId(event.node);
        let what = match event.what {
            What::Fault(strike) => self.strike(strike),
            What::Arrive { from, bytes, message } => self.arrive(event, NodeId(from), bytes, message),
            What::Deliver { .. } | What::Task(_) | What::PeerDown { .. } => self.give(event),
        };
        self.check_if_due(node);
        Some(Step { number: self.core.steps, at, node, what })
    }

    /// Whether every node is done.
    pub const fn is_done(&self) -> bool {
        self.busy == 0
    }

    /// Checks the invariants of all nodes.
    ///
    /// # Panics
    /// When one does not hold.
    pub fn check_invariants(&self) {
        (0..).map(NodeId).zip(&self.actors).for_each(|(node, actor)| actor.check_invariants(self.view(node)));
    }

    /// The nodes' machines.
    pub fn actors(&self) -> &[A] {
        &self.actors
    }

    /// The moment.
    pub const fn now(&self) -> Moment {
        self.core.now
    }

    /// Things that have happened.
    pub const fn steps(&self) -> u64 {
        self.core.steps
    }

    /// All that has happened as one number: equal when two runs were the same, event for event.
    pub fn trace(&self) -> u64 {
        self.trace.finish()
    }

    /// What the network has done for a node.
    pub fn traffic(&self, node: NodeId) -> Traffic {
        self.core.wires.traffic(node)
    }

    /// Whether a node is up.
    pub fn is_up(&self, node: NodeId) -> bool {
        self.core.stations[node.index()].is_up
    }

    /// How often a node has been started.
    pub fn starts(&self, node: NodeId) -> u16 {
        self.core.stations[node.index()].incarnation
    }

    fn count_step(&mut self, at: Moment) {
        self.core.steps += 1;
        if at > self.core.now {
            (self.core.now, self.moment_began) = (at, self.core.steps);
        }
        let steps = self.core.steps - self.moment_began;
        assert!(steps < STEPS_A_MOMENT_MAX, "TIME_MOVES_ON: {steps} events at {at}, and ever more follow");
    }

    fn arrive(
        &mut self,
        event: Event<A::Message, A::Task>,
        from: NodeId,
        bytes: u32,
        message: A::Message,
    ) -> Happened<A::Message, A::Task> {
        let event = Event { what: What::Deliver { from: from.0, message }, ..event };
        match self.core.wires.receive(self.core.now, from, NodeId(event.node), bytes) {
            Received::Now => self.give(event),
            Received::Lost => Happened::Lost,
            Received::At(moment) => {
                self.core.queue.push(moment, event);
                Happened::Held
            }
        }
    }

    /// Gives a message or a task to its node, if that is there to take it.
    fn give(&mut self, event: Event<A::Message, A::Task>) -> Happened<A::Message, A::Task> {
        let node = NodeId(event.node);
        let station = self.core.stations[node.index()];
        if !station.is_up {
            if let What::Deliver { .. } = event.what {
                self.core.wires.count_unheard(node);
            }
            return Happened::Lost;
        }
        if station.stalled_until > self.core.now {
            self.core.queue.push(station.stalled_until, event);
            return Happened::Held;
        }
        if !self.is_current(event) {
            return Happened::Lost;
        }
        let actor = &mut self.actors[node.index()];
        let mut io = Io { me: node, core: &mut self.core };
        let happened = match event.what {
            What::Deliver { from, message } => {
                actor.handle_message(&mut io, NodeId(from), message);
                Happened::Message { from: NodeId(from), message }
            }
            What::Task(task) => {
                actor.handle_task(&mut io, task);
                Happened::Task(task)
            }
            What::PeerDown { peer, .. } => {
                actor.handle_peer_down(&mut io, NodeId(peer));
                Happened::PeerDown(NodeId(peer))
            }
            What::Arrive { .. } | What::Fault(_) => Happened::Lost,
        };
        self.note_if_busy(node, false);
        happened
    }

    /// Whether the node it is for, and the one it is about, are still those they were.
    fn is_current(&self, event: Event<A::Message, A::Task>) -> bool {
        match event.what {
            What::Task(_) => self.core.stations[usize::from(event.node)].incarnation == event.incarnation,
            What::PeerDown { peer, incarnation } => {
                let peer = &self.core.stations[usize::from(peer)];
                !peer.is_up && peer.incarnation == incarnation
            }
            What::Arrive { .. } | What::Deliver { .. } | What::Fault(_) => true,
        }
    }

    fn check_if_due(&mut self, node: NodeId) {
        let every = match self.checks {
            Checks::EveryStep => 1,
            Checks::OneIn(count) => count.max(1),
            Checks::AtEnd => return,
        };
        self.until_check -= 1;
        if self.until_check == 0 {
            self.until_check = every;
            self.actors[node.index()].check_invariants(self.view(node));
        }
    }

    fn view(&self, node: NodeId) -> View {
        View { now: self.core.now, grace_ns: self.core.stations[node.index()].grace_ns }
    }

    /// Counts the node as busy or not. One that is down is busy when it will come back.
    fn note_if_busy(&mut self, node: NodeId, comes_back: bool) {
        let station = &mut self.core.stations[node.index()];
        let is_busy = if station.is_up { !self.actors[node.index()].is_done() } else { comes_back };
        self.busy = self.busy + usize::from(is_busy) - usize::from(station.is_busy);
        station.is_busy = is_busy;
    }
}

/// The streams of chance of a seed. Actors take theirs from [`ACTORS`](stream::ACTORS) on.
pub mod stream {
    /// What goes wrong.
    pub(super) const WORLD: u64 = 0;
    /// What the links do.
    pub(super) const NETWORK: u64 = 1;
    /// The first that is free for actors.
    pub const ACTORS: u64 = 1 << 32;
}
