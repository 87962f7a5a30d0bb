//! One node of the cluster with the smallest driver that is correct.

use std::collections::BTreeMap;

use dsm_core::home::Home;
use dsm_core::id::{Incarnation, NodeId, PageId, PortId, SlotId};
use dsm_core::node::{Config, Fault, Node, Output, PageBytes, Snapshot};
use dsm_core::replacement::Policy;
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::HEADER_BYTES;

use crate::oracle::{Oracle, held_in_order};
use crate::packet::Packet;
use crate::setup::{PAGE_BYTES, Setup};

/// One node: its state machines, the memory lent to them, its threads, and what its driver is busy with.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    pub(crate) is_alive: bool,
    pub(crate) incarnation: Incarnation,
    pub(crate) config: Config,
    snapshot: Option<Snapshot>,
    pages: Vec<PageEntry>,
    slots: Vec<SlotEntry>,
    peers: Vec<PeerEntry>,
    requests: Vec<RequestEntry>,
    pub(crate) home: Home,
    /// The page that lies in each place of this owner's memory.
    pub(crate) memory: Vec<u32>,
    pub(crate) threads: Vec<Thread>,
    pub(crate) work: Vec<Work>,
    /// Which pages this node's readers can see, and in which slot.
    pub(crate) visible: BTreeMap<u32, u32>,
    /// The page whose bytes lie in each slot, visible or not.
    pub(crate) kept: BTreeMap<u32, u32>,
    /// Parts of pages that were put aside, by slot.
    pub(crate) stored: BTreeMap<u32, Stored>,
    pub(crate) oracle: Oracle,
    /// How far this node's clock is from the world's, in microseconds, and how much later than it should it may act.
    pub(crate) skew_us: i64,
    pub(crate) slack_us: u64,
}

/// What a thread is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Thread {
    Running,
    Fetching(Wait),
    WaitingForPage(Wait),
    WaitingForSlot(Wait),
}

/// What a thread waits for, and since when: by its node's clock and by the world's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Wait {
    pub(crate) page: PageId,
    pub(crate) since: Instant,
    pub(crate) world_since: Instant,
    /// It was asked for ahead: the thread goes on, whatever becomes of it.
    pub(crate) is_ahead: bool,
    /// Another thread has missed what was asked for ahead, so the deadline began again.
    pub(crate) is_missed: bool,
}

/// What the driver is busy with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Work {
    Fill { page: PageId, slot: SlotId },
    Unmap { page: PageId },
    Hide { page: PageId },
}

/// The bytes of a page that were put aside.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Stored {
    pub(crate) page: u32,
    pub(crate) has: [bool; PAGE_BYTES as usize],
}

impl Member {
    pub(crate) fn new(setup: &Setup, me: NodeId, incarnation: Incarnation) -> Self {
        let config = setup.config(me, incarnation);
        let placement = config.placement;
        let mut pages = vec![PageEntry::EMPTY; usize::from(setup.pages)];
        let mut slots = vec![SlotEntry::EMPTY; usize::from(setup.slots)];
        let mut peers = vec![PeerEntry::EMPTY; usize::from(placement.owner_count())];
        let mut requests = vec![RequestEntry::EMPTY; usize::from(setup.requests)];
        let storage =
            Storage { pages: &mut pages, slots: &mut slots, peers: &mut peers, requests: &mut requests };
        let node = Node::new(config, storage, Policy::new(setup.policy, 1));
        let snapshot = node.expect("the set-up is consistent").into_snapshot();
        let home = Home::new(me, config.cluster, config.epoch, placement, PAGE_BYTES);
        Self {
            is_alive: true,
            incarnation,
            config,
            snapshot: Some(snapshot),
            pages,
            slots,
            peers,
            requests,
            home: home.in_incarnation(incarnation),
            memory: held_in_order(&placement, me),
            threads: vec![Thread::Running; usize::from(setup.threads)],
            work: Vec::new(),
            visible: BTreeMap::new(),
            kept: BTreeMap::new(),
            stored: BTreeMap::new(),
            oracle: Oracle::default(),
            skew_us: 0,
            slack_us: 0,
        }
    }

    /// Lets `look` do with the node what leaves no output.
    pub(crate) fn with_node<T>(&mut self, look: impl FnOnce(&mut Node<'_>) -> T) -> T {
        let snapshot = self.snapshot.take().expect("put back after each use");
        let Self { pages, slots, peers, requests, .. } = self;
        let mut node = snapshot.resume(Storage { pages, slots, peers, requests });
        let seen = look(&mut node);
        self.snapshot = Some(node.into_snapshot());
        seen
    }

    /// Gives the node one input and does what it says at once, but for the work that takes time. `packet` is what
    /// arrived. Returns what the input returned, the messages to send, and the threads to wake.
    pub(crate) fn input<T>(
        &mut self,
        packet: Option<&Packet>,
        give: impl FnOnce(&mut Node<'_>) -> T,
    ) -> (T, Vec<Packet>, Vec<usize>) {
        let mut outputs = Vec::new();
        let answer = self.with_node(|node| {
            let answer = give(node);
            let mut buffer = [0; HEADER_BYTES];
            loop {
                match node.poll(&mut buffer) {
                    Output::Idle(_) => break,
                    output => outputs.push((output, buffer)),
                }
            }
            node.check_invariants();
            answer
        });
        let (mut sent, mut woken) = (Vec::new(), Vec::new());
        for (output, buffer) in outputs {
            match output {
                Output::Transmit { len, .. } => {
                    assert_eq!(len, HEADER_BYTES);
                    sent.push(Packet { header: buffer, page: None });
                }
                Output::Store { page, slot, offset, bytes } => {
                    self.store(
                        page,
                        slot,
                        offset,
                        bytes,
                        packet.expect("a part of a page comes with a message"),
                    );
                }
                Output::Map { page, slot, bytes } => self.map(page, slot, bytes, packet),
                Output::Unmap { page, slot } => {
                    let kept = self.kept.get(&slot.0);
                    assert_eq!(
                        kept,
                        Some(&page.0),
                        "SLOT_HOLDS_ONE_PAGE: {page} is taken away and is not there"
                    );
                    self.work.push(Work::Unmap { page });
                }
                Output::Hide { page, slot } => {
                    let visible = self.visible.get(&page.0);
                    assert_eq!(visible, Some(&slot.0), "SLOT_HOLDS_ONE_PAGE: {page} is hidden unseen");
                    self.work.push(Work::Hide { page });
                }
                Output::WakePage { page } => {
                    woken.extend(self.waiting(
                        |thread| matches!(thread, Thread::WaitingForPage(wait) if wait.page == page),
                    ))
                }
                Output::WakeSlots => {
                    woken.extend(self.waiting(|thread| matches!(thread, Thread::WaitingForSlot(_))));
                }
                Output::Idle(_) => {}
            }
        }
        (answer, sent, woken)
    }

    fn store(&mut self, page: PageId, slot: SlotId, offset: u32, bytes: u32, packet: &Packet) {
        packet.assert_is_of(page);
        let fresh = Stored { page: page.0, has: [false; PAGE_BYTES as usize] };
        let stored = self.stored.entry(slot.0).or_insert_with(|| fresh.clone());
        if stored.page != page.0 {
            *stored = fresh;
        }
        stored.has[offset as usize..(offset + bytes) as usize].fill(true);
    }

    fn map(&mut self, page: PageId, slot: SlotId, bytes: PageBytes, packet: Option<&Packet>) {
        match bytes {
            PageBytes::InMessage => packet.expect("a page comes with a message").assert_is_of(page),
            PageBytes::Kept => {
                let kept = self.kept.get(&slot.0);
                assert_eq!(kept, Some(&page.0), "RIGHT_BYTES: {page} is shown and is not there");
            }
            PageBytes::Stored => {
                let stored = self.stored.get(&slot.0).filter(|stored| stored.page == page.0);
                let is_whole = stored.is_some_and(|stored| stored.has.iter().all(|has| *has));
                assert!(is_whole, "RIGHT_BYTES: {page} is not whole and becomes visible");
            }
        }
        self.stored.remove(&slot.0);
        let is_busy =
            self.work.iter().any(|work| matches!(work, Work::Fill { slot: other, .. } if *other == slot));
        assert!(!is_busy, "SLOT_HOLDS_ONE_PAGE: slot {} is filled twice", slot.0);
        self.work.push(Work::Fill { page, slot });
    }

    /// The driver has done a piece of its work: readers see the page, or do not any more.
    pub(crate) fn complete(&mut self, work: Work, now: Instant) -> (Vec<Packet>, Vec<usize>) {
        let ((), sent, woken) = match work {
            Work::Fill { page, slot } => {
                let is_taken = self.visible.values().any(|other| *other == slot.0);
                assert!(
                    !is_taken,
                    "SLOT_HOLDS_ONE_PAGE: slot {} is filled under another page's readers",
                    slot.0
                );
                self.visible.insert(page.0, slot.0);
                self.kept.insert(slot.0, page.0);
                self.input(None, |node| node.handle_filled(now, page))
            }
            Work::Unmap { page } => {
                self.visible.remove(&page.0);
                self.kept.retain(|_, other| *other != page.0);
                self.input(None, |node| node.handle_unmapped(now, page))
            }
            Work::Hide { page } => {
                self.visible.remove(&page.0);
                self.input(None, |node| node.handle_covered(now, page))
            }
        };
        (sent, woken)
    }

    /// Somebody waits for a page that may have been asked for ahead: the first time, its deadline begins again. Tells which
    /// thread has asked, if so.
    pub(crate) fn note_missed(&mut self, page: PageId, now: Instant) -> Option<usize> {
        self.threads.iter_mut().position(|thread| {
            let Thread::Fetching(wait) = thread else { return false };
            let is_adopted = wait.page == page && wait.is_ahead && !wait.is_missed;
            if is_adopted {
                (wait.is_missed, wait.world_since) = (true, now);
            }
            is_adopted
        })
    }

    /// What a thread does after the node has answered its fault.
    pub(crate) fn settle(&mut self, thread: usize, answer: Fault, wait: Wait) {
        self.threads[thread] = match answer {
            Fault::Ready => {
                let own = self.memory.contains(&wait.page.0);
                assert!(
                    own || self.visible.contains_key(&wait.page.0),
                    "READY_IS_VISIBLE: {} is not",
                    wait.page
                );
                Thread::Running
            }
            Fault::Failed(_) => Thread::Running,
            Fault::Fetch | Fault::Show => Thread::Fetching(wait),
            Fault::Wait => Thread::WaitingForPage(wait),
            Fault::Full => Thread::WaitingForSlot(wait),
        };
    }

    /// What the node has counted.
    pub(crate) fn stats(&self) -> dsm_core::stats::NodeStats {
        self.snapshot.as_ref().map(Snapshot::stats).unwrap_or_default()
    }

    /// The threads that do this.
    pub(crate) fn waiting(&self, wanted: impl Fn(&Thread) -> bool) -> Vec<usize> {
        (0..self.threads.len()).filter(|index| wanted(&self.threads[*index])).collect()
    }

    /// A page is being put in place.
    pub(crate) fn is_filling(&self, page: PageId) -> bool {
        self.work.iter().any(|work| matches!(work, Work::Fill { page: other, .. } if *other == page))
    }

    /// This node's time when the world's is `now`.
    pub(crate) fn time(&self, now: Instant) -> Instant {
        Instant::from_micros(now.as_micros().saturating_add_signed(self.skew_us))
    }

    /// When a thread next has something to look after, by the world's clock.
    pub(crate) fn next_timer(&mut self, thread: usize) -> Option<Instant> {
        let skew_us = self.skew_us;
        let port = port(thread);
        let outside = self.with_node(|node| node.next_timeout(port))?;
        Some(Instant::from_micros(outside.as_micros().saturating_add_signed(-skew_us)))
    }
}

impl Thread {
    pub(crate) fn wait(&self) -> Option<Wait> {
        match self {
            Self::Running => None,
            Self::Fetching(wait) | Self::WaitingForPage(wait) | Self::WaitingForSlot(wait) => Some(*wait),
        }
    }
}

/// The port of a thread.
pub(crate) fn port(thread: usize) -> PortId {
    PortId(u8::try_from(thread).unwrap_or(u8::MAX))
}
