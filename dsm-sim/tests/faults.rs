//! What goes wrong has the effect it is said to have, and nobody waits for ever.

use dsm_core::id::{NodeId, PageId};
use dsm_core::placement::Stripes;
use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::Ended;
use dsm_sim::fault::Fault;
use dsm_sim::paging::{Config, ConfigError, Memory, Report, Workload, World};
use dsm_sim::time::{Moment, ms, us};

const NODES: u16 = 8;
const PAGES: u32 = 64;
const TOUCHES: u64 = 16 * 100;

fn at(milliseconds: u64) -> Moment {
    Moment::from_ns(ms(milliseconds))
}

/// Eight nodes on a perfect network, on which these faults fall.
fn with_faults(schedule: &[(Moment, Fault)], change: impl Fn(&mut Config)) -> Report {
    let mut config = Config::new(NODES, PAGES).unwrap();
    config.faults.schedule = schedule.to_vec();
    config.think_ns = us(100);
    change(&mut config);
    let report = World::new(&mut Memory::new(config).unwrap(), PolicyKind::Random, 5).run();
    assert_eq!(report.ended, Ended::Done);
    report
}

fn cut_off(report: &Report) -> u64 {
    report.nodes.iter().map(|node| node.traffic.cut_off).sum()
}

#[test]
fn nothing_goes_wrong_where_nothing_is_to() {
    let report = with_faults(&[], |_| ());
    let total = report.total();
    assert_eq!((total.touches, total.failed_touches, total.resends), (TOUCHES, 0, 0));
    assert_eq!((report.lost_messages(), total.refused_messages, total.late_answers), (0, 0, 0));
    assert_eq!(total.requests, total.granted_pages);
}

#[test]
fn a_cut_holds_the_two_sides_up_until_it_heals() {
    let apart = [0, 1, 2].map(NodeId).to_vec();
    let schedule = [(at(2), Fault::Cut(apart)), (at(102), Fault::Heal)];
    let report = with_faults(&schedule, |_| ());
    assert!(cut_off(&report) > 0);
    assert!(report.total().resends >= cut_off(&report) / 2);
    assert_eq!((report.total().touches, report.total().failed_touches), (TOUCHES, 0));
    assert!(report.latencies.max() > ms(50), "{}", report.latencies.max());
}

#[test]
fn a_cut_that_outlasts_the_deadline_fails_pages_and_loses_no_waiter() {
    let schedule = [(at(2), Fault::Cut(vec![NodeId(0)]))];
    let report = with_faults(&schedule, |config| config.node.deadline_us = 20_000);
    assert_eq!(report.total().touches, TOUCHES);
    assert!(report.total().failed_touches > 0);
    // Both sides go on with what they have, and the cut off node can have only its own pages.
    assert!(report.nodes[0].counts.failed_touches > 100, "{report}");
}

#[test]
fn a_crash_takes_what_the_node_had_under_way_and_a_restart_brings_it_back() {
    let schedule = [(at(2), Fault::Crash(NodeId(3))), (at(32), Fault::Restart(NodeId(3)))];
    let report = with_faults(&schedule, |_| ());
    let node = report.nodes[3];
    assert!(node.is_up && node.starts == 2 && node.traffic.unheard > 0, "{node:?}");
    assert_eq!(report.total().failed_touches, 0, "its pages are back before the deadline");
    // Its two threads were in the middle of a touch at most.
    assert!((TOUCHES..=TOUCHES + 2).contains(&report.total().touches), "{report}");
}

#[test]
fn a_node_that_stays_down_is_not_waited_for() {
    let report = with_faults(&[(at(2), Fault::Crash(NodeId(3)))], |config| config.node.deadline_us = 20_000);
    assert!(!report.nodes[3].is_up && report.nodes[3].counts.touches < 200);
    let others = report.nodes.iter().filter(|node| node.is_up).map(|node| node.counts.touches);
    assert_eq!(others.sum::<u64>(), TOUCHES - 200);
}

#[test]
fn with_two_copies_any_node_may_die_at_any_moment() {
    let (mut failovers, mut deaths) = (0, 0);
    for (node, moment) in (0..NODES).flat_map(|node| (0..60).map(move |step| (node, us(100 * step)))) {
        let schedule = [(Moment::from_ns(moment), Fault::Crash(NodeId(node)))];
        let report = with_faults(&schedule, |config| {
            config.node.placement = config.node.placement.with_replicas(2).unwrap();
            config.touches = 30;
        });
        assert_eq!(
            report.total().failed_touches,
            0,
            "node {node} dies after {} us: {report}",
            moment / 1_000
        );
        failovers += report.total().failovers;
        deaths += u64::from(!report.nodes[usize::from(node)].is_up);
    }
    assert!(failovers > deaths && deaths > 300, "{failovers} {deaths}");
}

#[test]
fn with_one_copy_a_death_loses_its_pages_and_only_those() {
    let report = with_faults(&[(Moment::ZERO, Fault::Crash(NodeId(3)))], |config| config.touches = 30);
    let failed: Vec<u64> = report.nodes.iter().map(|node| node.counts.failed_pages).collect();
    assert!(failed.iter().all(|failed| *failed <= u64::from(PAGES / u32::from(NODES))), "{failed:?}");
    assert!(failed.iter().sum::<u64>() > 20, "{failed:?}");
}

#[test]
fn a_death_that_is_told_costs_no_waiting() {
    let told = |tell_deaths_after_ns| {
        let schedule = [(at(1), Fault::Crash(NodeId(3)))];
        with_faults(&schedule, |config| {
            config.node.placement = config.node.placement.with_replicas(2).unwrap();
            config.faults.tell_deaths_after_ns = tell_deaths_after_ns;
        })
    };
    let (told, silent) = (told(Some(us(100))), told(None));
    assert!(told.latencies.max() < us(300), "{}", told.latencies.max());
    assert!(silent.latencies.max() > ms(1), "{}", silent.latencies.max());
    assert_eq!(told.total().dead_peers, 7);
}

#[test]
fn pages_come_in_fragments_that_get_lost() {
    let report = with_faults(&[], |config| {
        (config.node.fragments, config.message_room) = (true, 1_400);
        config.network = config.network.clone().with_links(|link| link.loss_ppm = 50_000);
    });
    let total = report.total();
    assert_eq!((total.touches, total.failed_touches), (TOUCHES, 0));
    assert!(total.fragments >= 13 * total.fetched_pages, "{total:?}");
}

#[test]
fn a_stalled_node_does_nothing_and_then_goes_on() {
    let report = with_faults(&[(at(2), Fault::Stall { node: NodeId(3), ns: ms(40) })], |_| ());
    assert_eq!((report.total().touches, report.total().failed_touches), (TOUCHES, 0));
    assert!(report.at > at(42) && report.latencies.max() > ms(35), "{report}");
}

#[test]
fn a_slow_node_takes_longer_for_all_it_does() {
    let usual = with_faults(&[], |_| ());
    let slow = with_faults(&[(Moment::ZERO, Fault::Slow { node: NodeId(3), percent: 1_000 })], |_| ());
    assert_eq!(slow.total().touches, TOUCHES);
    assert!(slow.at.as_ns() > 5 * usual.at.as_ns(), "{} {}", slow.at, usual.at);
}

#[test]
fn a_clock_that_jumps_fails_pages_at_worst() {
    for us in [-10_000_000, -1_000, 1_000, 10_000_000] {
        let jumps: Vec<_> =
            (1..10).map(|time| (at(time), Fault::ClockJump { node: NodeId(3), us })).collect();
        let report = with_faults(&jumps, |config| {
            config.network = config.network.clone().with_links(|link| link.loss_ppm = 50_000);
        });
        assert_eq!(report.total().touches, TOUCHES, "by {us}");
        let failed = report.total().failed_touches;
        assert!(failed == 0 || us > 1_000_000, "by {us}: {failed}");
    }
}

#[test]
fn configurations_that_contradict_themselves_are_refused_in_one_line() {
    let refused = |change: fn(&mut Config)| {
        let mut config = Config::new(NODES, PAGES).unwrap();
        change(&mut config);
        let error = Memory::new(config).map(|_| ()).unwrap_err();
        assert!(!error.to_string().contains('\n'));
        error
    };
    let crash = |config: &mut Config| config.faults.schedule = vec![(at(1), Fault::Crash(NodeId(8)))];
    assert_eq!(refused(crash), ConfigError::Fault(NodeId(8)));
    assert_eq!(refused(|config| config.nodes = 0), ConfigError::Nodes(0));
    assert_eq!(refused(|config| config.nodes = 5000), ConfigError::Nodes(5000));
    assert_eq!(refused(|config| config.renderers = 9), ConfigError::Renderers { renderers: 9, nodes: 8 });
    assert!(matches!(refused(|config| config.slots = 0), ConfigError::Node(_)));
    assert_eq!(refused(|config| config.message_room = 1_400), ConfigError::MessageRoom(1_400));
    let owner = |config: &mut Config| {
        config.node.placement = Stripes::new(PAGES, 1, NodeId(4), 5).unwrap();
    };
    assert_eq!(refused(owner), ConfigError::Owner { owner: NodeId(8), nodes: 8 });
    for workload in [
        Workload::Trace(vec![]),
        Workload::Trace(vec![vec![]]),
        Workload::Trace(vec![vec![PageId(PAGES)]]),
        Workload::Zipf { exponent: f64::NAN },
        Workload::Zipf { exponent: 1e9 },
        Workload::Window { pages: 0, touches_a_page: 1 },
    ] {
        let config = Config { workload, ..Config::new(NODES, PAGES).unwrap() };
        assert_eq!(Memory::new(config).map(|_| ()).unwrap_err(), ConfigError::Workload);
    }
    assert_eq!(Config::new(0, PAGES).map(|_| ()), Err(ConfigError::Nodes(0)));
    assert_eq!(Config::with_stores(u16::MAX, 1, PAGES).map(|_| ()), Err(ConfigError::Nodes(u16::MAX)));
}

#[test]
fn no_fragmented_page_misses_its_deadline_where_a_tenth_of_all_messages_is_lost() {
    let mut config = Config::new(NODES, PAGES).unwrap();
    (config.node.fragments, config.message_room) = (true, 1_400);
    config.network = config.network.with_links(|link| link.loss_ppm = 100_000);
    let mut memory = Memory::new(config).unwrap();
    let (mut resends, mut requests) = (0, 0);
    for seed in 0..60 {
        let report = World::new(&mut memory, PolicyKind::Random, seed).run();
        let total = report.total();
        assert_eq!((report.ended, total.touches, total.failed_touches), (Ended::Done, TOUCHES, 0), "{seed}");
        assert!(report.latencies.max() < ms(500), "seed {seed}: {} us", report.latencies.max() / 1000);
        (resends, requests) = (resends + total.resends, requests + total.requests);
    }
    assert!(resends > requests, "of twelve fragments one is lost nearly each time: {resends} {requests}");
}
