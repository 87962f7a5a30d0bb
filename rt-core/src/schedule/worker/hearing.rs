//! What a node makes of what it is told.

use super::super::message::{Body, Gift, Message, Stamp};
use super::super::mutants::{self, Mutant};
use super::super::page_map::PageMap;
use super::asking::{Asking, Question};
use super::hand::TileState;
use super::{Refused, Worker, WorkerConfig};
use crate::tile::TileId;

impl Worker<'_> {
    /// Whether a message is for this node, and from somebody.
    pub(super) fn believe(&self, message: &Message) -> Result<(), Refused> {
        let WorkerConfig { epoch, me, nodes, .. } = self.config;
        let Message { from, to, .. } = *message;
        let is_epoch = message.epoch == epoch || mutants::is_on(Mutant::SkipEpochCheck);
        let is_known = is_epoch && to == me && from <= nodes && from != me;
        if is_known { Ok(()) } else { Err(Refused::Stranger) }
    }

    pub(super) fn handle(&mut self, now_us: u64, message: &Message) -> Result<(), Refused> {
        let Message { stamp, from, ref body, .. } = *message;
        let is_from_display = from == self.config.nodes;
        match (body, is_from_display) {
            (Body::Deal { number, tiles }, true) => self.handle_deal(now_us, stamp, *number, tiles),
            (Body::Shown { tiles }, true) => self.handle_shown(stamp, tiles),
            (Body::Give { number, left_us, gifts }, false) => {
                self.in_view(stamp)?;
                self.peers.note_left(from, *left_us);
                self.handle_gift(now_us, from, *number, gifts)
            }
            (Body::Taken { number }, false) => {
                self.in_view(stamp)?;
                self.handle_taken(from, *number)
            }
            (Body::Ask { number, map, waits }, false) => self.handle_ask(stamp, from, *number, *map, *waits),
            (Body::Nothing { number, left_us, map, busiest }, false) => {
                self.in_view(stamp)?;
                self.peers.note(from, *map, *left_us, true);
                self.handle_nothing(now_us, from, *number, *busiest)
            }
            _ => Err(Refused::Senseless),
        }
    }

    fn in_view(&self, stamp: Stamp) -> Result<(), Refused> {
        let is_it = self.stamp == Some(stamp) || mutants::is_on(Mutant::SkipViewCheck);
        if is_it { Ok(()) } else { Err(Refused::OtherView) }
    }

    fn handle_deal(
        &mut self,
        now_us: u64,
        stamp: Stamp,
        number: u32,
        tiles: &[TileId],
    ) -> Result<(), Refused> {
        let is_news = self.stamp.is_none_or(|mine| mine < stamp);
        if number == 0 && is_news {
            self.open(now_us, stamp);
        } else {
            self.in_view(stamp)?;
        }
        let is_first = number == 0 && is_news;
        let display = usize::from(self.config.nodes);
        let taken = self.peers.all[display].taken;
        if !is_first && number > taken + 1 {
            return Err(Refused::OutOfTurn);
        }
        self.peers.all[display].owes_taken = true;
        self.has_mail = true;
        if !is_first && number <= taken {
            return Ok(());
        }
        self.peers.all[display].taken = number;
        for tile in tiles {
            match self.state(*tile) {
                Some(TileState::Elsewhere) => self.hand.queue(*tile),
                // Drawn in an earlier view; the display has not seen it.
                Some(TileState::Drawn { .. }) => {
                    self.hand
                        .entry(*tile)
                        .into_iter()
                        .for_each(|e| e.state = TileState::Drawn { is_due: true });
                }
                _ => {}
            }
        }
        self.got_work(now_us);
        Ok(())
    }

    /// A view begins, and perhaps a frame.
    fn open(&mut self, now_us: u64, stamp: Stamp) {
        let is_new_frame = self.stamp.is_none_or(|mine| mine.frame != stamp.frame);
        if is_new_frame {
            self.maps = [PageMap::EMPTY, self.maps[0]];
            self.busy_us = [0, self.busy_us[0]];
            self.began_us = now_us;
            self.unconfirmed = 0;
        }
        self.stamp = Some(stamp);
        self.hand.clear(stamp.frame, is_new_frame, self.dear_us());
        self.peers.clear(stamp);
        self.asking = Asking::new();
    }

    fn handle_shown(&mut self, stamp: Stamp, tiles: &[TileId]) -> Result<(), Refused> {
        // What the display has it has, in whatever view.
        if self.stamp.is_none_or(|mine| mine.frame != stamp.frame) {
            return Err(Refused::OtherView);
        }
        if mutants::is_on(Mutant::IgnoreShown) {
            return Ok(());
        }
        for tile in tiles {
            let drawn = self.hand.entry(*tile).filter(|entry| matches!(entry.state, TileState::Drawn { .. }));
            if let Some(entry) = drawn {
                entry.state = TileState::Shown;
                self.unconfirmed -= 1;
            }
        }
        Ok(())
    }

    fn handle_gift(&mut self, now_us: u64, from: u16, number: u32, gifts: &[Gift]) -> Result<(), Refused> {
        let Some(peer) = self.peers.get(from) else { return Err(Refused::Stranger) };
        if number > peer.taken + 1 {
            return Err(Refused::OutOfTurn);
        }
        peer.owes_taken = true;
        self.has_mail = true;
        if number <= peer.taken {
            return Ok(());
        }
        peer.taken = number;
        for gift in gifts {
            // One that we gave away and that comes back was taken, whether we have heard so or not.
            if mutants::is_on(Mutant::ForgetGift) {
                continue;
            }
            if let Some(TileState::Elsewhere | TileState::Given) = self.state(gift.tile) {
                self.hand.queue_gift(gift);
                self.stats.taken += 1;
            }
        }
        if self.asking.pending.is_some_and(|question| question.to == from) {
            self.asking.pending = None;
        }
        self.got_work(now_us);
        Ok(())
    }

    fn handle_taken(&mut self, from: u16, number: u32) -> Result<(), Refused> {
        let Some(peer) = self.peers.get(from) else { return Err(Refused::Stranger) };
        if !peer.gift.acknowledge(number) {
            return Err(Refused::OutOfTurn);
        }
        for index in 0..self.hand.tiles.len() {
            let entry = &mut self.hand.tiles[index];
            if entry.state != TileState::Given || entry.to != from {
                continue;
            }
            entry.state = TileState::Elsewhere;
            if mutants::is_on(Mutant::KeepGiven) {
                self.hand.queue(TileId(u32::try_from(index).unwrap_or(u32::MAX)));
            }
        }
        Ok(())
    }

    fn handle_ask(
        &mut self,
        stamp: Stamp,
        from: u16,
        number: u32,
        map: PageMap,
        waits: bool,
    ) -> Result<(), Refused> {
        let mine = self.stamp;
        let Some(peer) = self.peers.get(from) else { return Err(Refused::Stranger) };
        if mine.is_none_or(|mine| mine < stamp) {
            peer.ahead = Some(stamp);
            return Err(Refused::OtherView);
        }
        if mine != Some(stamp) {
            return Err(Refused::OtherView);
        }
        if number <= peer.asked {
            return Err(Refused::OutOfTurn);
        }
        peer.asked = number;
        self.peers.note(from, map, 0, true);
        if !self.share(from) {
            self.peers.get(from).into_iter().for_each(|peer| {
                peer.owes_nothing = true;
                peer.waits |= waits;
            });
            self.has_mail = true;
        }
        Ok(())
    }

    fn handle_nothing(
        &mut self,
        now_us: u64,
        from: u16,
        number: u32,
        busiest: Option<u16>,
    ) -> Result<(), Refused> {
        let is_answer = |question: Question| question.to == from && question.number == number;
        if !self.asking.pending.is_some_and(is_answer) {
            return Err(Refused::OutOfTurn);
        }
        self.asking.pending = None;
        self.asking.take_hint(busiest);
        self.look_for_work(now_us);
        Ok(())
    }
}
