//! Whom a node asks that has nothing left.

use core::hash::{Hash, Hasher};

use super::peers::Peers;
use crate::schedule::Balancer;
use crate::schedule::dice::Dice;
use crate::schedule::mutants::{self, Mutant};
use crate::schedule::page_map::PageMap;

/// How far an idle node has come in its search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Asking {
    /// The question that is not answered yet.
    pub(super) pending: Option<Question>,
    /// Questions of this view.
    pub(super) number: u32,
    stage: Stage,
    /// Somebody who knows of much work.
    hint: Option<u16>,
    /// Nobody is asked before this.
    pub(super) pause_until_us: Option<u64>,
}

/// A question to a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Question {
    pub(super) to: u16,
    pub(super) number: u32,
    /// If the answer is no, the peer remembers who asked.
    pub(super) waits: bool,
    pub(super) sent_us: u64,
    /// It waits to be sent.
    pub(super) is_due: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Stage {
    /// So many have been asked in vain.
    Asking(u16),
    /// The lifeline of this number is next.
    Lifelines(u16),
    /// Somebody will come, or the next frame.
    Resting,
}

impl Asking {
    pub(super) const fn new() -> Self {
        Self { pending: None, number: 0, stage: Stage::Asking(0), hint: None, pause_until_us: None }
    }

    /// There is work again; the next search begins from the start.
    pub(super) const fn start_over(&mut self) {
        self.stage = Stage::Asking(0);
        self.hint = None;
        self.pause_until_us = None;
    }

    pub(super) fn fingerprint(&self, now_us: u64, hasher: &mut impl Hasher) {
        let left_us = |moment_us: u64| moment_us.saturating_sub(now_us);
        let pending = |question: Question| {
            // Of one that waits for an answer, only how long it has done so.
            (question.to, question.waits, question.is_due, now_us - question.sent_us.min(now_us))
        };
        (self.pending.map(pending), self.stage, self.hint, self.pause_until_us.map(left_us)).hash(hasher);
    }

    pub(super) fn is_resting(&self) -> bool {
        self.stage == Stage::Resting
    }

    pub(super) const fn take_hint(&mut self, busiest: Option<u16>) {
        self.hint = busiest;
    }

    /// Asks the next one, if there is one worth asking, nobody is being asked and it is time.
    pub(super) fn go_on(
        &mut self,
        balancer: Balancer,
        peers: &Peers<'_>,
        map: PageMap,
        dice: &mut Dice,
        now_us: u64,
    ) {
        let is_too_early = self.pause_until_us.is_some_and(|until| now_us < until);
        if self.pending.is_some() || is_too_early {
            return;
        }
        self.pause_until_us = None;
        let next = match balancer {
            Balancer::Steal => self.next_at_random(peers, dice, now_us).map(|to| (to, false)),
            Balancer::StealNear => self.next_near(peers, map, dice),
            Balancer::Static | Balancer::Demand { .. } => None,
        };
        let Some((to, waits)) = next else { return };
        self.number += 1;
        self.pending = Some(Question { to, number: self.number, waits, sent_us: now_us, is_due: true });
    }

    /// The paper's choice: anybody. After as many questions as there are peers there is a pause.
    fn next_at_random(&mut self, peers: &Peers<'_>, dice: &mut Dice, now_us: u64) -> Option<u16> {
        let Stage::Asking(asked) = self.stage else { return None };
        if asked >= peers.count() {
            self.stage = Stage::Asking(0);
            self.pause_until_us = Some(now_us + PAUSE_US);
            return None;
        }
        self.stage = Stage::Asking(asked + 1);
        peers.any(dice, |_| true)
    }

    /// The nearest that is not known to have nothing, a few times; then the lifelines, each of which remembers.
    ///
    /// # Source
    /// Saraswat and others, "Lifeline-based global load balancing", PPoPP 2011.
    fn next_near(&mut self, peers: &Peers<'_>, map: PageMap, dice: &mut Dice) -> Option<(u16, bool)> {
        if let Stage::Asking(asked) = self.stage {
            let hint = self.hint.take().filter(|hint| peers.may_have_work(*hint));
            let near = || peers.nearest(map, dice);
            if let Some(to) = hint.or_else(near).filter(|_| asked < NEAR_TRIES) {
                self.stage = Stage::Asking(asked + 1);
                return Some((to, false));
            }
            self.stage = Stage::Lifelines(0);
        }
        while let Stage::Lifelines(number) = self.stage {
            let lifeline = peers.lifeline(number);
            self.stage = if lifeline.is_none() { Stage::Resting } else { Stage::Lifelines(number + 1) };
            if let Some(to) = lifeline.filter(|to| peers.is_up(*to)) {
                return Some((to, true));
            }
        }
        if mutants::is_on(Mutant::NeverRest) {
            self.stage = Stage::Lifelines(1);
            return peers.lifeline(0).filter(|to| peers.is_up(*to)).map(|to| (to, true));
        }
        None
    }
}

/// Peers that are asked before the lifelines.
const NEAR_TRIES: u16 = 4;

/// How long the paper's thief waits after it has asked as many peers as there are, in microseconds.
const PAUSE_US: u64 = 1000;
