//! A node: hands tiles to its threads, asks others for more, gives away what is too much.

mod asking;
mod hand;
mod hearing;
mod peers;
mod sharing;

pub use hand::{TileEntry, TileState};
pub use peers::PeerEntry;

use core::hash::{Hash, Hasher};

use super::Balancer;
use super::curve::along_curve;
use super::dice::Dice;
use super::message::{Body, Gift, Message, Stamp};
use super::page_map::PageMap;
use crate::tile::{TileId, Tiles};
use asking::Asking;
use hand::Hand;
use peers::Peers;

/// What a worker must know before it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkerConfig {
    /// The run; messages of another are refused.
    pub epoch: u32,
    /// This node, in `0..nodes`.
    pub me: u16,
    /// Nodes there are; the display has this number.
    pub nodes: u16,
    /// Render threads of this node.
    pub threads: u16,
    /// Render threads, of whatever node, that share a core; 1 where each has its own.
    pub threads_per_core: u16,
    /// The picture.
    pub tiles: Tiles,
    /// Whom it asks and what it gives.
    pub balancer: Balancer,
    /// First time after which what was not answered is sent again, in microseconds.
    pub resend_us: u64,
    /// What is sent to the display arrives, so a tile that is drawn is done with.
    pub is_display_reliable: bool,
    /// Decides what chance decides.
    pub seed: u64,
}

/// Memory lent to a [`Worker`].
#[derive(Debug)]
pub struct WorkerStorage<'s> {
    /// One entry per tile.
    pub tiles: &'s mut [TileEntry],
    /// One number per tile.
    pub order: &'s mut [u32],
    /// One entry per node, and one for the display.
    pub peers: &'s mut [PeerEntry],
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Output {
    /// Send the first `length` bytes of the buffer to `to`; the display has the number after the last node's.
    Transmit {
        /// The receiver.
        to: u16,
        /// Length of the message.
        length: usize,
    },
    /// Send the pixels of this tile to the display, behind [`Body::Drawn`]. Only where the display is not reliable.
    Deliver {
        /// The tile.
        tile: TileId,
    },
    /// Nothing to do before this moment, or before the next input when `None`.
    Idle(Option<u64>),
}

/// Why a message was refused; the worker's state has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// It is of another epoch, for somebody else, or from nobody we know.
    Stranger,
    /// It is of a view that is over, or has not begun here.
    OtherView,
    /// It has come before, or another must come first.
    OutOfTurn,
    /// Nobody says this to a node.
    Senseless,
}

/// What a worker has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerStats {
    /// Tiles drawn, of whatever frame.
    pub drawn: u64,
    /// Tiles taken from other nodes.
    pub taken: u64,
    /// Tiles given to other nodes.
    pub given: u64,
    /// Questions asked.
    pub asked: u64,
    /// Messages refused.
    pub refused: u64,
    /// Time spent drawing, over all threads, in microseconds.
    pub busy_us: u64,
}

/// One node of the balance.
///
/// # Use
/// Threads call [`take`](Self::take) and [`handle_drawn`](Self::handle_drawn); messages and moments come in by
/// [`handle_message`](Self::handle_message) and [`handle_timeout`](Self::handle_timeout). After any of these, call
/// [`poll`](Self::poll) until it says [`Output::Idle`].
///
/// # Invariants
/// See [`check_invariants`](Self::check_invariants).
#[derive(Debug)]
pub struct Worker<'s> {
    config: WorkerConfig,
    /// The view it is in; `None` before the first deal.
    stamp: Option<Stamp>,
    hand: Hand<'s>,
    peers: Peers<'s>,
    asking: Asking,
    dice: Dice,
    /// What this node's tiles used in the last frame and in this one.
    maps: [PageMap; 2],
    /// Time spent drawing in this frame and in the last one, over all threads.
    busy_us: [u64; 2],
    /// When this node heard of the frame.
    began_us: u64,
    /// Tiles that the display has not confirmed, and when the next of them are sent again.
    unconfirmed: u32,
    deliver_at_us: u64,
    /// Nobody is asked before this frame: what was taken took much longer here than where it came from.
    asks_from_frame: u32,
    /// How often in a row that was so.
    times_slow: u32,
    /// Something may be due to be sent.
    has_mail: bool,
    stats: WorkerStats,
}

impl<'s> Worker<'s> {
    /// A node that has not heard of any frame.
    ///
    /// # Panics
    /// When the storage does not fit the picture and the number of nodes.
    pub fn new(config: WorkerConfig, storage: WorkerStorage<'s>) -> Self {
        let WorkerStorage { tiles, order, peers } = storage;
        let count = config.tiles.count() as usize;
        assert!(tiles.len() == count && order.len() == count, "one entry per tile: there are {count}");
        assert_eq!(peers.len(), usize::from(config.nodes) + 1, "one entry per node and one for the display");
        along_curve(config.tiles, false).zip(order.iter_mut()).for_each(|(tile, place)| *place = tile.0);
        let seed = config.seed ^ (u64::from(config.me) << 48);
        Self {
            config,
            stamp: None,
            hand: Hand::new(tiles, order),
            peers: Peers::new(peers, config.me, config.nodes),
            asking: Asking::new(),
            dice: Dice::new(seed),
            maps: [PageMap::EMPTY; 2],
            busy_us: [0; 2],
            began_us: 0,
            unconfirmed: 0,
            deliver_at_us: 0,
            asks_from_frame: 0,
            times_slow: 0,
            has_mail: false,
            stats: WorkerStats::default(),
        }
    }

    /// Ends the worker and gives back what was lent to it.
    pub fn into_storage(self) -> WorkerStorage<'s> {
        let (tiles, order) = self.hand.into_storage();
        WorkerStorage { tiles, order, peers: self.peers.all }
    }

    /// The tile that a thread is to draw now. `None`: there is none, until a message has come.
    pub fn take(&mut self, now_us: u64) -> Option<TileId> {
        let tile = self.hand.next();
        if let Some(tile) = tile {
            self.hand.unqueue(tile, TileState::Drawing);
        }
        // The paper's thief asks when it has nothing to do; ours when it has begun the last thing it has.
        if self.hand.queued == 0 && (tile.is_none() || self.config.balancer == Balancer::StealNear) {
            self.look_for_work(now_us);
        }
        tile
    }

    /// A thread has drawn a tile of `frame`. Tells whether that is of use: the frame may be over.
    pub fn handle_drawn(
        &mut self,
        now_us: u64,
        frame: u32,
        tile: TileId,
        cost_us: u32,
        map: PageMap,
    ) -> bool {
        self.stats.drawn += 1;
        self.stats.busy_us += u64::from(cost_us);
        let is_reliable = self.config.is_display_reliable;
        let is_current = self.stamp.is_some_and(|stamp| stamp.frame == frame);
        let entry = self.hand.entry(tile).filter(|entry| is_current && entry.state == TileState::Drawing);
        let Some(entry) = entry else { return false };
        entry.state = if is_reliable { TileState::Shown } else { TileState::Drawn { is_due: true } };
        let told_us = core::mem::take(&mut entry.is_gift).then_some(entry.cost_us);
        self.note_pace(frame, told_us, cost_us);
        self.hand.measure(tile, cost_us, map);
        self.maps[0] = self.maps[0].with(map);
        self.busy_us[0] += u64::from(cost_us);
        if !is_reliable {
            self.unconfirmed += 1;
            self.has_mail = true;
            self.deliver_at_us = now_us + self.config.resend_us;
        }
        true
    }

    /// A message has come.
    ///
    /// # Errors
    /// It makes no sense now; nothing has changed.
    pub fn handle_message(&mut self, now_us: u64, message: &Message) -> Result<(), Refused> {
        let answer = self.believe(message).and_then(|()| self.handle(now_us, message));
        self.stats.refused += u64::from(answer.is_err());
        answer
    }

    /// Time has passed.
    pub fn handle_timeout(&mut self, now_us: u64) {
        let resend_us = self.config.resend_us;
        for peer in self.peers.all.iter_mut().filter(|peer| !peer.is_down) {
            self.has_mail |= peer.gift.expire(now_us, resend_us);
        }
        if self.unconfirmed > 0 && self.deliver_at_us <= now_us {
            self.deliver_at_us = now_us + resend_us;
            self.has_mail = true;
            for tile in
                self.hand.tiles.iter_mut().filter(|tile| matches!(tile.state, TileState::Drawn { .. }))
            {
                tile.state = TileState::Drawn { is_due: true };
            }
        }
        let is_late = |sent_us: u64| sent_us + resend_us <= now_us;
        if self.asking.pending.is_some_and(|question| !question.is_due && is_late(question.sent_us)) {
            self.asking.pending = None;
            self.look_for_work(now_us);
        }
        // Over whether anybody is asked then or not, or it would be due for ever.
        if self.asking.pause_until_us.take_if(|until| *until <= now_us).is_some() {
            self.look_for_work(now_us);
        }
    }

    /// Whoever drives this node says that a peer is dead, or back. It is not asked while it is; its tiles are the display's
    /// affair.
    pub fn handle_peer(&mut self, peer: u16, is_down: bool) {
        self.peers.note_down(peer, is_down);
    }

    /// What is to be done next. `buffer` has room for [`MESSAGE_BYTES_MAX`](super::message::MESSAGE_BYTES_MAX).
    pub fn poll(&mut self, now_us: u64, buffer: &mut [u8]) -> Output {
        if let Some((to, message)) = self.next_message(now_us) {
            return Output::Transmit { to, length: message.emit(buffer) };
        }
        if self.has_mail {
            let is_due = |entry: &TileEntry| entry.state == TileState::Drawn { is_due: true };
            if let Some(index) = self.hand.tiles.iter().position(is_due) {
                self.hand.tiles[index].state = TileState::Drawn { is_due: false };
                return Output::Deliver { tile: TileId(u32::try_from(index).unwrap_or(u32::MAX)) };
            }
            self.has_mail = false;
        }
        Output::Idle(self.deadline())
    }

    /// The view it is in.
    pub const fn stamp(&self) -> Option<Stamp> {
        self.stamp
    }

    /// Whether a thread that asks now gets a tile.
    pub const fn has_queued(&self) -> bool {
        self.hand.queued > 0
    }

    /// Queued tiles, in the order in which they will be drawn.
    pub fn queued_tiles(&self) -> impl Iterator<Item = TileId> {
        self.hand.queued_tiles(false)
    }

    /// All tiles, in the order in which this frame's are drawn.
    pub fn tiles_in_order(&self) -> impl Iterator<Item = TileId> {
        self.hand.tiles_in_order()
    }

    /// Where a tile is, as this node sees it.
    pub fn state(&self, tile: TileId) -> Option<TileState> {
        self.hand.tiles.get(tile.0 as usize).map(|entry| entry.state)
    }

    /// What the tile took when it was drawn last, in microseconds; 0 when nobody knows.
    pub fn cost_us(&self, tile: TileId) -> u32 {
        self.hand
            .tiles
            .get(tile.0 as usize)
            .filter(|entry| entry.is_measured)
            .map_or(0, |entry| entry.cost_us)
    }

    /// Whether it has found nothing to do and will not look for more.
    pub fn is_resting(&self) -> bool {
        self.hand.queued == 0 && self.asking.is_resting()
    }

    /// Whether a thread that asks now makes it ask somebody.
    pub fn may_ask(&self) -> bool {
        let is_searching = self.asking.pending.is_some() || self.asking.pause_until_us.is_some();
        self.config.balancer.steals()
            && self.config.nodes > 1
            && self.asks_in_frame()
            && !is_searching
            && !self.asking.is_resting()
    }

    /// What it has counted.
    pub const fn stats(&self) -> WorkerStats {
        self.stats
    }

    /// Puts into `hasher` all that decides what it does but for the numbers of questions and gifts, of which only matters how
    /// they compare with those of messages under way. Moments count as distances from now.
    pub fn fingerprint(&self, now_us: u64, hasher: &mut impl Hasher) {
        (self.stamp, self.unconfirmed, self.has_mail, self.maps, self.busy_us, &self.dice).hash(hasher);
        self.asking.fingerprint(now_us, hasher);
        (self.asks_from_frame, self.times_slow).hash(hasher);
        self.hand.tiles.hash(hasher);
        let left_us = |moment_us: u64| moment_us.saturating_sub(now_us);
        (self.unconfirmed > 0).then(|| left_us(self.deliver_at_us)).hash(hasher);
        // The wait where cores are shared, or how long it is over: what more is drawn lengthens it.
        (self.config.threads_per_core > 1).then(|| left_us(self.asks_at_us() + LONG_US)).hash(hasher);
        let resend_us = self.config.resend_us;
        for peer in self.peers.all.iter() {
            peer.fingerprint(hasher);
            peer.gift.deadline(resend_us).map(left_us).hash(hasher);
        }
    }

    /// Whether a message would be news to this node, as far as its number says.
    pub fn is_news(&self, message: &Message) -> bool {
        let Some(peer) = self.peers.all.get(usize::from(message.from)) else { return false };
        match message.body {
            Body::Deal { number, .. } | Body::Give { number, .. } => number > peer.taken,
            Body::Taken { number } => peer.gift.is_open && peer.gift.number == number,
            Body::Ask { number, .. } => number > peer.asked,
            Body::Nothing { number, .. } => {
                self.asking.pending.is_some_and(|question| question.number == number)
            }
            Body::Drawn { .. } | Body::Shown { .. } => true,
        }
    }

    /// Whether a question of this number is the one that waits for an answer.
    pub fn awaits(&self, number: u32) -> bool {
        self.asking.pending.is_some_and(|question| question.number == number)
    }

    /// Checks what must hold after every input.
    ///
    /// # Panics
    /// `QUEUE_COUNTED`: count and cost of the queued tiles are those of the entries; `GIFT_HAS_RECEIVER`: a tile that is
    /// given belongs to a parcel that is open; `DRAWN_COUNTED`: unconfirmed tiles are counted.
    pub fn check_invariants(&self) {
        let queued = || self.hand.tiles.iter().filter(|entry| entry.state == TileState::Queued);
        let cost_us: u64 = queued().map(|entry| u64::from(entry.cost_us)).sum();
        assert_eq!(
            (self.hand.queued as usize, self.hand.queued_us),
            (queued().count(), cost_us),
            "QUEUE_COUNTED"
        );
        assert_eq!(
            self.hand.queued_tiles(false).count(),
            queued().count(),
            "QUEUE_COUNTED: behind the cursor"
        );
        for entry in self.hand.tiles.iter().filter(|entry| entry.state == TileState::Given) {
            let is_open = self.peers.all.get(usize::from(entry.to)).is_some_and(|peer| peer.gift.is_open);
            assert!(is_open, "GIFT_HAS_RECEIVER: {entry:?}");
        }
        let drawn = self.hand.tiles.iter().filter(|entry| matches!(entry.state, TileState::Drawn { .. }));
        assert_eq!(drawn.count(), self.unconfirmed as usize, "DRAWN_COUNTED");
    }

    /// Notes whether a tile that was given took much longer here than it was to take. A node that is slow lets some frames
    /// go by before it takes from others again, twice as many each time.
    fn note_pace(&mut self, frame: u32, told_us: Option<u32>, cost_us: u32) {
        let Some(told_us) = told_us.filter(|_| self.config.balancer == Balancer::StealNear) else { return };
        if cost_us <= told_us.saturating_mul(SLOW).max(SLOW_US) {
            self.times_slow = 0;
        } else if self.asks_from_frame <= frame {
            self.times_slow = (self.times_slow + 1).min(SLOW_TIMES_MAX);
            self.asks_from_frame = frame.saturating_add(1 << self.times_slow);
        }
    }

    /// Whether a frame has begun in which others are asked.
    fn asks_in_frame(&self) -> bool {
        self.stamp.is_some_and(|stamp| stamp.frame >= self.asks_from_frame)
    }

    /// When a node that has nothing asks: at once, where threads have cores of their own. Where they share them, those of the
    /// others may only have had to wait for this one's, and catch up now; to take their tiles from them would bring nothing
    /// and cost their pages. So it lets each of them have the core for as long as it had it itself, and for one turn more.
    fn asks_at_us(&self) -> u64 {
        let WorkerConfig { threads, threads_per_core, balancer, .. } = self.config;
        if threads_per_core <= 1 || balancer != Balancer::StealNear {
            return 0;
        }
        let others = u64::from(threads_per_core - 1);
        let own_us = self.busy_us[0] / u64::from(threads.max(1));
        self.began_us + own_us + others * (own_us + TURN_US)
    }

    /// Asks somebody, if there is nothing queued.
    fn look_for_work(&mut self, now_us: u64) {
        let is_alone = self.config.nodes <= 1;
        if is_alone || self.hand.queued > 0 || !self.asks_in_frame() || self.asking.pending.is_some() {
            return;
        }
        let asks_at_us = self.asks_at_us();
        if now_us < asks_at_us {
            self.asking.pause_until_us = Some(asks_at_us);
            return;
        }
        let map = self.map();
        let before = self.asking.number;
        self.asking.go_on(self.config.balancer, &self.peers, map, &mut self.dice, now_us);
        self.stats.asked += u64::from(self.asking.number - before);
        self.has_mail |= self.asking.pending.is_some_and(|question| question.is_due);
    }

    /// Tiles were queued: those who wait may have some, and the next search starts over.
    fn got_work(&mut self, now_us: u64) {
        if self.hand.queued == 0 {
            // A thread has been told that there is nothing, or will ask.
            self.look_for_work(now_us);
            return;
        }
        self.asking.start_over();
        for peer in 0..self.config.nodes {
            if self.peers.all[usize::from(peer)].waits && self.share(peer) {
                self.peers.all[usize::from(peer)].waits = false;
            }
        }
    }

    /// Gives a peer what can be spared. Tells whether that is anything.
    fn share(&mut self, to: u16) -> bool {
        let Some(peer) = self.peers.all.get(usize::from(to)) else { return false };
        if peer.gift.is_open || self.hand.queued <= self.idle_threads() {
            return false;
        }
        let chosen = match self.config.balancer {
            Balancer::Steal => self.hand.choose_last(),
            Balancer::StealNear => self.hand.choose_half(self.peers.map_of(to), self.margin_us()),
            Balancer::Static | Balancer::Demand { .. } => return false,
        };
        if chosen.is_empty() {
            return false;
        }
        self.hand.give(&chosen, to);
        self.stats.given += chosen.len() as u64;
        self.peers.all[usize::from(to)].gift.open();
        self.has_mail = true;
        true
    }

    /// Threads that draw nothing of this frame, and will take what is queued at once: a tile that came for one of them
    /// would else be given on, and wander.
    fn idle_threads(&self) -> u32 {
        let drawing = self.hand.tiles.iter().filter(|entry| entry.state == TileState::Drawing).count();
        u32::from(self.config.threads).saturating_sub(u32::try_from(drawing).unwrap_or(u32::MAX))
    }

    /// What is queued must take longer than this to be shared: else moving it costs more than it brings, and tiles would
    /// wander to and fro with every breath of the machine.
    fn margin_us(&self) -> u64 {
        (self.busy_us[1] / MARGIN_PART).max(MARGIN_US * u64::from(self.config.threads.max(1)))
    }

    /// A tile that takes a quarter of what a thread has to do is drawn first, so that nobody waits for it in the end.
    fn dear_us(&self) -> u32 {
        let share_us = self.busy_us[1] / (4 * u64::from(self.config.threads.max(1)));
        let is_wanted = self.config.balancer == Balancer::StealNear && share_us > 0;
        if is_wanted { u32::try_from(share_us).unwrap_or(u32::MAX) } else { u32::MAX }
    }

    fn map(&self) -> PageMap {
        self.maps[0].with(self.maps[1])
    }

    fn deadline(&self) -> Option<u64> {
        let resend_us = self.config.resend_us;
        let up = self.peers.all.iter().filter(|peer| !peer.is_down);
        let gifts = up.filter_map(|peer| peer.gift.deadline(resend_us));
        let tiles = (self.unconfirmed > 0).then_some(self.deliver_at_us);
        let question = self.asking.pending.map(|question| question.sent_us + resend_us);
        gifts.chain(tiles).chain(question).chain(self.asking.pause_until_us).min()
    }

    /// The next message that is due, if any.
    fn next_message(&mut self, now_us: u64) -> Option<(u16, Message)> {
        let stamp = self.stamp.filter(|_| self.has_mail)?;
        let (to, body) = self.next_question(now_us).or_else(|| self.next_to_peer(now_us))?;
        let WorkerConfig { epoch, me: from, .. } = self.config;
        Some((to, Message { epoch, stamp, from, to, body }))
    }

    fn next_question(&mut self, now_us: u64) -> Option<(u16, Body)> {
        let map = self.map();
        let question = self.asking.pending.as_mut().filter(|question| question.is_due)?;
        (question.is_due, question.sent_us) = (false, now_us);
        Some((question.to, Body::Ask { number: question.number, map, waits: question.waits }))
    }

    fn next_to_peer(&mut self, now_us: u64) -> Option<(u16, Body)> {
        // The dead take nothing: what was given to one is dealt anew if it is missing.
        let is_due =
            |peer: &PeerEntry| !peer.is_down && (peer.owes_taken || peer.owes_nothing || peer.gift.is_due);
        let to = u16::try_from(self.peers.all.iter().position(is_due)?).ok()?;
        let (map, left_us, busiest) = (self.map(), self.left_us(), self.peers.busiest(to));
        let peer = &mut self.peers.all[usize::from(to)];
        if core::mem::take(&mut peer.owes_taken) {
            return Some((to, Body::Taken { number: peer.taken }));
        }
        if core::mem::take(&mut peer.owes_nothing) {
            return Some((to, Body::Nothing { number: peer.asked, left_us, map, busiest }));
        }
        peer.gift.note_sent(now_us);
        let number = peer.gift.number;
        let given = (0..).zip(self.hand.tiles.iter());
        let given = given.filter(|(_, entry)| entry.state == TileState::Given && entry.to == to);
        let gifts = given.map(|(tile, entry)| Gift {
            tile: TileId(tile),
            cost_us: if entry.is_measured { entry.cost_us } else { 0 },
            map: entry.map,
        });
        Some((to, Body::Give { number, left_us, gifts: gifts.collect() }))
    }

    fn left_us(&self) -> u32 {
        u32::try_from(self.hand.queued_us).unwrap_or(u32::MAX)
    }
}

/// What is queued is shared when it takes longer than this part of what the node drew in the last frame.
const MARGIN_PART: u64 = 8;

/// How long a system leaves a core to one thread while others wait for it, about.
const TURN_US: u64 = 3000;

/// The tiles of a model's frame lengthen a wait by less than this, so of one that has been over for longer it does not matter
/// for how long.
const LONG_US: u64 = 10_000;

/// A tile that takes so many times what it is to take, and at least so many microseconds, was drawn by a slow node.
const SLOW: u32 = 4;
const SLOW_US: u32 = 1000;

/// A slow node lets at most two to this power of frames go by.
const SLOW_TIMES_MAX: u32 = 6;

/// And longer than this, in microseconds a thread: about what it takes to give a tile away and to miss its pages.
const MARGIN_US: u64 = 200;

#[cfg(test)]
mod tests;
