//! The shadow samples of a tile, each looking for any surface of a volume between itself and the light.

use super::cross::{Roots, Targets};
use super::packet::Packet;
use crate::beam::samples::{GROUPS, Samples};
use crate::beam::triangles::Bounds;
use crate::simd::{Simd, each};
use crate::volume_ray::VolumePlace;

/// The samples that are still open: each group is a packet.
pub(super) struct Shadows<'a, 'b, S: Simd> {
    samples: &'a mut Samples<'b>,
    place: VolumePlace,
    packets: [Packet<S::D>; GROUPS],
    /// Groups whose packet is made.
    made: u64,
}

impl<'a, 'b, S: Simd> Shadows<'a, 'b, S> {
    #[inline(always)]
    pub(super) fn new(s: S, samples: &'a mut Samples<'b>, place: &VolumePlace) -> Self {
        Self { samples, place: *place, packets: [Packet::none(s); GROUPS], made: 0 }
    }
}

impl<S: Simd> Targets<S> for Shadows<'_, '_, S> {
    #[inline(always)]
    fn least(&mut self, s: S) -> f32 {
        self.samples.least(s)
    }

    #[inline(always)]
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64 {
        self.samples.interest(s, bounds)
    }

    #[inline(always)]
    fn packet(&mut self, s: S, number: usize) -> Option<&Packet<S::D>> {
        let group = number % GROUPS;
        if self.made >> group & 1 == 0 {
            let points = self.samples.points_of_group(s, group);
            let light = s.splat3(self.samples.light);
            let to_light = each!(3: [0, 1, 2], axis => s.sub(light[axis], points[axis]));
            let rays = (points, to_light);
            let ends = (s.splat_f64(1.0), self.samples.open[group]);
            self.packets[group] = Packet::new(s, &self.place, rays, ends)?;
            self.made |= 1 << group;
        }
        Some(&self.packets[group])
    }

    #[inline(always)]
    fn take(&mut self, s: S, number: usize, roots: &Roots<'_, S>) {
        let group = number % GROUPS;
        self.packets[group].open &= !roots.lanes;
        self.samples.close_all(s, group, roots.lanes);
    }
}
