//! What is stated of extremes: the slowest and fastest peers, the fewest and most pages, slots and nodes, and clocks
//! that jump.

use dsm_core::home::{Answer, Home};
use dsm_core::id::{ClusterId, Epoch, Incarnation, MAX_NODES, NodeId, PageId, PortId};
use dsm_core::node::{Config, ConfigError, Fault, Node, Output};
use dsm_core::page_table::StorageError;
use dsm_core::placement::{REPLICAS_MAX, Stripes};
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{Body, HEADER_BYTES, Message, Refusal};
use proptest::prelude::*;

const PORT: PortId = PortId(0);
const PAGE_BYTES: u32 = 4096;
const SECOND: u64 = 1_000_000;

fn at(micros: u64) -> Instant {
    Instant::from_micros(micros)
}

/// Memory for a node, on the heap.
struct Lent {
    pages: Vec<PageEntry>,
    slots: Vec<SlotEntry>,
    peers: Vec<PeerEntry>,
    requests: Vec<RequestEntry>,
}

impl Lent {
    fn for_placement(placement: &Stripes, slots: usize) -> Self {
        Self {
            pages: vec![PageEntry::EMPTY; placement.page_count() as usize],
            slots: vec![SlotEntry::EMPTY; slots],
            peers: vec![PeerEntry::EMPTY; placement.owner_count().into()],
            requests: vec![RequestEntry::EMPTY; 4],
        }
    }

    fn node(&mut self, config: Config) -> Result<Node<'_>, ConfigError> {
        let Self { pages, slots, peers, requests } = self;
        Node::new(config, Storage { pages, slots, peers, requests }, Policy::new(PolicyKind::Fifo, 1))
    }
}

/// Takes all outputs; gives the requests among them, each with whom it is for, and the pages that have to leave.
fn outputs(node: &mut Node<'_>) -> (Vec<Message>, Vec<PageId>) {
    let (mut requests, mut victims) = (Vec::new(), Vec::new());
    let mut buffer = [0; HEADER_BYTES];
    loop {
        match node.poll(&mut buffer) {
            Output::Idle(_) => return (requests, victims),
            Output::Transmit { len, .. } => requests.push(Message::parse(&buffer[..len]).unwrap()),
            Output::Unmap { page, .. } => victims.push(page),
            _ => {}
        }
    }
}

fn give(node: &mut Node<'_>, now: Instant, message: &Message) {
    let mut buffer = [0; HEADER_BYTES];
    message.emit(&mut buffer);
    let _ = node.handle_message(now, &buffer);
    let _ = outputs(node);
}

/// Fetches `page` from an owner that answers every request `round_trip_us` later; gives the time then.
fn fetch_slowly(node: &mut Node<'_>, start: u64, page: u32, round_trip_us: u64) -> u64 {
    assert_eq!(node.handle_fault(at(start), PageId(page), PORT), Fault::Fetch);
    let mut answer = Some(outputs(node).0[0]);
    let arrives = start + round_trip_us;
    while let Some(due) = node.next_timeout(PORT).filter(|due| *due < at(arrives)) {
        node.handle_timeout(due, PORT);
        let _ = outputs(node);
    }
    if let Some(request) = answer.take() {
        give(node, at(arrives), &request.grant(request.to, PAGE_BYTES));
    }
    node.handle_filled(at(arrives), PageId(page));
    let _ = outputs(node);
    arrives
}

#[test]
fn round_trips_from_a_microsecond_to_ten_seconds_are_learnt_from_the_first_answer_on() {
    let placement = Stripes::new(64, 64, NodeId(1), 1).unwrap();
    for round_trip_us in [1, 10, 100, 1_000, 10_000, 100_000, SECOND, 10 * SECOND] {
        let mut lent = Lent::for_placement(&placement, 64);
        let mut node = lent
            .node(Config {
                resend_us_min: 1,
                suspect_after_us: 60 * SECOND,
                dead_after_us: 60 * SECOND,
                deadline_us: 120 * SECOND,
                ..Config::new(NodeId(0), placement, PAGE_BYTES)
            })
            .unwrap();
        let mut now = fetch_slowly(&mut node, SECOND, 0, round_trip_us);
        // The first answer is one to the first sending, however often the request was sent since.
        assert_eq!(node.round_trip_us(NodeId(1)), Some(round_trip_us));
        let resends = node.stats().resends;
        for page in 1..64 {
            now = fetch_slowly(&mut node, now + 7, page, round_trip_us);
        }
        assert_eq!(node.round_trip_us(NodeId(1)), Some(round_trip_us));
        assert_eq!((node.stats().resends, node.stats().failed_pages), (resends, 0), "{round_trip_us} us");
        node.check_invariants();
    }
}

#[test]
fn one_page_and_one_slot_are_a_cluster() {
    let placement = Stripes::new(1, 1, NodeId(1), 1).unwrap();
    let mut lent = Lent::for_placement(&placement, 1);
    let mut node = lent.node(Config::new(NodeId(0), placement, PAGE_BYTES)).unwrap();
    fetch_slowly(&mut node, 0, 0, 5);
    assert_eq!(node.handle_fault(at(9), PageId(0), PORT), Fault::Ready);
    assert!(outputs(&mut node).1.is_empty());
    // Its owner needs no slot, no request and nobody.
    let mut lent = Lent { slots: Vec::new(), requests: Vec::new(), ..Lent::for_placement(&placement, 0) };
    let mut owner = lent.node(Config::new(NodeId(1), placement, PAGE_BYTES)).unwrap();
    assert_eq!(owner.handle_fault(at(0), PageId(0), PORT), Fault::Ready);
    owner.check_invariants();
}

#[test]
fn one_slot_serves_every_page_in_turn() {
    let placement = Stripes::new(100, 1, NodeId(1), 1).unwrap();
    let mut lent = Lent::for_placement(&placement, 1);
    let mut node = lent.node(Config::new(NodeId(0), placement, PAGE_BYTES)).unwrap();
    for page in 0..100 {
        if page > 0 {
            assert_eq!(node.handle_fault(at(10), PageId(page), PORT), Fault::Full);
            assert_eq!(outputs(&mut node).1, [PageId(page - 1)]);
            node.handle_unmapped(at(10), PageId(page - 1));
            let _ = outputs(&mut node);
        }
        fetch_slowly(&mut node, 10, page, 5);
        node.check_invariants();
    }
    assert_eq!((node.stats().fetched_pages, node.stats().evicted_pages), (100, 99));
}

#[test]
fn of_the_most_pages_there_can_be_the_last_is_placed_granted_and_refused_like_any() {
    let last = PageId(u32::MAX - 1);
    let placement = Stripes::new(u32::MAX, 64, NodeId(0), MAX_NODES).unwrap();
    let placement = placement.with_replicas(REPLICAS_MAX).unwrap();
    assert_eq!(placement.home(PageId(u32::MAX)), None);
    let holders = placement.holders(last);
    assert_eq!(holders.as_slice().len(), usize::from(REPLICAS_MAX));
    let held: u64 = placement.owner_ids().map(|owner| u64::from(placement.held_pages(owner))).sum();
    assert_eq!(held, u64::from(u32::MAX) * u64::from(REPLICAS_MAX));
    for owner in placement.owner_ids().filter(|owner| holders.contains(*owner)) {
        let mut home = Home::new(owner, ClusterId(0), Epoch(0), placement, PAGE_BYTES);
        let mut answer = |page| {
            let mut buffer = [0; HEADER_BYTES];
            request(NodeId(7), owner, page).emit(&mut buffer);
            home.handle_message(&buffer).unwrap()
        };
        let Answer::Grant { message, held_index } = answer(last) else { panic!("not granted") };
        assert!(held_index < placement.held_pages(owner) && message.page == last);
        let Answer::Refuse { message } = answer(PageId(u32::MAX)) else { panic!("granted") };
        assert_eq!(message.body, Body::Refusal(Refusal::NotOwner));
    }
}

#[test]
fn a_table_for_the_most_pages_is_asked_for_by_number_and_not_allocated() {
    let placement = Stripes::new(u32::MAX, 1, NodeId(1), 1).unwrap();
    let mut lent = Lent {
        pages: vec![PageEntry::EMPTY; 3],
        slots: vec![SlotEntry::EMPTY],
        peers: vec![PeerEntry::EMPTY],
        requests: vec![RequestEntry::EMPTY],
    };
    let error = lent.node(Config::new(NodeId(0), placement, PAGE_BYTES)).map(|_| ()).unwrap_err();
    assert_eq!(error, ConfigError::Storage(StorageError::Pages { needed: u32::MAX, got: 3 }));
}

#[test]
fn every_owner_of_the_largest_cluster_is_asked_and_believed() {
    let owners = MAX_NODES - 1;
    let placement = Stripes::new(owners.into(), 1, NodeId(1), owners).unwrap();
    let mut lent = Lent::for_placement(&placement, owners.into());
    let mut node = lent.node(Config::new(NodeId(0), placement, PAGE_BYTES)).unwrap();
    for page in 0..owners {
        fetch_slowly(&mut node, 10, page.into(), 3);
        assert_eq!(node.round_trip_us(NodeId(page + 1)), Some(3));
    }
    assert_eq!(node.stats().fetched_pages, owners.into());
    node.check_invariants();
    assert!(Stripes::new(1, 1, NodeId(0), MAX_NODES + 1).is_err());
    assert!(Stripes::new(1, 1, NodeId(MAX_NODES), 1).is_err());
}

fn request(from: NodeId, to: NodeId, page: PageId) -> Message {
    Message {
        cluster: ClusterId(0),
        epoch: Epoch(0),
        from,
        to,
        from_incarnation: Incarnation(0),
        to_incarnation: Incarnation(0),
        page,
        request: u32::MAX,
        stamp_us: u32::MAX,
        body: Body::REQUEST,
    }
}

/// Clocks as the worst systems have them.
fn any_clock() -> impl Strategy<Value = Vec<u64>> {
    let reading = prop_oneof![any::<u64>(), 0..10 * SECOND, Just(0), Just(u64::MAX)];
    prop::collection::vec(reading, 1..60)
}

proptest! {
    #[test]
    fn whatever_the_clock_says_a_fault_ends_within_its_deadline_of_a_clock_that_runs(
        readings in any_clock(), start in prop_oneof![0..SECOND, Just(u64::MAX / 2)],
    ) {
        let placement = Stripes::new(4, 1, NodeId(1), 2).unwrap().with_replicas(2).unwrap();
        let mut lent = Lent::for_placement(&placement, 2);
        let config = Config::new(NodeId(0), placement, PAGE_BYTES);
        let mut node = lent.node(config).unwrap();
        assert_eq!(node.handle_fault(at(readings[0]), PageId(1), PORT), Fault::Fetch);
        let _ = outputs(&mut node);
        for reading in readings {
            node.handle_timeout(at(reading), PORT);
            let _ = outputs(&mut node);
            node.check_invariants();
        }
        // From here on the clock runs as it should.
        let mut now = start;
        node.handle_timeout(at(now), PORT);
        let _ = outputs(&mut node);
        while let Some(due) = node.next_timeout(PORT) {
            prop_assert!(due <= at(start + config.deadline_us), "due {due:?}, from {start} on");
            now = now.max(due.as_micros());
            node.handle_timeout(at(now), PORT);
            let _ = outputs(&mut node);
        }
        prop_assert!(matches!(node.handle_fault(at(now), PageId(1), PORT), Fault::Failed(_)));
    }
}
