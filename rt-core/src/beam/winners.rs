//! The triangles that pixels of a tile have found nearest so far.

use heapless::Vec;

use super::triangles::Corners;
use crate::grid::ClusterRef;

/// The clusters that pixels show, or showed. A pixel holds the *place* of a triangle: a cluster here, and a triangle in
/// it.
///
/// # Invariants
/// The cluster under test is the last; it stays when one of its triangles wins, and gives way to the next otherwise.
pub(super) struct Winners {
    clusters: Vec<ClusterRef, CAPACITY>,
    current: usize,
    /// Whether a triangle of the last cluster has won.
    pub(super) has_won: bool,
}

/// At most 1024 are in use at once, so a quarter of the table is free after each clearing out.
const CAPACITY: usize = 1280;

impl Winners {
    pub(super) const fn new() -> Self {
        Self { clusters: Vec::new(), current: 0, has_won: false }
    }

    /// Takes up the next cluster. `used` goes through the places that pixels hold, and is called when the table is full.
    #[inline(always)]
    pub(super) fn begin<'a, P: Iterator<Item = &'a mut u32>>(
        &mut self,
        cluster: &ClusterRef,
        used: impl FnOnce() -> P,
    ) {
        self.current += usize::from(self.has_won);
        self.has_won = false;
        if self.current == CAPACITY {
            self.clear_out(used());
        }
        match self.clusters.get_mut(self.current) {
            Some(current) => *current = *cluster,
            None => _ = self.clusters.push(*cluster),
        }
    }

    /// The place of a triangle of the last cluster.
    #[inline(always)]
    pub(super) const fn place(&self, triangle: Corners) -> u32 {
        self.current as u32 * Corners::COUNT + triangle.name()
    }

    /// The cluster and the triangle at a place; of a place that nobody holds, no cluster.
    #[inline(always)]
    pub(super) fn get(&self, place: u32) -> (&ClusterRef, Corners) {
        (self.clusters.get(cluster_of(place)).unwrap_or(&ClusterRef::NONE), Corners::of(place))
    }

    /// Keeps only the clusters in use, and corrects the places.
    #[inline(never)]
    fn clear_out<'a>(&mut self, places: impl Iterator<Item = &'a mut u32>) {
        const UNUSED: u16 = u16::MAX;
        let kept = core::mem::take(&mut self.clusters);
        let mut moved = [UNUSED; CAPACITY];
        for place in places {
            let (old, triangle) = (cluster_of(*place), Corners::of(*place));
            if moved[old] == UNUSED {
                moved[old] = self.clusters.len() as u16;
                self.clusters.extend(kept.get(old).copied());
            }
            *place = u32::from(moved[old]) * Corners::COUNT + triangle.name();
        }
        self.current = self.clusters.len();
    }
}

const fn cluster_of(place: u32) -> usize {
    (place / Corners::COUNT) as usize % CAPACITY
}
