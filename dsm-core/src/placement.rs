//! Which nodes hold which page.

use core::fmt;
use core::ops::Range;

use crate::id::{MAX_NODES, NodeId, PageId};

/// Deals the pages of the address space to the nodes that own them, in contiguous stripes, with copies if so wished.
///
/// Stripe `s` holds pages `s * stripe_pages ..`. Its *home*, which holds the first copy, is owner `s % owners`, round
/// robin. As many stripes as there are owners are a *round*; the other copies of a round's stripes lie all at the same
/// *distances* behind their homes, counted in owners: owner `(home + distance) % owners`. The distances of a round are the
/// `replicas - 1` with the highest random weight, which is a hash of round and distance. So what a lost node held is
/// spread over all others, and yet every owner holds as much as any other.
///
/// An owner numbers the pages it holds without gaps, its home pages in address order first, its replicas in address order
/// behind them; that *held index* is the page's place in the owner's memory. Whoever knows these few numbers can compute
/// it, for any owner, so there is no table.
///
/// # Invariants
/// - `HELD_BY_K`: every page has exactly `replicas` holders, all different, which follow from its number alone.
/// - Only the very last stripe may be shorter, so held indices have no gaps.
///
/// # Cost
/// The home is two divisions. The other holders take a hash for each owner (1 ns each), and are asked for only when the
/// home does not answer, or is not the nearest.
///
/// # Source
/// DeMarle, Gribble, Parker, "Memory-Savvy Distributed Interactive Ray Tracing", EGPGV 2004, sec. 3: "each node
/// assumes ownership of different stripes of the shared memory space". Thaler and Ravishankar, "Using Name-Based
/// Mappings to Increase Hit Rates", IEEE/ACM Transactions on Networking 6(1), 1998, for the highest random weight. We
/// differ: distances are weighed, not nodes, once a round and not once a stripe; nodes would be loaded unevenly, and an
/// owner's index of a replica would need a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stripes {
    page_count: u32,
    stripe_pages: u32,
    first_owner: u16,
    owner_count: u16,
    replicas: u8,
}

/// The nodes that hold a page, its home first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Holders {
    nodes: [NodeId; REPLICAS_MAX as usize],
    count: u8,
}

/// Copies of a page that there can be at most.
pub const REPLICAS_MAX: u8 = 4;

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
    /// More than `2^32 - 1` pages. That number itself names none: it stands for "none".
    TooManyPages,
    /// No copy at all, more than [`REPLICAS_MAX`], or more than there are owners to hold them.
    Replicas {
        /// Copies asked for.
        got: u8,
        /// Nodes that own pages.
        owners: u16,
    },
}

impl Stripes {
    /// Places `page_count` pages in stripes of `stripe_pages` on the nodes `first_owner ..` (`owner_count` of them).
    ///
    /// # Errors
    /// A count of zero, or more nodes than there are numbers for.
    pub fn new(
        page_count: u32,
        stripe_pages: u32,
        first_owner: NodeId,
        owner_count: u16,
    ) -> Result<Self, PlacementError> {
        let last = u32::from(first_owner.0) + u32::from(owner_count.max(1)) - 1;
        match (page_count, stripe_pages, owner_count) {
            (0, _, _) => Err(PlacementError::NoPages),
            (_, 0, _) => Err(PlacementError::EmptyStripe),
            (_, _, 0) => Err(PlacementError::NoOwners),
            _ if last >= u32::from(MAX_NODES) => Err(PlacementError::TooManyNodes { last }),
            _ => Ok(Self { page_count, stripe_pages, first_owner: first_owner.0, owner_count, replicas: 1 }),
        }
    }

    /// The same with `replicas` copies of each page in all.
    ///
    /// # Errors
    /// None at all, more than [`REPLICAS_MAX`], or more than there are owners.
    pub const fn with_replicas(self, replicas: u8) -> Result<Self, PlacementError> {
        if replicas == 0 || replicas > REPLICAS_MAX || replicas as u16 > self.owner_count {
            return Err(PlacementError::Replicas { got: replicas, owners: self.owner_count });
        }
        Ok(Self { replicas, ..self })
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

    /// The first node that owns pages.
    #[must_use]
    pub const fn first_owner(&self) -> NodeId {
        NodeId(self.first_owner)
    }

    /// Nodes that own pages.
    #[must_use]
    pub const fn owner_count(&self) -> u16 {
        self.owner_count
    }

    /// Copies of each page.
    #[must_use]
    pub const fn replicas(&self) -> u8 {
        self.replicas
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

    /// The nodes that hold `page`, its home first; none when there is no such page.
    #[must_use]
    pub fn holders(&self, page: PageId) -> Holders {
        let mut holders = Holders { nodes: [NodeId(0); REPLICAS_MAX as usize], count: 0 };
        let Some(home) = self.home(page) else { return holders };
        holders.push(home);
        let (round, home_rank) = self.round_and_rank(page.0 / self.stripe_pages);
        for distance in self.distances(round) {
            let rank = (u32::from(home_rank) + u32::from(distance)) % u32::from(self.owner_count);
            #[expect(clippy::cast_possible_truncation, reason = "a remainder of a u16")]
            holders.push(NodeId(self.first_owner + rank as u16));
        }
        holders
    }

    /// Whether `node` holds `page`.
    #[inline]
    #[must_use]
    pub fn holds(&self, node: NodeId, page: PageId) -> bool {
        self.home(page) == Some(node) || self.replicas > 1 && self.holders(page).contains(node)
    }

    /// The place of `page` among the pages that `node` holds, or `None` when it holds no such page.
    #[inline]
    #[must_use]
    pub fn held_index(&self, node: NodeId, page: PageId) -> Option<u32> {
        if self.home(page)? != node {
            return self.replica_index(node, page);
        }
        let round = page.0 / self.stripe_pages / u32::from(self.owner_count);
        Some(round * self.stripe_pages + page.0 % self.stripe_pages)
    }

    /// The place of `page` among the pages that `node` holds, when it holds it as a replica.
    fn replica_index(&self, node: NodeId, page: PageId) -> Option<u32> {
        let (round, home_rank) = self.round_and_rank(page.0 / self.stripe_pages);
        let mut position = None;
        let mut before = 0;
        // Of this round's stripes the node holds one a distance, where the round has them: count those before this one.
        for other_rank in self.replicated_ranks(self.owner_rank(node)?, round) {
            if other_rank == home_rank {
                position = Some(());
            } else if other_rank < home_rank {
                before += 1;
            }
        }
        position?;
        // All rounds before the last are full: so many stripes in each, none of them short.
        let stripes = round * u32::from(self.replicas - 1) + before;
        let missing = u32::from(crate::mutants::is_on(crate::mutants::Mutant::WrongReplicaIndex));
        Some((self.home_pages(node) - missing) + stripes * self.stripe_pages + page.0 % self.stripe_pages)
    }

    /// Everything that `node` holds as ranges of page numbers, in the order of their held index: its home stripes, then
    /// its replicas.
    pub fn held_stripes_of(&self, node: NodeId) -> impl Iterator<Item = Range<u32>> + use<> {
        self.stripes_of(node).chain(self.replica_stripes_of(node))
    }

    /// The stripes of which `node` holds a replica, as ranges of page numbers, in address order.
    pub fn replica_stripes_of(&self, node: NodeId) -> impl Iterator<Item = Range<u32>> + use<> {
        let this = *self;
        let owners = u32::from(this.owner_count);
        let rounds = if this.replicas > 1 { this.stripe_count().div_ceil(owners) } else { 0 };
        let rank = this.owner_rank(node);
        (0..rounds).filter_map(move |round| Some((round, rank?))).flat_map(move |(round, rank)| {
            let mut ranks = [u16::MAX; REPLICAS_MAX as usize];
            this.replicated_ranks(rank, round).zip(&mut ranks).for_each(|(rank, place)| *place = rank);
            ranks.sort_unstable();
            ranks.into_iter().take_while(|rank| *rank != u16::MAX).map(move |rank| {
                let start = (round * owners + u32::from(rank)) * this.stripe_pages;
                start..start.saturating_add(this.stripe_pages).min(this.page_count)
            })
        })
    }

    /// The home stripes of `node` as ranges of page numbers, in address order. Empty for a node that owns nothing.
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

    /// Pages that `node` holds: its home pages and its replicas.
    #[must_use]
    pub fn held_pages(&self, node: NodeId) -> u32 {
        let home_pages = self.home_pages(node);
        let Some(rank) = self.owner_rank(node).filter(|_| self.replicas > 1) else { return home_pages };
        let full_rounds = (self.stripe_count() - 1) / u32::from(self.owner_count);
        let in_full_rounds = full_rounds * u32::from(self.replicas - 1) * self.stripe_pages;
        let last = self.replicated_ranks(rank, full_rounds).map(|home_rank| {
            let start =
                (full_rounds * u32::from(self.owner_count) + u32::from(home_rank)) * self.stripe_pages;
            (self.page_count - start).min(self.stripe_pages)
        });
        home_pages + in_full_rounds + last.sum::<u32>()
    }

    /// Pages of the node that holds most.
    #[must_use]
    pub fn held_pages_max(&self) -> u32 {
        self.owner_ids().map(|owner| self.held_pages(owner)).max().unwrap_or(0)
    }

    /// All stripes, the last one short or not.
    const fn stripe_count(&self) -> u32 {
        self.page_count.div_ceil(self.stripe_pages)
    }

    /// The round of a stripe, and its home's place among the owners.
    #[expect(clippy::cast_possible_truncation, reason = "a remainder of a u16")]
    const fn round_and_rank(&self, stripe: u32) -> (u32, u16) {
        (stripe / self.owner_count as u32, (stripe % self.owner_count as u32) as u16)
    }

    /// The homes, by their place among the owners, of the stripes of `round` that owner `rank` holds replicas of.
    fn replicated_ranks(&self, rank: u16, round: u32) -> impl Iterator<Item = u16> + use<> {
        let owners = self.owner_count;
        let stripes_in_round = self.stripe_count() - round * u32::from(owners);
        self.distances(round)
            .map(move |distance| if rank >= distance { rank - distance } else { rank + (owners - distance) })
            .filter(move |home_rank| u32::from(*home_rank) < stripes_in_round)
    }

    /// How far behind their homes the replicas of a round lie: the distances with the highest random weight.
    fn distances(&self, round: u32) -> impl Iterator<Item = u16> + use<> {
        let wanted = usize::from(self.replicas - 1);
        let mut best = [(0, 0); REPLICAS_MAX as usize - 1];
        if wanted > 0 {
            for distance in 1..self.owner_count {
                let mut candidate = (weight(round, distance), distance);
                for place in &mut best[..wanted] {
                    if candidate > *place {
                        core::mem::swap(&mut candidate, place);
                    }
                }
            }
        }
        best.into_iter().take(wanted).map(|(_, distance)| distance)
    }

    fn owner_rank(&self, node: NodeId) -> Option<u16> {
        node.0.checked_sub(self.first_owner).filter(|rank| *rank < self.owner_count)
    }
}

impl Holders {
    /// The nodes, the home first.
    #[must_use]
    pub fn as_slice(&self) -> &[NodeId] {
        &self.nodes[..usize::from(self.count)]
    }

    /// Whether `node` is one of them.
    #[must_use]
    pub fn contains(&self, node: NodeId) -> bool {
        self.as_slice().contains(&node)
    }

    fn push(&mut self, node: NodeId) {
        self.nodes[usize::from(self.count)] = node;
        self.count += 1;
    }
}

/// The random weight of a distance in a round: a finaliser of SplitMix64, which mixes every bit into every other.
const fn weight(round: u32, distance: u16) -> u64 {
    let mut mixed = (((round as u64) << 16) | distance as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
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
            Self::TooManyPages => write!(f, "more than 2^32 - 1 pages; choose a larger page"),
            Self::Replicas { got: 0, .. } => write!(f, "no copy of a page is too few; 1 is the home's own"),
            Self::Replicas { got, owners } => write!(
                f,
                "{got} copies of each page are more than {owners} owners or a limit of {REPLICAS_MAX} allow"
            ),
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
        assert_eq!(stripes.held_index(NodeId(0), PageId(u32::MAX)), None);
    }

    #[test]
    fn the_largest_address_space_is_placed_without_overflow() {
        let stripes = Stripes::new(u32::MAX - 1, 1 << 31, NodeId(0), 4095).unwrap();
        assert_eq!(stripes.home(PageId(u32::MAX - 2)), Some(NodeId(1)));
        assert_eq!(stripes.stripes_of(NodeId(1)).next(), Some((1 << 31)..u32::MAX - 1));
        assert_eq!(stripes.stripes_of(NodeId(2)).next(), None);
    }

    #[test]
    fn replicas_of_the_largest_address_space_are_placed_without_overflow() {
        let stripes = Stripes::new(u32::MAX - 1, 1, NodeId(0), 4095).unwrap().with_replicas(4).unwrap();
        let last = PageId(u32::MAX - 2);
        for holder in stripes.holders(last).as_slice() {
            assert_eq!(
                stripes.held_index(*holder, last),
                Some(stripes.held_pages(*holder) - 1 - behind(&stripes, *holder))
            );
        }
        let wide = Stripes::new(u32::MAX - 1, 1 << 31, NodeId(0), 2).unwrap().with_replicas(2).unwrap();
        assert_eq!([NodeId(0), NodeId(1)].map(|node| wide.held_pages(node)), [u32::MAX - 1; 2]);
        assert_eq!(wide.held_index(NodeId(1), PageId(0)), Some((1 << 31) - 2));
    }

    /// Replicas of the last round that `node` numbers behind the very last page.
    fn behind(stripes: &Stripes, node: NodeId) -> u32 {
        let last = PageId(stripes.page_count() - 1);
        if stripes.home(last) == Some(node) { stripes.held_pages(node) - stripes.home_pages(node) } else { 0 }
    }

    #[test]
    fn too_few_and_too_many_copies_are_refused() {
        let stripes = Stripes::new(10, 2, NodeId(0), 3).unwrap();
        for (got, good) in [(0, false), (1, true), (3, true), (4, false), (5, false)] {
            let error = PlacementError::Replicas { got, owners: 3 };
            assert_eq!(stripes.with_replicas(got).map(|_| ()), if good { Ok(()) } else { Err(error) });
        }
    }

    #[test]
    fn what_a_lost_node_held_is_spread_over_all_others() {
        const OWNERS: usize = 16;
        let stripes = Stripes::new(16 * 3000, 1, NodeId(0), OWNERS as u16).unwrap().with_replicas(2).unwrap();
        let mut takes_over = [0u32; OWNERS];
        for page in stripes.stripes_of(NodeId(5)).flatten() {
            takes_over[stripes.holders(PageId(page)).as_slice()[1].index()] += 1;
        }
        assert_eq!(takes_over[5], 0);
        // 3000 pages over 15 others are 200 each; the standard deviation is below 14.
        let others = takes_over.iter().enumerate().filter(|(owner, _)| *owner != 5);
        assert!(others.clone().all(|(_, pages)| (140..260).contains(pages)), "{takes_over:?}");
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
                prop_assert_eq!(stripes.held_index(home, PageId(page)), Some(next[home.index()]));
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

        #[test]
        fn held_indices_have_no_gaps_and_every_page_has_its_copies(
            page_count in 1u32..300, stripe_pages in 1u32..20, first in 0u16..5, owners in 1u16..9, replicas in 1u8..5,
        ) {
            let stripes = Stripes::new(page_count, stripe_pages, NodeId(first), owners).unwrap();
            let Ok(stripes) = stripes.with_replicas(replicas) else { return Ok(()) };
            let mut copies = [0u8; 300];
            for owner in (0..16).map(NodeId) {
                let mut next = 0;
                for page in stripes.held_stripes_of(owner).flatten() {
                    prop_assert_eq!(stripes.held_index(owner, PageId(page)), Some(next));
                    prop_assert!(stripes.holds(owner, PageId(page)));
                    copies[page as usize] += 1;
                    next += 1;
                }
                prop_assert_eq!(stripes.held_pages(owner), next);
                prop_assert!(next <= stripes.held_pages_max());
                let held = (0..page_count).filter(|page| stripes.held_index(owner, PageId(*page)).is_some());
                prop_assert_eq!(held.count() as u32, next);
            }
            prop_assert!(copies[..page_count as usize].iter().all(|count| *count == replicas));
        }
    }
}
