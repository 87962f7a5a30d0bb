//! The shadow samples of a tile, each looking for any surface of a volume between itself and the light.

use super::cross::{Roots, Targets};
use super::packet::Limit;
use super::waiting::Names;
use crate::beam::samples::{GROUPS, Samples};
use crate::beam::triangles::Bounds;
use crate::simd::{Simd, each};

/// The samples that are still open: each group is a packet.
pub(super) struct Shadows<'a, 'b>(pub(super) &'a mut Samples<'b>);

impl<S: Simd> Targets<S> for Shadows<'_, '_> {
    #[inline(always)]
    fn least(&mut self, s: S) -> f32 {
        self.0.least(s)
    }

    #[inline(always)]
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64 {
        self.0.interest(s, bounds)
    }

    #[inline(always)]
    fn rays(&self, s: S, number: usize) -> [[S::F; 3]; 2] {
        let points = self.0.points_of_group(s, number % GROUPS);
        let light = s.splat3(self.0.light);
        [points, each!(3: [0, 1, 2], axis => s.sub(light[axis], points[axis]))]
    }

    #[inline(always)]
    fn limit(&self, s: S, number: usize) -> Limit<S::D> {
        Limit { end: s.splat_f64(1.0), open: self.0.open[number % GROUPS] }
    }

    #[inline(always)]
    fn take(&mut self, s: S, names: &Names, roots: &Roots<'_, S>) {
        let mut lanes = roots.lanes;
        while lanes != 0 {
            let (group, own) = names.take_packet(&mut lanes);
            self.0.close_all(s, group % GROUPS, own);
        }
    }
}
