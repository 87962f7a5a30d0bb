//! The display: deals the tiles of a frame, and knows which have come.

use core::hash::{Hash, Hasher};

use heapless::Vec;

use super::Balancer;
use super::curve::along_curve;
use super::dice::Dice;
use super::fixed::Static;
use super::message::{Body, Message, Stamp, TILES_MAX};
use super::mutants::{self, Mutant};
use super::parcel::Parcel;
use super::worker::Refused;
use crate::tile::{TileId, Tiles};

/// What a ledger must know before it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LedgerConfig {
    /// The run; messages of another are refused.
    pub epoch: u32,
    /// Nodes there are, dead or alive.
    pub nodes: u16,
    /// Render threads of each.
    pub threads: u16,
    /// Render threads, of whatever node, that share a core; 1 where each has its own.
    pub threads_per_core: u16,
    /// The picture.
    pub tiles: Tiles,
    /// How tiles are dealt.
    pub balancer: Balancer,
    /// First time after which a deal that was not taken is sent again, in microseconds.
    pub resend_us: u64,
    /// Whether nodes wait to hear that a tile has come.
    pub confirms: bool,
    /// Decides what chance decides.
    pub seed: u64,
}

/// Memory lent to a [`Ledger`].
#[derive(Debug)]
pub struct LedgerStorage<'s> {
    /// One entry per tile.
    pub tiles: &'s mut [DealtTile],
    /// One number per tile.
    pub order: &'s mut [u32],
    /// One entry per node.
    pub nodes: &'s mut [DealtNode],
}

/// What the display knows of one tile. Opaque; start with [`DealtTile::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DealtTile {
    state: Dealt,
    /// The node that it was dealt to in this view.
    holder: u16,
    /// The node that it came from last; [`NOBODY`] before the first frame.
    drawn_by: u16,
    /// It has come, and the node that sent it is to hear so.
    owes_shown: Option<u16>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Dealt {
    /// In the central queue.
    Kept,
    /// Its holder does not know of it yet.
    Waiting,
    /// In the deal that is under way to its holder.
    Sent,
    /// Its holder has it, or has given it to somebody.
    Taken,
    /// It has come.
    Shown,
}

/// What the display knows of one node. Opaque; start with [`DealtNode::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DealtNode {
    is_up: bool,
    deal: Parcel,
    /// Tiles that it was dealt and that have not come, of the central queue.
    in_hand: u32,
    /// Tiles that wait for the next deal to it.
    waiting: u32,
}

/// What became of a tile that has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Arrival {
    /// Display it.
    First,
    /// It is there already.
    Again,
    /// It is of another frame, or no tile of the picture.
    Stale,
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Output {
    /// Send the first `length` bytes of the buffer to node `to`.
    Transmit {
        /// The receiver.
        to: u16,
        /// Length of the message.
        length: usize,
    },
    /// Nothing to do before this moment, or before the next input when `None`.
    Idle(Option<u64>),
}

/// The display's part of the balance.
///
/// # Use
/// [`begin`](Self::begin) a frame; tell of tiles that come ([`handle_drawn`](Self::handle_drawn)), of messages, moments,
/// and of nodes that die or come. After any of these, call [`poll`](Self::poll) until it says [`Output::Idle`]. The frame
/// is whole when [`missing`](Self::missing) is 0.
///
/// # Invariants
/// See [`check_invariants`](Self::check_invariants).
#[derive(Debug)]
pub struct Ledger<'s> {
    config: LedgerConfig,
    tiles: &'s mut [DealtTile],
    order: &'s mut [u32],
    nodes: &'s mut [DealtNode],
    stamp: Stamp,
    missing: u32,
    /// Tiles that came from another node than they were dealt to.
    moved: u32,
    /// Tiles in the central queue, and the place of the order before which there is none of them.
    kept: u32,
    kept_cursor: usize,
    /// The node whose tile came last, in the last frame.
    slowest: u16,
    is_first: bool,
    dice: Dice,
    has_mail: bool,
}

impl<'s> Ledger<'s> {
    /// A display with all nodes up and no frame begun.
    ///
    /// # Panics
    /// When the storage does not fit the picture and the number of nodes.
    pub fn new(config: LedgerConfig, storage: LedgerStorage<'s>) -> Self {
        let LedgerStorage { tiles, order, nodes } = storage;
        let count = config.tiles.count() as usize;
        assert!(tiles.len() == count && order.len() == count, "one entry per tile: there are {count}");
        assert_eq!(nodes.len(), usize::from(config.nodes), "one entry per node");
        tiles.fill(DealtTile::EMPTY);
        nodes.fill(DealtNode::EMPTY);
        along_curve(config.tiles, false).zip(order.iter_mut()).for_each(|(tile, place)| *place = tile.0);
        let (stamp, dice) = (Stamp::default(), Dice::new(config.seed));
        Self {
            config,
            tiles,
            order,
            nodes,
            stamp,
            missing: 0,
            moved: 0,
            kept: 0,
            kept_cursor: 0,
            slowest: NOBODY,
            is_first: true,
            dice,
            has_mail: false,
        }
    }

    /// Ends the ledger and gives back what was lent to it.
    pub fn into_storage(self) -> LedgerStorage<'s> {
        LedgerStorage { tiles: self.tiles, order: self.order, nodes: self.nodes }
    }

    /// Deals the tiles of a frame. Frames are numbered upwards.
    pub fn begin(&mut self, frame: u32) {
        self.stamp = Stamp { frame, view: 0 };
        self.missing = self.config.tiles.count();
        (self.moved, self.kept) = (0, 0);
        for place in 0..self.order.len() {
            let tile = self.order[place];
            let holder = self.holder_at_start(place);
            let entry = &mut self.tiles[tile as usize];
            *entry = DealtTile { state: Dealt::Waiting, holder, owes_shown: None, ..*entry };
        }
        if self.config.balancer == Balancer::Steal && !self.is_first {
            self.relieve_slowest();
        }
        self.is_first = false;
        self.deal_out();
    }

    /// A tile has come from a node.
    pub fn handle_drawn(&mut self, from: u16, frame: u32, tile: TileId) -> Arrival {
        let confirms = self.config.confirms;
        let is_frame = self.stamp.frame == frame || mutants::is_on(Mutant::AcceptOldFrame);
        let is_current = is_frame && from < self.config.nodes && !self.is_first;
        let entry = self.tiles.get_mut(tile.0 as usize).filter(|_| is_current);
        let Some(entry) = entry else { return Arrival::Stale };
        if confirms {
            entry.owes_shown = Some(from);
            self.has_mail = true;
        }
        if entry.state == Dealt::Shown {
            if mutants::is_on(Mutant::DisplayTwice) {
                return Arrival::First;
            }
            return Arrival::Again;
        }
        let (was, holder) = (entry.state, entry.holder);
        (entry.state, entry.drawn_by) = (Dealt::Shown, from);
        self.missing -= 1;
        self.kept -= u32::from(was == Dealt::Kept);
        self.moved += u32::from(holder != from);
        self.slowest = from;
        if let Some(node) = self.nodes.get_mut(usize::from(holder)) {
            node.in_hand = node.in_hand.saturating_sub(1);
            node.waiting -= u32::from(was == Dealt::Waiting);
        }
        self.top_up();
        Arrival::First
    }

    /// A message has come from a node.
    ///
    /// # Errors
    /// It makes no sense now; nothing has changed.
    pub fn handle_message(&mut self, message: &Message) -> Result<(), Refused> {
        let Message { epoch, stamp, from, to, ref body } = *message;
        let is_epoch = epoch == self.config.epoch || mutants::is_on(Mutant::SkipEpochCheck);
        if !is_epoch || to != self.config.nodes || from >= self.config.nodes {
            return Err(Refused::Stranger);
        }
        let Body::Taken { number } = *body else { return Err(Refused::Senseless) };
        if stamp != self.stamp {
            return Err(Refused::OtherView);
        }
        if !self.nodes[usize::from(from)].deal.acknowledge(number) {
            return Err(Refused::OutOfTurn);
        }
        for tile in self.tiles.iter_mut().filter(|tile| tile.state == Dealt::Sent && tile.holder == from) {
            tile.state = Dealt::Taken;
        }
        self.send_waiting(from);
        Ok(())
    }

    /// Time has passed.
    pub fn handle_timeout(&mut self, now_us: u64) {
        let resend_us = self.config.resend_us;
        for node in self.nodes.iter_mut().filter(|node| node.is_up) {
            self.has_mail |= node.deal.expire(now_us, resend_us);
        }
    }

    /// A node is dead. What is missing is dealt anew, in a new view. Tells how many tiles have another holder now.
    pub fn handle_down(&mut self, node: u16) -> u32 {
        let Some(entry) = self.nodes.get_mut(usize::from(node)).filter(|entry| entry.is_up) else { return 0 };
        *entry = DealtNode { is_up: false, ..DealtNode::EMPTY };
        if mutants::is_on(Mutant::ForgetTilesOfTheDead) {
            return 0;
        }
        self.deal_anew()
    }

    /// A node has come, or has come back with empty hands. It has no part in this view; it can take from others.
    pub fn handle_up(&mut self, node: u16) {
        let index = usize::from(node);
        let Some(entry) = self.nodes.get(index) else { return };
        if entry.is_up {
            // It was dead and nobody has noticed.
            self.handle_down(node);
        }
        self.nodes[index] = DealtNode::EMPTY;
        if !self.is_first {
            // Also when the frame is whole: so it learns what is over.
            self.nodes[index].deal.open();
            self.has_mail = true;
            self.top_up();
        }
    }

    /// What is to be done next. `buffer` has room for [`MESSAGE_BYTES_MAX`](super::message::MESSAGE_BYTES_MAX).
    pub fn poll(&mut self, now_us: u64, buffer: &mut [u8]) -> Output {
        if self.has_mail {
            if let Some((to, body)) = self.next_shown().or_else(|| self.next_deal(now_us)) {
                let LedgerConfig { epoch, nodes: from, .. } = self.config;
                let message = Message { epoch, stamp: self.stamp, from, to, body };
                return Output::Transmit { to, length: message.emit(buffer) };
            }
            self.has_mail = false;
        }
        let resend_us = self.config.resend_us;
        let up = self.nodes.iter().filter(|node| node.is_up);
        Output::Idle(up.filter_map(|node| node.deal.deadline(resend_us)).min())
    }

    /// The frame and view.
    pub const fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Tiles of the frame that have not come.
    pub fn missing(&self) -> u32 {
        if mutants::is_on(Mutant::EndEarly) {
            return self.missing.saturating_sub(1);
        }
        self.missing
    }

    /// Tiles of the frame that came from another node than they were dealt to.
    pub const fn moved(&self) -> u32 {
        self.moved
    }

    /// Whether a tile of the frame has come.
    pub fn is_shown(&self, tile: TileId) -> bool {
        self.tiles.get(tile.0 as usize).is_some_and(|entry| entry.state == Dealt::Shown)
    }

    /// Whether a tile is not on its way to anybody, or only on its way: no node is known to have it.
    pub fn keeps(&self, tile: TileId) -> bool {
        let entry = self.tiles.get(tile.0 as usize);
        entry.is_some_and(|entry| matches!(entry.state, Dealt::Kept | Dealt::Waiting | Dealt::Sent))
    }

    /// The node that a tile was dealt to, in this view.
    pub fn holder(&self, tile: TileId) -> Option<u16> {
        self.tiles.get(tile.0 as usize).map(|entry| entry.holder).filter(|holder| *holder != NOBODY)
    }

    /// Whether a node is believed to be alive.
    pub fn is_up(&self, node: u16) -> bool {
        self.nodes.get(usize::from(node)).is_some_and(|node| node.is_up)
    }

    /// Puts into `hasher` all that decides what it does. Moments count as distances from now.
    pub fn fingerprint(&self, now_us: u64, hasher: &mut impl Hasher) {
        (self.stamp, self.slowest, self.is_first, &self.dice, &*self.tiles).hash(hasher);
        for node in self.nodes.iter() {
            let DealtNode { is_up, deal, in_hand, waiting } = *node;
            let left_us = deal.deadline(self.config.resend_us).map(|at_us| at_us.saturating_sub(now_us));
            (is_up, deal.number, deal.is_open, deal.is_due, deal.tries(), left_us).hash(hasher);
            (in_hand, waiting).hash(hasher);
        }
    }

    /// Checks what must hold after every input.
    ///
    /// # Panics
    /// `MISSING_COUNTED`: tiles that are not there are counted; `NO_LOST_TILE`: each of them has a holder that is up, or is in
    /// the central queue.
    pub fn check_invariants(&self) {
        if self.is_first {
            return;
        }
        let missing = || self.tiles.iter().filter(|tile| tile.state != Dealt::Shown);
        assert_eq!(missing().count(), self.missing as usize, "MISSING_COUNTED");
        let is_anybody_up = self.nodes.iter().any(|node| node.is_up);
        for tile in missing().filter(|tile| is_anybody_up && tile.state != Dealt::Kept) {
            assert!(self.is_up(tile.holder), "NO_LOST_TILE: {tile:?} is dealt to nobody");
        }
        let kept = missing().filter(|tile| tile.state == Dealt::Kept);
        assert_eq!(kept.count(), self.kept as usize, "MISSING_COUNTED: the central queue");
        for (number, node) in (0..).zip(self.nodes.iter()).filter(|(_, node)| node.is_up) {
            let waiting = missing().filter(|tile| tile.state == Dealt::Waiting && tile.holder == number);
            assert_eq!(waiting.count(), node.waiting as usize, "MISSING_COUNTED: for node {number}");
        }
    }

    /// Who has the tile at a place of the order when a frame begins.
    fn holder_at_start(&self, place: usize) -> u16 {
        let LedgerConfig { balancer, nodes, tiles, threads_per_core, .. } = self.config;
        let tile = self.order[place];
        let drawn_by = self.tiles[tile as usize].drawn_by;
        let is_known = drawn_by != NOBODY;
        // Where threads share cores, what a node took from another was taken by chance: kept, such tiles would add up until
        // every node needs the pages of the whole picture.
        let is_kept = is_known && (balancer == Balancer::Steal || threads_per_core <= 1);
        let fixed = || Static::new(tiles, nodes.into()).node_of(TileId(tile));
        // Equal pieces of the curve, each a compact part of the picture.
        let piece = || place * usize::from(nodes) / self.order.len().max(1);
        match balancer {
            Balancer::Demand { .. } => NOBODY,
            Balancer::Steal | Balancer::StealNear if is_kept => drawn_by,
            Balancer::StealNear => u16::try_from(piece()).unwrap_or(NOBODY),
            Balancer::Static | Balancer::Steal => u16::try_from(fixed()).unwrap_or(NOBODY),
        }
    }

    /// The paper's gift of the slowest: one of its tiles goes to anybody else.
    fn relieve_slowest(&mut self) {
        let slowest = self.slowest;
        let is_its = |tile: &&mut DealtTile| tile.holder == slowest;
        let count = self.tiles.iter().filter(|tile| tile.holder == slowest).count();
        let others = |node: &u16| *node != slowest && self.is_up(*node);
        let other_count = (0..self.config.nodes).filter(others).count();
        let (tile, other) = (self.dice.below(count_u32(count)), self.dice.below(count_u32(other_count)));
        let Some(other) =
            (0..self.config.nodes).filter(|node| *node != slowest && self.is_up(*node)).nth(other as usize)
        else {
            return;
        };
        if let Some(tile) = self.tiles.iter_mut().filter(is_its).nth(tile as usize) {
            tile.holder = other;
        }
    }

    /// Opens the next view: deals every missing tile, to its holder if that is up. Tells how many have another holder now.
    fn deal_anew(&mut self) -> u32 {
        if self.missing == 0 {
            return 0;
        }
        self.stamp.view = self.stamp.view.saturating_add(1);
        for tile in
            self.tiles.iter_mut().filter(|tile| tile.state != Dealt::Shown && tile.state != Dealt::Kept)
        {
            tile.state = Dealt::Waiting;
        }
        self.deal_out()
    }

    /// Gives what waits and has no living holder to the living, in turn along the curve or back into the central queue,
    /// and opens a deal to each node. Tells how many tiles that were.
    fn deal_out(&mut self) -> u32 {
        let living = (0..self.config.nodes).filter(|node| self.is_up(*node)).count();
        let is_kept = living == 0 || matches!(self.config.balancer, Balancer::Demand { .. });
        for node in self.nodes.iter_mut().filter(|node| node.is_up) {
            *node = DealtNode::EMPTY;
            node.deal.open();
        }
        self.has_mail = true;
        let mut orphans = 0;
        for place in 0..self.order.len() {
            let index = self.order[place] as usize;
            let DealtTile { state, holder, .. } = self.tiles[index];
            if state != Dealt::Waiting {
                continue;
            }
            if !self.is_up(holder) {
                orphans += 1;
                if is_kept {
                    self.keep(index);
                    continue;
                }
                let mut up = (0..self.config.nodes).filter(|node| self.is_up(*node));
                self.tiles[index].holder = up.nth((orphans - 1) % living).unwrap_or(NOBODY);
            }
            let node = &mut self.nodes[usize::from(self.tiles[index].holder)];
            node.waiting += 1;
            node.in_hand += 1;
        }
        self.kept_cursor = 0;
        self.top_up();
        count_u32(orphans)
    }

    /// Puts a tile into the central queue.
    fn keep(&mut self, index: usize) {
        (self.tiles[index].state, self.tiles[index].holder) = (Dealt::Kept, NOBODY);
        self.kept += 1;
    }

    /// Deals from the central queue to every node that has fewer tiles than it shall have.
    fn top_up(&mut self) {
        if self.kept == 0 {
            return;
        }
        let wanted = match self.config.balancer {
            Balancer::Demand { window } => u32::from(window) * u32::from(self.config.threads.max(1)),
            // What was kept because nobody was up goes to whoever is.
            Balancer::Static | Balancer::Steal | Balancer::StealNear => u32::MAX,
        };
        for node in 0..self.config.nodes {
            let index = usize::from(node);
            while self.nodes[index].is_up && self.nodes[index].in_hand < wanted {
                let Some(tile) = self.next_kept() else { break };
                (self.tiles[tile].state, self.tiles[tile].holder) = (Dealt::Waiting, node);
                self.kept -= 1;
                self.nodes[index].in_hand += 1;
                self.nodes[index].waiting += 1;
            }
            self.send_waiting(node);
        }
    }

    /// The first tile of the central queue, along the curve.
    fn next_kept(&mut self) -> Option<usize> {
        while let Some(tile) = self.order.get(self.kept_cursor) {
            let tile = *tile as usize;
            if self.tiles[tile].state == Dealt::Kept {
                return Some(tile);
            }
            self.kept_cursor += 1;
        }
        None
    }

    /// Opens another deal to a node, if tiles wait for it and none is under way.
    fn send_waiting(&mut self, node: u16) {
        let entry = &mut self.nodes[usize::from(node)];
        let is_sent = !mutants::is_on(Mutant::ForgetWaiting);
        if entry.is_up && !entry.deal.is_open && entry.waiting > 0 && is_sent {
            entry.deal.open();
            self.has_mail = true;
        }
    }

    fn next_deal(&mut self, now_us: u64) -> Option<(u16, Body)> {
        let index = self.nodes.iter().position(|node| node.is_up && node.deal.is_due)?;
        let to = u16::try_from(index).ok()?;
        let deal = &mut self.nodes[index].deal;
        let (number, is_first_time) = (deal.number, deal.is_new());
        deal.note_sent(now_us);
        let mut tiles = Vec::new();
        for tile in self.order.iter() {
            let entry = &mut self.tiles[*tile as usize];
            if is_first_time && entry.state == Dealt::Waiting && entry.holder == to && tiles.len() < TILES_MAX
            {
                entry.state = Dealt::Sent;
                self.nodes[index].waiting -= 1;
            }
            if entry.state == Dealt::Sent && entry.holder == to {
                // There are no more of them than went into the first sending.
                let _ = tiles.push(TileId(*tile));
            }
        }
        Some((to, Body::Deal { number, tiles }))
    }

    fn next_shown(&mut self) -> Option<(u16, Body)> {
        let to = self.tiles.iter().find_map(|tile| tile.owes_shown)?;
        let mut tiles = Vec::new();
        for (id, tile) in (0..).zip(self.tiles.iter_mut()).filter(|(_, tile)| tile.owes_shown == Some(to)) {
            if tiles.push(TileId(id)).is_err() {
                break;
            }
            tile.owes_shown = None;
        }
        Some((to, Body::Shown { tiles }))
    }
}

impl DealtTile {
    /// A tile that was never dealt.
    pub const EMPTY: Self = Self { state: Dealt::Shown, holder: NOBODY, drawn_by: NOBODY, owes_shown: None };
}

impl DealtNode {
    /// A node that is up and has nothing.
    pub const EMPTY: Self = Self { is_up: true, deal: Parcel::none(u32::MAX), in_hand: 0, waiting: 0 };
}

/// No node has this number.
const NOBODY: u16 = u16::MAX;

fn count_u32(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests;
