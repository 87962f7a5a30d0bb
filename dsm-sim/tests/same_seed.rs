//! The same seed gives the same run, event for event; another one another.

use dsm_core::replacement::PolicyKind;
use dsm_sim::fault::Chances;
use dsm_sim::network::Network;
use dsm_sim::paging::{Config, Memory, Report, Workload, World};
use dsm_sim::time::{ms, us};

/// A cluster to which everything happens that can.
fn eventful() -> Config {
    let mut config = Config::new(8, 64).unwrap();
    config.workload = Workload::Zipf { exponent: 0.8 };
    config.network = Network::gigabit().with_links(|link| {
        (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm, link.reorder_ns) =
            (50_000, 20_000, 50_000, us(500));
    });
    config.faults.chances = Chances {
        crash_every_ns: ms(20),
        restart_after_ns: ms(5),
        down_max: 2,
        cut_every_ns: ms(50),
        heal_after_ns: ms(10),
        stall_every_ns: ms(10),
        stall_ns: ms(2),
        jump_every_ns: ms(20),
        jump_us: 10_000,
    };
    config
}

fn run(memory: &mut Memory, seed: u64) -> Report {
    World::new(memory, PolicyKind::Random, seed).run()
}

#[test]
fn a_seed_repeats_itself_bit_for_bit_in_new_and_in_used_memory() {
    let mut used = Memory::new(eventful()).unwrap();
    let first = run(&mut used, 7);
    assert_ne!(run(&mut used, 8).trace, first.trace);
    assert_eq!(run(&mut used, 7), first);
    assert_eq!(run(&mut Memory::new(eventful()).unwrap(), 7), first);
}

#[test]
fn step_by_step_is_the_same_as_in_one_go() {
    let mut memory = Memory::new(eventful()).unwrap();
    let whole = run(&mut memory, 3);
    let mut world = World::new(&mut memory, PolicyKind::Random, 3);
    let mut number = 0;
    while let Some(step) = world.step() {
        number += 1;
        assert_eq!(step.number, number);
    }
    assert_eq!(world.report(whole.ended), whole);
}

#[test]
fn the_trace_notices_a_change_that_no_count_shows() {
    let mut config = eventful();
    config.faults.chances = Chances::NONE;
    let mut later = config.clone();
    later.costs.fill_ns += 1;
    let (one, other) = (run(&mut Memory::new(config).unwrap(), 1), run(&mut Memory::new(later).unwrap(), 1));
    assert_ne!(one.trace, other.trace);
}

#[test]
fn chance_of_the_network_is_not_chance_of_the_workload() {
    let mut memory = Memory::new(Config { touches: 50, ..eventful() }).unwrap();
    let touches = run(&mut memory, 1).total().touches;
    let mut quiet = eventful();
    (quiet.touches, quiet.network, quiet.faults) = (50, Network::PERFECT, Default::default());
    assert_eq!(run(&mut Memory::new(quiet).unwrap(), 1).total().touches, 8 * 2 * 50);
    // A crash ends touches before their time; nothing else does.
    assert!((800..=900).contains(&touches), "{touches}");
}
