//! Packets in a brick: which of their rays meet a surface in it.

use super::brick_cells::BrickCells;
use super::cells::{Cells, InCells};
use super::cubics::Cubics;
use super::packet::Packet;
use crate::beam::triangles::Bounds;
use crate::brick::{CORNERS, SAMPLES};
use crate::count::Count;
use crate::isosurface::{Isosurfaces, Root};
use crate::memory::SceneMemory;
use crate::simd::{LANES, Mask, Part, Simd};

/// What a beam leads through a volume: the pixels of a tile, or its shadow samples; in up to 64 packets.
pub(super) trait Targets<S: Simd> {
    /// What has a smaller inverse depth than this does not matter; infinite when nothing matters any more.
    fn least(&mut self, s: S) -> f32;

    /// The packets that something within these bounds may matter to, a bit each.
    fn interest(&mut self, s: S, bounds: &Bounds) -> u64;

    /// A packet; `None` when it is not for beams.
    fn packet(&mut self, s: S, number: usize) -> Option<&Packet<S::D>>;

    /// Takes roots of rays of a packet.
    fn take(&mut self, s: S, number: usize, roots: &Roots<'_, S>);
}

/// That rays meet surfaces in voxel cells, and where.
pub(super) struct Roots<'a, S: Simd> {
    pub(super) places: &'a InCells<S::D, S::F>,
    /// Samples of the cells.
    pub(super) samples: &'a [S::F; 8],
    /// Which of the isosurfaces sought.
    pub(super) sought: S::F,
    /// The root in the stretch of each ray, if it is known.
    pub(super) at: Option<S::F>,
    pub(super) lanes: Mask,
}

/// The way of some packets through a brick, kept apart: it needs all registers.
pub(super) struct Cross<'a, M, C, T> {
    pub(super) surfaces: &'a Isosurfaces<'a, M>,
    pub(super) targets: &'a mut T,
    pub(super) count: &'a mut C,
    pub(super) brick: &'a BrickCells,
    /// The packets.
    pub(super) wanted: u64,
}

impl<S: Simd, M: SceneMemory, C: Count, T: Targets<S>> Part<S> for Cross<'_, M, C, T> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(mut self, s: S) -> Option<()> {
        while self.wanted != 0 {
            let number = self.wanted.trailing_zeros() as usize;
            self.wanted &= self.wanted - 1;
            self.cross(s, number)?;
        }
        Some(())
    }
}

impl<M: SceneMemory, C: Count, T> Cross<'_, M, C, T> {
    /// Leads one packet through the brick.
    #[inline(always)]
    fn cross<S: Simd>(&mut self, s: S, number: usize) -> Option<()>
    where
        T: Targets<S>,
    {
        let packet = *self.targets.packet(s, number)?;
        let Some(mut cells) = Cells::new(s, &packet, &self.brick.around, self.brick.corner) else {
            return Some(());
        };
        let mut moving = cells.live & !s.bits_of(&self.brick.active, cells.index);
        loop {
            let lanes = cells.advance(s, &packet, &self.brick.active, moving);
            if lanes == 0 {
                return Some(());
            }
            let places = cells.places(s, &packet, lanes);
            let found = self.look(s, number, (&packet, &cells), &places);
            cells.stop(found);
            moving = cells.live;
        }
    }

    /// Looks for roots in cells, and gives the rays that have one.
    #[inline(always)]
    fn look<S: Simd>(
        &mut self,
        s: S,
        number: usize,
        (packet, cells): (&Packet<S::D>, &Cells<S>),
        places: &InCells<S::D, S::F>,
    ) -> Mask
    where
        T: Targets<S>,
    {
        self.count.voxel_cells(places.lanes.count_ones());
        let samples = self.samples(s, cells.index);
        let sought = self.surfaces.sought();
        let (mut once, mut open, mut which) = (0, 0, s.splat(0.0));
        for (index, sought) in sought.iter().enumerate() {
            let lanes = places.lanes & s.bits_of(&self.brick.crossed[index], cells.index);
            self.count.cubics(lanes.count_ones());
            let values = self.values(s, &samples, sought.stored);
            let changes = Cubics::new(s, &values, &places.from, &places.to).changes(s);
            // Of roots of several isosurfaces in a cell, the order has to be found out.
            open |= (changes.more | once) & changes.any() & lanes;
            once |= changes.once & lanes;
            which = s.select(changes.once & lanes, s.splat(index as f32), which);
        }
        let mut found = once & !open;
        if found != 0 {
            let roots = Roots { places, samples: &samples, sought: which, at: None, lanes: found };
            self.targets.take(s, number, &roots);
        }
        while open != 0 {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            if let Some(root) = self.by_ray(s, lane, (packet, cells), places, &samples) {
                let (sought, at) = (s.splat(root.index as f32), Some(s.splat(root.s)));
                let roots = Roots { places, samples: &samples, sought, at, lanes: 1 << lane };
                self.targets.take(s, number, &roots);
                found |= 1 << lane;
            }
        }
        found
    }

    /// The samples at the corners of cells.
    #[inline(always)]
    fn samples<S: Simd>(&self, s: S, index: S::I) -> [S::F; 8] {
        let mut samples = [s.splat(0.0); 8];
        for (to, corner) in samples.iter_mut().zip(CORNERS) {
            *to = s.gather::<SAMPLES>(&self.brick.samples, s.add_where_int(Mask::MAX, index, s.splat_int(corner as i32)));
        }
        samples
    }

    #[inline(always)]
    fn values<S: Simd>(&self, s: S, samples: &[S::F; 8], stored: f32) -> [S::F; 8] {
        let mut values = *samples;
        for value in &mut values {
            *value = s.sub(*value, s.splat(stored));
        }
        values
    }

    /// The root that the ray kernel finds.
    #[inline(always)]
    fn by_ray<S: Simd>(
        &mut self,
        s: S,
        lane: usize,
        (packet, cells): (&Packet<S::D>, &Cells<S>),
        places: &InCells<S::D, S::F>,
        samples: &[S::F; 8],
    ) -> Option<Root> {
        let cell = cells.cell(s, lane, self.brick.corner);
        let samples = samples.map(|sample| s.array(sample)[lane % LANES]);
        let stretch = (s.array_f64(places.enter)[lane % LANES], s.array_f64(places.exit)[lane % LANES]);
        self.surfaces.root_in_cell(&packet.ray(s, lane), cell, stretch, &samples, &mut ())
    }
}
