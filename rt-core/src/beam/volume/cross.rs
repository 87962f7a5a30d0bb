//! Rays in a brick: which of them meet a surface in it.

use super::brick_cells::BrickCells;
use super::cells::{Cells, InCells};
use super::cubics::Cubics;
use super::packet::{Limit, Packets};
use super::waiting::{Names, Rays, Waiting};
use crate::beam::triangles::Bounds;
use crate::brick::SAMPLES;
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

    /// Origins and directions of the rays of a packet.
    fn rays(&self, s: S, number: usize) -> [[S::F; 3]; 2];

    /// How far they look.
    fn limit(&self, s: S, number: usize) -> Limit<S::D>;

    /// Takes roots of some rays.
    fn take(&mut self, s: S, names: &Names, roots: &Roots<'_, S>);
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

/// The way of rays of some packets through a brick, kept apart: it needs all registers.
pub(super) struct Cross<'a, 'p, S: Simd, M, C, T> {
    pub(super) packets: &'a mut Packets<'p, S>,
    /// The packets that go through it.
    pub(super) wanted: u64,
    pub(super) look: Look<'a, M, C, T>,
}

/// What is looked for, and in what.
pub(super) struct Look<'a, M, C, T> {
    pub(super) surfaces: &'a Isosurfaces<'a, M>,
    pub(super) targets: &'a mut T,
    pub(super) count: &'a mut C,
    pub(super) brick: &'a BrickCells,
}

impl<S: Simd, M: SceneMemory, C: Count, T: Targets<S>> Part<S> for Cross<'_, '_, S, M, C, T> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(mut self, s: S) -> Option<()> {
        let (mut waiting, mut rays, mut cells) = (Waiting::new(), Rays::none(s), Cells::none(s));
        loop {
            let live = cells.live(s);
            if live.count_ones() <= FEW && (self.wanted != 0 || waiting.count != 0) {
                let free = self.have_waiting(s, &mut waiting, !live)?;
                let stretch = waiting.put(s, free, &mut rays);
                let brick = self.look.brick;
                cells.put(s, &Cells::new(s, &rays.packet, &stretch, &brick.around, brick.corner));
                continue;
            }
            let there = s.bits_of(&self.look.brick.active, cells.index) & live;
            let moving = live & !there;
            if moving != 0 && there.count_ones() < MANY {
                cells.step(s, &rays.packet, moving);
            } else if there != 0 {
                let places = cells.places(s, &rays.packet, there);
                let found = self.look.look(s, (&rays, &cells), &places);
                cells.end(s, found);
                cells.step(s, &rays.packet, there & !found);
            } else {
                return Some(());
            }
        }
    }
}

impl<S: Simd, M: SceneMemory, C: Count, T: Targets<S>> Cross<'_, '_, S, M, C, T> {
    /// Has rays wait for these lanes, as long as any enter the brick; gives the lanes for which there are.
    #[inline(always)]
    fn have_waiting(&mut self, s: S, waiting: &mut Waiting, free: Mask) -> Option<Mask> {
        let brick = self.look.brick;
        while self.wanted != 0 && waiting.count < free.count_ones() as usize {
            let number = self.wanted.trailing_zeros() as usize;
            self.wanted &= self.wanted - 1;
            let packet = self.packets.get(s, self.look.targets, number)?;
            let limit = self.look.targets.limit(s, number);
            let stretch = packet.stretch(s, &packet.ends(s, &brick.around), &limit);
            if stretch.lanes != 0 {
                waiting.add(s, number, packet, &stretch);
            }
        }
        let mut lanes = free;
        while lanes.count_ones() as usize > waiting.count {
            lanes &= lanes - 1;
        }
        Some(lanes)
    }
}

impl<M: SceneMemory, C: Count, T> Look<'_, M, C, T> {
    /// Looks for roots in cells, and gives the rays that have one.
    #[inline(always)]
    fn look<S: Simd>(
        &mut self,
        s: S,
        (rays, cells): (&Rays<S>, &Cells<S>),
        places: &InCells<S::D, S::F>,
    ) -> Mask
    where
        T: Targets<S>,
    {
        self.count.voxel_cells(places.lanes.count_ones());
        let index = cells.index;
        let samples = self.samples(s, index);
        let (mut once, mut open, mut which) = (0, 0, s.splat(0.0));
        let all = self.surfaces.sought();
        for (which_one, (sought, crossed)) in (0_u8..).zip(all.iter().zip(&self.brick.crossed)) {
            let lanes = if all.len() == 1 { places.lanes } else { places.lanes & s.bits_of(crossed, index) };
            self.count.cubics(lanes.count_ones());
            let values = self.values(s, &samples, sought.stored);
            let changes = Cubics::new(s, &values, &places.from, &places.to).changes(s);
            // Of roots of several isosurfaces in a cell, the order has to be found out.
            open |= (changes.more | once) & changes.any() & lanes;
            once |= changes.once & lanes;
            which = s.select(changes.once & lanes, s.splat(f32::from(which_one)), which);
        }
        let mut found = once & !open;
        if found != 0 {
            let roots = Roots { places, samples: &samples, sought: which, at: None, lanes: found };
            self.targets.take(s, &rays.names(s), &roots);
        }
        while open != 0 {
            let lane = open.trailing_zeros() as usize;
            open &= open - 1;
            if let Some(root) = self.by_ray(s, lane, (rays, cells), places, &samples) {
                let (sought, at) = (s.splat(root.index as f32), Some(s.splat(root.s)));
                let roots = Roots { places, samples: &samples, sought, at, lanes: 1 << lane };
                self.targets.take(s, &rays.names(s), &roots);
                found |= 1 << lane;
            }
        }
        found
    }

    /// The samples at the corners of cells.
    #[inline(always)]
    fn samples<S: Simd>(&self, s: S, index: S::I) -> [S::F; 8] {
        let mut samples = [s.splat(0.0); 8];
        for (pair, corner) in samples.as_chunks_mut().0.iter_mut().zip(ROWS) {
            let index = s.add_where_int(Mask::MAX, index, s.splat_int(corner));
            *pair = s.gather_pairs::<SAMPLES>(&self.brick.samples, index);
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
        (rays, cells): (&Rays<S>, &Cells<S>),
        places: &InCells<S::D, S::F>,
        samples: &[S::F; 8],
    ) -> Option<Root> {
        let cell = cells.cell(s, lane, self.brick.corner);
        let samples = samples.map(|sample| s.array(sample)[lane % LANES]);
        let stretch = (s.array_f64(places.enter)[lane % LANES], s.array_f64(places.exit)[lane % LANES]);
        self.surfaces.root_in_cell(&rays.packet.ray(s, lane), cell, stretch, &samples, &mut ())
    }
}

/// From the lowest sample of a cell to the first of each two in a row.
const ROWS: [i32; 4] = [0, 8, 64, 72];

/// So few rays in a brick are joined by others.
const FEW: u32 = 8;

/// So many rays in cells that may hold a surface wait for no more.
const MANY: u32 = 12;
