#![expect(clippy::cast_possible_truncation, reason = "small numbers")]

use super::*;
use crate::failure::Failure;
use crate::id::{ClusterId, Epoch, NodeId, PageId, PortId};
use crate::page_table::StorageError;
use crate::placement::Stripes;
use crate::replacement::{Policy, PolicyKind};
use crate::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use crate::wire::{Body, HEADER_BYTES};

const PORT: PortId = PortId(0);
const OTHER_PORT: PortId = PortId(1);
const PAGES: usize = 8;

fn at(micros: u64) -> Instant {
    Instant::from_micros(micros)
}

/// Node 0 of two, with pages 0, 2, 4, 6 at home and the odd ones at node 1.
fn with_node<const SLOTS: usize>(change: impl Fn(&mut Config), test: impl Fn(Node<'_>)) {
    let mut config = Config::new(NodeId(0), Stripes::new(PAGES as u32, 1, NodeId(0), 2).unwrap(), 4096);
    change(&mut config);
    let mut pages = [PageEntry::EMPTY; PAGES];
    let mut slots = [SlotEntry::EMPTY; SLOTS];
    let (mut peers, mut requests) = ([PeerEntry::EMPTY; 2], [RequestEntry::EMPTY; 4]);
    let storage =
        Storage { pages: &mut pages, slots: &mut slots, peers: &mut peers, requests: &mut requests };
    test(Node::new(config, storage, Policy::new(PolicyKind::Fifo, 0)).unwrap());
}

fn outputs(node: &mut Node<'_>) -> heapless::Vec<Output, OUTBOX> {
    let mut buffer = [0; HEADER_BYTES];
    let mut outputs = heapless::Vec::new();
    loop {
        match node.poll(&mut buffer) {
            Output::Idle(_) => {
                node.check_invariants();
                return outputs;
            }
            output => outputs.push(output).unwrap(),
        }
    }
}

/// Faults on `page` and returns the request that goes out for it.
fn fetch(node: &mut Node<'_>, now: Instant, page: u32) -> Message {
    assert_eq!(node.handle_fault(now, PageId(page), PORT), Fault::Fetch);
    let mut buffer = [0; HEADER_BYTES];
    let Output::Transmit { len, .. } = node.poll(&mut buffer) else { panic!("no request") };
    let request = Message::parse(&buffer[..len]).unwrap();
    assert_eq!((request.page, request.body), (PageId(page), Body::REQUEST));
    request
}

fn give(node: &mut Node<'_>, now: Instant, message: Message) -> Result<(), MessageError> {
    let mut buffer = [0; HEADER_BYTES];
    message.emit(&mut buffer);
    node.handle_message(now, &buffer)
}

/// Brings `page` in, all the way.
fn bring(node: &mut Node<'_>, now: Instant, page: u32) {
    let request = fetch(node, now, page);
    assert_eq!(outputs(node), []);
    give(node, now, request.grant(NodeId(1), 4096)).unwrap();
    assert!(matches!(outputs(node)[..], [Output::Map { .. }]));
    node.handle_filled(now, PageId(page));
    assert_eq!(outputs(node), []);
    assert_eq!(node.table().state(PageId(page)), Some(PageState::Resident));
}

#[test]
fn a_second_fault_sends_no_second_request_and_is_woken() {
    with_node::<2>(
        |_| (),
        |mut node| {
            let request = fetch(&mut node, at(0), 1);
            assert_eq!(node.handle_fault(at(1), PageId(1), OTHER_PORT), Fault::Wait);
            assert_eq!(outputs(&mut node), []);
            give(&mut node, at(2), request.grant(NodeId(1), 4096)).unwrap();
            let _ = outputs(&mut node);
            assert_eq!(node.handle_fault(at(3), PageId(1), OTHER_PORT), Fault::Wait);
            node.handle_filled(at(4), PageId(1));
            assert_eq!(outputs(&mut node), [Output::WakePage { page: PageId(1) }]);
            assert_eq!(node.handle_fault_again(at(5), PageId(1), OTHER_PORT, at(1)), Fault::Ready);
            let stats = node.stats();
            assert_eq!((stats.faults, stats.merged_faults, stats.requests), (3, 2, 1));
        },
    );
}

#[test]
fn home_pages_are_always_ready() {
    with_node::<1>(
        |_| (),
        |mut node| {
            assert_eq!(node.handle_fault(at(0), PageId(4), PORT), Fault::Ready);
            assert_eq!(outputs(&mut node), []);
        },
    );
}

#[test]
fn with_one_slot_a_page_leaves_before_the_next_is_asked_for() {
    with_node::<1>(
        |_| (),
        |mut node| {
            bring(&mut node, at(0), 1);
            assert_eq!(node.handle_fault(at(1), PageId(3), PORT), Fault::Full);
            assert_eq!(outputs(&mut node), [Output::Unmap { page: PageId(1), slot: SlotId(0) }]);
            // Another thread finds the slot on its way out and waits; nothing is taken away twice.
            assert_eq!(node.handle_fault(at(2), PageId(5), OTHER_PORT), Fault::Full);
            assert_eq!(outputs(&mut node), []);
            node.handle_unmapped(at(3), PageId(1));
            assert_eq!(outputs(&mut node), [Output::WakeSlots]);
            assert_eq!(node.handle_fault_again(at(4), PageId(3), PORT, at(1)), Fault::Fetch);
            assert!(matches!(outputs(&mut node)[..], [Output::Transmit { .. }]));
        },
    );
}

#[test]
fn a_fault_on_a_leaving_page_waits_until_it_is_gone() {
    with_node::<1>(
        |_| (),
        |mut node| {
            bring(&mut node, at(0), 1);
            assert_eq!(node.handle_fault(at(1), PageId(3), PORT), Fault::Full);
            let _ = outputs(&mut node);
            assert_eq!(node.handle_fault(at(2), PageId(1), OTHER_PORT), Fault::Wait);
            let _ = outputs(&mut node);
            node.handle_unmapped(at(3), PageId(1));
            assert_eq!(outputs(&mut node), [Output::WakePage { page: PageId(1) }, Output::WakeSlots]);
        },
    );
}

#[test]
fn evicting_ahead_happens_in_the_shadow_of_a_request() {
    let ahead = |config: &mut Config| (config.evict_ahead, config.evict_batch) = (2, 2);
    with_node::<4>(ahead, |mut node| {
        for page in [1, 3] {
            bring(&mut node, at(0), page);
        }
        let _ = fetch(&mut node, at(1), 5);
        let victims: heapless::Vec<_, 4> =
            outputs(&mut node).iter().map(|output| matches!(output, Output::Unmap { .. })).collect();
        assert_eq!(victims, [true, true]);
        assert_eq!(node.table().leaving_count(), 2);
    });
}

#[test]
fn a_request_is_sent_again_at_doubling_times_and_fails_at_its_deadline() {
    let times = |config: &mut Config| (config.resend_us, config.deadline_us) = (10, 100);
    with_node::<1>(times, |mut node| {
        let first = fetch(&mut node, at(0), 1);
        let mut sent = heapless::Vec::<u64, 16>::new();
        for now in 0..100 {
            node.handle_timeout(at(now), PORT);
            if outputs(&mut node).iter().any(|output| matches!(output, Output::Transmit { .. })) {
                sent.push(now).unwrap();
            }
        }
        assert_eq!(sent, [10, 30, 70]);
        assert_eq!(node.handle_fault(at(99), PageId(1), OTHER_PORT), Fault::Wait);
        let _ = outputs(&mut node);
        node.handle_timeout(at(100), PORT);
        assert_eq!(outputs(&mut node), [Output::WakePage { page: PageId(1) }]);
        let failure = Failure::NoAnswer { from: NodeId(1) };
        assert_eq!(node.handle_fault_again(at(101), PageId(1), OTHER_PORT, at(99)), Fault::Failed(failure));
        assert_eq!(
            give(&mut node, at(102), first.grant(NodeId(1), 4096)),
            Err(MessageError::Late(PageId(1)))
        );
        assert_eq!(node.table().free_count(), 1);
    });
}

#[test]
fn the_timeout_of_another_port_touches_nothing() {
    with_node::<1>(
        |config| config.resend_us = 10,
        |mut node| {
            let _ = fetch(&mut node, at(0), 1);
            node.handle_timeout(at(50), OTHER_PORT);
            assert_eq!(outputs(&mut node), []);
            assert_eq!(node.next_timeout(OTHER_PORT), None);
            assert_eq!(node.next_timeout(PORT), Some(at(10)));
        },
    );
}

#[test]
fn a_refusal_fails_the_page_at_once() {
    with_node::<1>(
        |_| (),
        |mut node| {
            let request = fetch(&mut node, at(0), 1);
            give(&mut node, at(1), request.refusal(NodeId(1), crate::wire::Refusal::NotOwner)).unwrap();
            let _ = outputs(&mut node);
            let failure = Failure::Refused { by: NodeId(1), why: crate::wire::Refusal::NotOwner };
            assert_eq!(node.handle_fault(at(2), PageId(1), PORT), Fault::Failed(failure));
        },
    );
}

#[test]
fn a_slot_that_never_comes_free_fails_the_waiter_by_its_deadline() {
    with_node::<1>(
        |config| config.deadline_us = 100,
        |mut node| {
            let _ = fetch(&mut node, at(0), 1);
            assert_eq!(node.handle_fault(at(10), PageId(3), OTHER_PORT), Fault::Full);
            let _ = outputs(&mut node);
            assert_eq!(node.handle_fault_again(at(109), PageId(3), OTHER_PORT, at(10)), Fault::Full);
            let _ = outputs(&mut node);
            let failure = Fault::Failed(Failure::NoSlot);
            assert_eq!(node.handle_fault_again(at(110), PageId(3), OTHER_PORT, at(10)), failure);
        },
    );
}

#[test]
fn messages_that_make_no_sense_are_counted_and_change_nothing() {
    with_node::<1>(
        |_| (),
        |mut node| {
            let request = fetch(&mut node, at(0), 1);
            let good = request.grant(NodeId(1), 4096);
            let wrong = [
                (Message { cluster: ClusterId(9), ..good }, MessageError::Cluster(ClusterId(9))),
                (Message { epoch: Epoch(9), ..good }, MessageError::Epoch(Epoch(9))),
                (Message { to: NodeId(9), ..good }, MessageError::To(NodeId(9))),
                (Message { page: PageId(99), ..good }, MessageError::NoSuchPage(PageId(99))),
                (
                    Message { from: NodeId(0), ..good },
                    MessageError::NotOwner { page: PageId(1), from: NodeId(0) },
                ),
                (
                    Message { body: Body::Grant { offset: 0, bytes: 16 }, ..good },
                    MessageError::Fragment { offset: 0, bytes: 16 },
                ),
                (Message { body: Body::REQUEST, ..good }, MessageError::Request),
                (Message { request: good.request + 1, ..good }, MessageError::Late(PageId(1))),
            ];
            for (message, error) in wrong {
                assert_eq!(give(&mut node, at(1), message), Err(error));
                assert_eq!(outputs(&mut node), []);
            }
            assert_eq!((node.stats().refused_messages, node.stats().late_answers), (7, 1));
            give(&mut node, at(2), good).unwrap();
            assert!(matches!(outputs(&mut node)[..], [Output::Map { .. }]));
        },
    );
}

#[test]
fn configurations_that_contradict_themselves_are_refused() {
    let placement = Stripes::new(PAGES as u32, 1, NodeId(0), 2).unwrap();
    let good = Config::new(NodeId(0), placement, 4096);
    let attempt = |config: Config, page_entries: usize, slot_entries: usize| {
        let mut pages = [PageEntry::EMPTY; PAGES];
        let mut slots = [SlotEntry::EMPTY; 4];
        let (mut peers, mut requests) = ([PeerEntry::EMPTY; 2], [RequestEntry::EMPTY; 4]);
        let storage = Storage {
            pages: &mut pages[..page_entries],
            slots: &mut slots[..slot_entries],
            peers: &mut peers,
            requests: &mut requests,
        };
        Node::new(config, storage, Policy::new(PolicyKind::Fifo, 0)).map(|_| ())
    };
    assert_eq!(attempt(good, PAGES, 4), Ok(()));
    assert_eq!(attempt(Config { page_bytes: 5000, ..good }, PAGES, 4), Err(ConfigError::PageBytes(5000)));
    assert_eq!(attempt(Config { evict_batch: 33, ..good }, PAGES, 4), Err(ConfigError::EvictBatch(33)));
    assert_eq!(attempt(Config { deadline_us: 0, ..good }, PAGES, 4), Err(ConfigError::ZeroTime));
    let pages = StorageError::Pages { needed: 8, got: 3 };
    assert_eq!(attempt(good, 3, 4), Err(ConfigError::Storage(pages)));
    assert_eq!(attempt(good, PAGES, 0), Err(ConfigError::Storage(StorageError::NoSlots)));
}
