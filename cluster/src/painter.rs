//! A render thread: draws its share of a frame's tiles and sends them off.

use std::sync::Arc;

use anyhow::{Context, Result};
use dsm_core::placement::Stripes;
use fault_linux::{Attached, BackendKind, Record, Region, ThreadStats};
use kernels::Draw;
use kernels::noted::{Noted, Notes};
use kernels::pinned::{Pinned, Pins};
use rt_core::{Flat, Kernel, SceneMemory, SceneView, TILE_SIZE, Tiles};

use crate::balance::{Balance, Task};
use crate::control::News;
use crate::diagnostic::{FactBatch, Probe, Wants};
use crate::gather::{Outlets, Sender};
use crate::link::Link;
use crate::ports::Port;

/// What a render thread needs.
#[derive(Debug)]
pub(crate) struct Painter {
    pub(crate) region: Arc<Region>,
    pub(crate) port: Port,
    pub(crate) link: Arc<Link>,
    pub(crate) outlets: Arc<Outlets>,
    pub(crate) balance: Arc<Balance>,
    pub(crate) image_bytes: u64,
    pub(crate) kernel: Kernel,
    /// Tiles sent at a time at most.
    pub(crate) batch_tiles: u16,
    /// What is to be found out of each tile, and whose pages are whose.
    pub(crate) wants: Wants,
    pub(crate) placement: Stripes,
}

/// The `soft` backend of one thread, as memory.
#[derive(Clone, Copy, Debug)]
struct Slotted<'a> {
    attached: &'a Attached<Port>,
    length: u64,
}

impl Painter {
    /// Draws tile after tile until there are no more, or a page cannot be had.
    pub(crate) fn run(self) -> Result<ThreadStats> {
        let Self { region, port, link, outlets, balance, image_bytes, kernel, batch_tiles, wants, placement } =
            self;
        let attached = region.attach(port)?;
        let notes =
            Notes::new(u32::try_from(region.page_bytes())?, image_bytes).with_misses(!region.holds_all());
        let canvas = Canvas {
            attached: &attached,
            notes: &notes,
            link: &link,
            outlets: &outlets,
            balance: &balance,
            kernel,
            batch_tiles,
            wants,
            placement,
        };
        if region.choice().used == BackendKind::Soft {
            canvas.draw_all(Pinned(&Slotted { attached: &attached, length: image_bytes }))?;
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
    balance: &'a Balance,
    kernel: Kernel,
    batch_tiles: u16,
    wants: Wants,
    placement: Stripes,
}

impl Canvas<'_> {
    fn draw_all<'m, M: SceneMemory + Copy + 'm>(&'m self, memory: M) -> Result<()>
    where
        Noted<'m, M>: Draw,
    {
        let scene = SceneView::new(Noted::new(memory, self.notes));
        // A header of zeros is what a page that could not be had looks like; that failure comes first.
        self.attached.check()?;
        let scene = scene.context("the scene image")?;
        let mut sender = Sender::new(self.outlets, self.batch_tiles);
        let mut probe = Probe::new(self.wants, memory, self.placement, self.attached.region().page_bytes())?;
        let mut frame = 0;
        loop {
            let task = match self.balance.try_take()? {
                Some(task) => task,
                None => {
                    // Whoever waits for work keeps nobody waiting for what is done.
                    self.send_rest(&mut sender, &mut probe)?;
                    match self.balance.take_or_wait()? {
                        Some(task) => task,
                        None => return Ok(()),
                    }
                }
            };
            if task.frame.number != frame {
                self.send_rest(&mut sender, &mut probe)?;
                frame = task.frame.number;
            }
            self.draw(&scene, &task, &mut sender, &mut probe)?;
        }
    }

    /// Draws one tile and hands it to the sender, if anybody still wants it.
    fn draw<M: Draw, N: SceneMemory>(
        &self,
        scene: &SceneView<M>,
        task: &Task,
        sender: &mut Sender<'_>,
        probe: &mut Probe<N>,
    ) -> Result<()> {
        let (frame, id) = (&task.frame, task.tile);
        let tiles = Tiles::of(frame.width, frame.height);
        let Some(tile) = tiles.get(id) else { return Ok(()) };
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        let pixels = &mut pixels[..tile.pixels()];
        self.attached.begin_tile(id.0);
        probe.begin_tile(|| self.attached.misses());
        let counts = Draw::render_tile(scene, frame, tile, self.kernel, pixels);
        let facts = probe.end_tile(frame, (id, tile), || self.attached.misses());
        let mut is_wanted = Ok(false);
        self.notes.take(|pages| {
            self.attached.end_tile(id.0, pages);
            is_wanted = self.balance.handle_drawn(task, pages);
        });
        self.tell(facts)?;
        if is_wanted? {
            let when = (frame.number, task.is_calm);
            sender.push(when, tiles, (id, tile), (pixels, &counts), || self.check())?;
        }
        Ok(())
    }

    /// Sends what is left of a frame.
    fn send_rest<N: SceneMemory>(&self, sender: &mut Sender<'_>, probe: &mut Probe<N>) -> Result<()> {
        self.tell(probe.rest())?;
        sender.flush(|| self.check())
    }

    /// Nothing leaves that a page may have been made of that could not be had.
    fn check(&self) -> Result<()> {
        Ok(self.attached.check()?)
    }

    /// Sends what is known of some tiles, if anything is.
    fn tell(&self, facts: Option<FactBatch>) -> Result<()> {
        facts.map_or(Ok(()), |facts| Ok(self.link.send(&News::Facts(facts).to_packet()?)?))
    }
}

impl Pins for Slotted<'_> {
    fn record(&self, offset: u64, length: usize) -> Option<Record<'_>> {
        self.attached.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.length
    }
}
