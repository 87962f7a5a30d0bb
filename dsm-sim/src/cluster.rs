//! Machines in virtual time: the event core, which knows nothing of pages.
//!
//! An [`Actor`] is one node's machine. It is given messages and its own tasks, one at a time, and sends messages and
//! sets itself tasks through [`Io`]. The cluster owns time, chance, the network and everything that goes wrong.

use core::fmt;
use core::hash::{Hash, Hasher as _};

use dsm_core::id::NodeId;
use dsm_core::time::Instant;

use crate::chance::Chance;
use crate::fault::{ChanceKind, Fault, Faults};
use crate::network::{Network, Received, Traffic, Wires};
use crate::queue::Queue;
use crate::time::Moment;
use crate::trace::Trace;

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

    /// Somebody who knows says that `peer` is dead. See [`Faults::tell_deaths_after_ns`].
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

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// Every node is done.
    Done,
    /// The time given is over.
    TimeOver,
    /// Nothing more will ever happen, and yet somebody is not done.
    Stuck,
}

/// One thing that happened.
#[derive(Clone, Copy, Debug)]
pub struct Step<M, T> {
    /// The how manieth thing in this run, from 1.
    pub number: u64,
    /// When.
    pub at: Moment,
    /// To whom. Node 0 when it concerns all.
    pub node: NodeId,
    /// What.
    pub what: Happened<M, T>,
}

/// What can happen.
#[derive(Clone, Copy, Debug)]
pub enum Happened<M, T> {
    /// A message was taken in.
    Message {
        /// Its sender.
        from: NodeId,
        /// The message.
        message: M,
    },
    /// A task was done.
    Task(T),
    /// The node was told that another is dead.
    PeerDown(NodeId),
    /// A message or task waits for a busy card or for a stalled node.
    Held,
    /// A message or task came to nothing: cut off, no room, or the node is down or a new one.
    Lost,
    /// The node went down.
    Crashed,
    /// The node started again.
    Restarted,
    /// Another fault of the world, or its end.
    Fault,
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

/// What an actor can do to the world while it handles something.
#[derive(Debug)]
pub struct Io<'a, M, T> {
    me: NodeId,
    core: &'a mut Core<M, T>,
}

#[derive(Debug)]
struct Core<M, T> {
    now: Moment,
    steps: u64,
    queue: Queue<Event<M, T>>,
    wires: Wires,
    stations: Vec<Station>,
}

/// A node as the world sees it.
#[derive(Clone, Copy, Debug)]
struct Station {
    incarnation: u16,
    is_up: bool,
    is_busy: bool,
    slow_percent: u32,
    stalled_until: Moment,
    /// How far its clock is ahead. It starts at a value of its own, as clocks do.
    clock_ahead_us: u64,
    grace_ns: u64,
}

#[derive(Clone, Copy, Debug, Hash)]
struct Event<M, T> {
    node: u16,
    /// Tasks of an incarnation that is gone are dropped.
    incarnation: u16,
    what: What<M, T>,
}

#[derive(Clone, Copy, Debug, Hash)]
enum What<M, T> {
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
enum Strike {
    /// The schedule's entry of this number.
    Scheduled(u32),
    Chance(ChanceKind),
    /// The end of a crash or a cut that came by chance.
    Restart(u16),
    Heal,
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

    fn plan_faults(&mut self) {
        for (number, (at, _)) in (0..).zip(&self.faults.schedule) {
            self.core.push_strike(*at, Strike::Scheduled(number));
        }
        for kind in ChanceKind::ALL {
            self.plan_next(kind);
        }
    }

    fn plan_next(&mut self, kind: ChanceKind) {
        if let Some(ns) = self.faults.chances.wait(kind, &mut self.chance) {
            self.core.push_strike(self.core.now.after(ns), Strike::Chance(kind));
        }
    }

    fn strike(&mut self, strike: Strike) -> Happened<A::Message, A::Task> {
        match strike {
            Strike::Scheduled(number) => {
                let (_, fault) = self.faults.schedule[number as usize].clone();
                let comes_back = |fault: &Fault, node| *fault == Fault::Restart(node);
                let later = &self.faults.schedule[number as usize + 1..];
                let comes_back = match fault {
                    Fault::Crash(node) => later.iter().any(|(_, fault)| comes_back(fault, node)),
                    _ => false,
                };
                self.apply(&fault, comes_back)
            }
            Strike::Chance(kind) => {
                self.plan_next(kind);
                self.strike_by_chance(kind)
            }
            Strike::Restart(node) => self.apply(&Fault::Restart(NodeId(node)), false),
            Strike::Heal => self.apply(&Fault::Heal, false),
        }
    }

    fn strike_by_chance(&mut self, kind: ChanceKind) -> Happened<A::Message, A::Task> {
        let chances = self.faults.chances;
        let node = self.any_node();
        match kind {
            ChanceKind::Crash => {
                let down = self.core.stations.iter().filter(|station| !station.is_up).count();
                if down >= usize::from(chances.down_max) || !self.is_up(node) {
                    return Happened::Fault;
                }
                if chances.restart_after_ns > 0 {
                    let back = self.core.now.after(chances.restart_after_ns);
                    self.core.push_strike(back, Strike::Restart(node.0));
                }
                self.apply(&Fault::Crash(node), chances.restart_after_ns > 0)
            }
            ChanceKind::Cut if self.core.wires.is_cut() => Happened::Fault,
            ChanceKind::Cut => {
                let heals = self.core.now.after(chances.heal_after_ns);
                self.core.push_strike(heals, Strike::Heal);
                let apart = (0..=self.actors.len() / 4).map(|_| self.any_node()).collect();
                self.apply(&Fault::Cut(apart), false)
            }
            ChanceKind::Stall => {
                let ns = self.chance.below(chances.stall_ns);
                self.apply(&Fault::Stall { node, ns }, false)
            }
            ChanceKind::Jump => {
                let far = i64::from(chances.jump_us);
                let us = i64::try_from(self.chance.below(2 * u64::from(chances.jump_us))).unwrap_or(0) - far;
                self.apply(&Fault::ClockJump { node, us }, false)
            }
        }
    }

    fn apply(&mut self, fault: &Fault, comes_back: bool) -> Happened<A::Message, A::Task> {
        let now = self.core.now;
        match fault {
            Fault::Crash(node) => return self.crash(*node, comes_back),
            Fault::Restart(node) if self.is_up(*node) => {}
            Fault::Restart(node) => {
                self.start(*node);
                return Happened::Restarted;
            }
            Fault::Cut(apart) => self.core.wires.cut(|node| apart.contains(&node)),
            Fault::Heal => self.core.wires.cut(|_| false),
            Fault::Slow { node, percent } => self.core.stations[node.index()].slow_percent = *percent,
            Fault::Stall { node, ns } => {
                let station = &mut self.core.stations[node.index()];
                station.stalled_until = station.stalled_until.max(now.after(*ns));
                station.grace_ns = station.grace_ns.saturating_add(*ns);
            }
            Fault::ClockJump { node, us } => {
                let station = &mut self.core.stations[node.index()];
                station.clock_ahead_us = station.clock_ahead_us.saturating_add_signed(*us);
                station.grace_ns = station.grace_ns.saturating_add(us.unsigned_abs().saturating_mul(1_000));
            }
        }
        Happened::Fault
    }

    fn crash(&mut self, node: NodeId, comes_back: bool) -> Happened<A::Message, A::Task> {
        if !self.is_up(node) {
            return Happened::Fault;
        }
        self.core.stations[node.index()].is_up = false;
        self.actors[node.index()].handle_crash();
        self.note_if_busy(node, comes_back);
        self.tell_death(node);
        Happened::Crashed
    }

    /// Has the others told, if anybody tells them.
    fn tell_death(&mut self, dead: NodeId) {
        let Some(ns) = self.faults.tell_deaths_after_ns else { return };
        let at = self.core.now.after(ns);
        let what = What::PeerDown { peer: dead.0, incarnation: self.core.stations[dead.index()].incarnation };
        for node in (0..).take(self.actors.len()).filter(|node| *node != dead.0) {
            self.core.queue.push(at, Event { node, incarnation: 0, what });
        }
    }

    fn start(&mut self, node: NodeId) {
        let station = &mut self.core.stations[node.index()];
        station.is_up = true;
        station.incarnation += 1;
        station.stalled_until = self.core.now;
        self.actors[node.index()].handle_start(&mut Io { me: node, core: &mut self.core });
        self.note_if_busy(node, false);
    }

    fn any_node(&mut self) -> NodeId {
        NodeId(u16::try_from(self.chance.below(self.actors.len() as u64)).unwrap_or(0))
    }
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

impl<M: Copy, T: Copy> Core<M, T> {
    fn push_strike(&mut self, at: Moment, strike: Strike) {
        self.queue.push(at, Event { node: 0, incarnation: 0, what: What::Fault(strike) });
    }
}

impl Station {
    fn new(chance: &mut Chance) -> Self {
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
const STEPS_A_MOMENT_MAX: u64 = 1 << 20;

/// Clocks start up to this far apart: 12 days.
const CLOCK_AHEAD_US_MAX: u64 = 1 << 40;

/// The streams of chance of a seed. Actors take theirs from [`ACTORS`](stream::ACTORS) on.
pub mod stream {
    /// What goes wrong.
    pub(super) const WORLD: u64 = 0;
    /// What the links do.
    pub(super) const NETWORK: u64 = 1;
    /// The first that is free for actors.
    pub const ACTORS: u64 = 1 << 32;
}
