//! Every policy that keeps an order, beside the plainest program that does the same.

extern crate std;

use std::collections::VecDeque;
use std::vec::Vec;

use proptest::prelude::*;

use super::{Policy, PolicyKind, Replacement};
use crate::id::SlotId;
use crate::storage::{NONE, SlotEntry};

const SLOTS: u32 = 8;

/// One thing that a policy hears, or is asked.
#[derive(Clone, Copy, Debug)]
enum Op {
    /// A page comes, into the lowest slot that is free. Without effect when none is.
    Come,
    /// The page in this slot was used. Without effect when none is there.
    Use(u32),
    /// A victim is wanted.
    Choose,
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let op = prop_oneof![3 => Just(Op::Come), 3 => (0..SLOTS).prop_map(Op::Use), 2 => Just(Op::Choose)];
    prop::collection::vec(op, 0..200)
}

/// The plain program.
trait Model {
    fn come(&mut self, slot: u32);
    fn used(&mut self, slot: u32);
    fn choose(&mut self) -> Option<u32>;
}

#[derive(Default)]
struct Fifo(VecDeque<u32>);

impl Model for Fifo {
    fn come(&mut self, slot: u32) {
        self.0.push_back(slot);
    }

    fn used(&mut self, _slot: u32) {}

    fn choose(&mut self) -> Option<u32> {
        self.0.pop_front()
    }
}

#[derive(Default)]
struct Clock(VecDeque<(u32, bool)>);

impl Model for Clock {
    fn come(&mut self, slot: u32) {
        self.0.push_back((slot, false));
    }

    fn used(&mut self, slot: u32) {
        self.0.iter_mut().filter(|page| page.0 == slot).for_each(|page| page.1 = true);
    }

    fn choose(&mut self) -> Option<u32> {
        while let Some((slot, used)) = self.0.pop_front() {
            if !used {
                return Some(slot);
            }
            self.0.push_back((slot, false));
        }
        None
    }
}

/// Algorithm 1 of the paper, on a plain list, the oldest first.
#[derive(Default)]
struct Sieve {
    pages: Vec<(u32, bool)>,
    hand: usize,
}

impl Model for Sieve {
    fn come(&mut self, slot: u32) {
        // A hand beyond the newest begins anew with the oldest, even if another comes meanwhile.
        if self.hand == self.pages.len() {
            self.hand = 0;
        }
        self.pages.push((slot, false));
    }

    fn used(&mut self, slot: u32) {
        self.pages.iter_mut().filter(|page| page.0 == slot).for_each(|page| page.1 = true);
    }

    fn choose(&mut self) -> Option<u32> {
        while !self.pages.is_empty() {
            self.hand %= self.pages.len();
            if !self.pages[self.hand].1 {
                let victim = self.pages.remove(self.hand).0;
                return Some(victim);
            }
            self.pages[self.hand].1 = false;
            self.hand += 1;
        }
        None
    }
}

/// Runs `ops` on a policy and on its model, which must choose the same.
fn compare(kind: PolicyKind, mut model: impl Model, ops: &[Op]) {
    let mut policy = Policy::new(kind, 1);
    let mut slots = [SlotEntry::EMPTY; SLOTS as usize];
    let mut next_page = 0;
    for op in ops {
        match *op {
            Op::Come => {
                let Some(slot) = slots.iter().position(|slot| slot.page == NONE) else { continue };
                let id = SlotId(u32::try_from(slot).unwrap());
                (slots[slot].page, slots[slot].evictable) = (next_page, true);
                next_page += 1;
                policy.handle_resident(&mut slots, id);
                model.come(id.0);
            }
            Op::Use(slot) if slots[slot as usize].evictable => {
                policy.handle_reference(&mut slots, SlotId(slot));
                model.used(slot);
            }
            Op::Use(_) => {}
            Op::Choose => {
                let victim = policy.choose_victim(&mut slots);
                assert_eq!(victim.map(|slot| slot.0), model.choose(), "{kind}");
                if let Some(slot) = victim {
                    (slots[slot.index()].page, slots[slot.index()].evictable) = (NONE, false);
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn fifo_is_its_model(ops in ops()) {
        compare(PolicyKind::Fifo, Fifo::default(), &ops);
    }

    #[test]
    fn clock_is_its_model(ops in ops()) {
        compare(PolicyKind::Clock, Clock::default(), &ops);
    }

    #[test]
    fn sieve_is_its_model(ops in ops()) {
        compare(PolicyKind::Sieve, Sieve::default(), &ops);
    }
}
