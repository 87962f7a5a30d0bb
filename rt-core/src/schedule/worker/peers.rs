//! What a node knows of the others.

use core::hash::{Hash, Hasher};

use crate::schedule::dice::Dice;
use crate::schedule::message::Stamp;
use crate::schedule::page_map::PageMap;
use crate::schedule::parcel::Parcel;

/// What a node knows of one peer, or of the display. Opaque; start with [`PeerEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PeerEntry {
    /// The tiles on their way to it.
    pub(super) gift: Parcel,
    /// Number of the last gift, or deal, that was taken from it.
    pub(super) taken: u32,
    /// It is to hear that this was taken.
    pub(super) owes_taken: bool,
    /// Number of its last question.
    pub(super) asked: u32,
    /// It is to hear that there is nothing.
    pub(super) owes_nothing: bool,
    /// It has asked and will take what there is later.
    pub(super) waits: bool,
    /// It has asked in a view that has not begun here.
    pub(super) ahead: Option<Stamp>,
    /// It has said that it has nothing, in this view.
    is_empty: bool,
    pub(super) is_down: bool,
    left_us: u32,
    map: PageMap,
}

/// All others.
#[derive(Debug)]
pub(super) struct Peers<'s> {
    pub(super) all: &'s mut [PeerEntry],
    me: u16,
    nodes: u16,
}

impl<'s> Peers<'s> {
    /// Others of whom nothing is known; `all` has an entry for each node and one for the display.
    pub(super) fn new(all: &'s mut [PeerEntry], me: u16, nodes: u16) -> Self {
        all.fill(PeerEntry::EMPTY);
        Self { all, me, nodes }
    }

    pub(super) fn get(&mut self, peer: u16) -> Option<&mut PeerEntry> {
        self.all.get_mut(usize::from(peer))
    }

    /// A view begins: what was said in the last one is void.
    pub(super) fn clear(&mut self, stamp: Stamp) {
        for peer in self.all.iter_mut() {
            let PeerEntry { ahead, is_down, left_us, map, .. } = *peer;
            let waits = ahead == Some(stamp);
            let ahead = ahead.filter(|ahead| *ahead > stamp);
            *peer = PeerEntry { ahead, waits, is_down, left_us, map, ..PeerEntry::EMPTY };
        }
    }

    pub(super) fn note(&mut self, peer: u16, map: PageMap, left_us: u32, is_empty: bool) {
        if let Some(entry) = self.get(peer) {
            (entry.map, entry.left_us, entry.is_empty) = (map, left_us, is_empty);
        }
    }

    pub(super) fn map_of(&self, peer: u16) -> PageMap {
        self.all.get(usize::from(peer)).map_or(PageMap::EMPTY, |peer| peer.map)
    }

    pub(super) fn note_left(&mut self, peer: u16, left_us: u32) {
        self.get(peer).into_iter().for_each(|entry| entry.left_us = left_us);
    }

    pub(super) fn note_down(&mut self, peer: u16, is_down: bool) {
        self.get(peer).into_iter().for_each(|entry| entry.is_down = is_down);
    }

    /// Other nodes there are, dead or alive.
    pub(super) const fn count(&self) -> u16 {
        self.nodes.saturating_sub(1)
    }

    pub(super) fn is_up(&self, peer: u16) -> bool {
        peer != self.me && peer < self.nodes && !self.all[usize::from(peer)].is_down
    }

    pub(super) fn may_have_work(&self, peer: u16) -> bool {
        self.is_up(peer) && !self.all[usize::from(peer)].is_empty
    }

    /// Any node that lives and is as asked for, each with the same chance.
    pub(super) fn any(&self, dice: &mut Dice, is_wanted: impl Fn(u16) -> bool) -> Option<u16> {
        let wanted = || (0..self.nodes).filter(|peer| self.is_up(*peer) && is_wanted(*peer));
        match u32::try_from(wanted().count()).unwrap_or(u32::MAX) {
            0 | 1 => wanted().next(),
            count => wanted().nth(dice.below(count) as usize),
        }
    }

    /// Of the nodes that may have work, one whose pages are most like those of `map`.
    pub(super) fn nearest(&self, map: PageMap, dice: &mut Dice) -> Option<u16> {
        let share = |peer: u16| map.share_in(self.all[usize::from(peer)].map);
        let candidates = (0..self.nodes).filter(|peer| self.may_have_work(*peer));
        let most = candidates.map(share).max()?;
        self.any(dice, |peer| self.may_have_work(peer) && share(peer) == most)
    }

    /// The peer at distance `2^number`, if there is one that far.
    pub(super) fn lifeline(&self, number: u16) -> Option<u16> {
        let distance = 1_u32.checked_shl(number.into()).filter(|distance| *distance < self.nodes.into())?;
        let peer = (u32::from(self.me) + distance) % u32::from(self.nodes);
        u16::try_from(peer).ok()
    }

    /// Who has most left, of those that are known to have anything.
    pub(super) fn busiest(&self, but: u16) -> Option<u16> {
        let candidates = (0..self.nodes).filter(|peer| *peer != but && self.may_have_work(*peer));
        let left_us = |peer: &u16| self.all[usize::from(*peer)].left_us;
        candidates.max_by_key(left_us).filter(|peer| left_us(peer) > 0)
    }
}

impl PeerEntry {
    pub(super) fn fingerprint(&self, hasher: &mut impl Hasher) {
        let Self { gift, owes_taken, owes_nothing, waits, ahead, is_empty, is_down, .. } = *self;
        (gift.is_open, gift.is_due, gift.tries(), owes_taken).hash(hasher);
        (owes_nothing, waits, ahead, is_empty, is_down, self.left_us, self.map).hash(hasher);
    }

    /// A peer of which nothing is known.
    pub const EMPTY: Self = Self {
        gift: Parcel::none(0),
        taken: 0,
        owes_taken: false,
        asked: 0,
        owes_nothing: false,
        waits: false,
        ahead: None,
        is_empty: false,
        is_down: false,
        left_us: 0,
        map: PageMap::EMPTY,
    };
}
