//! Balancing at scale and in its stiff cases: counts in virtual time.

use dsm_sim::balance::{Case, Config, Costs, Gather, Memory, Report, run};
use dsm_sim::cluster::{Checks, Ended};
use dsm_sim::fault::{Chances, Faults};
use dsm_sim::time::{Moment, ms};
use rt_core::schedule::Balancer;

fn draw(config: &Config, case: Case) -> Report {
    let report = run(config, &case, &mut Memory::new(config), 1);
    assert_eq!(report.ended, Ended::Done);
    report
}

#[test]
fn a_hundred_seeds_of_a_lossy_cluster_with_deaths_display_each_tile_once() {
    let mut sums = [0; 3];
    for seed in 0..100 {
        let balancer = Balancer::ALL[usize::try_from(seed).unwrap() % 4];
        let mut config = Config::new(12, balancer);
        (config.tiles, config.frames, config.checks) = ([8, 8], 6, Checks::EveryStep);
        config.threads_per_core = 1 + u16::try_from(seed / 4 % 2).unwrap();
        config.network = config.network.with_links(|link| {
            (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm) = (100_000, 50_000, 50_000);
            link.reorder_ns = ms(3);
        });
        let chances =
            Chances { crash_every_ns: ms(8), restart_after_ns: ms(15), down_max: 4, ..Chances::NONE };
        config.faults = Faults { chances, tell_deaths_after_ns: Some(ms(2)), ..Faults::default() };
        config.until = Moment::from_ns(ms(60_000));
        let report = run(&config, &Case::Steady, &mut Memory::new(&config), seed);
        assert_eq!(report.ended, Ended::Done, "TERMINATES: seed {seed}, {balancer}");
        for frame in &report.frames {
            sums = [sums[0] + frame.moved, sums[1] + frame.again, sums[2] + frame.dealt_anew];
        }
    }
    println!("moved, again, dealt anew: {sums:?}");
    assert!(sums.iter().all(|sum| *sum > 100), "{sums:?}");
}

#[test]
fn without_deaths_no_tile_is_begun_twice_whatever_is_lost() {
    for balancer in Balancer::ALL {
        let mut config = Config::new(16, balancer);
        config.network = config.network.with_links(|link| {
            (link.loss_ppm, link.duplicate_ppm) = (100_000, 100_000);
        });
        for frame in draw(&config, Case::Steady).frames {
            assert_eq!(frame.begun, 256, "DRAWN_ONCE: {balancer}");
        }
    }
}

#[test]
fn in_a_steady_view_less_than_a_tile_in_a_hundred_moves() {
    let config = Config { frames: 30, ..Config::new(8, Balancer::StealNear) };
    let report = draw(&config, Case::Steady);
    let moved: u32 = report.frames[10..].iter().map(|frame| frame.moved).sum();
    println!("moved in frames 11 to 30: {moved}; in all {:?}", moved_of(&report));
    assert!(moved * 100 < 256 * 20, "{moved} of {} tiles", 256 * 20);
}

fn moved_of(report: &Report) -> Vec<u32> {
    report.frames.iter().map(|frame| frame.moved).collect()
}

/// Runs a case with `static` and with `steal-near`; prints and gives back the ratio of their times, and after how many
/// frames the latter settles.
fn against_static(case: Case) -> (f64, usize) {
    let [fixed, near] =
        [Balancer::Static, Balancer::StealNear].map(|balancer| draw(&case.config(balancer), case));
    let [fixed_ms, near_ms] = [&fixed, &near].map(Case::frame_ms);
    let settles = Case::settles_after(&near);
    println!(
        "{}: static {fixed_ms:.1} ms, steal-near {near_ms:.1} ms, {:.3}; settles after {settles}; moved {:?}",
        case.name(),
        near_ms / fixed_ms,
        moved_of(&near)
    );
    (near_ms / fixed_ms, settles)
}

#[test]
fn no_stiff_case_costs_more_than_static_by_more_than_its_margin() {
    for (case, margin, frames) in [
        (Case::Steady, 1.02, 5),
        (Case::DearTile, 1.02, 5),
        (Case::Alternating, 1.15, 5),
        (Case::SlowNode, 0.1, 20),
        (Case::Stalls, 1.05, usize::MAX),
        (Case::Far, 1.1, 8),
    ] {
        let (ratio, settles) = against_static(case);
        assert!(ratio <= margin, "{case:?}: {ratio} times the time of static");
        assert!(settles <= frames, "{case:?} settles after {settles} frames");
    }
}

#[test]
fn the_same_seed_makes_the_same_run() {
    let config = Config::new(8, Balancer::StealNear);
    assert_eq!(draw(&config, Case::Steady), draw(&config, Case::Steady));
}

#[test]
fn displays_take_every_tile_in_parcels_and_never_more_than_credit_allows() {
    let costs = Costs {
        tile_out: 0,
        parcel_out: 100,
        parcel_in: 1_000,
        tile_in: 10,
        message_out: 200,
        message_in: 50,
    };
    // A parcel holds three tiles of 1024 bytes with heads of 8, and a node may have two parcels under way.
    let gather =
        Gather { displays: 3, parcel_bytes: 3 * 1032 + 4, window_bytes: 7_000, ..Gather::new(costs) };
    for balancer in Balancer::ALL {
        let config = Config { gather: Some(gather), threads: 2, ..Config::new(4, balancer) };
        for frame in draw(&config, Case::Steady).frames {
            let talk = frame.talk;
            assert!(talk.parcels >= 256 / 3 && talk.parcels <= 256, "{balancer}: {talk:?}");
            assert_eq!(talk.bytes, 256 * 1032 + 4 * talk.parcels, "{balancer}");
            let least = 256 * costs.tile_in + talk.parcels * costs.parcel_in;
            let taken = talk.sum() - talk.supervisor;
            assert!(
                taken >= least && taken <= least + talk.parcels * costs.message_out,
                "{balancer}: {talk:?}"
            );
            assert!(talk.supervisor >= 4 * (costs.message_out + costs.message_in), "{balancer}: {talk:?}");
            assert_eq!(frame.begun, 256, "DRAWN_ONCE: {balancer}");
        }
    }
}
