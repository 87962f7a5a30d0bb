//! Which node draws which tile.
//!
//! Two state machines that know no clock, no socket and no chance but what they are given. A [`Worker`] is one node:
//! it hands tiles to its render threads, asks others for more when it has none, and gives away what it has too much
//! of. The [`Ledger`] is the display's: it deals each frame's tiles, knows which are there, and deals anew what was
//! lost with a node that died. They speak in [`Message`]s, which may be lost, doubled or late.
//!
//! | module | what it holds |
//! |---|---|
//! | [`fixed`] | the deal that never changes, and whose first tiles all others start from |
//! | [`curve`] | the order in which tiles are drawn |
//! | [`message`] | what is said, and its wire form |
//! | [`page_map`] | a sketch of a set of pages, to see how near a tile is to a node |
//! | [`worker`] | a node |
//! | [`ledger`] | the display |
//!
//! # Each tile of a frame once
//! A tile that is not displayed yet has one holder. It changes hands by a *gift*: the donor sends it again and again
//! until the thief says that it has taken it, and gifts to one peer are numbered, so each is taken once. Gifts, and all
//! that is said between nodes, belong to a *view* of the frame. When a node dies the display opens the next view: it
//! deals every missing tile to one living node, and whatever was said in earlier views is void. A tile that two have
//! drawn because of that is displayed when the first copy comes; the second is known by its number and dropped.
//!
//! # The end of a frame
//! The display counts tiles, so it knows when a frame is whole; a node need not. One that has nothing left and finds
//! nothing to take rests until somebody gives it something or the next frame comes. No tile costs a round trip.

pub mod curve;
mod dice;
pub mod fixed;
pub mod ledger;
pub mod message;
#[cfg(mutants)]
pub mod mutants;
#[cfg(not(mutants))]
mod mutants;
pub mod page_map;
mod parcel;
pub mod worker;

use core::fmt;
use core::str::FromStr;

pub use fixed::Static;
pub use ledger::{Ledger, LedgerStorage};
pub use message::{Message, Stamp};
pub use page_map::PageMap;
pub use worker::{Worker, WorkerStorage};

/// How tiles come to nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Balancer {
    /// Each tile has its node, for good.
    Static,
    /// The display keeps all tiles and sends a node the next when one has come back: the paper's central queue. Each
    /// render thread has `window` tiles at a time: one that it draws, and others that were sent ahead.
    Demand {
        /// Tiles that a render thread has at a time.
        window: u8,
    },
    /// The paper's section 4: a node starts with the tiles it drew in the last frame, asks peers at random for one more
    /// when it has none, and the slowest node of a frame gives one tile to a random peer before the next.
    Steal,
    /// A node starts with the tiles it drew in the last frame. When it has none left it asks the peer whose pages are most
    /// like its own, which gives half of what it has too much of, first what lies on pages that both have.
    StealNear,
}

impl Balancer {
    /// One of each kind.
    pub const ALL: [Self; 4] = [Self::Static, Self::Demand { window: 2 }, Self::Steal, Self::StealNear];

    /// Its name, as in `--balance`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::Demand { .. } => "demand",
            Self::Steal => "steal",
            Self::StealNear => "steal-near",
        }
    }

    /// Whether nodes take tiles from each other.
    pub const fn steals(self) -> bool {
        matches!(self, Self::Steal | Self::StealNear)
    }
}

impl fmt::Display for Balancer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Demand { window } => write!(f, "demand:{window}"),
            other => f.write_str(other.name()),
        }
    }
}

/// Text that names no balancer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownBalancer;

impl fmt::Display for UnknownBalancer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("expected static, demand, demand:WINDOW (1 to 255 tiles a thread), steal or steal-near")
    }
}

impl core::error::Error for UnknownBalancer {}

impl FromStr for Balancer {
    type Err = UnknownBalancer;

    fn from_str(text: &str) -> Result<Self, UnknownBalancer> {
        if let Some(balancer) = Self::ALL.into_iter().find(|balancer| balancer.name() == text) {
            return Ok(balancer);
        }
        let window = text.strip_prefix("demand:").and_then(|window| window.parse().ok());
        window.filter(|window| *window > 0).map(|window| Self::Demand { window }).ok_or(UnknownBalancer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn balancers_are_read_as_they_are_written() {
        for balancer in [&Balancer::ALL[..], &[Balancer::Demand { window: 7 }]].concat() {
            assert_eq!(balancer.to_string().parse(), Ok(balancer));
        }
        assert_eq!("demand".parse(), Ok(Balancer::Demand { window: 2 }));
        for text in ["", "demand:", "demand:0", "demand:256", "Steal", "steal-far"] {
            assert_eq!(text.parse::<Balancer>(), Err(UnknownBalancer), "{text}");
        }
    }
}
