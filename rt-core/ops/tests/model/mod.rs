//! The model: a world by the way that leads to it, how much may go wrong in it, and the properties.
#![allow(dead_code, reason = "each test file uses its own part")]

use core::hash::{Hash, Hasher};
use core::panic::AssertUnwindSafe;
use std::panic::catch_unwind;

use balance_ops::{Memory, Op, Setup, Tally, World};
use rt_core::schedule::Balancer;
use stateright::{Checker, HasDiscoveries, Model, Property};

/// What is explored: nodes of one thread that draw a frame of a few tiles beside each other, or several.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cluster {
    pub(crate) nodes: u8,
    pub(crate) tiles: u8,
    pub(crate) balancer: Balancer,
    /// Tiles may be lost on their way to the display, which confirms those that come.
    pub(crate) confirms: bool,
    pub(crate) frames: u8,
    pub(crate) shares_cores: bool,
    pub(crate) budget: Budget,
}

/// How often what may go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Budget {
    pub(crate) losses: u8,
    pub(crate) duplicates: u8,
    pub(crate) crashes: u8,
}

/// A state: the operations that lead to it, and what they come to.
#[derive(Clone, Debug)]
pub(crate) struct State {
    ops: Vec<Op>,
    fingerprint: u64,
    budget: Budget,
    frames_left: u8,
    /// What can happen next, whether it goes wrong or not.
    actions: Vec<Op>,
    missing: u32,
    tally: Tally,
    is_stuck: bool,
    broken: Option<String>,
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
const TRANSITIONS_MAX: usize = 100_000;

const SAFE: &str = "every invariant holds";
const GOES_ON: &str = "as long as tiles are missing something is due";

pub(crate) const STOLEN: &str = "a tile was stolen";
pub(crate) const REDRAWN: &str = "a frame became whole with tiles of a dead node";
pub(crate) const REFUSED: &str = "something was refused";
pub(crate) const WHOLE: &str = "the last frame became whole";

impl Cluster {
    /// Two nodes that take from each other, and nothing goes wrong. Tiles are not lost, as between processes of a machine.
    pub(crate) const CALM: Self = Self {
        nodes: 2,
        tiles: 3,
        balancer: Balancer::StealNear,
        confirms: false,
        frames: 1,
        shares_cores: false,
        budget: Budget::NONE,
    };
    pub(crate) const DEATH: Self = Self { budget: Budget { crashes: 1, ..Budget::NONE }, ..Self::CALM };
    pub(crate) const LOSS: Self = Self { budget: Budget { losses: 1, ..Budget::NONE }, ..Self::CALM };
    pub(crate) const DOUBLE: Self = Self { budget: Budget { duplicates: 1, ..Budget::NONE }, ..Self::CALM };
    /// Tiles may be lost, too.
    pub(crate) const TILE_LOSS: Self = Self { confirms: true, tiles: 2, ..Self::LOSS };
    pub(crate) const TILE_DEATH: Self = Self { confirms: true, tiles: 2, ..Self::DEATH };
    pub(crate) const DEMAND: Self = Self {
        balancer: Balancer::Demand { window: 1 },
        budget: Budget { losses: 1, crashes: 1, ..Budget::NONE },
        ..Self::TILE_LOSS
    };
    /// Nodes share cores: who has nothing waits before it asks.
    pub(crate) const SHARED_CORES: Self = Self { shares_cores: true, ..Self::DEATH };
    /// What is left under way of a frame when the next begins.
    pub(crate) const TWO_FRAMES: Self = Self { frames: 2, tiles: 2, ..Self::DOUBLE };
}

impl Budget {
    pub(crate) const NONE: Self = Self { losses: 0, duplicates: 0, crashes: 0 };

    fn spend(&mut self, action: Op) {
        match action {
            Op::Drop(_) => self.losses -= 1,
            Op::Duplicate(_) => self.duplicates -= 1,
            Op::Crash(_) => self.crashes -= 1,
            _ => {}
        }
    }
}

impl Cluster {
    const fn setup(&self) -> Setup {
        Setup {
            nodes: self.nodes,
            columns: self.tiles,
            rows: 1,
            threads: 1,
            shares_cores: self.shares_cores,
            balancer: self.balancer,
            confirms: self.confirms,
            is_pageless: true,
        }
    }

    /// The state that operations lead to, of which all but the last are known to break nothing.
    fn state(&self, ops: Vec<Op>, budget: Budget, frames_left: u8) -> State {
        let mut state = State {
            ops,
            fingerprint: 0,
            budget,
            frames_left,
            actions: Vec::new(),
            missing: 0,
            tally: Tally::default(),
            is_stuck: false,
            broken: None,
        };
        let applied = catch_unwind(AssertUnwindSafe(|| {
            let setup = self.setup();
            let mut memory = Memory::new(&setup);
            let mut world = World::new(setup, &mut memory);
            if let Some((last, before)) = state.ops.split_last() {
                before.iter().for_each(|op| world.apply_unchecked(*op));
                world.apply(*last);
            }
            self.look(&mut world, &mut state);
        }));
        if let Err(panic) = applied {
            state.broken = Some(text_of(&*panic));
            state.actions.clear();
        }
        state
    }

    /// Notes what a world is, and what can happen in it.
    fn look(&self, world: &mut World<'_>, state: &mut State) {
        let Budget { losses, duplicates, crashes } = state.budget;
        let messages = world.distinct_messages();
        let is_one_of = |op: &Op| !matches!(op, Op::Deliver(message) if !messages.contains(message));
        let mut actions: Vec<Op> = world.enabled().into_iter().filter(is_one_of).collect();
        if world.is_quiet() {
            actions.extend(world.timers());
        }
        let mut can_be_told = false;
        for node in 0..self.nodes {
            if world.is_alive(node) == (false, true) {
                actions.push(Op::TellDown(node));
                can_be_told = true;
            }
        }
        (state.missing, state.tally, state.fingerprint) =
            (world.missing(), world.tally(), world.fingerprint());
        state.is_stuck = state.missing > 0 && actions.is_empty() && !can_be_told;
        for message in messages {
            actions.extend((losses > 0).then_some(Op::Drop(message)));
            actions.extend((duplicates > 0).then_some(Op::Duplicate(message)));
        }
        // One lives on.
        let living = (0..self.nodes).filter(|node| world.is_alive(*node).0);
        let living: Vec<u8> = living.collect();
        if crashes > 0 && living.len() > 1 {
            actions.extend(living.into_iter().map(Op::Crash));
        }
        actions.extend((state.missing == 0 && state.frames_left > 1).then_some(Op::NextFrame));
        state.actions = actions;
    }
}

impl Model for Cluster {
    type State = State;
    type Action = Op;

    fn init_states(&self) -> Vec<State> {
        vec![self.state(Vec::new(), self.budget, self.frames)]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Op>) {
        actions.extend(&state.actions);
    }

    fn next_state(&self, last: &State, action: Op) -> Option<State> {
        let (mut ops, mut budget) = (last.ops.clone(), last.budget);
        budget.spend(action);
        ops.push(action);
        Some(self.state(ops, budget, last.frames_left - u8::from(action == Op::NextFrame)))
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(SAFE, |_, state: &State| state.broken.is_none()),
            Property::always(GOES_ON, |_, state: &State| !state.is_stuck),
            Property::sometimes(STOLEN, |_, state: &State| state.tally.stolen > 0),
            Property::sometimes(REDRAWN, |_, state: &State| state.missing == 0 && state.tally.dealt_anew > 0),
            Property::sometimes(REFUSED, |_, state: &State| state.tally.refused > 0),
            Property::sometimes(WHOLE, |_, state: &State| state.missing == 0 && state.frames_left == 1),
        ]
    }
}

impl Hash for State {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.fingerprint, self.budget, self.frames_left, self.broken.is_some()).hash(state);
    }
}

impl PartialEq for State {
    fn eq(&self, other: &Self) -> bool {
        (self.fingerprint, self.budget, self.frames_left)
            == (other.fingerprint, other.budget, other.frames_left)
    }
}

/// Looks at every state; or, if that is enough, at so many that a fault shows which shows at all.
pub(crate) fn explore(cluster: Cluster, until_broken: bool) -> Explored {
    // One, so that the order is always the same: numbers count only as they compare, so which of several lists of operations
    // that lead to one state stands for it can make a difference of a few states later.
    let checker = cluster.checker().threads(1);
    let checker = if until_broken {
        checker.finish_when(HasDiscoveries::AnyFailures).target_state_count(TRANSITIONS_MAX)
    } else {
        checker
    };
    let checker = checker.spawn_bfs().join();
    let mut broken = None;
    for name in [SAFE, GOES_ON] {
        if let Some(path) = checker.discovery(name) {
            let why = path.last_state().broken.clone().unwrap_or_default();
            broken.get_or_insert(format!("{name}: {why}\n{:?}", path.into_actions()));
        }
    }
    let reachable = [STOLEN, REDRAWN, REFUSED, WHOLE];
    let unreached = reachable.into_iter().filter(|name| checker.discovery(name).is_none()).collect();
    Explored { states: checker.unique_state_count(), transitions: checker.state_count(), broken, unreached }
}

/// What a panic said.
pub(crate) fn text_of(panic: &(dyn core::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned())).unwrap_or_default()
}
