//! What a walk does about pages that may be far away. All of it is apart: it is done seldom, and there is much of it.

use glam::Vec3;

use super::{Targets, Waiting, Walk};
use crate::count::Count;
use crate::grid::cell_coordinates;
use crate::kinds::Kinds;
use crate::memory::SceneMemory;
use crate::simd::{Part, Simd};
use crate::view::Damaged;

impl<S: Simd, M: SceneMemory, C: Count, K: Kinds, T: Targets<S>> Walk<'_, S, M, C, K, T> {
    /// Tests the clusters that wait and have a greater rank than this.
    #[inline(always)]
    pub(super) fn visit_before(&mut self, rank: f32) -> Result<(), Damaged> {
        self.s.apart(VisitBefore { walk: self, rank })
    }

    /// Has a cluster wait whose page may be far away. If there is no room, what has no smaller rank than the first of those is
    /// visited.
    #[inline(always)]
    pub(super) fn enqueue_far(&mut self, next: Waiting) -> Result<(), Damaged> {
        if self.far_queue.is_full()
            && let Some(rank) = self.far_queue.first()
        {
            // So that it is one of these itself.
            self.visit_before(rank.next_down())?;
        }
        self.far_queue.push(next);
        Ok(())
    }

    /// Whether anything in these cells of the branch at `corner` may matter; what they lead to may be far away.
    #[inline(always)]
    pub(super) fn may_enter_any(&mut self, corner: Vec3, cell: f32, cells: u64) -> Result<bool, Damaged> {
        self.s.apart(MayEnterAny { walk: self, corner, cell, cells })
    }
}

struct VisitBefore<'a, W> {
    walk: &'a mut W,
    rank: f32,
}

impl<S, M, C, K, T> Part<S> for VisitBefore<'_, Walk<'_, S, M, C, K, T>>
where
    S: Simd,
    M: SceneMemory,
    C: Count,
    K: Kinds,
    T: Targets<S>,
{
    type Output = Result<(), Damaged>;

    #[inline(always)]
    fn run(self, s: S) -> Result<(), Damaged> {
        let Self { walk, rank } = self;
        loop {
            let far = walk.far_queue.first().filter(|far| *far > rank);
            let next = match walk.queue.take_before(s, far.unwrap_or(rank)) {
                None if far.is_some() => walk.far_queue.take_first(),
                next => next,
            };
            match next {
                Some(next) => walk.visit(&next)?,
                None => return Ok(()),
            }
        }
    }
}

struct MayEnterAny<'a, W> {
    walk: &'a mut W,
    corner: Vec3,
    cell: f32,
    cells: u64,
}

impl<S, M, C, K, T> Part<S> for MayEnterAny<'_, Walk<'_, S, M, C, K, T>>
where
    S: Simd,
    M: SceneMemory,
    C: Count,
    K: Kinds,
    T: Targets<S>,
{
    type Output = Result<bool, Damaged>;

    #[inline(always)]
    fn run(self, _: S) -> Result<bool, Damaged> {
        let Self { walk, corner, cell, mut cells } = self;
        while cells != 0 {
            let at = cell_coordinates(cells.trailing_zeros()).map(|i| i as f32);
            cells &= cells - 1;
            if walk.may_enter(corner + Vec3::from(at) * cell, cell, false)? {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
