//! `s3-fifo`: a small queue for pages that may be of no further use, and a main one for those that were.

use super::Replacement;
use super::ghosts::Ghosts;
use super::queue::Queue;
use crate::id::SlotId;
use crate::storage::SlotEntry;

/// Three queues: a *small* one of a tenth of the slots that pages enter, a *main* one for pages that were used while
/// they were in it, and a *ghost* queue of pages that left the small one unused. A page that is a ghost when it
/// comes again enters the main queue at once.
///
/// # Where its reference bits come from
/// As for [`Clock`](super::Clock). With none, pages reach the main queue through the ghost queue alone.
///
/// # Source
/// Yang, Zhang, Qiu, Yue, Rashmi, "FIFO queues are all you need for cache eviction", SOSP 2023, algorithm 1.
/// We differ: a page moves on to the main queue when it was used once, as in the authors' own library (their
/// text says more than once), and the ghost queue is a table of four ways, so it forgets some pages early.
#[derive(Clone, Debug)]
pub struct S3Fifo {
    small: Queue,
    main: Queue,
    ghosts: Ghosts,
}

/// One slot in this many is the small queue's.
const SMALL_SHARE: u32 = 10;

/// Uses that are counted; each spares a page of the main queue one round.
const USES_MAX: u8 = 3;

impl S3Fifo {
    /// Queues of no slots.
    #[must_use]
    pub const fn new() -> Self {
        Self { small: Queue::new(), main: Queue::new(), ghosts: Ghosts::new() }
    }

    /// The oldest page of the small queue that was not used; those that were move on.
    fn choose_small(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        loop {
            let slot = self.small.pop(slots)?;
            let entry = &mut slots[slot.index()];
            if entry.uses == 0 {
                let page = entry.page;
                self.ghosts.remember(slots, page);
                return Some(slot);
            }
            entry.uses = 0;
            self.main.push(slots, slot);
        }
    }

    /// The oldest page of the main queue that has no uses left. Every round takes one use away, so this ends.
    fn choose_main(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        loop {
            let slot = self.main.pop(slots)?;
            let entry = &mut slots[slot.index()];
            if entry.uses == 0 {
                return Some(slot);
            }
            entry.uses -= 1;
            self.main.push(slots, slot);
        }
    }
}

impl Default for S3Fifo {
    fn default() -> Self {
        Self::new()
    }
}

impl Replacement for S3Fifo {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        slots[slot.index()].uses = 0;
        let page = slots[slot.index()].page;
        if self.ghosts.take(slots, page) {
            self.main.push(slots, slot);
        } else {
            self.small.push(slots, slot);
        }
    }

    fn handle_reference(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        let uses = &mut slots[slot.index()].uses;
        *uses = (*uses + 1).min(USES_MAX);
    }

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        let is_small_full = self.small.count() * SMALL_SHARE >= self.small.count() + self.main.count();
        if is_small_full {
            self.choose_small(slots).or_else(|| self.choose_main(slots))
        } else {
            self.choose_main(slots).or_else(|| self.choose_small(slots))
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::collections::VecDeque;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::storage::NONE;

    const SLOTS: usize = 16;

    /// Algorithm 1 of the paper with plain lists. Whether a page is still a ghost it takes from the policy, and checks
    /// that it may be.
    #[derive(Default)]
    struct Model {
        small: VecDeque<(u32, u8)>,
        main: VecDeque<(u32, u8)>,
        ghosts: VecDeque<u32>,
    }

    impl Model {
        fn come(&mut self, slot: u32, page: u32, went_to_main: bool) {
            let place = self.ghosts.iter().position(|ghost| *ghost == page);
            if went_to_main {
                let place = place.expect("only a page that left the small queue may return to the main one");
                assert!(place < SLOTS, "a ghost is remembered as long as there are slots, at most");
            }
            place.map(|place| self.ghosts.remove(place));
            if went_to_main { &mut self.main } else { &mut self.small }.push_back((slot, 0));
        }

        fn used(&mut self, slot: u32) {
            let all = self.small.iter_mut().chain(&mut self.main);
            all.filter(|page| page.0 == slot).for_each(|page| page.1 = (page.1 + 1).min(3));
        }

        fn choose(&mut self, page_in: impl Fn(u32) -> u32) -> Option<u32> {
            let all = self.small.len() + self.main.len();
            let mut from_small = self.small.len() * 10 >= all;
            for _ in 0..2 {
                let victim = if from_small { self.choose_small(&page_in) } else { self.choose_main() };
                if victim.is_some() {
                    return victim;
                }
                from_small = !from_small;
            }
            None
        }

        fn choose_small(&mut self, page_in: &impl Fn(u32) -> u32) -> Option<u32> {
            while let Some((slot, uses)) = self.small.pop_front() {
                if uses == 0 {
                    self.ghosts.push_front(page_in(slot));
                    return Some(slot);
                }
                self.main.push_back((slot, 0));
            }
            None
        }

        fn choose_main(&mut self) -> Option<u32> {
            while let Some((slot, uses)) = self.main.pop_front() {
                if uses == 0 {
                    return Some(slot);
                }
                self.main.push_back((slot, uses - 1));
            }
            None
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        /// Touches of pages, each with whether it is told of; a miss in a full cache takes a victim.
        #[test]
        fn s3_fifo_is_its_model(touches in prop::collection::vec((0_u32..40, any::<bool>()), 0..400)) {
            let (mut policy, mut model) = (S3Fifo::new(), Model::default());
            let mut slots = [SlotEntry::EMPTY; SLOTS];
            for (page, is_told) in touches {
                if let Some(slot) = slots.iter().position(|slot| slot.page == page) {
                    let slot = SlotId(u32::try_from(slot).unwrap());
                    if is_told {
                        policy.handle_reference(&mut slots, slot);
                        model.used(slot.0);
                    }
                    continue;
                }
                let free = slots.iter().position(|slot| slot.page == NONE).unwrap_or_else(|| {
                    let victim = policy.choose_victim(&mut slots).unwrap();
                    let page_in = |slot: u32| slots[slot as usize].page;
                    assert_eq!(Some(victim.0), model.choose(page_in));
                    victim.index()
                });
                slots[free].page = page;
                let before = policy.main.count();
                let slot = SlotId(u32::try_from(free).unwrap());
                policy.handle_resident(&mut slots, slot);
                model.come(slot.0, page, policy.main.count() > before);
            }
        }
    }

    #[test]
    fn a_page_that_comes_back_soon_is_taken_for_one_that_is_used() {
        let (mut policy, mut slots) = (S3Fifo::new(), [SlotEntry::EMPTY; SLOTS]);
        slots[0].page = 7;
        policy.handle_resident(&mut slots, SlotId(0));
        assert_eq!(policy.choose_victim(&mut slots), Some(SlotId(0)));
        slots[3].page = 7;
        policy.handle_resident(&mut slots, SlotId(3));
        assert_eq!((policy.small.count(), policy.main.count()), (0, 1));
        let found: Vec<u32> = slots.iter().map(|slot| slot.ghost).filter(|ghost| *ghost != NONE).collect();
        assert!(found.is_empty(), "a ghost that came back is none: {found:?}");
    }
}
