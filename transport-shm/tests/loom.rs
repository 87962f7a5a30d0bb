//! The ring and the bell under every order of memory that the language allows.
//!
//! `RUSTFLAGS="--cfg loom" cargo test -p transport-shm --test loom --release`
#![cfg(loom)]

use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::thread;
use transport_shm::bell::Bell;
use transport_shm::ring::{Consumer, Indices, Producer};

const CAPACITY: u32 = 2;

/// Every execution in which the threads are interrupted at most three times where they need not be.
fn explore(model: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(builder.preemption_bound.unwrap_or(3));
    builder.check(model);
}

/// A ring as it lies in shared memory, with payloads that loom watches for races.
struct Shared {
    indices: Indices,
    bell: Bell,
    places: [UnsafeCell<u32>; CAPACITY as usize],
}

impl Shared {
    fn new() -> Arc<Self> {
        let places = [UnsafeCell::new(0), UnsafeCell::new(0)];
        Arc::new(Self { indices: Indices::new(), bell: Bell::new(), places })
    }

    fn put(&self, producer: &mut Producer, value: u32) -> bool {
        let Some(place) = producer.free_place(&self.indices) else { return false };
        // SAFETY: the place is the producer's until it is published; loom reports it if that is not so.
        self.places[place as usize].with_mut(|place| unsafe { *place = value });
        producer.publish(&self.indices);
        self.bell.ring();
        true
    }

    fn take(&self, consumer: &mut Consumer) -> Option<u32> {
        let place = consumer.full_place(&self.indices)?;
        // SAFETY: the place is the consumer's until it is released; loom reports it if that is not so.
        let value = self.places[place as usize].with(|place| unsafe { *place });
        consumer.release(&self.indices);
        Some(value)
    }
}

#[test]
fn what_is_put_in_comes_out_whole_and_in_order() {
    explore(|| {
        let shared = Shared::new();
        let other = shared.clone();
        let producer = thread::spawn(move || {
            let mut producer = Producer::new(CAPACITY);
            let mut value = 1;
            while value <= 3 {
                if other.put(&mut producer, value) {
                    value += 1;
                } else {
                    thread::yield_now();
                }
            }
        });
        let mut consumer = Consumer::new(CAPACITY);
        let mut expected = 1;
        while expected <= 3 {
            match shared.take(&mut consumer) {
                Some(value) => {
                    assert_eq!(value, expected);
                    expected += 1;
                }
                None => thread::yield_now(),
            }
        }
        producer.join().unwrap();
    });
}

#[test]
fn a_sleeper_is_woken_by_whatever_is_published() {
    // Two messages: with one, even the wrong order of the handshake passes.
    explore(|| {
        let shared = Shared::new();
        let other = shared.clone();
        let producer = thread::spawn(move || {
            let mut producer = Producer::new(CAPACITY);
            assert!(other.put(&mut producer, 1));
            assert!(other.put(&mut producer, 2));
        });
        let mut consumer = Consumer::new(CAPACITY);
        for expected in [1, 2] {
            loop {
                if let Some(value) = shared.take(&mut consumer) {
                    assert_eq!(value, expected);
                    break;
                }
                // Without a timeout in the model: a lost wake-up is a deadlock, and loom reports it.
                shared.bell.wait(0, || consumer.full_place(&shared.indices).is_some());
            }
        }
        producer.join().unwrap();
    });
}

#[test]
fn two_ringers_do_not_hide_each_other() {
    explore(|| {
        let rings = [Shared::new(), Shared::new()];
        let bell = Arc::new(Bell::new());
        let ringers = rings.clone().map(|ring| {
            let bell = bell.clone();
            thread::spawn(move || {
                assert!(ring.put(&mut Producer::new(CAPACITY), 7));
                bell.ring();
            })
        });
        let mut consumers = [Consumer::new(CAPACITY), Consumer::new(CAPACITY)];
        let mut taken = 0;
        while taken < 2 {
            taken +=
                rings.iter().zip(&mut consumers).filter_map(|(ring, consumer)| ring.take(consumer)).count();
            if taken < 2 {
                bell.wait(0, || {
                    rings
                        .iter()
                        .zip(&consumers)
                        .any(|(ring, consumer)| consumer.full_place(&ring.indices).is_some())
                });
            }
        }
        for ringer in ringers {
            ringer.join().unwrap();
        }
    });
}
