//! Which engine notices which fault: each is put into the protocol in turn, and every engine runs until it finds it or
//! has done its work. Two engines at least must find each.
//!
//! `RUSTFLAGS="--cfg mutants" cargo test -p dsm-core --test mutants --release -- --nocapture`
#![cfg(mutants)]

mod model;

use std::panic::catch_unwind;

use dsm_core::mutants::{Mutant, switch_to};
use dsm_ops::{Op, Setup, run, run_bytes};
use model::{Cluster, explore};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

/// An engine: its name, and whether it finds that something is wrong, in as much work as it does in CI.
///
/// An engine of another crate has its own list of the same mutants, and a row here would be a circle of crates; `dsm-sim`
/// runs [`Mutant::ALL`] through its seeds the same way.
type Engine = (&'static str, fn() -> Option<String>);

const ENGINES: [Engine; 3] =
    [("proptest", by_proptest), ("stateright", by_stateright), ("fuzz, seeded", by_fuzz)];

/// Cases, of which most mutants need a few dozen.
const CASES: u32 = 3_000;

fn by_proptest() -> Option<String> {
    let config = Config { cases: CASES, failure_persistence: None, max_shrink_iters: 0, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(
        config,
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let setup = any::<[u8; Setup::BYTES]>().prop_map(Setup::from_bytes);
    let ops = prop::collection::vec(any::<[u8; Op::BYTES]>().prop_map(Op::from_bytes), 0..160);
    let outcome = runner.run(&(setup, ops), |(setup, ops)| {
        run(setup, ops);
        Ok(())
    });
    outcome.err().map(|error| error.to_string())
}

fn by_stateright() -> Option<String> {
    let clusters = [
        Cluster::RETURN,
        Cluster::FRAGMENTS,
        Cluster::ONE_COPY,
        Cluster::AHEAD_ONE_COPY,
        Cluster::TWO_THREADS,
        Cluster::AHEAD,
    ];
    clusters.into_iter().find_map(|cluster| explore(cluster, true).broken)
}

/// The fuzzer's entry on bytes that are the same each time.
fn by_fuzz() -> Option<String> {
    let mut state = 0x00FA_CADE_u64;
    let mut bytes = vec![0; 800];
    (0..CASES).find_map(|_| {
        for byte in &mut bytes {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *byte = state.to_be_bytes()[0];
        }
        let length = 200 + usize::from(bytes[0]) * 2;
        catch_unwind(|| run_bytes(&bytes[..length])).err().map(|panic| model::text_of(&*panic))
    })
}

#[test]
fn every_mutant_is_caught_by_two_engines_and_the_protocol_by_none() {
    // What is caught panics, thousands of times.
    std::panic::set_hook(Box::new(|_| {}));
    let mut survivors = Vec::new();
    let mut table =
        format!("{:<26}{:<14}{:<14}{:<14}caught as\n", "fault", ENGINES[0].0, ENGINES[1].0, ENGINES[2].0);
    for mutant in [None].into_iter().chain(Mutant::ALL.map(Some)) {
        switch_to(mutant);
        let found = ENGINES.map(|(_, find)| find());
        let caught = found.iter().flatten().count();
        let name = mutant.map_or("none".to_owned(), |mutant| format!("{mutant:?}"));
        let marks = found.each_ref().map(|found| if found.is_some() { "caught" } else { "-" });
        let words = found.iter().flatten().flat_map(|text| text.split_whitespace());
        let mut how = words.map(|word| word.trim_end_matches(':'));
        let how = how.find(|word| {
            word.len() > 3
                && word.to_uppercase() == **word
                && word.chars().all(|c| c.is_uppercase() || c == '_')
        });
        let how = how.unwrap_or_default();
        table += &format!("{name:<26}{:<14}{:<14}{:<14}{how}\n", marks[0], marks[1], marks[2]);
        if (mutant.is_none() && caught > 0) || (mutant.is_some() && caught < 2) {
            survivors.push(format!("{name}: {found:?}"));
        }
    }
    switch_to(None);
    println!("{table}");
    let _ = std::panic::take_hook();
    assert!(survivors.is_empty(), "{survivors:#?}");
}
