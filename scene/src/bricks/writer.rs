//! Puts bricks and ranges where they belong in an image.

use std::io::{self, Read, Seek, SeekFrom, Write};

use rayon::prelude::*;
use rt_core::Header;
use rt_core::image::Segment;
use rt_core::volume::{RANGE_BYTES, RANGES_PER_GROUP};
use xxhash_rust::xxh3::Xxh3;

use super::PrepareError;
use super::coder::{Coder, Encoded};
use super::slabs::Slab;
use super::tree::RangeTree;
use crate::build::{Progress, Stage};

/// An image being written.
pub(super) struct Bricks<'a, W> {
    pub(super) out: &'a mut W,
    /// Where the image begins in `out`.
    pub(super) start: u64,
    pub(super) header: Header,
    pub(super) coder: Coder,
    pub(super) tree: RangeTree,
    pub(super) progress: &'a (dyn Fn(Progress) + Sync),
    /// Bricks.
    pub(super) written: u64,
}

impl<W: Read + Write + Seek> Bricks<'_, W> {
    pub(super) fn write_slab(&mut self, slab: &Slab) -> Result<(), PrepareError> {
        self.coder.count(slab);
        let [columns, rows] = slab.bricks();
        let mut at: Vec<(u64, [u32; 3])> = (0..rows)
            .flat_map(|y| (0..columns).map(move |x| [x, y, slab.layer]))
            .filter_map(|at| Some((self.tree.brick(at)?, at)))
            .collect();
        at.sort_unstable();
        for batch in at.chunks(BATCH) {
            let coder = &self.coder;
            let encoded: Vec<Encoded> =
                batch.par_iter().map(|&(index, at)| coder.encode(slab, index, at)).collect();
            self.put(&encoded)?;
            for Encoded { at, low, high, .. } in encoded {
                self.tree.set(at, low, high);
            }
            self.written += batch.len() as u64;
            let total = self.tree.bricks;
            (self.progress)(Progress { stage: Stage::Write, done: self.written, total });
        }
        Ok(())
    }

    /// Writes bricks in ascending order, those that lie together at once.
    fn put(&mut self, bricks: &[Encoded]) -> io::Result<()> {
        for run in bricks.chunk_by(|a, b| a.index + 1 == b.index) {
            let bytes: Vec<u8> = run.iter().flat_map(|brick| brick.bytes.iter().copied()).collect();
            let size = bytes.len() as u64 / run.len() as u64;
            let offset = self.header.segments.bricks.offset + run[0].index * size;
            self.out.seek(SeekFrom::Start(self.start + offset))?;
            self.out.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Writes what is known only now: table, ranges, checksums, header.
    pub(super) fn finish(mut self) -> Result<Header, PrepareError> {
        self.tree.close();
        let segments = self.header.segments;
        let table = self.coder.table;
        self.write_at(segments.table.offset, bytemuck::bytes_of(&table))?;
        let mut groups = vec![0; usize::try_from(segments.ranges.bytes).unwrap_or(0)];
        for (group, branches) in groups.chunks_mut(4096).zip(self.tree.branches.chunks(RANGES_PER_GROUP)) {
            for (bytes, branch) in group.chunks_exact_mut(RANGE_BYTES).zip(branches) {
                bytes.copy_from_slice(bytemuck::bytes_of(branch));
            }
        }
        self.write_at(segments.ranges.offset, &groups)?;
        drop(groups);
        for segment in [segments.table, segments.ranges, segments.bricks] {
            self.pad(&segment)?;
        }
        self.header.segments.table.checksum = self.checksum(&segments.table)?;
        self.header.segments.ranges.checksum = self.checksum(&segments.ranges)?;
        self.header.segments.bricks.checksum = self.checksum(&segments.bricks)?;
        self.write_at(0, &self.header.emit())?;
        self.out.seek(SeekFrom::Start(self.start + self.header.image_bytes))?;
        self.out.flush()?;
        Ok(self.header)
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        self.out.seek(SeekFrom::Start(self.start + offset))?;
        self.out.write_all(bytes)
    }

    /// Fills the last page of a segment with zeros, whatever stood there.
    fn pad(&mut self, segment: &Segment) -> io::Result<()> {
        let end = segment.offset + segment.bytes;
        let rest = end.next_multiple_of(self.header.page_bytes.into()) - end;
        self.write_at(end, &vec![0; usize::try_from(rest).unwrap_or(0)])
    }

    fn checksum(&mut self, segment: &Segment) -> io::Result<u64> {
        self.out.seek(SeekFrom::Start(self.start + segment.offset))?;
        let (mut left, mut hash, mut buffer) = (segment.bytes, Xxh3::new(), vec![0; BUFFER_BYTES]);
        while left > 0 {
            let run = usize::try_from(left).unwrap_or(usize::MAX).min(BUFFER_BYTES);
            self.out.read_exact(&mut buffer[..run])?;
            hash.update(&buffer[..run]);
            left -= run as u64;
        }
        Ok(hash.digest())
    }
}

/// Bricks that are encoded before they are written.
const BATCH: usize = 4096;

const BUFFER_BYTES: usize = 1 << 20;
