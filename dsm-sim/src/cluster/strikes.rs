//! What goes wrong, and what that does to the nodes.

use dsm_core::id::NodeId;

use super::actor::{Actor, Io};
use super::state::{Event, Strike, What};
use super::{Cluster, Happened};
use crate::fault::{ChanceKind, Fault};

impl<A: Actor> Cluster<A> {
    pub(super) fn plan_faults(&mut self) {
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

    pub(super) fn strike(&mut self, strike: Strike) -> Happened<A::Message, A::Task> {
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

    pub(super) fn start(&mut self, node: NodeId) {
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
