//! The file of a trace.
//!
//! # Layout
//! The 8 bytes `MSVTRACE`; then numbers, each a `varint`; then the XXH3 checksum of everything before it, 8 bytes, little-endian.
//!
//! ```text
//! version = 1, page bytes, pages, nodes, width, height, frames,
//! then for each frame, for each node:
//!   tiles, then for each tile, in the order in which the node draws them:
//!     number of the tile, touches, then for each touch:
//!       page minus the page before (0 for the first of a tile), folded: 0, -1, 1, -2 .. are 0, 1, 2, 3 ..
//! ```

use core::fmt;
use std::fs;
use std::io::{self, Read, Write};
use std::path::Path;

use rt_core::TileId;
use xxhash_rust::xxh3::xxh3_64;

use super::{NodeFrame, Trace};
use crate::varint;

/// Why a file is no trace that can be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum TraceError {
    /// It cannot be read.
    Io(io::Error),
    /// It does not begin as traces do.
    NoTrace,
    /// It was written by another version.
    Version(u64),
    /// It was cut off, or changed: its checksum is another.
    Damaged,
    /// Its checksum is right, and it says what cannot be.
    Impossible {
        /// What is wrong.
        what: &'static str,
        /// The number that is.
        got: u64,
    },
}

const MAGIC: [u8; 8] = *b"MSVTRACE";
const VERSION: u64 = 1;
const CHECKSUM_BYTES: usize = 8;

/// A number that a file may hold at most where nothing else bounds it.
const COUNT_MAX: u64 = u32::MAX as u64;

impl Trace {
    /// Writes the trace.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        to.write_all(&self.to_bytes())
    }

    /// Reads and checks a trace.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn read(path: &Path) -> Result<Self, TraceError> {
        Self::from_bytes(&fs::read(path).map_err(TraceError::Io)?)
    }

    /// Whether a file begins as traces do.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn is_one(path: &Path) -> io::Result<bool> {
        let mut start = Vec::new();
        fs::File::open(path)?.take(MAGIC.len() as u64).read_to_end(&mut start)?;
        Ok(start == MAGIC)
    }

    /// The bytes of the file.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let [width, height] = self.size.map(u64::from);
        let (page_bytes, pages) = (u64::from(self.page_bytes), u64::from(self.page_count));
        let head = [VERSION, page_bytes, pages, self.nodes.into(), width, height, self.frames.len() as u64];
        head.into_iter().for_each(|number| varint::put(&mut bytes, number));
        for frame in self.frames.iter().flatten() {
            varint::put(&mut bytes, frame.tiles().len() as u64);
            for (TileId(tile), touches) in frame.tiles() {
                varint::put(&mut bytes, tile.into());
                varint::put(&mut bytes, touches.len() as u64);
                let mut before = 0;
                for page in touches {
                    varint::put(&mut bytes, varint::fold(i64::from(*page) - before));
                    before = i64::from(*page);
                }
            }
        }
        let checksum = xxh3_64(&bytes);
        bytes.extend(checksum.to_le_bytes());
        bytes
    }

    /// Reads and checks the bytes of a file.
    ///
    /// # Errors
    /// See [`TraceError`]. No bytes make it panic.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TraceError> {
        let rest = bytes.strip_prefix(&MAGIC).ok_or(TraceError::NoTrace)?;
        let mut numbers = Numbers { rest };
        let version = numbers.next()?;
        if version != VERSION {
            return Err(TraceError::Version(version));
        }
        let (body, checksum) = bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(TraceError::Damaged)?;
        if xxh3_64(body) != u64::from_le_bytes(*checksum) {
            return Err(TraceError::Damaged);
        }
        numbers.rest = numbers.rest.strip_suffix(checksum).ok_or(TraceError::Damaged)?;
        let trace = numbers.trace()?;
        match numbers.rest.len() as u64 {
            0 => Ok(trace),
            got => Err(TraceError::Impossible { what: "bytes behind the last tile", got }),
        }
    }
}

/// The numbers of a file that are not yet read.
struct Numbers<'a> {
    rest: &'a [u8],
}

impl Numbers<'_> {
    fn trace(&mut self) -> Result<Trace, TraceError> {
        let page_bytes = self.next_u32("length of a page")?;
        let page_count = self.next_u32("number of pages")?;
        let nodes = self.next_below(u64::from(u16::MAX) + 1, "number of nodes")?;
        let nodes = u16::try_from(nodes).unwrap_or(u16::MAX);
        let size = [self.next_u32("width")?, self.next_u32("height")?];
        let frames = self.next_below(COUNT_MAX, "number of frames")?;
        if page_count == 0 || nodes == 0 {
            return Err(TraceError::Impossible { what: "number of pages or nodes", got: 0 });
        }
        // Each node's frame takes a byte at least, so a short file cannot make this long.
        let mut trace = Trace { page_bytes, page_count, nodes, size, frames: Vec::new() };
        for _ in 0..frames {
            let frame = (0..nodes).map(|_| self.node_frame(page_count)).collect::<Result<_, _>>()?;
            trace.frames.push(frame);
        }
        Ok(trace)
    }

    fn node_frame(&mut self, page_count: u32) -> Result<NodeFrame, TraceError> {
        let mut frame = NodeFrame::default();
        let mut touches = Vec::new();
        for _ in 0..self.next_below(COUNT_MAX, "number of tiles")? {
            let tile = TileId(self.next_u32("number of a tile")?);
            touches.clear();
            let mut before = 0;
            for _ in 0..self.next_below(COUNT_MAX, "number of touches")? {
                let page = varint::unfold(self.next()?)
                    .checked_add(before)
                    .and_then(|page| u32::try_from(page).ok());
                let page = page.filter(|page| *page < page_count);
                let page = page.ok_or(TraceError::Impossible { what: "page outside the image", got: 0 })?;
                touches.push(page);
                before = i64::from(page);
            }
            frame.push(tile, &touches);
        }
        Ok(frame)
    }

    fn next_u32(&mut self, what: &'static str) -> Result<u32, TraceError> {
        let got = self.next()?;
        u32::try_from(got).map_err(|_| TraceError::Impossible { what, got })
    }

    fn next_below(&mut self, limit: u64, what: &'static str) -> Result<u64, TraceError> {
        let got = self.next()?;
        if got < limit { Ok(got) } else { Err(TraceError::Impossible { what, got }) }
    }

    fn next(&mut self) -> Result<u64, TraceError> {
        varint::take(&mut self.rest).ok_or(TraceError::Damaged)
    }
}

impl fmt::Display for TraceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "{error}"),
            Self::NoTrace => write!(f, "it is no page trace; record one with `memsavvy trace SCENE -o FILE`"),
            Self::Version(got) => {
                write!(
                    f,
                    "it is a page trace of version {got}, and this program reads {VERSION}; record it anew"
                )
            }
            Self::Damaged => write!(f, "the page trace was cut off or changed; record it anew"),
            Self::Impossible { what, got } => {
                write!(f, "the page trace contradicts itself: {what} {got}; record it anew")
            }
        }
    }
}

impl core::error::Error for TraceError {}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace() -> Trace {
        let mut frame = NodeFrame::default();
        frame.push(TileId(3), &[0, 900, 2, 0]);
        frame.push(TileId(0), &[]);
        frame.push(TileId(70_000), &[899, 900]);
        let frames = vec![vec![frame.clone(), NodeFrame::default()], vec![NodeFrame::default(), frame]];
        Trace { page_bytes: 16384, page_count: 901, nodes: 2, size: [640, 480], frames }
    }

    #[test]
    fn a_trace_reads_as_it_was_written() {
        let read = Trace::from_bytes(&trace().to_bytes()).unwrap();
        assert_eq!(read, trace());
        let tiles: Vec<_> = read.frames[0][0].tiles().collect();
        assert_eq!(tiles[0], (TileId(3), &[0, 900, 2, 0][..]));
        assert_eq!(tiles[2], (TileId(70_000), &[899, 900][..]));
        assert_eq!((read.touch_count(), read.distinct_pages()), (12, 4));
        assert_eq!((read.pages_per_node_frame(), read.pages_per_tile()), (2.0, 5.0 / 3.0));
    }

    #[test]
    fn no_cut_and_no_changed_byte_goes_unnoticed() {
        let bytes = trace().to_bytes();
        for length in 0..bytes.len() {
            assert!(Trace::from_bytes(&bytes[..length]).is_err(), "{length} bytes");
        }
        for index in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[index] ^= 1;
            assert!(Trace::from_bytes(&changed).is_err(), "byte {index}");
        }
    }

    #[test]
    fn what_cannot_be_is_refused_even_with_a_good_checksum() {
        let sealed = |numbers: &[u64]| {
            let mut bytes = MAGIC.to_vec();
            numbers.iter().for_each(|number| varint::put(&mut bytes, *number));
            let checksum = xxh3_64(&bytes);
            bytes.extend(checksum.to_le_bytes());
            Trace::from_bytes(&bytes).map_err(|error| error.to_string())
        };
        assert!(sealed(&[1, 4096, 9, 1, 16, 16, 1, 1, 0, 1, 16]).is_ok());
        for (numbers, why) in [
            (&[1, 4096, 9, 1, 16, 16, 1, 1, 0, 1, 18][..], "page outside"),
            (&[1, 4096, 9, 1, 16, 16, 1, 1, 0, 1, 1], "page outside"),
            (&[1, 4096, 9, 1, 16, 16, 1, 1, 0, 1, 16, 7], "bytes behind"),
            (&[1, 4096, 9, 0, 16, 16, 1], "nodes 0"),
            (&[1, 4096, 0, 1, 16, 16, 1], "nodes 0"),
            (&[1, 4096, 9, 65_536, 16, 16, 1], "nodes 65536"),
            (&[1, 1 << 40, 9, 1, 16, 16, 1], "length of a page"),
            (&[1, 4096, 9, 1, 16, 16, 1 << 31, 1], "cut off"),
            (&[2, 4096], "version 2"),
        ] {
            assert!(sealed(numbers).is_err_and(|error| error.contains(why)), "{numbers:?}: {why}");
        }
    }
}
