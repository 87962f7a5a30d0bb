//! A render thread: draws its share of a frame's tiles and sends them off.

use core::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use anyhow::{Context, Result};
use dsm_core::placement::Stripes;
use fault_linux::{Attached, BackendKind, Record, Region, ThreadStats};
use rt_core::{Flat, Frame, Kernel, SceneMemory, SceneView, TILE_SIZE, TileId, Tiles, render_tile};

use crate::control::News;
use crate::diagnostic::{FactBatch, Probe, Wants};
use crate::gather::{Outlets, Sender};
use crate::link::Link;
use crate::noted::{Noted, Notes};
use crate::ports::Port;

/// A frame to draw, shared by the threads of a node: each takes the next tile that nobody has.
#[derive(Debug)]
pub(crate) struct Job {
    frame: Frame,
    tiles: Tiles,
    own: Vec<TileId>,
    next: AtomicUsize,
}

/// What a render thread needs.
#[derive(Debug)]
pub(crate) struct Painter {
    pub(crate) region: Arc<Region>,
    pub(crate) port: Port,
    pub(crate) link: Arc<Link>,
    pub(crate) outlets: Arc<Outlets>,
    pub(crate) jobs: Receiver<Arc<Job>>,
    pub(crate) image_bytes: u64,
    pub(crate) kernel: Kernel,
    /// Tiles sent at a time at most.
    pub(crate) batch_tiles: u16,
    /// What is to be found out of each tile, and whose pages are whose.
    pub(crate) wants: Wants,
    pub(crate) placement: Stripes,
}

/// A scene of which every access goes through a table: the `soft` backend.
#[derive(Clone, Copy, Debug)]
struct Slotted<'a> {
    attached: &'a Attached<Port>,
    length: u64,
}

impl Job {
    pub(crate) fn new(frame: Frame, tiles: Tiles, own: Vec<TileId>) -> Self {
        Self { frame, tiles, own, next: AtomicUsize::new(0) }
    }

    /// The numbers of the tiles, in the order in which they are drawn.
    pub(crate) fn order(&self) -> Vec<u32> {
        self.own.iter().map(|tile| tile.0).collect()
    }

    fn take(&self) -> Option<TileId> {
        self.own.get(self.next.fetch_add(1, Ordering::Relaxed)).copied()
    }
}

impl Painter {
    /// Draws job after job until there are no more, or a page cannot be had.
    pub(crate) fn run(self) -> Result<ThreadStats> {
        let Self { region, port, link, outlets, jobs, image_bytes, kernel, batch_tiles, wants, placement } =
            self;
        let attached = region.attach(port)?;
        let notes = Notes::new(u32::try_from(region.page_bytes())?, image_bytes);
        let canvas = Canvas {
            attached: &attached,
            notes: &notes,
            link: &link,
            outlets: &outlets,
            jobs: &jobs,
            kernel,
            batch_tiles,
            wants,
            placement,
        };
        if region.choice().used == BackendKind::Soft {
            canvas.draw_all(Slotted { attached: &attached, length: image_bytes })?;
        } else {
            let bytes = attached.bytes();
            // Behind the image's end lies only what fills the last page.
            let length = usize::try_from(image_bytes)?.min(bytes.len());
            canvas.draw_all(Flat::new(&bytes[..length]))?;
        }
        Ok(attached.stats())
    }
}

/// Where a thread's tiles come from and go to.
struct Canvas<'a> {
    attached: &'a Attached<Port>,
    notes: &'a Notes,
    link: &'a Link,
    outlets: &'a Outlets,
    jobs: &'a Receiver<Arc<Job>>,
    kernel: Kernel,
    batch_tiles: u16,
    wants: Wants,
    placement: Stripes,
}

impl Canvas<'_> {
    fn draw_all<M: SceneMemory + Copy>(&self, memory: M) -> Result<()> {
        let scene = SceneView::new(Noted::new(memory, self.notes));
        // A header of zeros is what a page that could not be had looks like; that failure comes first.
        self.attached.check()?;
        let scene = scene.context("the scene image")?;
        let mut sender = Sender::new(self.outlets, self.batch_tiles);
        let mut probe = Probe::new(self.wants, memory, self.placement, self.attached.region().page_bytes())?;
        while let Ok(job) = self.jobs.recv() {
            self.draw(&scene, &job, &mut sender, &mut probe)?;
        }
        Ok(())
    }

    fn draw<M: SceneMemory, N: SceneMemory>(
        &self,
        scene: &SceneView<M>,
        job: &Job,
        sender: &mut Sender<'_>,
        probe: &mut Probe<N>,
    ) -> Result<()> {
        let (frame, columns) = (job.frame.number, job.tiles.columns());
        // Nothing leaves that a page may have been made of that could not be had.
        let check = || -> Result<()> { Ok(self.attached.check()?) };
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        while let Some(id) = job.take() {
            let Some(tile) = job.tiles.get(id) else { continue };
            let pixels = &mut pixels[..tile.pixels()];
            self.attached.begin_tile(id.0);
            probe.begin_tile(|| self.attached.misses());
            let counts = render_tile(scene, &job.frame, tile, self.kernel, pixels, &mut ());
            let facts = probe.end_tile(&job.frame, (id, tile), || self.attached.misses());
            self.notes.take(|pages| self.attached.end_tile(id.0, pages));
            self.tell(facts)?;
            sender.push(frame, columns, (id, tile), (pixels, &counts), check)?;
        }
        sender.flush(check)?;
        self.tell(probe.rest())?;
        self.link.send(&News::Drawn(frame).to_packet()?)?;
        Ok(())
    }

    /// Sends what is known of some tiles, if anything is.
    fn tell(&self, facts: Option<FactBatch>) -> Result<()> {
        facts.map_or(Ok(()), |facts| Ok(self.link.send(&News::Facts(facts).to_packet()?)?))
    }
}

impl SceneMemory for Slotted<'_> {
    type Record<'a>
        = Record<'a>
    where
        Self: 'a;

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<Record<'_>> {
        self.attached.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.length
    }
}
