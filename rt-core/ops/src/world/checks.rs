//! What must hold after each operation.

use rt_core::TileId;
use rt_core::schedule::message::Body;
use rt_core::schedule::worker::TileState;
use rt_core::schedule::{Message, Worker};

use super::{Packet, World};

impl World<'_> {
    pub(super) fn check(&self) {
        self.ledger.check_invariants();
        self.members.iter().filter_map(|member| member.worker.as_ref()).for_each(Worker::check_invariants);
        let is_whole = self.ledger.missing() == 0;
        assert!(
            !is_whole || self.shown.iter().all(|shown| *shown == 1),
            "EXACTLY_ONCE: a whole frame lacks a tile"
        );
        self.check_no_lost_tile();
    }

    fn check_no_lost_tile(&self) {
        let unnoticed = |node: usize| {
            !self.members[node].is_alive() && self.ledger.is_up(u16::try_from(node).unwrap_or(0))
        };
        if (0..self.members.len()).any(unnoticed) {
            // It may have died with its node; it is dealt anew when somebody says so.
            return;
        }
        let stamp = self.ledger.stamp();
        for tile in self.setup.tiles().ids().filter(|tile| !self.ledger.is_shown(*tile)) {
            let has = |worker: &Worker<'_>| {
                let Some(mine) = worker.stamp().filter(|mine| mine.frame == stamp.frame) else {
                    return false;
                };
                match worker.state(tile) {
                    Some(TileState::Drawing | TileState::Drawn { .. }) => true,
                    Some(TileState::Queued | TileState::Given) => mine == stamp,
                    _ => false,
                }
            };
            let is_held = self.members.iter().filter_map(|member| member.worker.as_ref()).any(has);
            let is_coming = || self.under_way.iter().any(|packet| self.brings(packet, tile));
            assert!(
                self.ledger.keeps(tile) || is_held || is_coming(),
                "NO_LOST_TILE: nobody has {tile:?} of {stamp:?}"
            );
        }
    }

    /// Whether a packet brings a tile of this frame to the display.
    fn brings(&self, packet: &Packet, tile: TileId) -> bool {
        let parsed = Message::parse(&packet.bytes);
        parsed.is_ok_and(|(message, _)| {
            let is_it = matches!(message.body, Body::Drawn { tile: other, .. } if other == tile);
            is_it && message.stamp.frame == self.ledger.stamp().frame
        })
    }
}
