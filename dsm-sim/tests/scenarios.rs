//! What must hold does, in small worlds that reach every part of the protocol; and with `--cfg mutants`, faults that
//! are put into the protocol on purpose are found out. `./ci.sh mutants` prints which, beside the other engines.

use dsm_core::id::NodeId;
use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::{Checks, Ended};
use dsm_sim::fault::Fault;
use dsm_sim::paging::{Config, Memory, Report, Workload, World};
use dsm_sim::time::{Moment, ms, us};
use dsm_sim::verify::{self, Counterexample};

/// A small world, and what must hold in it besides the invariants, which are checked after every step.
struct Scenario {
    name: &'static str,
    config: fn() -> Config,
    holds: fn(&Report) -> Result<(), String>,
}

const SCENARIOS: [Scenario; 8] = [
    Scenario { name: "nothing goes wrong", config: small, holds: nothing_is_lost },
    Scenario { name: "lossy links", config: lossy, holds: nothing_is_lost },
    Scenario { name: "pages in fragments", config: fragmented, holds: nothing_is_lost },
    Scenario { name: "neighbours", config: neighbours, holds: nothing_is_lost },
    Scenario { name: "strays", config: strays, holds: nothing_is_lost },
    Scenario { name: "a copy dies", config: a_copy_dies, holds: nothing_is_lost },
    Scenario { name: "deaths are told", config: deaths_are_told, holds: goes_on_at_once },
    Scenario { name: "the only copy dies", config: the_only_copy_dies, holds: fails_in_time },
];

/// Seeds that each scenario is tried with.
const SEEDS: u64 = 20;

impl Scenario {
    /// Tries some seeds.
    fn run(&self) -> Result<u64, Counterexample> {
        let mut memory = Memory::new((self.config)()).unwrap();
        verify::seeds(0..SEEDS, |seed| {
            let policy = PolicyKind::ALL[usize::try_from(seed).unwrap() % PolicyKind::ALL.len()];
            let report = World::new(&mut memory, policy, seed).run();
            if report.ended != Ended::Done {
                return Err("NO_LOST_WAITER: threads wait at the end of the time given".to_owned());
            }
            (self.holds)(&report)
        })
    }
}

/// Four nodes with two copies of each of 32 pages, three threads and few slots.
fn small() -> Config {
    let mut config = Config::new(4, 32).unwrap();
    config.node.placement = config.node.placement.with_replicas(2).unwrap();
    (config.threads, config.slots, config.touches) = (3, 4, 60);
    // Many threads touch the same pages, so that they wait for each other.
    config.workload = Workload::Zipf { exponent: 0.7 };
    (config.checks, config.until) = (Checks::EveryStep, Moment::from_ns(ms(30_000)));
    config
}

fn lossy() -> Config {
    let mut config = small();
    config.network = config.network.with_links(|link| {
        (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm, link.reorder_ns) =
            (100_000, 100_000, 100_000, us(200));
    });
    config
}

fn fragmented() -> Config {
    let mut config = lossy();
    (config.node.fragments, config.message_room) = (true, 1_400);
    config
}

/// Pages bring others along, which nobody waits for.
fn neighbours() -> Config {
    let mut config = lossy();
    (config.node.neighbours_max, config.slots) = (4, 8);
    config
}

fn strays() -> Config {
    Config { strays_ppm: 300_000, ..small() }
}

fn a_copy_dies() -> Config {
    let mut config = lossy();
    config.faults.schedule = vec![(Moment::from_ns(us(500)), Fault::Crash(NodeId(1)))];
    config
}

fn deaths_are_told() -> Config {
    let mut config = small();
    config.faults.schedule = vec![(Moment::from_ns(us(300)), Fault::Crash(NodeId(1)))];
    config.faults.tell_deaths_after_ns = Some(us(50));
    config
}

/// Readers and one store, which dies and takes all pages with it. Nobody finds out before the deadline.
fn the_only_copy_dies() -> Config {
    let mut config = Config::with_stores(2, 1, 32).unwrap();
    (config.touches, config.checks, config.until) = (10, Checks::EveryStep, Moment::from_ns(ms(60_000)));
    config.node.dead_after_us = 3_600_000_000;
    config.faults.schedule = vec![(Moment::from_ns(us(50)), Fault::Crash(NodeId(2)))];
    config
}

fn nothing_is_lost(report: &Report) -> Result<(), String> {
    match report.total().failed_touches {
        0 => Ok(()),
        failed => Err(format!("SURVIVES: {failed} touches ended without their page")),
    }
}

fn goes_on_at_once(report: &Report) -> Result<(), String> {
    nothing_is_lost(report)?;
    let longest = report.latencies.max();
    if longest < ms(1) { Ok(()) } else { Err(format!("a page took {} us", longest / 1_000)) }
}

/// Every page fails by its deadline, and in all that time few requests are sent.
fn fails_in_time(report: &Report) -> Result<(), String> {
    let total = report.total();
    if total.failed_touches == 0 {
        return Err("pages were had although nobody holds them".to_owned());
    }
    let most = total.requests * 12;
    if total.resends > most {
        return Err(format!("{} requests were sent again {} times", total.requests, total.resends));
    }
    Ok(())
}

#[test]
#[cfg(not(mutants))]
fn every_scenario_holds() {
    for scenario in SCENARIOS {
        if let Err(failed) = scenario.run() {
            panic!("{}: {failed}", scenario.name);
        }
    }
}

/// Which fault is found out by which scenario, as a table.
#[test]
#[cfg(mutants)]
fn faults_of_the_protocol_are_found_out() {
    use dsm_core::mutants::{Mutant, switch_to};

    std::panic::set_hook(Box::new(|_| {}));
    let mut missed = Vec::new();
    println!("fault                     found out by dsm-sim");
    for mutant in [None].into_iter().chain(Mutant::ALL.map(Some)) {
        switch_to(mutant);
        let found =
            SCENARIOS.iter().find_map(|scenario| scenario.run().err().map(|failed| (scenario.name, failed)));
        switch_to(None);
        let name = mutant.map_or("none".to_owned(), |mutant| format!("{mutant:?}"));
        match (mutant, found) {
            (None, None) => println!("{name:25} -"),
            (None, Some((scenario, failed))) => panic!("without a fault, {scenario}: {failed}"),
            (Some(_), Some((scenario, failed))) => println!("{name:25} {scenario}: {failed}"),
            (Some(_), None) => {
                println!("{name:25} -");
                missed.push(name);
            }
        }
    }
    let _ = std::panic::take_hook();
    // Whom a page comes from makes no difference to its bytes while an epoch lasts, and nothing is asked for ahead here: other
    // engines look at these.
    let of_others =
        ["SkipIncarnationCheck", "BelieveTheDead", "AheadTakesAllTime", "AheadFails", "AdoptChangesNothing"];
    assert_eq!(missed, of_others);
}
