//! The event core with machines that know nothing of pages.

use core::cell::RefCell;
use std::rc::Rc;

use dsm_core::id::NodeId;
use dsm_sim::chance::Chance;
use dsm_sim::cluster::{Actor, Checks, Cluster, Ended, Happened, Io, Setup, View, stream};
use dsm_sim::fault::{Fault, Faults};
use dsm_sim::network::{Link, Links, Network};
use dsm_sim::time::{Moment, us};
use dsm_sim::verify;

fn setup(loss_ppm: u32, schedule: &[(Moment, Fault)], seed: u64) -> Setup {
    let network = Network { links: Links::Same(Link { loss_ppm, ..Link::new(us(10)) }), ..Network::PERFECT };
    let faults = Faults { schedule: schedule.to_vec(), ..Faults::default() };
    Setup { network, faults, checks: Checks::EveryStep, seed }
}

fn at_us(micros: u64) -> Moment {
    Moment::from_ns(us(micros))
}

/// Tells a rumour to any three others, again and again, once it knows it.
struct Gossip {
    nodes: u64,
    knows: bool,
    chance: Chance,
}

impl Actor for Gossip {
    type Message = ();
    type Task = ();

    fn handle_start(&mut self, io: &mut Io<'_, (), ()>) {
        if io.me() == NodeId(0) {
            self.handle_message(io, NodeId(0), ());
        }
    }

    fn handle_message(&mut self, io: &mut Io<'_, (), ()>, _from: NodeId, (): ()) {
        if !self.knows {
            self.knows = true;
            self.handle_task(io, ());
        }
    }

    fn handle_task(&mut self, io: &mut Io<'_, (), ()>, (): ()) {
        for _ in 0..3 {
            let other = u16::try_from(self.chance.below(self.nodes)).unwrap();
            io.send(NodeId(other), 64, ());
        }
        io.work(us(100), ());
    }

    fn handle_crash(&mut self) {
        self.knows = false;
    }

    fn is_done(&self) -> bool {
        self.knows
    }
}

fn gossip(nodes: u16, seed: u64, schedule: &[(Moment, Fault)]) -> Cluster<Gossip> {
    let node = |node| Gossip {
        nodes: nodes.into(),
        knows: false,
        chance: Chance::new(seed, stream::ACTORS + u64::from(node)),
    };
    Cluster::new(setup(200_000, schedule, seed), (0..nodes).map(node).collect())
}

#[test]
fn a_rumour_reaches_a_thousand_nodes_in_a_few_rounds_and_the_same_way_each_time() {
    let mut one = gossip(1_000, 7, &[]);
    assert_eq!(one.run(Moment::NEVER), Ended::Done);
    assert!(one.now() < at_us(2_000), "{}", one.now());
    let mut again = gossip(1_000, 7, &[]);
    again.run(Moment::NEVER);
    assert_eq!((one.trace(), one.steps()), (again.trace(), again.steps()));
    let mut other = gossip(1_000, 8, &[]);
    other.run(Moment::NEVER);
    assert_ne!(one.trace(), other.trace());
}

#[test]
fn a_node_that_comes_back_is_told_anew_and_one_that_does_not_is_not_waited_for() {
    let schedule = [
        (at_us(50), Fault::Crash(NodeId(3))),
        (at_us(60), Fault::Crash(NodeId(4))),
        (at_us(5_000), Fault::Restart(NodeId(3))),
    ];
    let mut cluster = gossip(20, 7, &schedule);
    assert_eq!(cluster.run(Moment::NEVER), Ended::Done);
    assert!(cluster.now() > at_us(5_000) && cluster.actors()[3].knows && !cluster.is_up(NodeId(4)));
    assert_eq!((cluster.starts(NodeId(3)), cluster.starts(NodeId(4))), (2, 1));
}

#[test]
fn a_run_ends_when_its_time_is_over() {
    let mut cluster = gossip(1_000, 7, &[]);
    assert_eq!(cluster.run(at_us(15)), Ended::TimeOver);
    assert!(!cluster.is_done());
}

/// Waits for what never comes, or goes round in circles.
struct Idler {
    circles: bool,
    checks: Rc<RefCell<Vec<NodeId>>>,
    me: NodeId,
}

impl Actor for Idler {
    type Message = ();
    type Task = u32;

    fn handle_start(&mut self, io: &mut Io<'_, (), u32>) {
        self.me = io.me();
        io.work(us(100), u32::from(io.incarnation()));
    }

    fn handle_message(&mut self, _io: &mut Io<'_, (), u32>, _from: NodeId, (): ()) {}

    fn handle_task(&mut self, io: &mut Io<'_, (), u32>, incarnation: u32) {
        assert_eq!(incarnation, u32::from(io.incarnation()), "a task of an earlier life");
        if self.circles {
            io.work(0, incarnation);
        }
    }

    fn handle_crash(&mut self) {}

    fn is_done(&self) -> bool {
        false
    }

    fn check_invariants(&self, _view: View) {
        self.checks.borrow_mut().push(self.me);
    }
}

/// Looks at its clock every 100 us.
#[derive(Default)]
struct Watcher(Vec<u64>);

impl Actor for Watcher {
    type Message = ();
    type Task = ();

    fn handle_start(&mut self, io: &mut Io<'_, (), ()>) {
        io.work(us(100), ());
    }

    fn handle_message(&mut self, _io: &mut Io<'_, (), ()>, _from: NodeId, (): ()) {}

    fn handle_task(&mut self, io: &mut Io<'_, (), ()>, (): ()) {
        self.0.push(io.clock().as_micros());
        io.work(us(100), ());
    }

    fn handle_crash(&mut self) {}

    fn is_done(&self) -> bool {
        self.0.len() >= 4
    }
}

#[test]
fn clocks_start_apart_run_alike_and_jump_alone() {
    let jump = |at, us| (at_us(at), Fault::ClockJump { node: NodeId(1), us });
    let watchers = vec![Watcher::default(), Watcher::default()];
    let mut cluster = Cluster::new(setup(0, &[jump(150, 5_000), jump(250, -2_000)], 1), watchers);
    cluster.run(Moment::NEVER);
    let [one, other] = cluster.actors() else { panic!("two watchers") };
    let steps = |watcher: &Watcher| -> Vec<u64> {
        watcher.0.windows(2).map(|pair| pair[1].abs_diff(pair[0])).collect()
    };
    assert_eq!((steps(one), steps(other)), (vec![100, 100, 100], vec![5_100, 1_900, 100]));
    assert_ne!(one.0[0], other.0[0]);
}

fn idlers(circles: bool, setup: Setup) -> (Cluster<Idler>, Rc<RefCell<Vec<NodeId>>>) {
    let checks = Rc::new(RefCell::new(Vec::new()));
    let idler = |_| Idler { circles, checks: checks.clone(), me: NodeId(0) };
    (Cluster::new(setup, (0..2).map(idler).collect()), checks)
}

#[test]
fn who_waits_for_nothing_is_stuck() {
    assert_eq!(idlers(false, setup(0, &[], 1)).0.run(Moment::NEVER), Ended::Stuck);
}

#[test]
fn events_that_cause_each_other_without_end_are_found_out() {
    let found = verify::seeds(0..1, |seed| {
        idlers(true, setup(0, &[], seed)).0.run(Moment::NEVER);
        Ok(())
    });
    assert!(found.unwrap_err().what.starts_with("TIME_MOVES_ON"));
}

#[test]
fn a_task_does_not_outlive_the_life_that_set_it() {
    let schedule = [(at_us(10), Fault::Crash(NodeId(1))), (at_us(20), Fault::Restart(NodeId(1)))];
    let (mut cluster, _) = idlers(false, setup(0, &schedule, 1));
    let mut happened = Vec::new();
    while let Some(step) = cluster.step() {
        happened.push((step.at.as_ns() / 1_000, step.node.0, matches!(step.what, Happened::Task(_))));
    }
    let tasks: Vec<_> =
        happened.iter().filter(|(_, _, is_task)| *is_task).map(|(at, node, _)| (*at, *node)).collect();
    assert_eq!(tasks, [(100, 0), (120, 1)]);
}

#[test]
fn checks_are_made_as_often_as_asked() {
    for (checks, expected) in [(Checks::EveryStep, 2), (Checks::OneIn(2), 1), (Checks::AtEnd, 0)] {
        let (mut cluster, made) = idlers(false, Setup { checks, ..setup(0, &[], 1) });
        cluster.run(Moment::NEVER);
        assert_eq!(made.borrow().len(), expected, "{checks:?}");
        cluster.check_invariants();
        assert_eq!(made.borrow().len(), expected + 2);
    }
}
