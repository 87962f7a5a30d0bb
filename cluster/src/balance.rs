//! A node's part of the balance: which tile a thread draws next, and what nodes tell each other of it.
//!
//! The decisions are the [`Worker`]'s. Deals come from the supervisor's link; what other nodes say comes by *mailbox*: a
//! pair of sequenced-packet sockets for each node, one end of which is its own while the other is open in all other
//! nodes. So any node reaches any other directly, with two files a node and no hop on the way. A mailbox that is full
//! loses a letter; the protocol minds no loss.

use core::time::Duration;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use dsm_core::id::PageId;
use fault_linux::Region;
use rt_core::schedule::message::{Body, MESSAGE_BYTES_MAX};
use rt_core::schedule::worker::{Output, PeerEntry, TileEntry, TileState, WorkerConfig, WorkerStats};
use rt_core::schedule::{Balancer, Message, PageMap, Worker, WorkerStorage};
use rt_core::{Frame, TileId, Tiles};
use transport_shm::now;

use crate::control::{News, SetUp};
use crate::link::{Link, PACKET_BYTES_MAX, wait_for_any};
use crate::ports::EPOCH;

/// The tiles of a node, shared by its threads.
#[derive(Debug)]
pub(crate) struct Balance {
    state: Mutex<State>,
    /// Notified when there are tiles to take, and when there will never be any again.
    news: Condvar,
    link: Arc<Link>,
    /// The way to each node.
    mailboxes: Vec<Link>,
    region: Arc<Region>,
    balancer: Balancer,
    page_count: u32,
}

#[derive(Debug)]
struct State {
    worker: Worker<'static>,
    /// The frame of which tiles are dealt; `None` before the first.
    frame: Option<Frame>,
    /// The last frame of which tiles were dealt anew.
    dealt_anew: Option<u32>,
    is_over: bool,
    idle: Duration,
}

/// A tile to be drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Task {
    pub(crate) frame: Frame,
    pub(crate) tile: TileId,
    /// Nobody has died in this frame or the last, as far as is known: no tile was drawn twice.
    pub(crate) is_calm: bool,
    began: Instant,
}

/// What a node's balance has counted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BalanceStats {
    pub(crate) worker: WorkerStats,
    /// Time in which threads had nothing to draw, from the first tile of the run to its last.
    pub(crate) idle: Duration,
}

/// Pages that travel with a tile at most: what a packet has room for.
const PAGES_MAX: usize = 400;

/// First time after which something is said again. Letters are lost only where a mailbox is full.
pub(crate) const RESEND_US: u64 = 50_000;

/// How long the thread that reads letters waits at most, to end with the others.
const LOOK_MS: u64 = 50;

impl Balance {
    pub(crate) fn new(
        set_up: &SetUp,
        link: Arc<Link>,
        mailboxes: Vec<OwnedFd>,
        region: Arc<Region>,
    ) -> Result<Self> {
        let balancer: Balancer = set_up.balance.parse().map_err(|error| anyhow!("{error}"))?;
        let [width, height] = set_up.size;
        let tiles = Tiles::of(width, height);
        let config = WorkerConfig {
            epoch: EPOCH.0,
            me: set_up.node,
            nodes: set_up.nodes,
            threads: set_up.threads,
            threads_per_core: set_up.threads_per_core,
            tiles,
            balancer,
            resend_us: RESEND_US,
            is_display_reliable: true,
            seed: set_up.seed,
        };
        let page_count = set_up.image_bytes.div_ceil(set_up.page_bytes.into());
        Ok(Self {
            state: Mutex::new(State {
                worker: Worker::new(config, storage(tiles, set_up.nodes)),
                frame: None,
                dealt_anew: None,
                is_over: false,
                idle: Duration::ZERO,
            }),
            news: Condvar::new(),
            link,
            mailboxes: mailboxes.into_iter().map(Link::from_socket).collect(),
            region,
            balancer,
            page_count: u32::try_from(page_count)?,
        })
    }

    /// Reads letters until the run is over.
    pub(crate) fn start_reading(self: &Arc<Self>, letters: OwnedFd) -> Result<()> {
        let (balance, letters) = (self.clone(), Link::from_socket(letters));
        let body = move || {
            while !balance.lock().is_over {
                if balance.read_letters(&letters).is_err() {
                    return;
                }
            }
        };
        thread::Builder::new().name("balance".to_owned()).spawn(body)?;
        Ok(())
    }

    /// A frame begins; its tiles come with deals.
    pub(crate) fn begin(&self, frame: Frame) {
        self.lock().frame = Some(frame);
    }

    /// The display has dealt.
    pub(crate) fn handle_deal(&self, packet: &[u8]) -> Result<()> {
        let (message, _) = Message::parse(packet).context("a deal")?;
        let mut state = self.lock();
        let before = state.worker.stamp();
        // The tiles that this node drew in the frame that is ending are those it will most likely be dealt.
        let had: Vec<Option<TileState>> =
            tiles_of(&state).ids().map(|tile| state.worker.state(tile)).collect();
        let was = |tile: TileId, is: TileState| had.get(tile.0 as usize) == Some(&Some(is));
        // What is refused has been said before.
        let _ = state.worker.handle_message(now().as_micros(), &message);
        let after = state.worker.stamp();
        if let Some(stamp) = after.filter(|stamp| stamp.view > 0) {
            state.dealt_anew = Some(stamp.frame);
        }
        if before.map(|stamp| stamp.frame) != after.map(|stamp| stamp.frame) {
            let is_drawn_again = !matches!(self.balancer, Balancer::Demand { .. });
            let is_expected = |tile: &TileId| {
                is_queued(&state.worker, *tile) || is_drawn_again && was(*tile, TileState::Shown)
            };
            let order = state.worker.tiles_in_order().filter(is_expected).map(|tile| tile.0);
            self.region.begin_frame(&order.collect::<Vec<u32>>());
        } else {
            let is_new = |tile: &TileId| !was(*tile, TileState::Queued);
            state.worker.queued_tiles().filter(is_new).for_each(|tile| self.region.adopt_tile(tile.0, &[]));
        }
        self.send(&mut state)?;
        self.tell(&state);
        Ok(())
    }

    pub(crate) fn handle_peer_down(&self, peer: u16) {
        self.lock().worker.handle_peer(peer, true);
    }

    /// The next tile for a thread, if there is one.
    pub(crate) fn try_take(&self) -> Result<Option<Task>> {
        let mut state = self.lock();
        self.take(&mut state)
    }

    /// The next tile for a thread; waits until there is one. `None` when there will be none any more.
    pub(crate) fn take_or_wait(&self) -> Result<Option<Task>> {
        let (since, mut state) = (Instant::now(), self.lock());
        let has_begun = state.worker.stats().drawn > 0;
        loop {
            if state.is_over {
                return Ok(None);
            }
            if let Some(task) = self.take(&mut state)? {
                state.idle += if has_begun { since.elapsed() } else { Duration::ZERO };
                return Ok(Some(task));
            }
            while !state.is_over && !state.worker.has_queued() {
                state = self.wait(state)?;
            }
        }
    }

    /// Waits for news, or for the moment at which the worker wants to hear that time has passed.
    fn wait<'a>(&'a self, mut state: MutexGuard<'a, State>) -> Result<MutexGuard<'a, State>> {
        let Some(deadline_us) = deadline_us(&mut state) else {
            return Ok(self.news.wait(state).unwrap_or_else(PoisonError::into_inner));
        };
        let left = Duration::from_micros(deadline_us.saturating_sub(now().as_micros()));
        let (mut state, waited) = self.news.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner);
        if waited.timed_out() {
            state.worker.handle_timeout(now().as_micros());
            self.send(&mut state)?;
        }
        Ok(state)
    }

    /// A thread has drawn its tile, and used these pages. Tells whether anybody still wants it.
    pub(crate) fn handle_drawn(&self, task: &Task, pages: &[PageId]) -> Result<bool> {
        let cost_us = u32::try_from(task.began.elapsed().as_micros()).unwrap_or(u32::MAX);
        let map = PageMap::of(pages.iter().map(|page| page.0), self.page_count);
        let mut state = self.lock();
        let now_us = now().as_micros();
        let is_wanted = state.worker.handle_drawn(now_us, task.frame.number, task.tile, cost_us, map);
        self.send(&mut state)?;
        Ok(is_wanted)
    }

    /// Lets all threads go that wait.
    pub(crate) fn end(&self) -> BalanceStats {
        let mut state = self.lock();
        state.is_over = true;
        self.news.notify_all();
        BalanceStats { worker: state.worker.stats(), idle: state.idle }
    }

    fn take(&self, state: &mut State) -> Result<Option<Task>> {
        let taken = state.worker.take(now().as_micros());
        self.send(state)?;
        let is_calm = |frame: &Frame| state.dealt_anew.is_none_or(|last| last + 1 < frame.number);
        let task = |(tile, frame)| Task { frame, tile, is_calm: is_calm(&frame), began: Instant::now() };
        Ok(taken.zip(state.frame).map(task))
    }

    /// Waits for a letter, or for the moment at which something is to be said again.
    fn read_letters(&self, letters: &Link) -> Result<()> {
        let deadline_us = deadline_us(&mut self.lock());
        let wait_ms =
            deadline_us.map_or(LOOK_MS, |at| (at.saturating_sub(now().as_micros()) / 1000 + 1).min(LOOK_MS));
        let has_letter = !wait_for_any(&[letters.as_fd()], u32::try_from(wait_ms)?)?.is_empty();
        // All other nodes are gone when the other ends are.
        let packet =
            if has_letter { Some(letters.receive()?.context("no other node is left")?) } else { None };
        let mut state = self.lock();
        let now_us = now().as_micros();
        if let Some(packet) = packet {
            // What is no letter, or comes too late, changes nothing.
            if let Ok((message, pages)) = Message::parse(&packet.bytes) {
                self.handle_letter(&mut state, &message, pages);
            }
        }
        state.worker.handle_timeout(now_us);
        self.send(&mut state)?;
        self.tell(&state);
        Ok(())
    }

    fn handle_letter(&self, state: &mut State, message: &Message, mut pages: &[u8]) {
        let Body::Give { gifts, .. } = &message.body else {
            let _ = state.worker.handle_message(now().as_micros(), message);
            return;
        };
        let had: Vec<bool> = gifts.iter().map(|gift| is_queued(&state.worker, gift.tile)).collect();
        let _ = state.worker.handle_message(now().as_micros(), message);
        for (gift, had) in gifts.iter().zip(had) {
            let Some((list, rest)) = split_pages(pages) else { return };
            pages = rest;
            if !had && is_queued(&state.worker, gift.tile) {
                self.region.adopt_tile(gift.tile.0, &list);
            }
        }
    }

    /// Sends all that is due.
    fn send(&self, state: &mut State) -> Result<()> {
        let display = self.mailboxes.len();
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        while let Output::Transmit { to, length } = state.worker.poll(now().as_micros(), &mut buffer) {
            let message = &buffer[..length];
            match self.mailboxes.get(usize::from(to)) {
                Some(mailbox) => {
                    let letter = self.with_pages(message);
                    // Full, or its node is dead: the letter is lost.
                    let _ = mailbox.send_or_drop(&letter);
                }
                None if usize::from(to) >= display => {
                    self.link.send(&News::Balance(message.to_vec()).to_packet()?)?;
                }
                None => {}
            }
        }
        Ok(())
    }

    /// A letter, and behind it the pages of the tiles that it gives.
    fn with_pages(&self, message: &[u8]) -> Vec<u8> {
        let mut letter = message.to_vec();
        if let Ok((Message { body: Body::Give { gifts, .. }, .. }, _)) = Message::parse(message) {
            for gift in &gifts {
                let mut pages = self.region.pages_of(gift.tile.0);
                pages.truncate(PAGES_MAX);
                letter.extend(u16::try_from(pages.len()).unwrap_or(0).to_le_bytes());
                pages.iter().for_each(|page| letter.extend(page.0.to_le_bytes()));
            }
        }
        debug_assert!(letter.len() <= PACKET_BYTES_MAX);
        letter
    }

    fn tell(&self, state: &State) {
        if state.worker.has_queued() {
            self.news.notify_all();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// When the worker wants to hear that time has passed.
fn deadline_us(state: &mut State) -> Option<u64> {
    let mut buffer = [0; MESSAGE_BYTES_MAX];
    match state.worker.poll(now().as_micros(), &mut buffer) {
        Output::Idle(deadline) => deadline,
        // Nothing is due: all was sent when it became so.
        Output::Transmit { .. } | Output::Deliver { .. } => None,
    }
}

/// Memory for the worker. There is one in a process, as long as the process lives.
fn storage(tiles: Tiles, nodes: u16) -> WorkerStorage<'static> {
    let count = tiles.count() as usize;
    WorkerStorage {
        tiles: Box::leak(vec![TileEntry::EMPTY; count].into()),
        order: Box::leak(vec![0; count].into()),
        peers: Box::leak(vec![PeerEntry::EMPTY; usize::from(nodes) + 1].into()),
    }
}

/// The tiles of the picture; none before the first frame.
fn tiles_of(state: &State) -> Tiles {
    state.frame.map_or(Tiles::of(0, 0), |frame| Tiles::of(frame.width, frame.height))
}

fn is_queued(worker: &Worker<'_>, tile: TileId) -> bool {
    worker.state(tile) == Some(TileState::Queued)
}

/// Splits the pages of one tile from those of the others.
fn split_pages(bytes: &[u8]) -> Option<(Vec<PageId>, &[u8])> {
    let (count, rest) = bytes.split_first_chunk()?;
    let (pages, rest) = rest.split_at_checked(usize::from(u16::from_le_bytes(*count)) * 4)?;
    let pages = pages.as_chunks().0.iter().map(|page| PageId(u32::from_le_bytes(*page)));
    Some((pages.collect(), rest))
}

/// The two ends of the mailboxes of so many nodes: those that all others write to, and those that each reads.
pub(crate) fn mailboxes(nodes: u16) -> Result<(Vec<OwnedFd>, Vec<OwnedFd>)> {
    let mut ends = (Vec::new(), Vec::new());
    for _ in 0..nodes {
        let (write, read) = Link::pair().context("cannot get sockets between nodes")?;
        ends.0.push(write.into_socket());
        ends.1.push(read.into_socket());
    }
    Ok(ends)
}
