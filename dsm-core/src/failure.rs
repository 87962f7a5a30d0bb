//! Why a page cannot be had.

use core::fmt;

use crate::id::NodeId;
use crate::wire::Refusal;

/// Why a page cannot be had. It stays so until the epoch ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Failure {
    /// The address space has no such page.
    NoSuchPage,
    /// Nobody who holds it answered within the deadline.
    NoAnswer {
        /// The node asked last.
        from: NodeId,
    },
    /// Every node that holds it and is not dead refused it.
    Refused {
        /// The node that refused last.
        by: NodeId,
        /// What it said.
        why: Refusal,
    },
    /// No slot became free within the deadline.
    NoSlot,
    /// Every node that holds it is dead.
    Dead {
        /// The node asked last.
        last: NodeId,
    },
}

impl Failure {
    /// Packs the failure into 20 bits, so that the entry of a failed page can keep it where its slot was.
    pub(crate) const fn to_bits(self) -> u32 {
        match self {
            Self::NoSuchPage => 0,
            Self::NoAnswer { from } => 1 | (from.0 as u32) << 4,
            Self::Refused { by, why: Refusal::NotOwner } => 2 | (by.0 as u32) << 4,
            Self::Refused { by, why: Refusal::Unreadable } => 3 | (by.0 as u32) << 4,
            Self::NoSlot => 4,
            Self::Dead { last } => 5 | (last.0 as u32) << 4,
        }
    }

    /// The failure that [`to_bits`](Self::to_bits) packed.
    pub(crate) const fn from_bits(bits: u32) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "sixteen bits were put there")]
        let node = NodeId((bits >> 4) as u16);
        match bits & 0b1111 {
            1 => Self::NoAnswer { from: node },
            2 => Self::Refused { by: node, why: Refusal::NotOwner },
            3 => Self::Refused { by: node, why: Refusal::Unreadable },
            4 => Self::NoSlot,
            5 => Self::Dead { last: node },
            _ => Self::NoSuchPage,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSuchPage => write!(f, "the address space has no such page"),
            Self::NoAnswer { from } => {
                write!(f, "{from}, which holds it, did not answer within the deadline")
            }
            Self::Refused { by, why } => write!(f, "{by}, asked as its holder, refused it: {why}"),
            Self::NoSlot => write!(f, "no slot became free within the deadline"),
            Self::Dead { last } => write!(f, "{last}, the last node that held it, is dead"),
        }
    }
}

impl core::error::Error for Failure {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_loses_nothing() {
        for node in [0, 1, u16::MAX].map(NodeId) {
            for failure in [
                Failure::NoSuchPage,
                Failure::NoAnswer { from: node },
                Failure::Refused { by: node, why: Refusal::NotOwner },
                Failure::Refused { by: node, why: Refusal::Unreadable },
                Failure::NoSlot,
                Failure::Dead { last: node },
            ] {
                assert_eq!(Failure::from_bits(failure.to_bits()), failure);
                assert!(failure.to_bits() < 1 << 20);
            }
        }
    }
}
