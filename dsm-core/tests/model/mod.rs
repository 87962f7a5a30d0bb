//! The model: a world, how much may go wrong in it, and the properties.
#![allow(dead_code, reason = "each test file uses its own part")]

use core::hash::{Hash, Hasher};
use core::panic::AssertUnwindSafe;
use std::panic::catch_unwind;

use dsm_ops::{Op, Setup, Stray, Tally, World};
use stateright::{Checker, HasDiscoveries, Model, Property};

/// What is explored.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cluster {
    pub(crate) replicas: u8,
    pub(crate) fragments: u8,
    pub(crate) threads: u8,
    /// Threads ask for pages before they touch them, too.
    pub(crate) asks_ahead: bool,
    pub(crate) budget: Budget,
}

/// How often what may go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Budget {
    pub(crate) losses: u8,
    pub(crate) duplicates: u8,
    pub(crate) early_timers: u8,
    pub(crate) crashes: u8,
    pub(crate) restarts: u8,
}

/// A state: a world, what may still go wrong, and what has been reached on the way here.
#[derive(Clone, Debug)]
pub(crate) struct State {
    world: World,
    budget: Budget,
    reached: Reached,
    broken: Option<String>,
}

/// What has happened on the way to a state, as far as a property asks for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Reached {
    eviction: bool,
    failover: bool,
    death: bool,
    restart: bool,
    late: bool,
    adoption: bool,
    abandonment: bool,
}

/// What came of it.
#[derive(Debug)]
pub(crate) struct Explored {
    pub(crate) states: usize,
    pub(crate) transitions: usize,
    /// What did not hold somewhere, and the way there.
    pub(crate) broken: Option<String>,
    /// What should have been reachable and was not.
    pub(crate) unreached: Vec<&'static str>,
}

/// A protocol with a fault may reach states without end.
const TRANSITIONS_MAX: usize = 300_000;

const SAFE: &str = "every invariant holds";
const NO_PAGE_LOST: &str = "no page with a live copy fails";
const NO_WAITER_LOST: &str = "whoever waits is served in the end";

/// Replacement is at work.
const EVICTION: &str = "a page is evicted";
pub(crate) const FAILOVER: &str = "another copy is asked";
pub(crate) const DEATH: &str = "a peer is found dead";
pub(crate) const RETURN: &str = "a new incarnation answers";
pub(crate) const LATE: &str = "an answer comes late";
pub(crate) const ADOPTION: &str = "a fault finds its page asked for ahead";
pub(crate) const ABANDONMENT: &str = "a page asked for ahead is given up";

impl Cluster {
    /// What the protocol is asked to survive first of all.
    pub(crate) const TWO_THREADS: Self = Self {
        replicas: 2,
        fragments: 1,
        threads: 2,
        asks_ahead: false,
        budget: Budget { losses: 1, crashes: 1, ..Budget::NONE },
    };
    /// With all that follows from coming back.
    pub(crate) const RETURN: Self = Self {
        threads: 1,
        budget: Budget { losses: 1, crashes: 1, restarts: 1, ..Budget::NONE },
        ..Self::TWO_THREADS
    };
    /// Pages come before they are touched, too.
    pub(crate) const AHEAD: Self = Self { asks_ahead: true, ..Self::TWO_THREADS };
    /// Pages in two parts.
    pub(crate) const FRAGMENTS: Self = Self { fragments: 2, threads: 1, ..Self::TWO_THREADS };
    /// Every page is lost with its home.
    pub(crate) const ONE_COPY: Self =
        Self { replicas: 1, threads: 1, budget: Budget { crashes: 1, ..Budget::NONE }, ..Self::TWO_THREADS };
    /// What was asked for ahead may be lost with its home, before or after somebody misses it.
    pub(crate) const AHEAD_ONE_COPY: Self = Self { asks_ahead: true, ..Self::ONE_COPY };
}

impl Budget {
    pub(crate) const NONE: Self = Self { losses: 0, duplicates: 0, early_timers: 0, crashes: 0, restarts: 0 };
}

impl Model for Cluster {
    type State = State;
    type Action = Op;

    fn init_states(&self) -> Vec<State> {
        let setup = Setup {
            nodes: 3,
            owners: 2,
            pages: 2,
            stripe_pages: 1,
            replicas: self.replicas,
            threads: self.threads,
            slots: 1,
            requests: 2,
            fragments: self.fragments,
            tries: 1,
            is_rigid: true,
            // Who asks ahead for what cannot be had may ask again and again, until the owner is dead to it.
            buries_early: self.replicas > 1 || self.asks_ahead,
            ..Setup::SMALL
        };
        vec![State {
            world: World::new(setup),
            budget: self.budget,
            reached: Reached::default(),
            broken: None,
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Op>) {
        if state.broken.is_some() {
            return;
        }
        let Budget { losses, duplicates, early_timers, crashes, restarts } = state.budget;
        // The owners only own: with one copy each would read the other's page, and nothing new would come of it.
        let is_wanted = |op: &Op| !matches!(op, Op::Read { node: 1.., .. });
        actions.extend(state.world.enabled().into_iter().filter(is_wanted));
        if self.asks_ahead {
            actions.extend(state.world.asking_ahead().into_iter().filter(is_wanted));
        }
        let is_early = |(_, is_early): &(Op, bool)| !is_early || early_timers > 0;
        actions.extend(state.world.timers().into_iter().filter(is_early).map(|(op, _)| op));
        for message in (0..state.world.message_count()).filter_map(|index| u8::try_from(index).ok()) {
            actions.extend((losses > 0).then_some(Op::Drop(message)));
            actions.extend((duplicates > 0).then_some(Op::Duplicate(message)));
            // As many as there may be: they change nothing.
            actions.extend(Stray::ALL.map(|how| Op::Stray { message, how }));
        }
        for owner in 1..3 {
            actions.extend((crashes > 0).then_some(Op::Crash(owner)));
            if !state.world.is_alive(owner) {
                actions.extend((restarts > 0).then_some(Op::Restart(owner)));
                actions.push(Op::TellDown { node: 0, of: owner });
            }
        }
    }

    fn next_state(&self, last: &State, action: Op) -> Option<State> {
        let mut next = last.clone();
        next.budget.spend(action, &last.world);
        let applied = catch_unwind(AssertUnwindSafe(|| next.world.apply(action)));
        if let Err(panic) = applied {
            // Where it broke off it is good for nothing; the last good world stands for it.
            next.world = last.world.clone();
            next.broken = Some(text_of(&*panic));
            return Some(next);
        }
        next.reached.note(next.world.tally());
        Some(next)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(SAFE, |_, state: &State| state.broken.is_none()),
            Property::always(NO_PAGE_LOST, |model: &Self, state: &State| {
                model.replicas < 2 || state.broken.is_some() || state.world.failed == 0
            }),
            Property::always(NO_WAITER_LOST, |_, state: &State| {
                state.broken.is_some() || state.world.is_at_rest() || state.can_go_on()
            }),
            Property::sometimes(EVICTION, |_, state: &State| state.reached.eviction),
            Property::sometimes(FAILOVER, |_, state: &State| state.reached.failover),
            Property::sometimes(DEATH, |_, state: &State| state.reached.death),
            Property::sometimes(RETURN, |_, state: &State| state.reached.restart),
            Property::sometimes(LATE, |_, state: &State| state.reached.late),
            Property::sometimes(ADOPTION, |_, state: &State| state.reached.adoption),
            Property::sometimes(ABANDONMENT, |_, state: &State| state.reached.abandonment),
        ]
    }
}

impl State {
    /// Whether something is due that does not depend on anything else going wrong.
    fn can_go_on(&self) -> bool {
        self.world.message_count() > 0
            || self.world.enabled().iter().any(|op| matches!(op, Op::Finish { .. }))
            || !self.world.timers().is_empty()
    }
}

impl Budget {
    fn spend(&mut self, action: Op, world: &World) {
        match action {
            Op::Drop(_) => self.losses -= 1,
            Op::Duplicate(_) => self.duplicates -= 1,
            Op::Crash(_) => self.crashes -= 1,
            Op::Restart(_) => self.restarts -= 1,
            Op::Timer { .. } => {
                let is_early = world.timers().into_iter().any(|(op, is_early)| op == action && is_early);
                self.early_timers -= u8::from(is_early);
            }
            _ => {}
        }
    }
}

impl Reached {
    fn note(&mut self, tally: Tally) {
        self.eviction |= tally.evicted_pages > 0;
        self.failover |= tally.failovers > 0;
        self.death |= tally.dead_peers > 0;
        self.restart |= tally.restarts > 0 && tally.fetched_pages > 0;
        self.late |= tally.late_answers > 0;
        self.adoption |= tally.adopted_requests > 0;
        self.abandonment |= tally.abandoned_requests > 0;
    }
}

impl Hash for State {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.world.fingerprint(), self.budget, self.broken.is_some()).hash(state);
        (self.world.failed > 0).hash(state);
    }
}

impl PartialEq for State {
    fn eq(&self, other: &Self) -> bool {
        self.world.fingerprint() == other.world.fingerprint() && self.budget == other.budget
    }
}

/// Looks at every state; or, if that is enough, at so many that a fault shows which shows at all.
pub(crate) fn explore(cluster: Cluster, until_broken: bool) -> Explored {
    let checker = cluster.checker().threads(2);
    let checker = if until_broken {
        checker.finish_when(HasDiscoveries::AnyFailures).target_state_count(TRANSITIONS_MAX)
    } else {
        checker
    };
    let checker = checker.spawn_bfs().join();
    let mut broken = None;
    for name in [SAFE, NO_PAGE_LOST, NO_WAITER_LOST] {
        if let Some(path) = checker.discovery(name) {
            let why = path.last_state().broken.clone().unwrap_or_default();
            broken.get_or_insert(format!("{name}: {why}\n{:?}", path.into_actions()));
        }
    }
    let reachable = [EVICTION, FAILOVER, DEATH, RETURN, LATE, ADOPTION, ABANDONMENT];
    let unreached = reachable.into_iter().filter(|name| checker.discovery(name).is_none()).collect();
    Explored { states: checker.unique_state_count(), transitions: checker.state_count(), broken, unreached }
}

/// What a panic said.
pub(crate) fn text_of(panic: &(dyn core::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default()
}
