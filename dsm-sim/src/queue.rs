//! What is to happen, in the order in which it will.

use core::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::time::Moment;

/// Events in order of time; of two at the same moment, the one that was pushed first comes first.
///
/// # Shape and units
/// A binary heap of 16 bytes an event: the moment, then a running number, then the place where the event itself
/// lies. So sifting compares and moves one word of 128 bits, and an event of any size is written and read once.
///
/// # Edge cases
/// At most 2^24 events at a time and 2^40 in all; more panic. A million a second takes 12 days to get there.
#[derive(Debug)]
pub(crate) struct Queue<T> {
    heap: BinaryHeap<Reverse<u128>>,
    events: Vec<T>,
    free: Vec<u32>,
    pushed: u64,
}

const PLACE_BITS: u32 = 24;
const PLACES: usize = 1 << PLACE_BITS;
const PUSHED_BITS: u32 = 64 - PLACE_BITS;

impl<T: Copy> Queue<T> {
    pub(crate) const fn new() -> Self {
        Self { heap: BinaryHeap::new(), events: Vec::new(), free: Vec::new(), pushed: 0 }
    }

    pub(crate) fn push(&mut self, at: Moment, event: T) {
        let place = self.keep(event);
        let order = self.pushed << PLACE_BITS | u64::from(place);
        self.heap.push(Reverse(u128::from(at.as_ns()) << 64 | u128::from(order)));
        self.pushed += 1;
        assert!(self.pushed >> PUSHED_BITS == 0, "more than 2^{PUSHED_BITS} events in one run");
    }

    #[expect(clippy::cast_possible_truncation, reason = "takes the parts of a key apart")]
    pub(crate) fn pop(&mut self) -> Option<(Moment, T)> {
        let Reverse(key) = self.heap.pop()?;
        let place = key as u32 & (PLACES as u32 - 1);
        self.free.push(place);
        Some((Moment::from_ns((key >> 64) as u64), self.events[place as usize]))
    }

    /// Puts an event where it stays until it is popped.
    fn keep(&mut self, event: T) -> u32 {
        if let Some(place) = self.free.pop() {
            self.events[place as usize] = event;
            return place;
        }
        let place = self.events.len();
        assert!(place < PLACES, "more than {PLACES} events are to happen");
        self.events.push(event);
        u32::try_from(place).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chance::Chance;

    #[test]
    fn events_come_in_order_of_time_and_then_of_pushing() {
        let mut queue = Queue::new();
        for (at, event) in [(5, 'c'), (1, 'a'), (5, 'd'), (2, 'b'), (5, 'e')] {
            queue.push(Moment::from_ns(at), event);
        }
        let order: String = core::iter::from_fn(|| queue.pop()).map(|(_, event)| event).collect();
        assert_eq!(order, "abcde");
    }

    #[test]
    fn the_order_of_pushing_is_kept_in_places_that_are_used_again() {
        let mut queue = Queue::new();
        for round in 0..3 {
            (0..10).for_each(|event| queue.push(Moment::from_ns(round), event));
            assert!(core::iter::from_fn(|| queue.pop()).map(|(_, event)| event).eq(0..10));
        }
        assert_eq!(queue.events.len(), 10);
    }

    #[test]
    fn places_are_used_again_and_no_event_is_lost_or_doubled() {
        let (mut queue, mut chance) = (Queue::new(), Chance::new(1, 0));
        let (mut popped, mut last) = (Vec::new(), Moment::ZERO);
        for event in 0..10_000u32 {
            queue.push(last.after(chance.below(100)), event);
            if event % 3 > 0 {
                let (at, event) = queue.pop().unwrap();
                assert!(at >= last);
                last = at;
                popped.push(event);
            }
        }
        assert!(queue.events.len() < 4_000, "{}", queue.events.len());
        popped.extend(core::iter::from_fn(|| queue.pop()).map(|(_, event)| event));
        popped.sort_unstable();
        assert!(popped.into_iter().eq(0..10_000));
    }

    #[test]
    fn the_last_moment_there_is_can_be_waited_for() {
        let mut queue = Queue::new();
        queue.push(Moment::NEVER, ());
        assert_eq!(queue.pop(), Some((Moment::NEVER, ())));
        assert_eq!(queue.pop(), None);
    }
}
