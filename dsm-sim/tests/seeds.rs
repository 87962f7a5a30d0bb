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

/// 64 nodes that lose a tenth of all messages, and of which one at a time is down for a while.
fn lossy() -> Config {
    let mut config = Config::new(64, 256).unwrap();
    (config.touches, config.slots, config.think_ns) = (40, 8, us(50));
    config.network = Network::hundred_gigabit().with_links(|link| {
        (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm, link.reorder_ns) =
            (100_000, 20_000, 20_000, us(100));
    });
    config.faults.chances =
        Chances { crash_every_ns: ms(20), restart_after_ns: ms(30), down_max: 1, ..Chances::NONE };
    (config.node.resend_us, config.node.deadline_us) = (200, 20_000_000);
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
    let mut memory = Memory::new(lossy()).unwrap();
    let (mut steps, mut crashes, mut lost) = (0, 0, 0);
    hold("a_thousand_seeds", SEEDS, |seed| {
        let report = World::new(&mut memory, PolicyKind::ALL[(seed % 3) as usize], seed).run();
        steps += report.steps;
        crashes += report.nodes.iter().map(|node| u64::from(node.starts - 1)).sum::<u64>();
        lost += report.lost_messages();
        report
    });
    println!("{steps} events, {crashes} crashes, {lost} messages lost");
    assert!(crashes >= SEEDS / 4 && lost > 100 * SEEDS, "{crashes} crashes, {lost} messages lost");
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
