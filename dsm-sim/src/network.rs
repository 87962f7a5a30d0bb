//! What lies between the nodes: network cards, links, and what may go wrong on the way.

use dsm_core::id::NodeId;

use crate::chance::Chance;
use crate::time::Moment;

/// The network of a cluster.
#[derive(Clone, Debug)]
pub struct Network {
    /// The way from one card to another.
    pub links: Links,
    /// The card of each node.
    pub cards: Cards,
    /// Bytes that the network adds to each message: headers of its layers, gaps between frames.
    pub overhead_bytes: u32,
}

/// Which link leads from whom to whom.
#[derive(Clone, Copy, Debug)]
pub enum Links {
    /// All are the same.
    Same(Link),
    /// Nodes stand in racks of so many; `near` within one, `far` from one to another.
    Racks {
        /// Nodes of a rack.
        nodes: u16,
        /// Within a rack.
        near: Link,
        /// From one rack to another.
        far: Link,
    },
    /// What the function says, from whom to whom. It must say the same each time.
    Each(fn(NodeId, NodeId) -> Link),
}

/// Which card a node has.
#[derive(Clone, Copy, Debug)]
pub enum Cards {
    /// All are the same.
    Same(Card),
    /// What the function says.
    Each(fn(NodeId) -> Card),
}

/// The way of a message, once it has left its sender's card.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    /// The shortest time under way.
    pub latency_ns: u64,
    /// What comes on top of it.
    pub jitter: Jitter,
    /// Messages lost, in a million.
    pub loss_ppm: u32,
    /// Messages that arrive twice, in a million.
    pub duplicate_ppm: u32,
    /// Messages held up so that later ones overtake them, in a million.
    pub reorder_ppm: u32,
    /// How long these are held up at most.
    pub reorder_ns: u64,
}

/// Time under way beyond the shortest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jitter {
    /// None.
    None,
    /// Any time up to this, each with the same chance.
    Uniform(u64),
    /// This in the mean; mostly less, now and then much more.
    Tail(u64),
}

/// A node's network card: what it can send and receive, each way one message after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Card {
    /// Bits a second it can send; 0 for any number.
    pub send_bits_per_s: u64,
    /// Bits a second it can receive; 0 for any number.
    pub receive_bits_per_s: u64,
    /// Bytes that can wait to be sent, and bytes that the network keeps for this receiver; beyond it messages are
    /// lost. 0 for any number.
    pub queue_bytes: u64,
}

/// What the network has done for one node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Messages this node sent.
    pub sent_messages: u64,
    /// Bytes of them, with what the network adds.
    pub sent_bytes: u64,
    /// Messages that reached it.
    pub received_messages: u64,
    /// Bytes of them, with what the network adds.
    pub received_bytes: u64,
    /// Messages to it that were lost by chance.
    pub lost: u64,
    /// Messages to it that came twice.
    pub duplicated: u64,
    /// Messages to or from it that found no room to wait.
    pub overflowed: u64,
    /// Messages to it that did not get across a cut.
    pub cut_off: u64,
    /// Messages to it while it was down.
    pub unheard: u64,
}

impl Network {
    /// No latency, no limit, no loss.
    pub const PERFECT: Self =
        Self { links: Links::Same(Link::new(0)), cards: Cards::Same(Card::UNLIMITED), overhead_bytes: 0 };

    /// The paper's: Gigabit Ethernet of 2004 through one switch, 40 us from card to card. 66 bytes a frame for
    /// Ethernet, IP and UDP are counted once a message.
    #[must_use]
    pub const fn gigabit() -> Self {
        Self::switched(1_000_000_000, 40_000)
    }

    /// One of today: 100 Gbit/s through one switch, 3 us from card to card.
    #[must_use]
    pub const fn hundred_gigabit() -> Self {
        Self::switched(100_000_000_000, 3_000)
    }

    const fn switched(bits_per_s: u64, latency_ns: u64) -> Self {
        let link = Link { jitter: Jitter::Tail(latency_ns / 10), ..Link::new(latency_ns) };
        Self { links: Links::Same(link), cards: Cards::Same(Card::new(bits_per_s)), overhead_bytes: 66 }
    }

    /// The same with every link changed by `change`; links that a function gives stay as they are.
    #[must_use]
    pub fn with_links(mut self, change: impl Fn(&mut Link)) -> Self {
        match &mut self.links {
            Links::Same(link) => change(link),
            Links::Racks { near, far, .. } => {
                change(near);
                change(far);
            }
            Links::Each(_) => {}
        }
        self
    }
}

impl Traffic {
    /// The sums of both.
    #[must_use]
    pub const fn plus(&self, other: &Self) -> Self {
        Self {
            sent_messages: self.sent_messages + other.sent_messages,
            sent_bytes: self.sent_bytes + other.sent_bytes,
            received_messages: self.received_messages + other.received_messages,
            received_bytes: self.received_bytes + other.received_bytes,
            lost: self.lost + other.lost,
            duplicated: self.duplicated + other.duplicated,
            overflowed: self.overflowed + other.overflowed,
            cut_off: self.cut_off + other.cut_off,
            unheard: self.unheard + other.unheard,
        }
    }

    /// Messages that were lost, for whatever reason.
    #[must_use]
    pub const fn lost_in_all(&self) -> u64 {
        self.lost + self.overflowed + self.cut_off + self.unheard
    }
}

impl Links {
    fn between(&self, from: NodeId, to: NodeId) -> Link {
        match *self {
            Self::Same(link) => link,
            Self::Racks { nodes, near, far } => {
                let rack = |node: NodeId| node.0 / nodes.max(1);
                if rack(from) == rack(to) { near } else { far }
            }
            Self::Each(link) => link(from, to),
        }
    }
}

impl Link {
    /// A link of this latency on which nothing ever goes wrong.
    #[must_use]
    pub const fn new(latency_ns: u64) -> Self {
        Self {
            latency_ns,
            jitter: Jitter::None,
            loss_ppm: 0,
            duplicate_ppm: 0,
            reorder_ppm: 0,
            reorder_ns: 0,
        }
    }

    fn time_under_way(&self, chance: &mut Chance) -> u64 {
        let jitter = match self.jitter {
            Jitter::None => 0,
            Jitter::Uniform(most) => chance.below(most.saturating_add(1)),
            Jitter::Tail(mean) => chance.tail(mean),
        };
        let held = if chance.happens(self.reorder_ppm) { chance.below(self.reorder_ns) } else { 0 };
        self.latency_ns.saturating_add(jitter).saturating_add(held)
    }
}

impl Card {
    /// A card that takes no time.
    pub const UNLIMITED: Self = Self::new(0);

    /// A card of this speed both ways, with room for all that has to wait.
    #[must_use]
    pub const fn new(bits_per_s: u64) -> Self {
        Self { send_bits_per_s: bits_per_s, receive_bits_per_s: bits_per_s, queue_bytes: 0 }
    }
}

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

    #[test]
    fn racks_are_near_inside_and_far_outside() {
        let links = Links::Racks { nodes: 2, near: Link::new(1), far: Link::new(9) };
        let latency = |from, to| links.between(NodeId(from), NodeId(to)).latency_ns;
        assert_eq!([latency(0, 1), latency(1, 2), latency(3, 2)], [1, 9, 1]);
    }
}
