#![expect(clippy::cast_possible_truncation, reason = "small numbers")]

use super::*;
use crate::storage::SlotEntry;
use heapless::Vec;

const SLOTS: usize = 6;

/// Slots whose pages are all resident, made known to `policy` in order.
fn full(policy: &mut Policy) -> [SlotEntry; SLOTS] {
    let mut slots = [SlotEntry::EMPTY; SLOTS];
    for slot in 0..SLOTS {
        slots[slot] = SlotEntry { page: slot as u32, evictable: true, ..SlotEntry::EMPTY };
        policy.handle_resident(&mut slots, SlotId(slot as u32));
    }
    slots
}

fn victims(policy: &mut Policy, slots: &mut [SlotEntry]) -> Vec<u32, SLOTS> {
    let mut victims = Vec::new();
    while let Some(victim) = policy.choose_victim(slots) {
        slots[victim.index()].evictable = false;
        victims.push(victim.0).unwrap();
    }
    victims
}

#[test]
fn every_policy_evicts_every_page_once_and_then_none() {
    for kind in PolicyKind::ALL {
        let mut policy = Policy::new(kind, 7);
        let mut slots = full(&mut policy);
        let mut order = victims(&mut policy, &mut slots);
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3, 4, 5], "{kind}");
        assert_eq!(policy.choose_victim(&mut slots), None, "{kind}");
    }
}

#[test]
fn fifo_keeps_the_order_of_arrival() {
    let mut policy = Policy::new(PolicyKind::Fifo, 0);
    let mut slots = full(&mut policy);
    policy.handle_reference(&mut slots, SlotId(0));
    assert_eq!(victims(&mut policy, &mut slots), [0, 1, 2, 3, 4, 5]);
}

#[test]
fn clock_gives_a_used_page_a_second_chance_and_no_third() {
    let mut policy = Policy::new(PolicyKind::Clock, 0);
    let mut slots = full(&mut policy);
    policy.handle_reference(&mut slots, SlotId(0));
    policy.handle_reference(&mut slots, SlotId(2));
    assert_eq!(victims(&mut policy, &mut slots), [1, 3, 4, 5, 0, 2]);
}

#[test]
fn random_repeats_itself_for_a_seed_and_reaches_every_slot() {
    let order = |seed| {
        let mut policy = Policy::new(PolicyKind::Random, seed);
        let mut slots = full(&mut policy);
        victims(&mut policy, &mut slots)
    };
    assert_eq!(order(3), order(3));
    let mut first = [false; SLOTS];
    for seed in 0..200 {
        first[order(seed)[0] as usize] = true;
    }
    assert_eq!(first, [true; SLOTS]);
}

#[test]
fn names_round_trip() {
    for kind in PolicyKind::ALL {
        assert_eq!(kind.name().parse(), Ok(kind));
    }
    assert_eq!("lru".parse::<PolicyKind>(), Err(UnknownPolicy));
}
