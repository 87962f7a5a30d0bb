//! Lays a scene out in pages and writes its image.

use core::ops::Range;
use core::{fmt, iter};
use std::io::{self, Cursor, Seek, SeekFrom, Write};

use rayon::prelude::*;
use rt_core::Header;
use rt_core::cluster::{cluster_bytes, quads};
use rt_core::grid::{Branch, Leaf};
use rt_core::image::{CLUSTER_BYTES_MAX, PAGE_BYTES_MAX, PAGE_BYTES_MIN, Segment, Segments};
use rt_core::sphere::{Sphere, spheres_bytes};
use xxhash_rust::xxh3::Xxh3;

use crate::build::{Progress, Scene, Stage, VertexSet};

/// Why an image could not be written.
#[derive(Debug)]
#[non_exhaustive]
pub enum WriteError {
    /// The page size is no power of two from 4 KB to 2 MB.
    PageBytes(u32),
    /// More bytes of clusters than leaves can address.
    TooLarge {
        /// Length of the cluster segment.
        bytes: u64,
    },
    /// The file could not be written.
    Io(io::Error),
}

impl Scene {
    /// Writes the image with pages of `page_bytes`, and returns its header.
    ///
    /// The header is written last: until then its page is zero, so half an image is not taken for one. Order
    /// and contents of the records do not depend on the page size, only their places do.
    ///
    /// # Errors
    /// When the page size is impossible, the scene is too large to address, or `out` fails.
    pub fn write<W: Write + Seek>(
        &self,
        page_bytes: u32,
        out: &mut W,
        progress: &(dyn Fn(Progress) + Sync),
    ) -> Result<Header, WriteError> {
        let start = out.stream_position()?;
        let header = self.write_primitives(page_bytes, out, progress)?;
        out.seek(SeekFrom::Start(start))?;
        out.write_all(&header.emit())?;
        out.seek(SeekFrom::Start(start + header.image_bytes))?;
        out.flush()?;
        Ok(header)
    }

    /// Writes everything but the header, of whose page it leaves zeros.
    pub(crate) fn write_primitives<W: Write>(
        &self,
        page_bytes: u32,
        out: &mut W,
        progress: &(dyn Fn(Progress) + Sync),
    ) -> Result<Header, WriteError> {
        let layout = Layout::new(self, page_bytes)?;
        let mut header = layout.header(self);
        let mut pages = Pages { out, position: 0, hash: Xxh3::new() };
        let segments = &mut header.segments;
        pages.whole_segment(&mut segments.branches, bytemuck::cast_slice(&self.tree.branches))?;
        pages.whole_segment(&mut segments.leaves, bytemuck::cast_slice(&layout.placed_leaves(self)))?;
        pages.begin(&segments.clusters)?;
        self.write_clusters(&layout, &mut pages, progress)?;
        segments.clusters.checksum = pages.hash.digest();
        pages.whole_segment(&mut segments.ids, bytemuck::cast_slice(&self.tree.ids))?;
        for unused in [&mut segments.table, &mut segments.ranges, &mut segments.bricks] {
            pages.whole_segment(unused, &[])?;
        }
        pages.pad_to(header.image_bytes)?;
        Ok(header)
    }

    /// The image in memory.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn to_bytes(&self, page_bytes: u32) -> Result<Vec<u8>, WriteError> {
        let mut bytes = Cursor::new(Vec::new());
        self.write(page_bytes, &mut bytes, &|_| {})?;
        Ok(bytes.into_inner())
    }

    /// The header that an image with pages of `page_bytes` will have, but for the checksums of its segments.
    ///
    /// # Errors
    /// When the page size is impossible or the scene is too large to address.
    pub fn header(&self, page_bytes: u32) -> Result<Header, WriteError> {
        Ok(Layout::new(self, page_bytes)?.header(self))
    }

    fn write_clusters<W: Write>(
        &self,
        layout: &Layout,
        pages: &mut Pages<'_, W>,
        progress: &(dyn Fn(Progress) + Sync),
    ) -> Result<(), WriteError> {
        let clusters = self.tree.clusters.len();
        let total = self.tree.ids.len() as u64;
        let chunks: Vec<Range<usize>> =
            (0..clusters).step_by(CHUNK).map(|first| first..clusters.min(first + CHUNK)).collect();
        for batch in chunks.chunks(BATCH) {
            let encoded: Vec<Vec<u8>> =
                batch.par_iter().map(|chunk| self.encode_clusters(layout, chunk.clone())).collect();
            for bytes in &encoded {
                pages.put(bytes)?;
            }
            let next = batch.last().and_then(|chunk| self.tree.clusters.get(chunk.end));
            let done = next.map_or(total, |&leaf| u64::from(self.tree.leaves[leaf as usize].first));
            progress(Progress { stage: Stage::Write, done, total });
        }
        Ok(())
    }

    /// The bytes from the first of some clusters to the first after them.
    fn encode_clusters(&self, layout: &Layout, clusters: Range<usize>) -> Vec<u8> {
        let start = layout.start_of(clusters.start);
        let mut bytes = Vec::new();
        let mut vertices = VertexSet::new();
        for cluster in clusters.clone() {
            bytes.resize(length(start, layout.start_of(cluster)), 0);
            let leaf = &self.tree.leaves[self.tree.clusters[cluster] as usize];
            let ids = &self.tree.ids[leaf.first as usize..][..usize::from(leaf.count)];
            if leaf.vertices == Leaf::SPHERES {
                self.encode_spheres(ids, &mut bytes);
            } else {
                self.encode_triangles(leaf, ids, &mut vertices, &mut bytes);
            }
        }
        bytes.resize(length(start, layout.start_of(clusters.end)), 0);
        bytes
    }

    /// Appends one cluster of spheres, as laid down in [`rt_core::sphere`].
    fn encode_spheres(&self, ids: &[u32], bytes: &mut Vec<u8>) {
        let first = self.model.mesh.triangles.len();
        let spheres = ids.iter().map(|&id| self.model.spheres[id as usize - first]);
        let lanes: Vec<Sphere> = spheres.collect();
        let padding = quads(u8::try_from(ids.len()).unwrap_or(u8::MAX)) - lanes.len();
        let last = lanes.last().copied().unwrap_or_default();
        let lane = |of: fn(&Sphere) -> f32| {
            let padded = lanes.iter().chain(iter::repeat_n(&last, padding));
            padded.flat_map(move |sphere| of(sphere).to_le_bytes()).collect::<Vec<u8>>()
        };
        bytes.extend(lane(|sphere| sphere.centre.x));
        bytes.extend(lane(|sphere| sphere.centre.y));
        bytes.extend(lane(|sphere| sphere.centre.z));
        bytes.extend(lane(|sphere| sphere.radius));
    }

    /// Appends one cluster of triangles, as laid down in [`rt_core::cluster`].
    fn encode_triangles(&self, leaf: &Leaf, ids: &[u32], vertices: &mut VertexSet, bytes: &mut Vec<u8>) {
        vertices.clear();
        let mut indices = [[0_u8; 64]; 3];
        for (i, &id) in ids.iter().enumerate() {
            for (axis, vertex) in self.model.mesh.triangles[id as usize].into_iter().enumerate() {
                indices[axis][i] = vertices.insert(self.model.mesh.positions[vertex as usize]).unwrap_or(0);
            }
        }
        for axis in 0..3 {
            let last = vertices.points().last();
            for point in vertices
                .points()
                .chain(iter::repeat_with(|| last.unwrap_or_default()))
                .take(quads(leaf.vertices))
            {
                bytes.extend_from_slice(&point[axis].to_le_bytes());
            }
        }
        for corner in &indices {
            bytes.extend_from_slice(&corner[..quads(leaf.count)]);
        }
    }
}

/// Where everything lies for one page size.
struct Layout {
    page_bytes: u32,
    /// Place of each cluster in its segment, in address order, in units of 16 bytes; then the end of the
    /// last.
    clusters: Vec<u64>,
}

impl Layout {
    fn new(scene: &Scene, page_bytes: u32) -> Result<Self, WriteError> {
        if !page_bytes.is_power_of_two() || !(PAGE_BYTES_MIN..=PAGE_BYTES_MAX).contains(&page_bytes) {
            return Err(WriteError::PageBytes(page_bytes));
        }
        let page = u64::from(page_bytes);
        let mut end = 0_u64;
        let mut clusters = Vec::with_capacity(scene.tree.clusters.len() + 1);
        for &leaf in &scene.tree.clusters {
            let leaf = &scene.tree.leaves[leaf as usize];
            let bytes = bytes_of_cluster(leaf) as u64;
            let start = if end % page + bytes > page { end.next_multiple_of(page) } else { end };
            clusters.push(start / 16);
            end = start + bytes;
        }
        clusters.push(end / 16);
        if end > CLUSTER_BYTES_MAX {
            Err(WriteError::TooLarge { bytes: end })
        } else {
            Ok(Self { page_bytes, clusters })
        }
    }

    /// Offset of a cluster in its segment, by its number in address order.
    fn start_of(&self, cluster: usize) -> u64 {
        self.clusters[cluster] * 16
    }

    /// The leaves of the scene with the places of their clusters.
    fn placed_leaves(&self, scene: &Scene) -> Vec<Leaf> {
        let mut leaves = scene.tree.leaves.clone();
        for (&leaf, &place) in scene.tree.clusters.iter().zip(&self.clusters) {
            leaves[leaf as usize].cluster = u32::try_from(place).unwrap_or(0);
        }
        leaves
    }

    fn header(&self, scene: &Scene) -> Header {
        let page = u64::from(self.page_bytes);
        let mut end = page;
        let mut segment = |bytes: u64| {
            let offset = end;
            end = (offset + bytes).next_multiple_of(page);
            Segment { offset, bytes, checksum: 0 }
        };
        let tree = &scene.tree;
        let segments = Segments {
            branches: segment(size_of_val::<[Branch]>(&tree.branches) as u64),
            leaves: segment(size_of_val::<[Leaf]>(&tree.leaves) as u64),
            clusters: segment(self.start_of(tree.clusters.len())),
            ids: segment(size_of_val::<[u32]>(&tree.ids) as u64),
            table: segment(0),
            ranges: segment(0),
            bricks: segment(0),
        };
        let count = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        Header {
            page_bytes: self.page_bytes,
            image_bytes: end,
            volume: None,
            needs: scene.needs,
            triangles: scene.model.mesh.triangles.len() as u64,
            spheres: scene.model.spheres.len() as u64,
            collapsed: scene.collapsed,
            repeated: scene.repeated,
            vertices: scene.model.mesh.positions.len() as u64,
            primitives: count(tree.ids.len()),
            branches: count(tree.branches.len()),
            leaves: count(tree.leaves.len()),
            clusters: count(tree.clusters.len()),
            bounds: scene.bounds,
            view: scene.model.view.unwrap_or(scene.bounds),
            grid: scene.grid,
            typical_edge: scene.typical_edge,
            scale_exponent: scene.scale_exponent,
            segments,
        }
    }
}

/// Writes segments at their places, with zeros between them, and hashes them.
struct Pages<'w, W> {
    out: &'w mut W,
    position: u64,
    hash: Xxh3,
}

impl<W: Write> Pages<'_, W> {
    fn whole_segment(&mut self, segment: &mut Segment, bytes: &[u8]) -> io::Result<()> {
        self.begin(segment)?;
        self.put(bytes)?;
        segment.checksum = self.hash.digest();
        Ok(())
    }

    fn begin(&mut self, segment: &Segment) -> io::Result<()> {
        self.hash.reset();
        self.pad_to(segment.offset)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hash.update(bytes);
        self.position += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    fn pad_to(&mut self, position: u64) -> io::Result<()> {
        let zeros = [0; 4096];
        while self.position < position {
            let run = usize::try_from(position - self.position).unwrap_or(usize::MAX).min(zeros.len());
            self.out.write_all(&zeros[..run])?;
            self.position += run as u64;
        }
        Ok(())
    }
}

impl fmt::Display for WriteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PageBytes(bytes) => {
                write!(f, "a page of {bytes} bytes: it must be a power of two from 4 KB to 2 MB")
            }
            Self::TooLarge { bytes } => {
                write!(f, "the scene has {bytes} bytes of clusters; an image holds 32 GB of them")
            }
            Self::Io(error) => write!(f, "cannot write the image: {error}"),
        }
    }
}

impl core::error::Error for WriteError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        if let Self::Io(error) = self { Some(error) } else { None }
    }
}

impl From<io::Error> for WriteError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Length of the record of the cluster that a leaf names.
const fn bytes_of_cluster(leaf: &Leaf) -> usize {
    if leaf.vertices == Leaf::SPHERES {
        spheres_bytes(leaf.count)
    } else {
        cluster_bytes(leaf.vertices, leaf.count)
    }
}

/// Distance between two places of one chunk of clusters.
fn length(from: u64, to: u64) -> usize {
    usize::try_from(to - from).unwrap_or(usize::MAX)
}

/// Clusters that one thread encodes at a time.
const CHUNK: usize = 256;

/// Chunks that are encoded before they are written; bounds the memory of a write at some 10 MB.
const BATCH: usize = 64;
