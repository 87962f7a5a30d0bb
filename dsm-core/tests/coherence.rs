//! Random operations on a cluster in virtual time, against the oracle, with every invariant checked after each.

use dsm_core::replacement::PolicyKind;
use dsm_ops::{Op, Setup, run};
use proptest::prelude::*;

fn any_setup() -> impl Strategy<Value = Setup> {
    any::<[u8; Setup::BYTES]>().prop_map(Setup::from_bytes)
}

fn any_ops() -> impl Strategy<Value = Vec<Op>> {
    prop::collection::vec(any::<[u8; Op::BYTES]>().prop_map(Op::from_bytes), 0..160)
}

// `PROPTEST_CASES` asks for more.
proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases.max(10_000), ..ProptestConfig::default() })]

    #[test]
    fn no_order_of_events_breaks_an_invariant(setup in any_setup(), ops in any_ops()) {
        run(setup, ops);
    }
}

#[test]
fn a_long_quiet_run_serves_every_read() {
    let setup = Setup { slots: 2, policy: PolicyKind::Random, replicas: 1, ..Setup::SMALL };
    let ops = (0..2000u32).flat_map(|step| {
        let byte = |shift: u32| step.wrapping_mul(2_654_435_761).to_le_bytes()[shift as usize];
        let read = Op::Read { node: byte(0), thread: byte(1), page: byte(2) };
        let work = Op::Finish { node: byte(0), work: 0 };
        [read, Op::Deliver(0), work, Op::Deliver(0), work]
    });
    let world = run(setup, ops);
    assert_eq!(world.failed, 0);
    assert!(world.served > 1500, "{}", world.served);
}

#[test]
fn the_operations_reach_everything_that_can_go_wrong() {
    // The same numbers each time: what they reach is asserted, and would be missed if they did not.
    let mut state = 0x5EED_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 32).to_le_bytes()
    };
    let ops: Vec<Op> =
        (0..40_000).map(|_| next()).map(|[a, b, c, d, ..]| Op::from_bytes([a, b, c, d])).collect();
    let mut total = dsm_ops::Tally::default();
    for (number, ops) in ops.chunks(200).enumerate() {
        let fragments = if number % 2 == 0 { 1 } else { 4 };
        let neighbours = if number % 3 == 0 { 0 } else { 4 };
        let setup = Setup { fragments, neighbours, slots: 3, ..Setup::SMALL };
        total = total.plus(run(setup, ops.iter().copied()).tally());
    }
    println!("{total:?}");
    for (name, count) in total.named() {
        assert!(count > 20, "{name}: {count}");
    }
}

/// Found and made small by proptest.
#[test]
fn a_list_that_once_broke_an_invariant_does_so_no_more() {
    let read = |node, thread, page| Op::Read { node, thread, page };
    let neighbours = Setup { stripe_pages: 1, replicas: 1, tries: 1, buries_early: false, ..Setup::SMALL };

    // The request for a neighbour was lost, and the fault that came for it later waited until that request was given up.
    let mut lost_ahead = vec![read(1, 0, 24), Op::Deliver(0), Op::Deliver(0), Op::Deliver(0)];
    lost_ahead.extend([Op::Finish { node: 0, work: 0 }, read(0, 0, 150), read(2, 0, 3), Op::Deliver(86)]);
    lost_ahead.extend([read(2, 1, 6), read(0, 0, 4), Op::Jump { node: 2, ms: 7 }]);
    lost_ahead.extend([Op::Deliver(2), Op::Deliver(0), Op::Drop(152)]);
    let policy = PolicyKind::S3Fifo;
    run(
        Setup { slots: 3, requests: 3, policy, hidden: 2, neighbours: 4, fragments: 4, ..neighbours },
        lost_ahead,
    );
}
