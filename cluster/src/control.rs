//! What the supervisor and its processes say to each other.
//!
//! A packet is one letter and what belongs to it: JSON where people may want to look, bytes where there are many.

use anyhow::{Context, Result, bail};
use rt_core::{Frame, Tile, TileCounts, TileId, Tiles};
use serde::{Deserialize, Serialize};

use crate::diagnostic::{FactBatch, Wants};
use crate::link::PACKET_BYTES_MAX;
use crate::plan::PlacementNumbers;
use crate::report::ProcessReport;

/// From the supervisor to a process.
#[derive(Debug)]
pub(crate) enum Order {
    /// Who you are. Comes first, with the files listed in [`Files`].
    SetUp(Box<SetUp>),
    /// Every page is in place; you may fetch from others.
    Go,
    /// Draw your tiles of this frame.
    Draw(Frame),
    /// Draw these tiles of this frame besides: whoever was to draw them is dead.
    DrawTiles(Frame, Vec<TileId>),
    /// The process of this number is dead; ask it for nothing.
    Down(u16),
    /// Report and end.
    Stop,
}

/// From a process to the supervisor.
#[derive(Debug)]
pub(crate) enum News {
    /// Home pages are filled.
    Ready,
    /// Nothing has happened, and I am here.
    Alive,
    /// Some tiles of a frame.
    Tiles(TileBatch),
    /// What is known of some tiles of a frame, where somebody wants to know.
    Facts(FactBatch),
    /// One thread has sent all that it has drawn for one order, of this frame.
    Drawn(u32),
    /// I have to give up.
    Failed(String),
    /// What I have counted; the last packet.
    Report(Box<ProcessReport>),
}

/// What a process must know before it starts.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SetUp {
    pub(crate) node: u16,
    pub(crate) nodes: u16,
    pub(crate) processes: u16,
    pub(crate) cluster: u64,
    pub(crate) placement: PlacementNumbers,
    pub(crate) page_bytes: u32,
    pub(crate) image_bytes: u64,
    pub(crate) budget_bytes: u64,
    pub(crate) slots: u32,
    pub(crate) threads: u16,
    /// Each render thread keeps to a core of its own.
    pub(crate) binds_to_cores: bool,
    pub(crate) backend: String,
    pub(crate) policy: String,
    /// A source of reference bits by name.
    pub(crate) reference: String,
    pub(crate) hidden_per_cent: u32,
    pub(crate) prefetch: bool,
    pub(crate) kernel: String,
    pub(crate) transport: TransportKind,
    pub(crate) spin_us: u64,
    pub(crate) deadline_us: u64,
    /// Messages lost on purpose, in a thousand, and the seed of which.
    pub(crate) lose_per_mille: u32,
    pub(crate) seed: u64,
    /// Tiles sent at a time at most; fewer than a packet holds for tests that count them.
    pub(crate) batch_tiles: u16,
    /// What is to be found out of each tile.
    pub(crate) wants: Wants,
}

/// How pages travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum TransportKind {
    /// Shared memory, read straight out of the owner's; no server has to answer.
    Shm,
    /// Shared memory, through rings and the owner's server thread, as between machines.
    ShmRing,
}

/// Where render threads run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BindTo {
    /// Each on a core of its own.
    Core,
    /// Wherever the system puts them.
    None,
}

/// The order of the files that come with [`Order::SetUp`]: the image, the pages of each owner, the inboxes of each.
#[derive(Debug)]
pub(crate) struct Files<T> {
    pub(crate) image: T,
    pub(crate) pages: Vec<T>,
    pub(crate) inboxes: Vec<T>,
}

/// Tiles of one frame, packed into a packet, and what was counted while they were drawn.
#[derive(Debug, Default)]
pub(crate) struct TileBatch {
    drawn: Drawn,
    bytes: Vec<u8>,
}

/// What was counted while tiles of a frame were drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Drawn {
    pub(crate) frame: u32,
    pub(crate) primary_rays: u64,
    pub(crate) hits: u64,
    pub(crate) shadow_rays: u64,
    pub(crate) lit: u64,
    pub(crate) damaged: u64,
}

impl Order {
    pub(crate) fn to_packet(&self) -> Result<Vec<u8>> {
        Ok(match self {
            Self::SetUp(set_up) => with_json(b'S', set_up)?,
            Self::Go => vec![b'G'],
            Self::Draw(frame) => [b"D", frame.as_bytes()].concat(),
            Self::DrawTiles(frame, tiles) => {
                let tiles: Vec<[u8; 4]> = tiles.iter().map(|tile| tile.0.to_le_bytes()).collect();
                [b"T", frame.as_bytes(), tiles.as_flattened()].concat()
            }
            Self::Down(process) => [&b"N"[..], &process.to_le_bytes()].concat(),
            Self::Stop => vec![b'X'],
        })
    }

    pub(crate) fn from_packet(packet: &[u8]) -> Result<Self> {
        match packet {
            [b'S', json @ ..] => Ok(Self::SetUp(serde_json::from_slice(json)?)),
            [b'G'] => Ok(Self::Go),
            [b'D', frame @ ..] => Ok(Self::Draw(Frame::read(frame)?)),
            [b'T', rest @ ..] => {
                let (frame, tiles) = rest.split_at_checked(size_of::<Frame>()).context("half a frame")?;
                let (tiles, half) = tiles.as_chunks::<4>();
                if !half.is_empty() {
                    bail!("half a tile's number");
                }
                let tiles = tiles.iter().map(|tile| TileId(u32::from_le_bytes(*tile)));
                Ok(Self::DrawTiles(Frame::read(frame)?, tiles.collect()))
            }
            [b'N', low, high] => Ok(Self::Down(u16::from_le_bytes([*low, *high]))),
            [b'X'] => Ok(Self::Stop),
            _ => bail!("an order of {} bytes that is none", packet.len()),
        }
    }
}

impl News {
    pub(crate) fn to_packet(&self) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Ready => vec![b'R'],
            Self::Alive => vec![b'A'],
            Self::Tiles(batch) => batch.to_packet(),
            Self::Facts(batch) => batch.to_packet(b'I'),
            Self::Drawn(frame) => [&b"D"[..], &frame.to_le_bytes()].concat(),
            Self::Failed(why) => [b"F", why.as_bytes()].concat(),
            Self::Report(report) => with_json(b'P', report)?,
        })
    }

    pub(crate) fn from_packet(packet: &[u8]) -> Result<Self> {
        match packet {
            [b'R'] => Ok(Self::Ready),
            [b'A'] => Ok(Self::Alive),
            [b'T', rest @ ..] => Ok(Self::Tiles(TileBatch::from_bytes(rest)?)),
            [b'I', rest @ ..] => Ok(Self::Facts(FactBatch::from_bytes(rest)?)),
            [b'D', f0, f1, f2, f3] => Ok(Self::Drawn(u32::from_le_bytes([*f0, *f1, *f2, *f3]))),
            [b'F', why @ ..] => Ok(Self::Failed(String::from_utf8_lossy(why).into_owned())),
            [b'P', json @ ..] => Ok(Self::Report(serde_json::from_slice(json)?)),
            _ => bail!("news of {} bytes that is none", packet.len()),
        }
    }
}

impl<T> Files<T> {
    /// All of them, in the order in which they travel.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &T> {
        core::iter::once(&self.image).chain(&self.pages).chain(&self.inboxes)
    }

    /// Sorts what came with the plan into its places.
    pub(crate) fn from_list(list: Vec<T>, owners: usize, transport: TransportKind) -> Result<Self> {
        let inboxes = if transport == TransportKind::ShmRing { owners } else { 0 };
        let got = list.len();
        let mut list = list.into_iter();
        let image = list.next().context("the image did not come with the plan")?;
        let pages: Vec<T> = list.by_ref().take(owners).collect();
        let inboxes: Vec<T> = list.by_ref().take(inboxes).collect();
        if pages.len() != owners || list.next().is_some() {
            bail!("{got} files came with a plan for {owners} owners");
        }
        Ok(Self { image, pages, inboxes })
    }
}

impl TileBatch {
    /// An empty batch for a frame.
    pub(crate) fn new(frame: u32) -> Self {
        Self { drawn: Drawn { frame, ..Drawn::default() }, bytes: Vec::new() }
    }

    /// Adds a tile and what was counted for it, unless the packet would become too large.
    pub(crate) fn push(&mut self, TileId(id): TileId, pixels: &[u8], counts: &TileCounts) -> bool {
        let header = 1 + Drawn::BYTES;
        if header + self.bytes.len() + size_of::<u32>() + pixels.len() > PACKET_BYTES_MAX {
            return false;
        }
        self.bytes.extend(id.to_le_bytes());
        self.bytes.extend(pixels);
        self.drawn.add(counts);
        true
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// What was counted while these tiles were drawn.
    pub(crate) const fn drawn(&self) -> &Drawn {
        &self.drawn
    }

    fn to_packet(&self) -> Vec<u8> {
        [&b"T"[..], &self.drawn.to_bytes(), &self.bytes].concat()
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let (drawn, tiles) = bytes.split_first_chunk().context("half a batch of tiles")?;
        Ok(Self { drawn: Drawn::from_bytes(drawn), bytes: tiles.to_vec() })
    }

    /// The tiles in it, for a picture cut as `tiles` says.
    ///
    /// # Errors
    /// A tile that is none of the picture's, or half a tile.
    pub(crate) fn tiles(&self, tiles: Tiles) -> impl Iterator<Item = Result<(TileId, Tile, &[u8])>> {
        let mut rest = &self.bytes[..];
        core::iter::from_fn(move || {
            if rest.is_empty() {
                return None;
            }
            let taken = take_tile(rest, tiles);
            rest = taken.as_ref().map_or(&[][..], |(_, _, _, rest)| rest);
            Some(taken.map(|(id, tile, pixels, _)| (id, tile, pixels)))
        })
    }
}

fn take_tile(bytes: &[u8], tiles: Tiles) -> Result<(TileId, Tile, &[u8], &[u8])> {
    let (id, rest) = bytes.split_first_chunk::<4>().context("half a tile's number")?;
    let id = TileId(u32::from_le_bytes(*id));
    let tile = tiles.get(id).with_context(|| format!("tile {} of a picture that has fewer", id.0))?;
    let (pixels, rest) = rest.split_at_checked(tile.pixels()).context("half a tile")?;
    Ok((id, tile, pixels, rest))
}

impl Drawn {
    /// Length of the counts in a packet.
    const BYTES: usize = 4 + 5 * 8;

    /// Adds what was counted for other tiles of the frame.
    pub(crate) const fn merge(&mut self, other: &Self) {
        self.primary_rays += other.primary_rays;
        self.hits += other.hits;
        self.shadow_rays += other.shadow_rays;
        self.lit += other.lit;
        self.damaged += other.damaged;
    }

    fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let (frame, counts) = bytes.split_at_mut(4);
        frame.copy_from_slice(&self.frame.to_le_bytes());
        let values = [self.primary_rays, self.hits, self.shadow_rays, self.lit, self.damaged];
        for (place, value) in counts.chunks_exact_mut(8).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let [f0, f1, f2, f3, counts @ ..] = bytes;
        let mut counts = counts.as_chunks::<8>().0.iter().map(|count| u64::from_le_bytes(*count));
        let mut next = || counts.next().unwrap_or_default();
        Self {
            frame: u32::from_le_bytes([*f0, *f1, *f2, *f3]),
            primary_rays: next(),
            hits: next(),
            shadow_rays: next(),
            lit: next(),
            damaged: next(),
        }
    }

    fn add(&mut self, counts: &TileCounts) {
        self.primary_rays += counts.primary;
        self.hits += counts.hits;
        self.shadow_rays += counts.shadow;
        self.lit += counts.lit;
        self.damaged += counts.damaged;
    }
}

fn with_json(letter: u8, value: &impl Serialize) -> Result<Vec<u8>> {
    let mut packet = vec![letter];
    serde_json::to_writer(&mut packet, value)?;
    Ok(packet)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::TILE_SIZE;

    #[test]
    fn tiles_travel_in_packets_that_fit() {
        let tiles = Tiles::of(3 * TILE_SIZE - 5, 2 * TILE_SIZE - 9);
        let counts = TileCounts { primary: 1, hits: 2, shadow: 3, lit: 4, damaged: 5, t_sum: 0.0 };
        let mut batch = TileBatch::new(7);
        for id in tiles.ids() {
            let pixels = vec![u8::try_from(id.0).unwrap(); tiles.get(id).unwrap().pixels()];
            assert!(batch.push(id, &pixels, &counts));
        }
        let News::Tiles(batch) = News::from_packet(&News::Tiles(batch).to_packet().unwrap()).unwrap() else {
            panic!("tiles became something else");
        };
        let drawn = Drawn { frame: 7, primary_rays: 6, hits: 12, shadow_rays: 18, lit: 24, damaged: 30 };
        assert_eq!(*batch.drawn(), drawn);
        let found: Vec<_> = batch.tiles(tiles).map(Result::unwrap).collect();
        assert_eq!(found.len(), 6);
        for (id, tile, pixels) in found {
            assert_eq!(Some(tile), tiles.get(id));
            assert!(pixels.iter().all(|pixel| u32::from(*pixel) == id.0));
        }
    }

    #[test]
    fn a_full_batch_takes_no_more() {
        let mut batch = TileBatch::new(0);
        let pixels = [0; 256];
        let pushed =
            (0..1000).take_while(|id| batch.push(TileId(*id), &pixels, &TileCounts::default())).count();
        assert_eq!(pushed, (PACKET_BYTES_MAX - 1 - Drawn::BYTES) / 260);
        assert!(News::Tiles(batch).to_packet().unwrap().len() <= PACKET_BYTES_MAX);
    }

    #[test]
    fn half_a_tile_and_a_tile_of_another_picture_are_errors() {
        let tiles = Tiles::of(TILE_SIZE, TILE_SIZE);
        for bytes in [&[0, 0, 0][..], &[0, 0, 0, 0, 1, 2], &[9, 0, 0, 0]] {
            let batch = TileBatch { drawn: Drawn::default(), bytes: bytes.to_vec() };
            assert!(batch.tiles(tiles).next().unwrap().is_err());
            assert_eq!(batch.tiles(tiles).count(), 1);
        }
    }

    #[test]
    fn packets_that_are_none_are_errors() {
        for packet in [&b""[..], b"Z", b"S{", b"Dxx", b"GG", b"Txx", b"N", b"N123"] {
            assert!(Order::from_packet(packet).is_err());
        }
        for packet in [&b""[..], b"T12", b"P[]", b"RR", b"I12"] {
            assert!(News::from_packet(packet).is_err());
        }
    }
}
