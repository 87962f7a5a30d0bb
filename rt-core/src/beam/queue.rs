//! Clusters that wait to be tested, the nearest first.

use super::boxes::SeenBox;
use super::triangles::Bounds;
use crate::grid::ClusterRef;
use crate::simd::{LANES, Simd};

/// Up to sixteen clusters. While they wait, their bytes come nearer, and what is tested before may hide them.
pub(super) struct Queue<F> {
    waiting: [Waiting; LANES],
    /// Greatest inverse depths; below 0 where nobody waits.
    near: F,
    count: usize,
}

/// A cluster, and how its box shows.
#[derive(Clone, Copy)]
pub(super) struct Waiting {
    pub(super) place: ClusterRef,
    pub(super) bounds: Bounds,
    pub(super) seen: SeenBox,
}

impl<F: Copy> Queue<F> {
    pub(super) fn new<S: Simd<F = F>>(s: S) -> Self {
        let place = ClusterRef::NONE;
        let bounds = Bounds { left: 0.0, right: 0.0, top: 0.0, bottom: 0.0, near: 0.0 };
        let seen = SeenBox { centre: [0.0; 3], half: [0.0; 3] };
        Self { waiting: [Waiting { place, bounds, seen }; LANES], near: s.splat(-1.0), count: 0 }
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
        self.near = s.select(1 << place, s.splat(next.bounds.near), self.near);
        self.count += 1;
    }

    /// Takes the nearest away if it is nearer than an inverse depth of `near`.
    #[inline(always)]
    pub(super) fn take_nearer<S: Simd<F = F>>(&mut self, s: S, near: f32) -> Option<Waiting> {
        if s.lt(s.splat(near), self.near) == 0 { None } else { self.take_nearest(s) }
    }

    /// Takes the nearest away.
    #[inline(always)]
    pub(super) fn take_nearest<S: Simd<F = F>>(&mut self, s: S) -> Option<Waiting> {
        let last = self.count.checked_sub(1)?;
        let nearest = s.least(s.sub(s.splat(0.0), self.near));
        let place = s.le(s.splat(-nearest), self.near).trailing_zeros() as usize % LANES;
        let taken = self.waiting[place];
        // The last one moves up.
        let last = last % LANES;
        self.waiting[place] = self.waiting[last];
        let moved = s.splat(self.waiting[last].bounds.near);
        self.near = s.select(1 << last, s.splat(-1.0), s.select(1 << place, moved, self.near));
        self.count = last;
        Some(taken)
    }
}
