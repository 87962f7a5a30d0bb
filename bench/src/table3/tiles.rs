//! What the tiles of a session take to be drawn, sent and put in place: measured, one thread, tile by tile.

use std::time::Instant;

use anyhow::{Result, ensure};
use dsm_sim::balance::Workload;
use kernels::Draw;
use memsavvy::gather::codec::Encoder;
use memsavvy::gather::place;
use memsavvy::session::Session;
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, Tile};

/// The tiles of all frames of a session, cut in squares of one edge.
#[derive(Debug)]
pub(super) struct Measured {
    pub(super) columns: u32,
    frames: Vec<Vec<Cost>>,
    /// What a tile takes to be put in place, in the mean, in nanoseconds.
    pub(super) place_ns: f64,
}

/// One tile of one frame.
#[derive(Clone, Copy, Debug)]
struct Cost {
    /// The fastest of some rounds.
    ns: u64,
    /// Bytes of its pixels by themselves, and on top of the last frame's.
    bytes: [u32; 2],
}

/// What drawing takes on processors that are so many times slower.
#[derive(Debug)]
pub(super) struct Slower<'a> {
    pub(super) tiles: &'a Measured,
    pub(super) times: f64,
}

impl Measured {
    /// Draws every tile of a session so many times.
    pub(super) fn draw(image: &[u8], session: &Session, size: u32, edge: u32, rounds: u32) -> Result<Self> {
        let view = SceneView::new(Flat::new(image))?;
        // Asked once: on a virtual machine the processor's answer takes as long as a tile.
        let kernel = Kernel::fastest();
        let orbit = Orbit::around(&view.header().view);
        let columns = size.div_ceil(edge);
        let (mut frames, mut place_ns) = (Vec::new(), f64::INFINITY);
        let (mut before, mut picture): (Option<Vec<Vec<u8>>>, Vec<u8>) =
            (None, vec![0; (size * size) as usize]);
        for (number, moment) in (0..).zip(session.moments()) {
            let frame = Frame::aimed(number, &orbit, &moment.aim, moment.light, [size, size])?;
            let tiles: Vec<Tile> =
                (0..columns * columns).map(|id| tile_of(id, columns, edge, size)).collect();
            let drawn: Vec<(u64, Vec<u8>)> =
                tiles.iter().map(|tile| timed(&view, &frame, *tile, (kernel, rounds))).collect();
            let pixels: Vec<Vec<u8>> = drawn.iter().map(|(_, pixels)| pixels.clone()).collect();
            let (mut encoder, mut costs, mut sent) = (Encoder::default(), Vec::new(), Vec::new());
            for (index, (ns, pixels)) in drawn.iter().enumerate() {
                let width = tiles[index].width as usize;
                let last = before.as_ref().map(|before| &*before[index]);
                let [mut whole, mut changes] = [Vec::new(), Vec::new()];
                encoder.encode(width, pixels, None, &mut whole);
                let coding = encoder.encode(width, pixels, last, &mut changes);
                let bytes =
                    [whole.len(), changes.len()].map(|bytes| u32::try_from(bytes).unwrap_or(u32::MAX));
                costs.push(Cost { ns: *ns, bytes });
                sent.push((coding, changes));
            }
            let (start, mut scratch) = (Instant::now(), Vec::new());
            for ((coding, bytes), tile) in sent.iter().zip(&tiles) {
                let [at, extent] =
                    [[tile.x, tile.y], [tile.width, tile.height]].map(|pair| pair.map(|n| n as usize));
                place((*coding, bytes), (&mut picture, size as usize), at, extent, &mut scratch)?;
            }
            place_ns = place_ns.min(start.elapsed().as_secs_f64() * 1e9 / tiles.len() as f64);
            let first = &tiles[0];
            let corner = &pixels[0][..first.width as usize];
            ensure!(picture[..corner.len()] == *corner, "SAME_IMAGE: a tile was not put where it belongs");
            frames.push(costs);
            before = Some(pixels);
        }
        Ok(Self { columns, frames, place_ns })
    }

    /// Milliseconds that one thread takes for a frame, in the mean.
    pub(super) fn frame_ms(&self) -> f64 {
        let ns: u64 = self.frames.iter().flatten().map(|cost| cost.ns).sum();
        ns as f64 / 1e6 / self.frames.len().max(1) as f64
    }

    /// The dearest tile of all frames, in milliseconds.
    pub(super) fn dearest_ms(&self) -> f64 {
        self.frames.iter().flatten().map(|cost| cost.ns).max().unwrap_or(0) as f64 / 1e6
    }

    pub(super) fn frame_count(&self) -> u32 {
        u32::try_from(self.frames.len()).unwrap_or(u32::MAX)
    }

    fn cost(&self, frame: u32, tile: u32) -> Cost {
        // Frames of a run are numbered from 1; a longer one goes on from the start.
        let frame = frame.saturating_sub(1) as usize % self.frames.len();
        self.frames[frame][tile as usize]
    }
}

fn tile_of(id: u32, columns: u32, edge: u32, size: u32) -> Tile {
    let (x, y) = (id % columns * edge, id / columns * edge);
    Tile { x, y, width: edge.min(size - x), height: edge.min(size - y) }
}

/// The fewest nanoseconds that a tile takes, and its pixels.
fn timed(
    view: &SceneView<Flat<'_>>,
    frame: &Frame,
    tile: Tile,
    (kernel, rounds): (Kernel, u32),
) -> (u64, Vec<u8>) {
    let mut pixels = vec![0; tile.pixels()];
    let round = |_| {
        let start = Instant::now();
        Draw::render_tile(view, frame, tile, kernel, &mut pixels);
        u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX)
    };
    let ns = (0..rounds.max(1)).map(round).min().unwrap_or(0);
    (ns, pixels)
}

impl Workload for Slower<'_> {
    fn cost_ns(&self, frame: u32, tile: u32, _: u16) -> u64 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time")]
        let ns = (self.tiles.cost(frame, tile).ns as f64 * self.times) as u64;
        ns
    }

    fn bytes(&self, frame: u32, tile: u32, is_known: bool) -> u32 {
        self.tiles.cost(frame, tile).bytes[usize::from(is_known)]
    }
}
