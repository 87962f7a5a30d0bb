//! Which engine notices which fault: each is put into the balance in turn, and every engine runs until it finds it or has
//! done its work. Two engines at least must find each.
//!
//! `RUSTFLAGS="--cfg mutants" cargo test -p balance-ops --test mutants --release -- --nocapture`
#![cfg(mutants)]

mod model;

use std::panic::{AssertUnwindSafe, catch_unwind};

use balance_ops::{Op, Setup, run, run_bytes};
use dsm_sim::balance::{Case, Config, Memory};
use dsm_sim::cluster::{Checks, Ended};
use dsm_sim::fault::{Chances, Faults};
use dsm_sim::time::{Moment, ms};
use model::{Cluster, explore};
use proptest::prelude::*;
use proptest::test_runner::{Config as Cases, RngAlgorithm, TestRng, TestRunner};
use rt_core::schedule::Balancer;
use rt_core::schedule::mutants::{Mutant, switch_to};

/// An engine: its name, and whether it finds that something is wrong, in as much work as it does in CI.
type Engine = (&'static str, fn() -> Option<String>);

const ENGINES: [Engine; 4] = [
    ("proptest", by_proptest),
    ("stateright", by_stateright),
    ("fuzz, seeded", by_fuzz),
    ("dsm-sim", by_simulator),
];

/// Cases, of which most mutants need a few dozen.
const CASES: u32 = 3_000;

/// Seeds of the simulator, five of each balancer.
const SEEDS: u64 = 20;

fn by_proptest() -> Option<String> {
    let config = Cases { cases: CASES, failure_persistence: None, max_shrink_iters: 0, ..Cases::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let setup = any::<[u8; Setup::BYTES]>().prop_map(Setup::from_bytes);
    let ops = prop::collection::vec(any::<[u8; Op::BYTES]>().prop_map(Op::from_bytes), 0..250);
    let outcome = runner.run(&(setup, ops), |(setup, ops)| {
        run(setup, ops);
        Ok(())
    });
    outcome.err().map(|error| error.to_string())
}

fn by_stateright() -> Option<String> {
    let clusters = [
        Cluster::CALM,
        Cluster::DEMAND,
        Cluster::TILE_LOSS,
        Cluster::DEATH,
        Cluster::LOSS,
        Cluster::TWO_FRAMES,
    ];
    clusters.into_iter().find_map(|cluster| explore(cluster, true).broken)
}

/// The fuzzer's entry on bytes that are the same each time.
fn by_fuzz() -> Option<String> {
    let mut state = 0x00FA_CADE_u64;
    let mut bytes = vec![0; 1200];
    (0..CASES).find_map(|_| {
        for byte in &mut bytes {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *byte = state.to_be_bytes()[0];
        }
        let length = 300 + usize::from(bytes[0]) * 3;
        catch_unwind(|| run_bytes(&bytes[..length])).err().map(|panic| model::text_of(&*panic))
    })
}

/// A lossy cluster whose nodes die.
fn by_simulator() -> Option<String> {
    (0..SEEDS).find_map(|seed| {
        let balancer = Balancer::ALL[usize::try_from(seed).unwrap_or(0) % 4];
        let mut config = Config::new(6, balancer);
        (config.tiles, config.frames, config.checks) = ([6, 6], 4, Checks::EveryStep);
        config.network = config.network.with_links(|link| {
            (link.loss_ppm, link.duplicate_ppm, link.reorder_ppm) = (100_000, 50_000, 50_000);
            link.reorder_ns = ms(3);
        });
        let chances =
            Chances { crash_every_ns: ms(8), restart_after_ns: ms(15), down_max: 3, ..Chances::NONE };
        config.faults = Faults { chances, tell_deaths_after_ns: Some(ms(2)), ..Faults::default() };
        config.until = Moment::from_ns(ms(2_000));
        let draw = || dsm_sim::balance::run(&config, &Case::Steady, &mut Memory::new(&config), seed);
        match catch_unwind(AssertUnwindSafe(draw)) {
            Err(panic) => Some(model::text_of(&*panic)),
            Ok(report) => (report.ended != Ended::Done).then(|| format!("TERMINATES: {:?}", report.ended)),
        }
    })
}

#[test]
fn every_mutant_is_caught_by_two_engines_and_the_balance_by_none() {
    // What is caught panics, thousands of times.
    std::panic::set_hook(Box::new(|_| {}));
    let mut survivors = Vec::new();
    let heads = ENGINES.map(|(name, _)| format!("{name:<14}")).concat();
    println!("{:<26}{heads}caught as", "fault of the balance");
    for mutant in [None].into_iter().chain(Mutant::ALL.map(Some)) {
        switch_to(mutant);
        let found = ENGINES.map(|(_, find)| find());
        let caught = found.iter().flatten().count();
        let name = mutant.map_or("none".to_owned(), |mutant| format!("{mutant:?}"));
        let marks =
            found.each_ref().map(|found| format!("{:<14}", if found.is_some() { "caught" } else { "-" }));
        let how = found.iter().flatten().find_map(|text| invariant_in(text)).unwrap_or_default();
        println!("{name:<26}{}{how}", marks.concat());
        if (mutant.is_none() && caught > 0) || (mutant.is_some() && caught < 2) {
            survivors.push(format!("{name}: {found:?}"));
        }
    }
    switch_to(None);
    let _ = std::panic::take_hook();
    assert!(survivors.is_empty(), "{survivors:#?}");
}

/// The first name of an invariant in a text.
fn invariant_in(text: &str) -> Option<&str> {
    let is_name = |word: &&str| {
        word.len() > 3 && word.chars().all(|letter| letter.is_ascii_uppercase() || letter == '_')
    };
    text.split_whitespace().map(|word| word.trim_end_matches(':')).find(is_name)
}
