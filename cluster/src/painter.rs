//! A render thread: draws its share of a frame's tiles and sends them off.

use std::sync::Arc;

use anyhow::{Context, Result};
use fault_linux::{Attached, BackendKind, Record, Region, ThreadStats};
use rt_core::{Flat, Kernel, SceneMemory, SceneView, TILE_SIZE, Tiles, render_tile};

use crate::balance::{Balance, Task};
use crate::control::{News, TileBatch};
use crate::link::Link;
use crate::noted::{Noted, Notes};
use crate::ports::Port;

/// What a render thread needs.
#[derive(Debug)]
pub(crate) struct Painter {
    pub(crate) region: Arc<Region>,
    pub(crate) port: Port,
    pub(crate) link: Arc<Link>,
    pub(crate) balance: Arc<Balance>,
    pub(crate) image_bytes: u64,
    pub(crate) kernel: Kernel,
    /// Tiles sent at a time at most.
    pub(crate) batch_tiles: u16,
}

/// A scene of which every access goes through a table: the `soft` backend.
#[derive(Clone, Copy, Debug)]
struct Slotted<'a> {
    attached: &'a Attached<Port>,
    length: u64,
}

impl Painter {
    /// Draws tile after tile until there are no more, or a page cannot be had.
    pub(crate) fn run(self) -> Result<ThreadStats> {
        let Self { region, port, link, balance, image_bytes, kernel, batch_tiles } = self;
        let attached = region.attach(port)?;
        let notes = Notes::new(u32::try_from(region.page_bytes())?, image_bytes);
        let canvas = Canvas {
            attached: &attached,
            notes: &notes,
            link: &link,
            balance: &balance,
            kernel,
            batch_tiles,
        };
        if region.choice().used == BackendKind::Soft {
            canvas.draw_all(Noted::new(Slotted { attached: &attached, length: image_bytes }, &notes))?;
        } else {
            let bytes = attached.bytes();
            // Behind the image's end lies only what fills the last page.
            let length = usize::try_from(image_bytes)?.min(bytes.len());
            canvas.draw_all(Noted::new(Flat::new(&bytes[..length]), &notes))?;
        }
        Ok(attached.stats())
    }
}

/// Where a thread's tiles come from and go to.
struct Canvas<'a> {
    attached: &'a Attached<Port>,
    notes: &'a Notes,
    link: &'a Link,
    balance: &'a Balance,
    kernel: Kernel,
    batch_tiles: u16,
}

impl Canvas<'_> {
    fn draw_all<M: SceneMemory>(&self, memory: M) -> Result<()> {
        let scene = SceneView::new(memory);
        // A header of zeros is what a page that could not be had looks like; that failure comes first.
        self.attached.check()?;
        let scene = scene.context("the scene image")?;
        let (mut batch, mut batched) = (TileBatch::new(0), 0);
        loop {
            let task = match self.balance.try_take()? {
                Some(task) => task,
                None => {
                    // Whoever waits for work keeps nobody waiting for what is done.
                    self.send(core::mem::replace(&mut batch, TileBatch::new(0)))?;
                    match self.balance.take_or_wait()? {
                        Some(task) => task,
                        None => return Ok(()),
                    }
                }
            };
            if batch.frame() != task.frame.number || batched == self.batch_tiles {
                self.send(core::mem::replace(&mut batch, TileBatch::new(task.frame.number)))?;
                batched = 0;
            }
            self.draw(&scene, &task, &mut batch)?;
            batched += 1;
        }
    }

    /// Draws one tile into the batch, which is sent first if it has no room.
    fn draw<M: SceneMemory>(&self, scene: &SceneView<M>, task: &Task, batch: &mut TileBatch) -> Result<()> {
        let (frame, id) = (&task.frame, task.tile);
        let Some(tile) = Tiles::of(frame.width, frame.height).get(id) else { return Ok(()) };
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        let pixels = &mut pixels[..tile.pixels()];
        self.attached.begin_tile(id.0);
        let counts = render_tile(scene, frame, tile, self.kernel, pixels, &mut ());
        let mut is_wanted = Ok(false);
        self.notes.take(|pages| {
            self.attached.end_tile(id.0, pages);
            is_wanted = self.balance.handle_drawn(task, pages);
        });
        if is_wanted? && !batch.push(id, pixels, &counts) {
            self.send(core::mem::replace(batch, TileBatch::new(frame.number)))?;
            batch.push(id, pixels, &counts);
        }
        Ok(())
    }

    /// Sends tiles, unless a page that they may be made of could not be had.
    fn send(&self, batch: TileBatch) -> Result<()> {
        self.attached.check()?;
        if !batch.is_empty() {
            self.link.send(&News::Tiles(batch).to_packet()?)?;
        }
        Ok(())
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
