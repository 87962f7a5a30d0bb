//! Clusters that wait to be tested, that of the greatest rank first: mostly the nearest.

use super::boxes::SeenBox;
use super::triangles::Bounds;
use crate::grid::ClusterRef;
use crate::simd::{LANES, Simd};

/// Up to sixteen clusters. While they wait, their bytes come nearer, and what is tested before may hide them.
pub(super) struct Queue<F> {
    waiting: [Waiting; LANES],
    /// Their ranks; below 0 where nobody waits.
    ranks: F,
    count: usize,
}

/// A cluster, and how its box shows.
#[derive(Clone, Copy)]
pub(super) struct Waiting {
    pub(super) place: ClusterRef,
    pub(super) bounds: Bounds,
    pub(super) seen: SeenBox,
    /// As the walk has it; 0 or more.
    pub(super) rank: f32,
}

impl<F: Copy> Queue<F> {
    pub(super) fn new<S: Simd<F = F>>(s: S) -> Self {
        let place = ClusterRef::NONE;
        let bounds = Bounds { left: 0.0, right: 0.0, top: 0.0, bottom: 0.0, near: 0.0 };
        let seen = SeenBox { centre: [0.0; 3], half: [0.0; 3] };
        Self { waiting: [Waiting { place, bounds, seen, rank: 0.0 }; LANES], ranks: s.splat(-1.0), count: 0 }
    }

    pub(super) const fn is_full(&self) -> bool {
        self.count == LANES
    }

    /// Adds a cluster to a queue that is not full.
    #[inline(always)]
    pub(super) fn push<S: Simd<F = F>>(&mut self, s: S, next: Waiting) {
        // The places in use are the first ones.
        let place = self.count % LANES;
        self.waiting[place] = next;
        self.ranks = s.select(1 << place, s.splat(next.rank), self.ranks);
        self.count += 1;
    }

    /// Takes the first away if its rank is greater than `rank`.
    #[inline(always)]
    pub(super) fn take_before<S: Simd<F = F>>(&mut self, s: S, rank: f32) -> Option<Waiting> {
        if s.lt(s.splat(rank), self.ranks) == 0 { None } else { self.take_first(s) }
    }

    /// Takes the first away.
    #[inline(always)]
    pub(super) fn take_first<S: Simd<F = F>>(&mut self, s: S) -> Option<Waiting> {
        let last = self.count.checked_sub(1)?;
        let greatest = s.least(s.sub(s.splat(0.0), self.ranks));
        let place = s.le(s.splat(-greatest), self.ranks).trailing_zeros() as usize % LANES;
        let taken = self.waiting[place];
        // The last one moves up.
        let last = last % LANES;
        self.waiting[place] = self.waiting[last];
        let moved = s.splat(self.waiting[last].rank);
        self.ranks = s.select(1 << last, s.splat(-1.0), s.select(1 << place, moved, self.ranks));
        self.count = last;
        Some(taken)
    }
}
