//! All the world can do to a cluster, and a cluster it can be done to.
//!
//! Three nodes, two threads each, in virtual time. The driver here is the smallest correct one: it keeps a list of
//! messages under way and of work that a real driver would be busy with, and the operations choose what happens next.
#![expect(clippy::cast_possible_truncation, reason = "small numbers")]

use std::collections::{BTreeMap, BTreeSet};

use dsm_core::home::{Answer, Home};
use dsm_core::id::{Incarnation, NodeId, PageId, PortId, SlotId};
use dsm_core::node::{Config, Fault, Node, Output};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{Body, HEADER_BYTES, Message};

pub(crate) const NODES: u8 = 3;
pub(crate) const THREADS: u8 = 2;
pub(crate) const PAGES: u8 = 9;

/// One thing that can happen.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Op {
    /// A thread reads a page. Without effect while it waits for another.
    Read { node: u8, thread: u8, page: u8 },
    /// The n-th message under way arrives.
    Deliver(u8),
    /// The n-th message under way is lost.
    Drop(u8),
    /// The n-th message under way arrives and stays under way.
    Duplicate(u8),
    /// The n-th piece of work of a node is finished: a slot filled, a victim unmapped.
    Finish { node: u8, work: u8 },
    /// Time passes, and every thread looks after its requests.
    Advance { us: u16 },
    /// Bytes that are nearly a message arrive: the n-th message under way with one byte changed.
    Corrupt { message: u8, byte: u8, xor: u8 },
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Setup {
    pub(crate) slots: u8,
    pub(crate) policy: PolicyKind,
    pub(crate) evict_batch: u8,
    pub(crate) evict_ahead: u8,
}

/// What a thread is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thread {
    Running,
    Fetching { page: PageId, since: Instant },
    WaitingForPage { page: PageId, since: Instant },
    WaitingForSlot { page: PageId, since: Instant },
}

#[derive(Clone, Copy, Debug)]
enum Work {
    Fill { page: PageId, slot: SlotId },
    Unmap { page: PageId },
}

struct Member {
    node: Node<'static>,
    home: Home,
    threads: [Thread; THREADS as usize],
    work: Vec<Work>,
    /// The oracle: which pages this node's readers can see, and in which slot.
    visible: BTreeMap<u32, u32>,
}

/// A cluster and its network.
pub(crate) struct World {
    now: Instant,
    members: Vec<Member>,
    under_way: Vec<[u8; HEADER_BYTES]>,
    pub(crate) served: u64,
    pub(crate) failed: u64,
}

/// Runs `ops` on a cluster, with every invariant checked after each, then lets it come to rest.
pub(crate) fn run(setup: Setup, ops: &[Op]) -> World {
    let mut world = World::new(setup);
    for op in ops {
        world.apply(*op);
        world.check();
    }
    world.come_to_rest();
    world
}

impl World {
    fn new(setup: Setup) -> Self {
        let placement = Stripes::new(u32::from(PAGES), 2, NodeId(0), u16::from(NODES)).unwrap();
        let members = (0..u16::from(NODES)).map(|node| Member::new(setup, placement, NodeId(node))).collect();
        Self { now: Instant::from_micros(1000), members, under_way: Vec::new(), served: 0, failed: 0 }
    }

    fn apply(&mut self, op: Op) {
        match op {
            Op::Read { node, thread, page } => {
                let (node, thread) = (usize::from(node % NODES), usize::from(thread % THREADS));
                if self.members[node].threads[thread] == Thread::Running {
                    self.fault(node, thread, PageId(u32::from(page % PAGES)), None);
                }
            }
            Op::Deliver(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    let message = self.under_way.swap_remove(index);
                    self.deliver(message);
                }
            }
            Op::Drop(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    self.under_way.swap_remove(index);
                }
            }
            Op::Duplicate(index) => {
                if let Some(index) = pick(index, self.under_way.len()) {
                    self.deliver(self.under_way[index]);
                }
            }
            Op::Finish { node, work } => self.finish(usize::from(node % NODES), work),
            Op::Advance { us } => self.advance(u64::from(us)),
            Op::Corrupt { message, byte, xor } => {
                if let Some(index) = pick(message, self.under_way.len()) {
                    let mut bytes = self.under_way[index];
                    bytes[usize::from(byte) % HEADER_BYTES] ^= xor;
                    // A changed request number or page can still be a believable message; both are fine.
                    self.deliver(bytes);
                }
            }
        }
    }

    /// Delivers everything, finishes all work and lets time pass until nobody waits. `NO_LOST_WAITER`.
    fn come_to_rest(&mut self) {
        for _ in 0..10_000 {
            while let Some(message) = self.under_way.pop() {
                self.deliver(message);
                self.check();
            }
            for node in 0..self.members.len() {
                while !self.members[node].work.is_empty() {
                    self.finish(node, 0);
                    self.check();
                }
            }
            if self
                .members
                .iter()
                .all(|member| member.threads.iter().all(|thread| *thread == Thread::Running))
            {
                return;
            }
            self.advance(997);
            self.check();
        }
        panic!("NO_LOST_WAITER: a thread waits for ever");
    }

    fn fault(&mut self, node: usize, thread: usize, page: PageId, since: Option<Instant>) {
        let now = self.now;
        let member = &mut self.members[node];
        let port = PortId(thread as u8);
        let answer = match since {
            None => member.node.handle_fault(now, page, port),
            Some(since) => member.node.handle_fault_again(now, page, port, since),
        };
        let since = since.unwrap_or(now);
        member.threads[thread] = match answer {
            Fault::Ready => {
                self.served += 1;
                let own = member.home.handle_message(&request_for(page, NodeId(node as u16)));
                let own = matches!(own, Ok(Answer::Grant { .. }));
                assert!(
                    own || member.visible.contains_key(&page.0),
                    "told to go on, and {page} is not visible"
                );
                Thread::Running
            }
            Fault::Failed(_) => {
                self.failed += 1;
                Thread::Running
            }
            Fault::Fetch => Thread::Fetching { page, since },
            Fault::Wait => Thread::WaitingForPage { page, since },
            Fault::Full => Thread::WaitingForSlot { page, since },
        };
        self.drain(node);
    }

    fn drain(&mut self, node: usize) {
        let mut buffer = [0; HEADER_BYTES];
        let mut woken = Vec::new();
        loop {
            let member = &mut self.members[node];
            match member.node.poll(&mut buffer) {
                Output::Idle(_) => break,
                Output::Transmit { len, .. } => {
                    assert_eq!(len, HEADER_BYTES);
                    self.under_way.push(buffer);
                }
                Output::Map { page, slot, .. } => member.work.push(Work::Fill { page, slot }),
                Output::Unmap { page, slot } => {
                    assert_eq!(member.visible.get(&page.0), Some(&slot.0), "a victim is visible until it is unmapped");
                    member.work.push(Work::Unmap { page });
                }
                Output::Store { .. } => panic!("fragments were not asked for"),
                Output::WakePage { page } => woken.extend(member.waiters(|thread| {
                    matches!(thread, Thread::WaitingForPage { page: waited_for, .. } if waited_for == page)
                })),
                Output::WakeSlots => {
                    woken.extend(member.waiters(|thread| matches!(thread, Thread::WaitingForSlot { .. })));
                }
            }
        }
        for (thread, page, since) in woken {
            // Waking one may have changed what the next finds; each simply asks again.
            self.fault(node, thread, page, Some(since));
        }
    }

    fn deliver(&mut self, bytes: [u8; HEADER_BYTES]) {
        let Ok(message) = Message::parse(&bytes) else { return };
        let to = usize::from(message.to.0);
        let Some(member) = self.members.get_mut(to) else { return };
        if let Body::Request { .. } = message.body {
            match member.home.handle_message(&bytes) {
                Ok(Answer::Grant { message, .. } | Answer::Refuse { message }) => {
                    let mut answer = [0; HEADER_BYTES];
                    message.emit(&mut answer);
                    self.under_way.push(answer);
                }
                Err(_) => {}
            }
        } else {
            let _ = member.node.handle_message(self.now, &bytes);
            self.drain(to);
            self.look_after_fetchers(to);
        }
    }

    fn finish(&mut self, node: usize, work: u8) {
        let member = &mut self.members[node];
        let Some(index) = pick(work, member.work.len()) else { return };
        match member.work.swap_remove(index) {
            Work::Fill { page, slot } => {
                assert!(
                    !member.visible.values().any(|other| *other == slot.0),
                    "SLOT_HOLDS_ONE_PAGE: filled twice"
                );
                member.visible.insert(page.0, slot.0);
                member.node.handle_filled(self.now, page);
            }
            Work::Unmap { page } => {
                member.visible.remove(&page.0);
                member.node.handle_unmapped(self.now, page);
            }
        }
        self.drain(node);
        self.look_after_fetchers(node);
    }

    fn advance(&mut self, us: u64) {
        self.now = self.now.after(us);
        for node in 0..self.members.len() {
            for thread in 0..THREADS {
                self.members[node].node.handle_timeout(self.now, PortId(thread));
                self.drain(node);
            }
            self.look_after_fetchers(node);
            // A wait for a slot is a timed one: it looks again now and then, and so finds its own deadline.
            let waiters =
                self.members[node].waiters(|thread| matches!(thread, Thread::WaitingForSlot { .. }));
            for (thread, page, since) in waiters {
                self.fault(node, thread, page, Some(since));
            }
        }
    }

    /// A thread that fetches goes on when its page is there, or has failed.
    fn look_after_fetchers(&mut self, node: usize) {
        let under_way: BTreeSet<u32> = self.members[node].work.iter().filter_map(Work::filling).collect();
        let fetchers = self.members[node].waiters(|thread| matches!(thread, Thread::Fetching { .. }));
        for (thread, page, since) in fetchers {
            let state = self.members[node].node.table().state(page).unwrap();
            let on_its_way = format!("{state:?}") == "Requested" || under_way.contains(&page.0);
            if !on_its_way {
                self.fault(node, thread, page, Some(since));
            }
        }
    }

    fn check(&self) {
        for member in &self.members {
            member.node.check_invariants();
            let slots: BTreeSet<u32> = member.visible.values().copied().collect();
            assert_eq!(
                slots.len(),
                member.visible.len(),
                "SLOT_HOLDS_ONE_PAGE: two visible pages share a slot"
            );
            assert!(member.visible.len() <= member.node.table().slot_count() as usize, "BOUNDED");
        }
    }
}

impl Member {
    fn new(setup: Setup, placement: Stripes, me: NodeId) -> Self {
        let config = Config {
            evict_batch: u32::from(setup.evict_batch),
            evict_ahead: u32::from(setup.evict_ahead),
            resend_us: 1_000,
            deadline_us: 20_000,
            ..Config::new(me, placement, 4096)
        };
        let storage = Storage {
            pages: Box::leak(vec![PageEntry::EMPTY; usize::from(PAGES)].into_boxed_slice()),
            slots: Box::leak(vec![SlotEntry::EMPTY; usize::from(setup.slots)].into_boxed_slice()),
            peers: Box::leak(vec![PeerEntry::EMPTY; usize::from(NODES)].into_boxed_slice()),
            requests: Box::leak(vec![RequestEntry::EMPTY; 8].into_boxed_slice()),
        };
        let node = Node::new(config, storage, Policy::new(setup.policy, 1)).unwrap();
        let home = Home::new(me, config.cluster, config.epoch, placement, config.page_bytes);
        Self {
            node,
            home,
            threads: [Thread::Running; THREADS as usize],
            work: Vec::new(),
            visible: BTreeMap::new(),
        }
    }

    fn waiters(&self, wanted: impl Fn(Thread) -> bool) -> Vec<(usize, PageId, Instant)> {
        let parts = |(index, thread): (usize, &Thread)| match *thread {
            Thread::Running => None,
            Thread::Fetching { page, since }
            | Thread::WaitingForPage { page, since }
            | Thread::WaitingForSlot { page, since } => Some((index, page, since)),
        };
        self.threads.iter().enumerate().filter(|(_, thread)| wanted(**thread)).filter_map(parts).collect()
    }
}

impl Work {
    fn filling(&self) -> Option<u32> {
        match self {
            Self::Fill { page, .. } => Some(page.0),
            Self::Unmap { .. } => None,
        }
    }
}

fn request_for(page: PageId, me: NodeId) -> [u8; HEADER_BYTES] {
    let config = Config::new(me, Stripes::new(1, 1, NodeId(0), 1).unwrap(), 4096);
    let (cluster, epoch) = (config.cluster, config.epoch);
    let mut bytes = [0; HEADER_BYTES];
    let (from_incarnation, to_incarnation) = (Incarnation(0), Incarnation(0));
    let body = Body::REQUEST;
    Message { cluster, epoch, from: me, to: me, from_incarnation, to_incarnation, page, request: 0, body }
        .emit(&mut bytes);
    bytes
}

fn pick(index: u8, count: usize) -> Option<usize> {
    usize::from(index).checked_rem(count)
}
