//! Many seeds, and many nodes. A seed that fails is printed with the command that replays it.

use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::{Checks, Ended};
use dsm_sim::fault::Chances;
use dsm_sim::network::Network;
use dsm_sim::paging::{Config, Memory, Report, World};
use dsm_sim::time::{Moment, ms, us};
use dsm_sim::verify;

/// Seeds of 64 nodes; `DSM_SIM_SEEDS` has more run, or only one from `DSM_SIM_SEED` on.
const SEEDS: u64 = 1_000;

/// 64 nodes with two copies of each page, which lose a tenth of all messages. One node at a time dies at some moment;
/// in every other seed it stays dead, in the others it comes back.
fn lossy(seed: u64) -> Config {
    let mut config = Config::new(64, 256).unwrap();
    (config.touches, config.slots, config.think_ns) = (40, 8, us(50));
    config.node.placement = config.node.placement.with_replicas(2).unwrap();
    config.network = Network::hundred_gigabit().with_links(|link| {
        (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm, link.reorder_ns) =
            (100_000, 20_000, 20_000, us(100));
    });
    let restart_after_ns = if seed.is_multiple_of(2) { 0 } else { ms(30) };
    config.faults.chances =
        Chances { crash_every_ns: ms(10), restart_after_ns, down_max: 1, ..Chances::NONE };
    config.checks = Checks::OneIn(256);
    config.until = Moment::from_ns(ms(60_000));
    config
}

/// Runs as many seeds as the environment says, and fails with the first that does.
fn hold(name: &str, count: u64, mut run: impl FnMut(u64) -> Report) {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let first = number("DSM_SIM_SEED").unwrap_or(0);
    let count = number("DSM_SIM_SEEDS").unwrap_or(count);
    let outcome = verify::seeds(first..first + count, |seed| {
        let report = run(seed);
        let total = report.total();
        if report.ended != Ended::Done {
            return Err(format!("NO_LOST_WAITER: {:?} at {}", report.ended, report.at));
        }
        if total.failed_touches > 0 {
            return Err(format!("SURVIVES: {} touches ended without their page", total.failed_touches));
        }
        Ok(())
    });
    if let Err(failed) = outcome {
        let seed = failed.seed;
        panic!(
            "{failed}\nreplay: DSM_SIM_SEED={seed} DSM_SIM_SEEDS=1 cargo test -p dsm-sim --test seeds {name}"
        );
    }
}

#[test]
fn a_thousand_seeds_of_64_nodes_lose_no_waiter_and_no_page() {
    let mut memories = [0, 1].map(|seed| Memory::new(lossy(seed)).unwrap());
    let (mut steps, mut deaths, mut even_seeds, mut returns, mut failovers, mut lost) = (0, 0, 0, 0, 0, 0);
    hold("a_thousand_seeds", SEEDS, |seed| {
        let memory = &mut memories[usize::from(!seed.is_multiple_of(2))];
        let report = World::new(memory, PolicyKind::ALL[(seed % 3) as usize], seed).run();
        steps += report.steps;
        even_seeds += usize::from(seed.is_multiple_of(2));
        deaths += report.nodes.iter().filter(|node| !node.is_up).count();
        returns += report.nodes.iter().map(|node| u64::from(node.starts - 1)).sum::<u64>();
        failovers += report.total().failovers;
        lost += report.lost_messages();
        report
    });
    println!(
        "{steps} events, {deaths} dead, {returns} came back, {failovers} failovers, {lost} messages lost"
    );
}

#[test]
fn a_cluster_of_4096_nodes_runs() {
    let mut config = Config::with_stores(4032, 64, 2048).unwrap();
    (config.touches, config.slots) = (40, 32);
    config.checks = Checks::OneIn(4096);
    config.network = config.network.with_links(|link| link.loss_ppm = 10_000);
    let report = World::new(&mut Memory::new(config).unwrap(), PolicyKind::Random, 1).run();
    assert_eq!(report.ended, Ended::Done);
    assert_eq!((report.total().touches, report.total().failed_touches), (4032 * 2 * 40, 0));
    println!("{report}");
}
