//! The part of a picture that one display puts together.

use anyhow::{Context, Result, bail};
use rt_core::{Frame, TILE_SIZE, TileId, Tiles};

use super::bands::Bands;
use super::codec::{Coding, decode};
use super::head::Head;
use super::parcel::{Packed, open};
use crate::control::Drawn;
use crate::picture::Picture;

/// The band of the picture that one of some displays puts together.
#[derive(Debug)]
pub(super) struct Part {
    display: usize,
    displays: usize,
    frame: u32,
    tiles: Tiles,
    width: usize,
    pixels: Vec<u8>,
    /// For each tile of the whole picture whether it is in place.
    is_there: Vec<bool>,
    missing: usize,
    /// Whether `pixels` holds the whole frame before.
    has_before: bool,
    pub(super) counts: Drawn,
    pub(super) traffic: Traffic,
    tile: Vec<u8>,
}

/// What came in for one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Traffic {
    /// Parcels.
    pub(crate) parcels: u64,
    /// Bytes of all parcels.
    pub(crate) bytes: u64,
    /// Tiles that came with pixels.
    pub(crate) changed_tiles: u64,
    /// Time spent on taking parcels and putting tiles in place.
    pub(crate) busy_ns: u64,
}

impl Part {
    /// The part of display `display` of so many, of pictures yet unknown.
    pub(super) fn new(display: usize, displays: usize) -> Self {
        Self {
            display,
            displays,
            frame: 0,
            tiles: Tiles::of(0, 0),
            width: 0,
            pixels: Vec::new(),
            is_there: Vec::new(),
            missing: 0,
            has_before: false,
            counts: Drawn::default(),
            traffic: Traffic::default(),
            tile: Vec::new(),
        }
    }

    /// A frame begins, and the last one is over.
    pub(super) fn begin(&mut self, frame: &Frame) {
        let tiles = Tiles::of(frame.width, frame.height);
        self.has_before =
            self.missing == 0 && self.tiles == tiles && frame.number.checked_sub(1) == Some(self.frame);
        (self.frame, self.tiles, self.width) = (frame.number, tiles, frame.width as usize);
        let rows = self.bands().rows_of(self.display).len();
        self.missing = rows * tiles.columns() as usize;
        self.pixels.resize(rows * TILE_SIZE as usize * self.width, 0);
        self.is_there.clear();
        self.is_there.resize(tiles.count() as usize, false);
        self.counts = Drawn { frame: frame.number, ..Drawn::default() };
        self.traffic = Traffic::default();
    }

    fn bands(&self) -> Bands {
        Bands::of(self.tiles, self.displays)
    }

    pub(super) const fn is_whole(&self) -> bool {
        self.missing == 0
    }

    #[cfg(test)]
    fn is_there(&self, TileId(id): TileId) -> bool {
        self.is_there.get(id as usize).is_some_and(|is_there| *is_there)
    }

    /// Tiles that are in place.
    pub(super) fn present(&self) -> usize {
        self.is_there.iter().filter(|is_there| **is_there).count()
    }

    /// Puts the tiles of a parcel in place, each once, and tells which came for the first time. What comes a second time, or
    /// of a frame that is over, was drawn twice because somebody died, and is dropped.
    ///
    /// # Errors
    /// The packet is no parcel for this part of this frame; the message says why.
    pub(super) fn take(&mut self, packet: &[u8]) -> Result<Vec<TileId>> {
        let (frame, tiles) = open(packet)?;
        let mut arrived = Vec::new();
        if frame < self.frame {
            return Ok(arrived);
        }
        if frame > self.frame {
            bail!("tiles of frame {frame} for frame {}", self.frame);
        }
        for tile in tiles {
            let tile = tile?;
            let id = tile.head.id;
            if self.put(tile).with_context(|| format!("tile {}", id.0))? {
                arrived.push(id);
            }
        }
        self.traffic.parcels += 1;
        self.traffic.bytes += packet.len() as u64;
        Ok(arrived)
    }

    /// Puts a tile in place, if it is not there yet.
    fn put(&mut self, Packed { head, bytes }: Packed<'_>) -> Result<bool> {
        let Head { id, counts, coding, .. } = head;
        let tile = self.tiles.get(id).with_context(|| format!("the picture has {}", self.tiles.count()))?;
        if self.bands().display_of(id) != self.display {
            bail!("it goes to another display than {}", self.display);
        }
        if self.is_there[id.0 as usize] {
            return Ok(false);
        }
        if matches!(coding, Coding::Same | Coding::Temporal) && !self.has_before {
            bail!("it builds on a frame before, and there is none");
        }
        let above = self.bands().rows_of(self.display).start * TILE_SIZE as usize;
        let at = [tile.x as usize, tile.y as usize - above];
        let size = [tile.width as usize, tile.height as usize];
        place((coding, bytes), (&mut self.pixels, self.width), at, size, &mut self.tile)?;
        self.is_there[id.0 as usize] = true;
        self.missing -= 1;
        self.counts.add(&counts);
        self.traffic.changed_tiles += u64::from(coding != Coding::Same);
        Ok(true)
    }

    /// Copies the part to where it belongs in the picture.
    pub(super) fn copy_to(&self, picture: &mut Picture) {
        let strip = TILE_SIZE as usize * self.width;
        let rows =
            picture.pixels_mut().chunks_mut(strip.max(1)).skip(self.bands().rows_of(self.display).start);
        for (to, from) in rows.zip(self.pixels.chunks(strip.max(1))) {
            to.copy_from_slice(&from[..to.len()]);
        }
    }
}

/// Puts the tile of this `size` at `at` in place in a picture with rows of some width. `scratch` is overwritten.
///
/// # Errors
/// The bytes are not those of such a tile; the picture is as it was.
///
/// # Panics
/// When the tile does not lie in the picture.
pub fn place(
    (coding, bytes): (Coding, &[u8]),
    (picture, row): (&mut [u8], usize),
    [x, y]: [usize; 2],
    [width, height]: [usize; 2],
    scratch: &mut Vec<u8>,
) -> Result<()> {
    let lines = |line: usize| {
        let start = (y + line) * row + x;
        start..start + width
    };
    scratch.clear();
    match coding {
        Coding::Same | Coding::Temporal => (0..height).for_each(|line| scratch.extend(&picture[lines(line)])),
        Coding::Raw | Coding::Spatial => scratch.resize(width * height, 0),
    }
    decode(coding, width, bytes, scratch)?;
    if coding != Coding::Same {
        for (line, from) in scratch.chunks_exact(width).enumerate() {
            picture[lines(line)].copy_from_slice(from);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::codec::Encoder;
    use super::super::parcel::Parcel;
    use super::*;
    use crate::size::PictureSize;
    use rt_core::camera::{Orbit, OrbitPlace};
    use rt_core::{Bounds, TileCounts};

    const WIDTH: u32 = 2 * TILE_SIZE + 5;
    const HEIGHT: u32 = 3 * TILE_SIZE + 1;
    const ONE_RAY: TileCounts = TileCounts { primary: 1, hits: 0, shadow: 0, lit: 0, damaged: 0, t_sum: 0.0 };

    fn frame(number: u32) -> Frame {
        let orbit = Orbit::around(&Bounds { low: [0.0; 3].into(), high: [1.0; 3].into() });
        let place = OrbitPlace { radius: 1.5, elevation: 0.0, frame: number, frames: 8 };
        Frame::on_orbit(&orbit, &place, WIDTH, HEIGHT).unwrap()
    }

    /// A parcel with one tile.
    fn parcel(number: u32, id: u32, coding: Coding, bytes: &[u8]) -> Vec<u8> {
        let mut parcel = Parcel::new(number);
        let length = u16::try_from(bytes.len()).unwrap();
        let head = Head { id: TileId(id), counts: ONE_RAY, coding, length };
        assert!(parcel.push(&Packed { head, bytes }));
        parcel.to_packet()
    }

    #[test]
    fn displays_put_one_picture_together() {
        let tiles = Tiles::of(WIDTH, HEIGHT);
        let pixel = |number: u32, x: u32, y: u32| (x ^ (y + number * 3)).to_le_bytes()[0];
        for displays in [1, 2, 3, 5] {
            let mut parts: Vec<Part> = (0..displays).map(|display| Part::new(display, displays)).collect();
            let mut before: Vec<Option<Vec<u8>>> = vec![None; tiles.count() as usize];
            for frame_number in 0..3 {
                parts.iter_mut().for_each(|part| part.begin(&frame(frame_number)));
                for id in tiles.ids() {
                    let tile = tiles.get(id).unwrap();
                    let number = if id.0 == 4 { 9 } else { frame_number };
                    let line = |y| (0..tile.width).map(move |x| pixel(number, tile.x + x, tile.y + y));
                    let pixels: Vec<u8> = (0..tile.height).flat_map(line).collect();
                    let mut bytes = Vec::new();
                    let last = before[id.0 as usize].replace(pixels.clone());
                    let coding =
                        Encoder::default().encode(tile.width as usize, &pixels, last.as_deref(), &mut bytes);
                    assert_eq!(coding == Coding::Same, id.0 == 4 && frame_number > 0);
                    let display = Bands::of(tiles, displays).display_of(id);
                    assert!(!parts[display].is_there(id));
                    parts[display].take(&parcel(frame_number, id.0, coding, &bytes)).unwrap();
                    assert!(parts[display].is_there(id));
                }
                assert!(parts.iter().all(Part::is_whole));
                assert_eq!(parts.iter().map(Part::present).sum::<usize>(), 12);
                let mut picture = Picture::new(PictureSize { width: WIDTH, height: HEIGHT });
                parts.iter().for_each(|part| part.copy_to(&mut picture));
                for (index, grey) in (0..).zip(picture.pixels()) {
                    let (x, y) = (index % WIDTH, index / WIDTH);
                    let is_still = y / TILE_SIZE == 1 && x / TILE_SIZE == 1;
                    assert_eq!(*grey, pixel(if is_still { 9 } else { frame_number }, x, y), "{x} {y}");
                }
            }
        }
    }

    #[test]
    fn garbage_is_refused_and_named() {
        let whole = vec![1; (TILE_SIZE * TILE_SIZE) as usize];
        for (packet, words) in [
            (vec![1, 2, 3], "half a parcel"),
            (parcel(1, 0, Coding::Raw, &whole), "frame 1 for frame 0"),
            (parcel(0, 12, Coding::Raw, &whole), "tile 12: the picture has 12"),
            (parcel(0, 11, Coding::Raw, &whole), "tile 11: it goes to another display"),
            (parcel(0, 0, Coding::Raw, &whole[1..]), "tile 0: its pixels are cut off"),
            (parcel(0, 2, Coding::Raw, &whole), "tile 2: it has more pixels"),
            (parcel(0, 0, Coding::Spatial, &[0x11]), "tile 0: its pixels are cut off"),
            (parcel(0, 0, Coding::Spatial, &[9]), "tile 0: its pixels have a block of parameter 9"),
            (parcel(0, 0, Coding::Same, &[]), "tile 0: it builds on a frame before"),
            (parcel(0, 0, Coding::Temporal, &[0xFF; 16]), "tile 0: it builds on a frame before"),
        ] {
            let mut part = Part::new(0, 2);
            part.begin(&frame(0));
            let error = format!("{:#}", part.take(&packet).unwrap_err());
            assert!(error.contains(words), "{words}: {error}");
            assert_eq!(part.take(&parcel(0, 1, Coding::Raw, &whole)).unwrap(), [TileId(1)]);
        }
    }

    #[test]
    fn second_copies_and_tiles_of_frames_that_are_over_are_dropped() {
        let [one, other] = [1, 2].map(|grey| vec![grey; (TILE_SIZE * TILE_SIZE) as usize]);
        let mut part = Part::new(0, 2);
        part.begin(&frame(1));
        assert_eq!(part.take(&parcel(1, 1, Coding::Raw, &one)).unwrap(), [TileId(1)]);
        for late in [parcel(1, 1, Coding::Raw, &other), parcel(0, 0, Coding::Raw, &other)] {
            assert_eq!(part.take(&late).unwrap(), []);
        }
        assert_eq!((part.counts.primary_rays, part.present()), (1, 1));
        assert!(!part.pixels.contains(&2));
    }
}
