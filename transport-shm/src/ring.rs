//! A ring of places for one producer and one consumer: who may touch which place, and when. The bytes lie elsewhere.

use crate::sync::{AtomicU32, Ordering};

/// The two indices of a ring, each written by one side. Lies in shared memory.
///
/// Positions count up and wrap at `2^32`; position `p` is place `p % capacity`. All bits zero is an empty ring.
#[derive(Debug)]
#[repr(C)]
pub struct Indices {
    /// Next position to be taken out. Written by the consumer.
    head: Line,
    /// Next position to be put in. Written by the producer.
    tail: Line,
}

/// An index alone on its cache line, so that the two sides do not take it from each other.
#[derive(Debug)]
#[repr(C, align(64))]
struct Line(AtomicU32);

/// The side that puts in.
///
/// # Invariants
/// Keeps its own index to itself and only publishes it, so the other process cannot move it.
#[derive(Debug)]
pub struct Producer {
    tail: u32,
    capacity: u32,
}

/// The side that takes out. The same invariant holds.
#[derive(Debug)]
pub struct Consumer {
    head: u32,
    capacity: u32,
}

impl Indices {
    /// The indices of an empty ring.
    #[must_use]
    pub fn new() -> Self {
        Self { head: Line(AtomicU32::new(0)), tail: Line(AtomicU32::new(0)) }
    }
}

impl Default for Indices {
    fn default() -> Self {
        Self::new()
    }
}

impl Producer {
    /// The producer of an empty ring with `capacity` places, a power of two.
    #[must_use]
    pub const fn new(capacity: u32) -> Self {
        assert!(capacity.is_power_of_two());
        Self { tail: 0, capacity }
    }

    /// The next free place, which is the producer's until it is published; `None` when there is none.
    ///
    /// A consumer that claims to have taken out more than was put in gets nothing: that reads as full.
    #[must_use]
    pub fn free_place(&self, indices: &Indices) -> Option<u32> {
        // Acquire: pairs with the Release in `Consumer::release`; the consumer is done with the place.
        let used = self.tail.wrapping_sub(indices.head.0.load(Ordering::Acquire));
        (used < self.capacity).then_some(self.tail & (self.capacity - 1))
    }

    /// Gives the place last returned by [`free_place`](Self::free_place) to the consumer.
    pub fn publish(&mut self, indices: &Indices) {
        self.tail = self.tail.wrapping_add(1);
        // Release: pairs with the Acquire in `Consumer::full_place`; what was written to the place is visible.
        indices.tail.0.store(self.tail, Ordering::Release);
    }
}

impl Consumer {
    /// The consumer of an empty ring with `capacity` places, a power of two.
    #[must_use]
    pub const fn new(capacity: u32) -> Self {
        assert!(capacity.is_power_of_two());
        Self { head: 0, capacity }
    }

    /// The next full place, which is the consumer's until it is released; `None` when there is none.
    ///
    /// A producer that claims to have put in more than fits is not believed: that reads as empty.
    #[must_use]
    pub fn full_place(&self, indices: &Indices) -> Option<u32> {
        // Acquire: pairs with the Release in `Producer::publish`.
        let filled = indices.tail.0.load(Ordering::Acquire).wrapping_sub(self.head);
        (1..=self.capacity).contains(&filled).then_some(self.head & (self.capacity - 1))
    }

    /// Gives the place last returned by [`full_place`](Self::full_place) back to the producer.
    pub fn release(&mut self, indices: &Indices) {
        self.head = self.head.wrapping_add(1);
        // Release: pairs with the Acquire in `Producer::free_place`; we are done with the place.
        indices.head.0.store(self.head, Ordering::Release);
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn places_come_in_turn_and_a_full_ring_has_none() {
        let indices = Indices::new();
        let (mut producer, mut consumer) = (Producer::new(2), Consumer::new(2));
        assert_eq!(consumer.full_place(&indices), None);
        for place in [0, 1] {
            assert_eq!(producer.free_place(&indices), Some(place));
            producer.publish(&indices);
        }
        assert_eq!(producer.free_place(&indices), None);
        assert_eq!(consumer.full_place(&indices), Some(0));
        consumer.release(&indices);
        assert_eq!(producer.free_place(&indices), Some(0));
        assert_eq!(consumer.full_place(&indices), Some(1));
    }

    #[test]
    fn positions_wrap() {
        let indices = Indices::new();
        let start = u32::MAX - 1;
        indices.head.0.store(start, Ordering::Relaxed);
        indices.tail.0.store(start, Ordering::Relaxed);
        let mut producer = Producer { tail: start, capacity: 4 };
        let mut consumer = Consumer { head: start, capacity: 4 };
        for step in 0..10 {
            let place = start.wrapping_add(step) & 3;
            assert_eq!(producer.free_place(&indices), Some(place));
            producer.publish(&indices);
            assert_eq!(consumer.full_place(&indices), Some(place));
            consumer.release(&indices);
            assert_eq!(consumer.full_place(&indices), None);
        }
    }

    #[test]
    fn a_lying_peer_gets_nothing() {
        for lie in [3, 100, u32::MAX, 1 << 31] {
            let indices = Indices::new();
            indices.tail.0.store(lie, Ordering::Relaxed);
            assert_eq!(Consumer::new(2).full_place(&indices), None, "tail {lie}");
            let indices = Indices::new();
            indices.head.0.store(lie, Ordering::Relaxed);
            let place = Producer::new(2).free_place(&indices);
            assert!(place.is_none_or(|place| place < 2), "head {lie}");
        }
    }
}
