//! A node's side: from the threads that draw to the displays.

use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use rt_core::{Tile, TileCounts, TileId, Tiles};

use super::bands::Bands;
use super::codec::Encoder;
use super::credit::Window;
use super::head::Head;
use super::parcel::{Packed, Parcel};
use crate::link::Link;

/// The ways of a node to all displays, shared by its threads.
#[derive(Debug)]
pub(crate) struct Outlets {
    displays: Vec<Outlet>,
    kept: Mutex<Kept>,
}

/// The way to one display.
#[derive(Debug)]
struct Outlet {
    link: Link,
    window: Mutex<Window>,
}

/// Tiles as this node has drawn them last, which the displays then have too: a frame begins when all displays have the
/// whole one before it, and whoever draws a tile of a frame draws the same.
#[derive(Debug, Default)]
struct Kept {
    tiles: Vec<Option<Last>>,
    bytes: usize,
    /// The frame in which what is too old was last forgotten.
    tidied: u32,
}

#[derive(Debug)]
struct Last {
    frame: u32,
    pixels: Box<[u8]>,
}

/// Bytes of tiles that a node keeps at most, as many as a picture of 512x512 has; tiles beyond that travel whole.
const KEPT_BYTES_MAX: usize = 256 << 10;

/// Sends the tiles of one thread.
#[derive(Debug)]
pub(crate) struct Sender<'a> {
    outlets: &'a Outlets,
    encoder: Encoder,
    scratch: Vec<u8>,
    /// What is being filled for each display.
    parcels: Vec<Parcel>,
    /// Tiles in a parcel at most.
    tiles_max: u16,
}

impl Outlets {
    /// The ways to the displays, in their order.
    pub(crate) fn new(links: Vec<Link>) -> Self {
        let outlet = |link| Outlet { link, window: Mutex::new(Window::default()) };
        Self { displays: links.into_iter().map(outlet).collect(), kept: Mutex::default() }
    }

    /// Sends a packet to a display; waits for credit.
    fn send(&self, display: usize, packet: &[u8]) -> Result<()> {
        let Outlet { link, window } = &self.displays[display];
        let mut window = window.lock().unwrap_or_else(PoisonError::into_inner);
        while !window.has_room(packet.len()) {
            let mut credit = [0; 8];
            match link.receive_into(&mut credit)? {
                Some(8) => window.credit(u64::from_le_bytes(credit))?,
                Some(length) => bail!("a display gave credit of {length} bytes"),
                None => bail!("a display is gone"),
            }
        }
        window.send(packet.len());
        link.send(packet).context("cannot send tiles to a display")
    }

    fn kept(&self) -> std::sync::MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    /// The pixels of the tile in the last frame, if this node drew it then; forgets them.
    fn take(&mut self, TileId(id): TileId, frame: u32) -> Option<Box<[u8]>> {
        let last = self.tiles.get_mut(id as usize)?.take()?;
        self.bytes -= last.pixels.len();
        (last.frame.checked_add(1) == Some(frame)).then_some(last.pixels)
    }

    /// Keeps the pixels of a tile, if there is room.
    fn put(&mut self, TileId(id): TileId, frame: u32, pixels: Box<[u8]>) {
        if self.bytes + pixels.len() > KEPT_BYTES_MAX && self.tidied != frame {
            self.forget_before(frame);
        }
        if self.bytes + pixels.len() > KEPT_BYTES_MAX {
            return;
        }
        let id = id as usize;
        if self.tiles.len() <= id {
            self.tiles.resize_with(id + 1, || None);
        }
        self.bytes += pixels.len();
        if let Some(old) = self.tiles[id].replace(Last { frame, pixels }) {
            self.bytes -= old.pixels.len();
        }
    }

    /// Forgets tiles that were last drawn before the frame before this one.
    fn forget_before(&mut self, frame: u32) {
        self.tidied = frame;
        for tile in &mut self.tiles {
            if let Some(old) = tile.take_if(|last| last.frame.saturating_add(1) < frame) {
                self.bytes -= old.pixels.len();
            }
        }
    }
}

impl<'a> Sender<'a> {
    /// Sends the tiles that one thread draws, at most `tiles_max` at a time.
    pub(crate) fn new(outlets: &'a Outlets, tiles_max: u16) -> Self {
        let parcels = outlets.displays.iter().map(|_| Parcel::default()).collect();
        Self { outlets, encoder: Encoder::default(), scratch: Vec::new(), parcels, tiles_max }
    }

    /// Adds a tile of a frame that is cut into `tiles`, and what was counted for it. It builds on the last frame only if
    /// that `is_sure`, and this node drew it then. `check` says before anything leaves whether it may.
    pub(crate) fn push(
        &mut self,
        (frame, is_sure): (u32, bool),
        tiles: Tiles,
        (id, tile): (TileId, Tile),
        (pixels, counts): (&[u8], &TileCounts),
        check: impl Fn() -> Result<()>,
    ) -> Result<()> {
        let before = self.outlets.kept().take(id, frame).filter(|_| is_sure);
        self.scratch.clear();
        let coding = self.encoder.encode(tile.width as usize, pixels, before.as_deref(), &mut self.scratch);
        let kept = match before {
            Some(mut kept) => {
                kept.copy_from_slice(pixels);
                kept
            }
            None => pixels.into(),
        };
        self.outlets.kept().put(id, frame, kept);
        let display = Bands::of(tiles, self.parcels.len()).display_of(id);
        let length = u16::try_from(self.scratch.len()).context("a tile of more bytes than pixels")?;
        let packed = Packed { head: Head { id, counts: *counts, coding, length }, bytes: &self.scratch };
        let parcel = &mut self.parcels[display];
        if parcel.tiles() == 0 {
            *parcel = Parcel::new(frame);
        }
        debug_assert_eq!(parcel.frame(), frame, "what is left of a frame is sent before the next");
        if !parcel.push(&packed) {
            let full = core::mem::replace(parcel, Parcel::new(frame));
            parcel.push(&packed);
            check()?;
            self.outlets.send(display, &full.to_packet())?;
        }
        let parcel = &mut self.parcels[display];
        if parcel.tiles() >= self.tiles_max {
            let full = core::mem::take(parcel);
            check()?;
            self.outlets.send(display, &full.to_packet())?;
        }
        Ok(())
    }

    /// Sends what is left.
    pub(crate) fn flush(&mut self, check: impl Fn() -> Result<()>) -> Result<()> {
        check()?;
        for (display, parcel) in self.parcels.iter_mut().enumerate().filter(|(_, parcel)| parcel.tiles() > 0)
        {
            self.outlets.send(display, &core::mem::take(parcel).to_packet())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(grey: u8, count: usize) -> Box<[u8]> {
        vec![grey; count].into()
    }

    #[test]
    fn only_what_was_drawn_in_the_last_frame_counts() {
        let mut kept = Kept::default();
        kept.put(TileId(2), 5, pixels(1, 8));
        assert_eq!(kept.take(TileId(1), 6), None);
        assert_eq!(kept.take(TileId(9), 6), None);
        assert_eq!(kept.take(TileId(2), 6), Some(pixels(1, 8)));
        assert_eq!(kept.take(TileId(2), 6), None);
        kept.put(TileId(2), 6, pixels(2, 8));
        assert_eq!(kept.take(TileId(2), 8), None);
        assert_eq!(kept.bytes, 0);
    }

    #[test]
    fn what_is_kept_is_bounded_and_the_old_makes_room() {
        let mut kept = Kept::default();
        for id in 0..3000 {
            kept.put(TileId(id), 1, pixels(0, 1024));
        }
        assert_eq!(kept.bytes, KEPT_BYTES_MAX);
        // Frame 2 may still be compared with frame 1; in frame 3 all of that is too old.
        kept.put(TileId(2999), 2, pixels(0, 1024));
        assert!(kept.take(TileId(2999), 3).is_none());
        kept.put(TileId(2999), 3, pixels(0, 1024));
        assert_eq!(kept.bytes, 1024);
        assert!(kept.take(TileId(2999), 4).is_some());
    }
}
