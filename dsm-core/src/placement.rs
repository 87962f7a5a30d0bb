//! Which node is home to which page.

use core::fmt;
use core::ops::Range;

use crate::id::{MAX_NODES, NodeId, PageId};

/// Deals the pages of the address space to their home nodes, in contiguous stripes, round robin.
///
/// Stripe `s` holds pages `s * stripe_pages ..`, and its home is owner `s % owners`. An owner numbers its home
/// pages without gaps in address order; that *home index* is the page's place in the owner's memory.
///
/// # Invariants
/// - Every page has exactly one home node, which follows from its number alone: no table, no message.
/// - Only the very last stripe may be shorter, so home indices have no gaps.
///
/// # Source
/// DeMarle, Gribble, Parker, "Memory-Savvy Distributed Interactive Ray Tracing", EGPGV 2004, sec. 3: "each node
/// assumes ownership of different stripes of the shared memory space".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stripes {
    page_count: u32,
    stripe_pages: u32,
    first_owner: u16,
    owner_count: u16,
}

/// Why no placement came of these numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlacementError {
    /// There is no page to place.
    NoPages,
    /// A stripe of no pages.
    EmptyStripe,
    /// No node owns anything.
    NoOwners,
    /// The last owner would be `last`, and a cluster has at most [`MAX_NODES`] nodes.
    TooManyNodes {
        /// Number of the last owner asked for.
        last: u32,
    },
    /// `2^32 - 1` names no page: it stands for "none".
    TooManyPages,
}

impl Stripes {
    /// Places `page_count` pages in stripes of `stripe_pages` on the nodes `first_owner ..` (`owner_count` of them).
    ///
    /// # Errors
    /// A count of zero, or more nodes or pages than there are numbers for.
    pub fn new(
        page_count: u32,
        stripe_pages: u32,
        first_owner: NodeId,
        owner_count: u16,
    ) -> Result<Self, PlacementError> {
        let last = u32::from(first_owner.0) + u32::from(owner_count.max(1)) - 1;
        match (page_count, stripe_pages, owner_count) {
            (0, _, _) => Err(PlacementError::NoPages),
            (u32::MAX, _, _) => Err(PlacementError::TooManyPages),
            (_, 0, _) => Err(PlacementError::EmptyStripe),
            (_, _, 0) => Err(PlacementError::NoOwners),
            _ if last >= u32::from(MAX_NODES) => Err(PlacementError::TooManyNodes { last }),
            _ => Ok(Self { page_count, stripe_pages, first_owner: first_owner.0, owner_count }),
        }
    }

    /// Pages in the address space.
    #[must_use]
    pub const fn page_count(&self) -> u32 {
        self.page_count
    }

    /// Pages in a full stripe.
    #[must_use]
    pub const fn stripe_pages(&self) -> u32 {
        self.stripe_pages
    }

    /// Nodes that own pages.
    #[must_use]
    pub const fn owner_count(&self) -> u16 {
        self.owner_count
    }

    /// The nodes that own pages, in order. The last may own none, where there are fewer stripes than owners.
    pub fn owner_ids(&self) -> impl ExactSizeIterator<Item = NodeId> + use<> {
        (self.first_owner..self.first_owner + self.owner_count).map(NodeId)
    }

    /// The home node of `page`, or `None` when there is no such page.
    #[inline]
    #[must_use]
    pub fn home(&self, page: PageId) -> Option<NodeId> {
        if page.0 >= self.page_count {
            return None;
        }
        let owner = (page.0 / self.stripe_pages) % u32::from(self.owner_count);
        #[expect(clippy::cast_possible_truncation, reason = "a remainder of a u16")]
        Some(NodeId(self.first_owner + owner as u16))
    }

    /// The place of `page` among its owner's home pages, or `None` when there is no such page.
    #[inline]
    #[must_use]
    pub fn home_index(&self, page: PageId) -> Option<u32> {
        if page.0 >= self.page_count {
            return None;
        }
        let stripe = page.0 / self.stripe_pages / u32::from(self.owner_count);
        Some(stripe * self.stripe_pages + page.0 % self.stripe_pages)
    }

    /// The stripes of `node` as ranges of page numbers, in address order. Empty for a node that owns nothing.
    pub fn stripes_of(&self, node: NodeId) -> impl Iterator<Item = Range<u32>> + use<> {
        let Self { page_count, stripe_pages, .. } = *self;
        let step = u64::from(stripe_pages) * u64::from(self.owner_count);
        let start = match self.owner_rank(node) {
            Some(rank) => u64::from(rank) * u64::from(stripe_pages),
            None => u64::from(page_count),
        };
        core::iter::successors(Some(start), move |start| Some(start + step))
            .map_while(move |start| u32::try_from(start).ok().filter(|start| *start < page_count))
            .map(move |start| start..start.saturating_add(stripe_pages).min(page_count))
    }

    /// Home pages of `node`.
    #[must_use]
    pub fn home_pages(&self, node: NodeId) -> u32 {
        let Some(rank) = self.owner_rank(node) else { return 0 };
        let owners = u32::from(self.owner_count);
        let full_stripes = self.page_count / self.stripe_pages;
        let rest = self.page_count % self.stripe_pages;
        let own_stripes = full_stripes / owners + u32::from(u32::from(rank) < full_stripes % owners);
        let own_rest = if full_stripes % owners == u32::from(rank) { rest } else { 0 };
        own_stripes * self.stripe_pages + own_rest
    }

    /// Home pages of the node that has most.
    #[must_use]
    pub fn home_pages_max(&self) -> u32 {
        // The first owner starts every round; only a short last stripe can put it behind the next full one.
        self.home_pages(NodeId(self.first_owner))
    }

    fn owner_rank(&self, node: NodeId) -> Option<u16> {
        node.0.checked_sub(self.first_owner).filter(|rank| *rank < self.owner_count)
    }
}

impl fmt::Display for PlacementError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPages => write!(f, "there is no page to place"),
            Self::EmptyStripe => write!(f, "a stripe needs at least one page"),
            Self::NoOwners => write!(f, "no node owns pages"),
            Self::TooManyNodes { last } => {
                write!(f, "node {last} is beyond the {MAX_NODES} nodes that a cluster can have")
            }
            Self::TooManyPages => write!(f, "more than 2^32 - 2 pages; choose a larger page"),
        }
    }
}

impl core::error::Error for PlacementError {}

#[cfg(test)]
mod tests {
    #![expect(clippy::cast_possible_truncation, reason = "small numbers")]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stripes_go_round_robin_and_the_last_one_may_be_short() {
        let stripes = Stripes::new(10, 2, NodeId(0), 3).unwrap();
        let homes: heapless::Vec<u16, 16> =
            (0..10).map(|page| stripes.home(PageId(page)).unwrap().0).collect();
        assert_eq!(homes, [0, 0, 1, 1, 2, 2, 0, 0, 1, 1]);
        let of_one: heapless::Vec<_, 16> = stripes.stripes_of(NodeId(1)).collect();
        assert_eq!(of_one, [2..4, 8..10]);
    }

    #[test]
    fn pages_outside_have_no_home() {
        let stripes = Stripes::new(10, 4, NodeId(0), 3).unwrap();
        assert_eq!(stripes.home(PageId(10)), None);
        assert_eq!(stripes.home_index(PageId(u32::MAX)), None);
    }

    #[test]
    fn the_largest_address_space_is_placed_without_overflow() {
        let stripes = Stripes::new(u32::MAX - 1, 1 << 31, NodeId(0), 4095).unwrap();
        assert_eq!(stripes.home(PageId(u32::MAX - 2)), Some(NodeId(1)));
        assert_eq!(stripes.stripes_of(NodeId(1)).next(), Some((1 << 31)..u32::MAX - 1));
        assert_eq!(stripes.stripes_of(NodeId(2)).next(), None);
    }

    proptest! {
        #[test]
        fn home_indices_have_no_gaps(
            page_count in 1u32..300, stripe_pages in 1u32..40, first in 0u16..5, owners in 1u16..7,
        ) {
            let stripes = Stripes::new(page_count, stripe_pages, NodeId(first), owners).unwrap();
            let mut next = [0u32; 16];
            for page in 0..page_count {
                let home = stripes.home(PageId(page)).unwrap();
                prop_assert_eq!(stripes.home_index(PageId(page)), Some(next[home.index()]));
                next[home.index()] += 1;
            }
            for owner in 0..16 {
                let node = NodeId(owner);
                prop_assert_eq!(stripes.home_pages(node), next[node.index()]);
                let listed: u32 = stripes.stripes_of(node).map(|range| range.len() as u32).sum();
                prop_assert_eq!(listed, next[node.index()]);
                prop_assert!(next[node.index()] <= stripes.home_pages_max());
            }
        }
    }
}
