//! The network at work: what waits for whom, and what gets lost.

use dsm_core::id::NodeId;

use crate::chance::Chance;
use crate::network::{Card, Cards, Network, Traffic};
use crate::time::Moment;

/// The network at work.
#[derive(Debug)]
pub(crate) struct Wires {
    network: Network,
    ends: Vec<End>,
    chance: Chance,
}

/// Where a node is plugged in.
#[derive(Debug)]
struct End {
    card: Card,
    send_free: Moment,
    receive_free: Moment,
    /// Nodes hear each other when they are on the same side.
    side: bool,
    traffic: Traffic,
}

/// What became of a message that was sent: the moments at which its last bit reaches the other card.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Sent {
    pub(crate) arrives: Option<Moment>,
    pub(crate) arrives_again: Option<Moment>,
}

/// What becomes of a message whose last bit has reached the other card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Received {
    Now,
    At(Moment),
    Lost,
}

impl Wires {
    pub(crate) fn new(network: Network, node_count: u16, chance: Chance) -> Self {
        let end = |node| End {
            card: match network.cards {
                Cards::Same(card) => card,
                Cards::Each(card) => card(NodeId(node)),
            },
            send_free: Moment::ZERO,
            receive_free: Moment::ZERO,
            side: false,
            traffic: Traffic::default(),
        };
        let ends = (0..node_count).map(end).collect();
        Self { network, ends, chance }
    }

    /// Sends a message of so many bytes. It waits for the sender's card and may be lost or doubled behind it.
    pub(crate) fn send(&mut self, now: Moment, from: NodeId, to: NodeId, bytes: u32) -> Sent {
        if from == to {
            return Sent { arrives: Some(now), arrives_again: None };
        }
        let Some(departs) = self.depart(now, from, bytes) else { return Sent::default() };
        let link = self.network.links.between(from, to);
        let is_lost = self.chance.happens(link.loss_ppm);
        let traffic = &mut self.ends[to.index()].traffic;
        if is_lost {
            traffic.lost += 1;
            return Sent::default();
        }
        let is_double = self.chance.happens(link.duplicate_ppm);
        traffic.duplicated += u64::from(is_double);
        let mut arrival = || departs.after(link.time_under_way(&mut self.chance));
        Sent { arrives: Some(arrival()), arrives_again: is_double.then(arrival) }
    }

    /// When the last bit has left the card, or `None` when there is no room to wait.
    fn depart(&mut self, now: Moment, from: NodeId, bytes: u32) -> Option<Moment> {
        let bytes = bytes.saturating_add(self.network.overhead_bytes);
        let end = &mut self.ends[from.index()];
        let card = end.card;
        let wait = end.send_free.since(now);
        if card.queue_bytes > 0 && wait > time_of(card.queue_bytes, card.send_bits_per_s) {
            end.traffic.overflowed += 1;
            return None;
        }
        end.traffic.sent_messages += 1;
        end.traffic.sent_bytes += u64::from(bytes);
        end.send_free = now.after(wait).after(time_of(u64::from(bytes), card.send_bits_per_s));
        Some(end.send_free)
    }

    /// Receives a message whose last bit is here now. While the card still takes in others, it waits.
    ///
    /// Bits come in while the sender still sends, so a message alone takes its bytes' time once, not twice.
    pub(crate) fn receive(&mut self, now: Moment, from: NodeId, to: NodeId, bytes: u32) -> Received {
        if from == to {
            return Received::Now;
        }
        let bytes = u64::from(bytes.saturating_add(self.network.overhead_bytes));
        let sender = &self.ends[from.index()];
        let (side, send_bits_per_s) = (sender.side, sender.card.send_bits_per_s);
        let end = &mut self.ends[to.index()];
        if end.side != side {
            end.traffic.cut_off += 1;
            return Received::Lost;
        }
        let Card { receive_bits_per_s, queue_bytes, .. } = end.card;
        let first_bit = Moment::from_ns(now.as_ns().saturating_sub(time_of(bytes, send_bits_per_s)));
        let begins = first_bit.max(end.receive_free);
        let ends = begins.after(time_of(bytes, receive_bits_per_s)).max(now);
        if queue_bytes > 0 && begins.since(first_bit) > time_of(queue_bytes, receive_bits_per_s) {
            end.traffic.overflowed += 1;
            return Received::Lost;
        }
        end.receive_free = ends;
        end.traffic.received_messages += 1;
        end.traffic.received_bytes += bytes;
        if ends == now { Received::Now } else { Received::At(ends) }
    }

    /// Cuts the network in two: what is on the way from one side to the other is lost too.
    pub(crate) fn cut(&mut self, is_apart: impl Fn(NodeId) -> bool) {
        for (node, end) in (0..).zip(&mut self.ends) {
            end.side = is_apart(NodeId(node));
        }
    }

    pub(crate) fn is_cut(&self) -> bool {
        self.ends.iter().any(|end| end.side)
    }

    pub(crate) fn count_unheard(&mut self, node: NodeId) {
        self.ends[node.index()].traffic.unheard += 1;
    }

    pub(crate) fn traffic(&self, node: NodeId) -> Traffic {
        self.ends[node.index()].traffic
    }
}

/// Nanoseconds that so many bytes take, rounded up.
fn time_of(bytes: u64, bits_per_s: u64) -> u64 {
    if bits_per_s == 0 {
        return 0;
    }
    let time = (u128::from(bytes) * 8_000_000_000).div_ceil(u128::from(bits_per_s));
    u64::try_from(time).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Link, Links};

    const A: NodeId = NodeId(0);
    const B: NodeId = NodeId(1);
    const C: NodeId = NodeId(2);

    /// Three nodes, 8 Gbit/s: a byte takes a nanosecond.
    fn wires(change: impl Fn(&mut Network)) -> Wires {
        let mut network = Network {
            links: Links::Same(Link::new(500)),
            cards: Cards::Same(Card::new(8_000_000_000)),
            overhead_bytes: 0,
        };
        change(&mut network);
        Wires::new(network, 3, Chance::new(1, 0))
    }

    fn at(ns: u64) -> Moment {
        Moment::from_ns(ns)
    }

    #[test]
    fn a_message_alone_takes_its_bytes_and_its_latency() {
        let mut wires = wires(|_| ());
        let sent = wires.send(at(10), A, B, 100);
        assert_eq!(sent, Sent { arrives: Some(at(610)), arrives_again: None });
        assert_eq!(wires.receive(at(610), A, B, 100), Received::Now);
    }

    #[test]
    fn a_sender_sends_one_after_the_other_and_a_receiver_receives_so() {
        let mut wires = wires(|_| ());
        assert_eq!(wires.send(at(0), A, B, 100).arrives, Some(at(600)));
        assert_eq!(wires.send(at(0), A, B, 100).arrives, Some(at(700)));
        assert_eq!(wires.send(at(0), C, B, 100).arrives, Some(at(600)));
        assert_eq!(wires.receive(at(600), A, B, 100), Received::Now);
        assert_eq!(wires.receive(at(600), C, B, 100), Received::At(at(700)));
        assert_eq!(wires.receive(at(700), A, B, 100), Received::At(at(800)));
    }

    #[test]
    fn a_slow_receiver_sets_the_pace() {
        let slow = |node: NodeId| Card::new(if node == B { 4_000_000_000 } else { 8_000_000_000 });
        let mut wires = wires(|network| network.cards = Cards::Each(slow));
        assert_eq!(wires.send(at(0), A, B, 100).arrives, Some(at(600)));
        assert_eq!(wires.receive(at(600), A, B, 100), Received::At(at(700)));
    }

    #[test]
    fn what_finds_no_room_is_lost_and_counted() {
        let card = Card { queue_bytes: 150, ..Card::new(8_000_000_000) };
        let mut wires = wires(|network| network.cards = Cards::Same(card));
        let arrivals = [0; 4].map(|_| wires.send(at(0), A, B, 100).arrives.map(Moment::as_ns));
        assert_eq!(arrivals, [Some(600), Some(700), None, None]);
        assert_eq!(wires.traffic(A).overflowed, 2);
        let received = [0; 4].map(|_| wires.receive(at(600), C, B, 100));
        assert_eq!(received, [Received::Now, Received::At(at(700)), Received::Lost, Received::Lost]);
    }

    #[test]
    fn a_cut_loses_what_crosses_it_and_nothing_else() {
        let mut wires = wires(|_| ());
        wires.cut(|node| node == C);
        assert!(wires.is_cut());
        assert_eq!(wires.receive(at(600), A, B, 1), Received::Now);
        assert_eq!(wires.receive(at(600), A, C, 1), Received::Lost);
        assert_eq!(wires.receive(at(600), C, B, 1), Received::Lost);
        wires.cut(|_| false);
        assert!(!wires.is_cut());
        assert_eq!(wires.receive(at(700), A, C, 1), Received::Now);
    }

    #[test]
    fn losses_doubles_and_overtaking_happen_as_often_as_they_should() {
        let unlucky = Link {
            loss_ppm: 100_000,
            duplicate_ppm: 50_000,
            reorder_ppm: 200_000,
            reorder_ns: 1_000,
            ..Link::new(500)
        };
        let mut wires = wires(|network| network.links = Links::Same(unlucky));
        let sent: Vec<Sent> = (0..10_000).map(|n| wires.send(at(n * 1_000), A, B, 0)).collect();
        let lost = sent.iter().filter(|sent| sent.arrives.is_none()).count();
        let doubled = sent.iter().filter(|sent| sent.arrives_again.is_some()).count();
        let held = (0..)
            .zip(&sent)
            .filter(|(n, sent)| sent.arrives.is_some_and(|arrives| arrives > at(n * 1_000 + 500)))
            .count();
        assert!((900..1_100).contains(&lost), "{lost}");
        assert!((400..500).contains(&doubled), "{doubled}");
        assert!((1_650..1_950).contains(&held), "{held}");
        assert_eq!(wires.traffic(B).lost, lost as u64);
    }
}
