//! Which worlds are the same for a model checker.

use core::hash::{Hash, Hasher};
use std::collections::hash_map::DefaultHasher;

use rt_core::schedule::message::Body;
use rt_core::schedule::{Message, Worker};

use super::{Packet, World};

impl World<'_> {
    /// Whether nothing is under way that will not be refused whenever it arrives.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.under_way.iter().all(|packet| self.packet_fingerprint(packet).is_none())
    }

    /// A number that two worlds have in common when whatever happens to both leads to the same: moments count as distances
    /// from now, questions and gifts have no numbers but are news or not, and the order of what is under way does not
    /// matter; what will be refused whenever it arrives does not count. For worlds in which nobody comes back.
    #[must_use]
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        let mut packets: Vec<u64> =
            self.under_way.iter().filter_map(|packet| self.packet_fingerprint(packet)).collect();
        packets.sort_unstable();
        (packets, &self.begun, &self.shown).hash(&mut hasher);
        self.ledger.fingerprint(self.now_us, &mut hasher);
        for member in &self.members {
            member.is_alive().hash(&mut hasher);
            let mut drawing = member.drawing.clone();
            drawing.sort_unstable();
            drawing.hash(&mut hasher);
            member.worker.iter().for_each(|worker| worker.fingerprint(self.now_us, &mut hasher));
        }
        hasher.finish()
    }

    fn packet_fingerprint(&self, packet: &Packet) -> Option<u64> {
        let mut hasher = DefaultHasher::new();
        let (message, _) = Message::parse(&packet.bytes).expect("what was sent parses");
        let worker =
            |node: u16| self.members.get(usize::from(node)).and_then(|member| member.worker.as_ref());
        let is_for_display = packet.to == self.setup.display();
        if !is_for_display && worker(packet.to).is_none_or(|worker| is_void(worker, &message)) {
            return None;
        }
        let is_news = worker(packet.to).map(|worker| worker.is_news(&message));
        (packet.to, message.from, message.stamp, is_news).hash(&mut hasher);
        match &message.body {
            Body::Deal { number, tiles } => (0u8, number, tiles).hash(&mut hasher),
            Body::Give { left_us, gifts, .. } => {
                (1u8, left_us).hash(&mut hasher);
                gifts.iter().for_each(|gift| (gift.tile, gift.cost_us, gift.map).hash(&mut hasher));
            }
            // The display's deals have few numbers.
            Body::Taken { number } => (2u8, is_news.is_none().then_some(number)).hash(&mut hasher),
            Body::Ask { number, map, waits } => {
                let is_awaited = worker(message.from).is_some_and(|asker| asker.awaits(*number));
                (3u8, is_awaited, map, waits).hash(&mut hasher);
            }
            Body::Nothing { left_us, map, busiest, .. } => (4u8, left_us, map, busiest).hash(&mut hasher),
            Body::Drawn { tile, cost_us } => (5u8, tile, cost_us).hash(&mut hasher),
            Body::Shown { tiles } => (6u8, tiles).hash(&mut hasher),
        }
        Some(hasher.finish())
    }
}

/// Whether a node will refuse a message whenever it arrives: it is of a view that is over, or answers what does not wait for
/// an answer any more.
fn is_void(worker: &Worker<'_>, message: &Message) -> bool {
    let Some(stamp) = worker.stamp() else { return false };
    let is_over = match message.body {
        Body::Shown { .. } => message.stamp.frame < stamp.frame,
        _ => message.stamp < stamp,
    };
    let is_answer = matches!(message.body, Body::Taken { .. } | Body::Nothing { .. } | Body::Ask { .. });
    is_over || is_answer && message.stamp == stamp && !worker.is_news(message)
}
