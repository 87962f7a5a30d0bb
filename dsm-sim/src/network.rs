//! What lies between the nodes: network cards, links, and what may go wrong on the way.

use dsm_core::id::NodeId;

use crate::chance::Chance;

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
    pub(crate) fn between(&self, from: NodeId, to: NodeId) -> Link {
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

    pub(crate) fn time_under_way(&self, chance: &mut Chance) -> u64 {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn racks_are_near_inside_and_far_outside() {
        let links = Links::Racks { nodes: 2, near: Link::new(1), far: Link::new(9) };
        let latency = |from, to| links.between(NodeId(from), NodeId(to)).latency_ns;
        assert_eq!([latency(0, 1), latency(1, 2), latency(3, 2)], [1, 9, 1]);
    }
}
