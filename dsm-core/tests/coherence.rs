//! Random operations on a cluster in virtual time, against an oracle, with every invariant checked after each.
#![expect(clippy::cast_possible_truncation, reason = "small numbers")]

mod ops;

use dsm_core::replacement::PolicyKind;
use ops::{Op, Setup, run};
use proptest::prelude::*;

fn any_op() -> impl Strategy<Value = Op> {
    prop_oneof![
        6 => (any::<u8>(), any::<u8>(), any::<u8>()).prop_map(|(node, thread, page)| Op::Read { node, thread, page }),
        6 => any::<u8>().prop_map(Op::Deliver),
        4 => (any::<u8>(), any::<u8>()).prop_map(|(node, work)| Op::Finish { node, work }),
        1 => any::<u8>().prop_map(Op::Drop),
        1 => any::<u8>().prop_map(Op::Duplicate),
        1 => (0u16..3000).prop_map(|us| Op::Advance { us }),
        1 => (any::<u8>(), any::<u8>(), any::<u8>()).prop_map(|(message, byte, xor)| Op::Corrupt { message, byte, xor }),
    ]
}

fn any_setup() -> impl Strategy<Value = Setup> {
    (1u8..7, prop::sample::select(&PolicyKind::ALL[..]), 1u8..4, 0u8..3).prop_map(
        |(slots, policy, evict_batch, evict_ahead)| Setup { slots, policy, evict_batch, evict_ahead },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn no_order_of_events_breaks_an_invariant(setup in any_setup(), ops in prop::collection::vec(any_op(), 0..200)) {
        run(setup, &ops);
    }
}

#[test]
fn a_long_quiet_run_serves_every_read() {
    let setup = Setup { slots: 2, policy: PolicyKind::Random, evict_batch: 1, evict_ahead: 0 };
    let mut ops = Vec::new();
    for step in 0..2000u32 {
        let byte = |shift: u32| (step.wrapping_mul(2_654_435_761) >> shift) as u8;
        ops.push(Op::Read { node: byte(3), thread: byte(11), page: byte(19) });
        ops.extend([
            Op::Deliver(0),
            Op::Finish { node: byte(3), work: 0 },
            Op::Deliver(0),
            Op::Finish { node: byte(3), work: 0 },
        ]);
    }
    let world = run(setup, &ops);
    assert_eq!(world.failed, 0);
    assert!(world.served > 1500, "{}", world.served);
}
