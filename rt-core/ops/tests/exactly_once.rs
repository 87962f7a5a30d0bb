//! Random lists of what can happen, on random clusters: each tile of each frame is displayed once.
//!
//! `PROPTEST_CASES=100000 cargo test -p balance-ops --test exactly_once` for more.

use balance_ops::{Op, Setup, Tally, run};
use proptest::prelude::*;
use rt_core::schedule::Balancer;

fn any_setup() -> impl Strategy<Value = Setup> {
    any::<[u8; Setup::BYTES]>().prop_map(Setup::from_bytes)
}

fn any_ops() -> impl Strategy<Value = Vec<Op>> {
    prop::collection::vec(any::<[u8; Op::BYTES]>().prop_map(Op::from_bytes), 0..250)
}

fn cases() -> u32 {
    std::env::var("PROPTEST_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(10_000)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn each_tile_of_each_frame_is_displayed_once(setup in any_setup(), ops in any_ops()) {
        run(setup, ops);
    }
}

/// Random lists go deep enough to mean something: they steal, kill, double and begin new frames.
#[test]
fn random_lists_reach_what_they_are_to_reach() {
    let mut state = 0x5EED_u64;
    let mut byte = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state.to_be_bytes()[0]
    };
    for balancer in Balancer::ALL {
        let mut sum = Tally::default();
        for _ in 0..300 {
            let setup = Setup { balancer, ..Setup::from_bytes([byte(), byte(), byte(), byte()]) };
            let ops: Vec<Op> = (0..250).map(|_| Op::from_bytes([byte(), byte(), byte(), byte()])).collect();
            let tally = run(setup, ops);
            sum.stolen += tally.stolen;
            sum.again += tally.again;
            sum.dealt_anew += tally.dealt_anew;
            sum.frames += tally.frames;
            sum.restarts += tally.restarts;
            sum.refused += tally.refused;
        }
        println!("{balancer}: {sum:?}");
        assert_eq!(sum.stolen > 0, balancer.steals(), "{balancer}: {sum:?}");
        assert!(
            sum.again > 0 && sum.dealt_anew > 0 && sum.restarts > 0 && sum.refused > 0,
            "{balancer}: {sum:?}"
        );
        assert!(sum.frames > 600, "{balancer}: {sum:?}");
    }
}
