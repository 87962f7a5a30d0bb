//! A render thread's side: measuring a tile, finding the page behind each pixel.

use core::cell::Cell;
use std::time::Instant;

use anyhow::{Context, Result};
use dsm_core::id::PageId;
use dsm_core::placement::Stripes;
use rt_core::image::Segment;
use rt_core::{Frame, Hit, Primitive, Ray, SceneMemory, SceneView, Tile, TileId};
use serde::{Deserialize, Serialize};

use super::bricks::Bricks;
use super::facts::{FactBatch, TileFacts};

/// What is to be found out of each tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Wants {
    /// Anything at all: then time and misses, which cost next to nothing.
    pub(crate) facts: bool,
    /// The owner of the page behind each pixel, which takes a ray more for each.
    pub(crate) owners: bool,
}

/// Finds out what is wanted of the tiles that one thread draws.
pub(crate) struct Probe<M> {
    wants: Wants,
    owners: Option<Owners<M>>,
    batch: FactBatch,
    start: Option<(Instant, u64)>,
    pixels: Vec<u8>,
}

/// The scene once more, its memory telling which record was read last.
struct Owners<M> {
    scene: SceneView<LastRead<M>>,
    placement: Stripes,
    page_bytes: usize,
}

/// A scene's memory that tells where the last record of a segment was read.
#[derive(Debug)]
pub(super) struct LastRead<M> {
    memory: M,
    segment: Cell<Segment>,
    last: Cell<u64>,
}

impl<M: SceneMemory> Probe<M> {
    /// Finds out what is `wanted` of a scene that lies in `memory`.
    pub(crate) fn new(wants: Wants, memory: M, placement: Stripes, page_bytes: usize) -> Result<Self> {
        let owners = if wants.owners { Some(Owners::new(memory, placement, page_bytes)?) } else { None };
        Ok(Self { wants, owners, batch: FactBatch::default(), start: None, pixels: Vec::new() })
    }

    /// A tile begins; so many misses there were before.
    pub(crate) fn begin_tile(&mut self, misses: impl FnOnce() -> u64) {
        self.start = self.wants.facts.then(|| (Instant::now(), misses()));
    }

    /// The tile is drawn. Gives back a batch that is full.
    pub(crate) fn end_tile(
        &mut self,
        frame: &Frame,
        (id, tile): (TileId, Tile),
        misses: impl FnOnce() -> u64,
    ) -> Option<FactBatch> {
        let (start, misses_before) = self.start.take()?;
        let measured = TileFacts {
            cost_ns: u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX),
            misses: u32::try_from(misses().saturating_sub(misses_before)).unwrap_or(u32::MAX),
        };
        self.pixels.clear();
        if let Some(owners) = &self.owners {
            owners.of_tile(frame, tile, &mut self.pixels);
        }
        if self.batch.is_empty() {
            self.batch = FactBatch::new(frame.number);
        }
        if self.batch.push(id, measured, &self.pixels) {
            return None;
        }
        let full = core::mem::replace(&mut self.batch, FactBatch::new(frame.number));
        self.batch.push(id, measured, &self.pixels);
        Some(full)
    }

    /// What is left, if anything.
    pub(crate) fn rest(&mut self) -> Option<FactBatch> {
        let rest = core::mem::take(&mut self.batch);
        (!rest.is_empty()).then_some(rest)
    }
}

impl<M: SceneMemory> Owners<M> {
    fn new(memory: M, placement: Stripes, page_bytes: usize) -> Result<Self> {
        let last = LastRead { memory, segment: Cell::default(), last: Cell::new(0) };
        let scene = SceneView::new(last).context("the scene image")?;
        Ok(Self { scene, placement, page_bytes })
    }

    /// Adds for each pixel of a tile the owner of the page behind it plus one, 0 where nothing is hit.
    fn of_tile(&self, frame: &Frame, tile: Tile, owners: &mut Vec<u8>) {
        let bricks = Bricks::new(&self.scene, frame);
        for y in tile.y..tile.y + tile.height {
            let row = frame.camera.row(y);
            for x in tile.x..tile.x + tile.width {
                let direction = frame.camera.direction(row, x);
                let ray = Ray { origin: frame.camera.eye, direction, t_max: f32::INFINITY };
                owners.push(self.behind(&ray, &bricks).map_or(0, |offset| self.owner(offset)));
            }
        }
    }

    /// Where in the image that lies which a ray sees.
    fn behind(&self, ray: &Ray, bricks: &Bricks<'_, M>) -> Option<u64> {
        let surface = self.surface_behind(ray);
        let t_max = surface.map_or(ray.t_max, |(t, _)| t);
        bricks.behind(&Ray { t_max, ..*ray }).or(surface.map(|(_, offset)| offset))
    }

    /// The nearest triangle or sphere, and where the cluster lies that it was found in.
    fn surface_behind(&self, ray: &Ray) -> Option<(f32, u64)> {
        let read = self.scene.memory().of(self.scene.header().segments.clusters);
        // Whoever is offered has just been read. The nearest may be offered before others at the same distance.
        let mut offered: Vec<(Primitive, u64)> = Vec::new();
        let note = |hit: &Hit| {
            offered.push((hit.primitive, read.last()));
            true
        };
        let hit = self.scene.nearest_filtered(ray, note, &mut ()).ok()??;
        let found = offered.iter().rev().find(|(primitive, _)| *primitive == hit.primitive)?;
        Some((hit.t, found.1))
    }

    fn owner(&self, offset: u64) -> u8 {
        let page = u32::try_from(offset / self.page_bytes as u64).ok().map(PageId);
        let home = page.and_then(|page| self.placement.home(page));
        home.and_then(|home| u8::try_from(home.0 + 1).ok()).unwrap_or(0)
    }
}

impl<M> LastRead<M> {
    /// From now on looks at records of that segment.
    pub(super) fn of(&self, segment: Segment) -> &Self {
        self.segment.set(segment);
        self
    }

    /// Where in the image the last record of the segment begins.
    pub(super) const fn last(&self) -> u64 {
        self.last.get()
    }
}

impl<M: SceneMemory> SceneMemory for LastRead<M> {
    type Record<'b>
        = M::Record<'b>
    where
        Self: 'b;

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<Self::Record<'_>> {
        let Segment { offset: start, bytes, .. } = self.segment.get();
        if offset.wrapping_sub(start) < bytes {
            self.last.set(offset);
        }
        self.memory.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.memory.length()
    }
}
