//! Clusters whose pages may be far away, that of the greatest rank first.
//!
//! Each may cost a miss, so they wait longer than others: what is tested meanwhile may hide them for good.

use heapless::Vec;
use heapless::binary_heap::{BinaryHeap, Max};

use super::queue::Waiting;

/// Up to [`FAR_MAX`] clusters. Nothing in it is touched by a scene whose memory is all at hand.
pub(super) struct FarQueue {
    waiting: Vec<Waiting, FAR_MAX>,
    /// Places in `waiting` that are free again.
    free: Vec<u8, FAR_MAX>,
    /// A rank, as an integer of the same order, above a place.
    order: BinaryHeap<u64, Max, FAR_MAX>,
}

/// Half as many let beams read some more pages of a dense mesh; twice as many spare hardly any.
const FAR_MAX: usize = 128;

impl FarQueue {
    pub(super) const fn new() -> Self {
        Self { waiting: Vec::new(), free: Vec::new(), order: BinaryHeap::new() }
    }

    pub(super) fn is_full(&self) -> bool {
        self.order.len() == FAR_MAX
    }

    /// The greatest rank of any that waits.
    #[inline]
    pub(super) fn first(&self) -> Option<f32> {
        self.order.peek().map(|key| f32::from_bits((key >> 32) as u32))
    }

    /// Adds a cluster to a queue that is not full.
    #[inline]
    pub(super) fn push(&mut self, next: Waiting) {
        let rank = next.rank.max(0.0).to_bits();
        let place = match self.free.pop() {
            Some(place) => {
                self.waiting[usize::from(place)] = next;
                place.into()
            }
            None => {
                let place = self.waiting.len() as u64;
                if self.waiting.push(next).is_err() {
                    return;
                }
                place
            }
        };
        let pushed = self.order.push(u64::from(rank) << 32 | place);
        debug_assert!(pushed.is_ok(), "the queue is not full");
    }

    /// Takes the first away.
    #[inline]
    pub(super) fn take_first(&mut self) -> Option<Waiting> {
        let place = place_of(self.order.pop()?);
        let freed = u8::try_from(place).map(|place| self.free.push(place));
        debug_assert!(freed.is_ok_and(|pushed| pushed.is_ok()), "a place is freed once");
        Some(self.waiting[place])
    }
}

/// The place in a key.
const fn place_of(key: u64) -> usize {
    key as usize % FAR_MAX
}
