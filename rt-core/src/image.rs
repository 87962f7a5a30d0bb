//! The header of a scene image: page 0 of the shared address space.
//!
//! An image is one file, position-independent, little-endian: the header page, then segments that begin at
//! page boundaries.
//!
//! - *branches*: [`Branch`](crate::grid::Branch), 32 bytes each, depth first: the children of a branch
//!   together, then what is below each of them;
//! - *leaves*: [`Leaf`](crate::grid::Leaf), 16 bytes each, by branch; its lists after its runs;
//! - *clusters*: see [`cluster`](crate::cluster) and [`sphere`](crate::sphere), in Morton order of space, depth
//!   first: the *address order*;
//! - *ids*: a `u32` for each triangle and sphere in address order, its number in the model: triangles first,
//!   spheres after the last triangle;
//! - *table*: the [`VolumeTable`](crate::volume::VolumeTable) of a volume, one record;
//! - *ranges*: [`RangeBranch`](crate::volume::RangeBranch), 144 bytes each, depth first like branches;
//! - *bricks*: see [`volume`](crate::volume), in Morton order.
//!
//! Segments of what a scene does not have are empty and take no page.
//!
//! No record crosses a page of `page_bytes`. A run may use any larger power of two as its page.

mod raw;
#[cfg(test)]
mod tests;

use core::fmt;

use glam::Vec3;

use crate::grid::{BRANCH_BYTES, GridShape, LEAF_BYTES, LEVELS_MAX};
use crate::needs::SceneNeeds;
use crate::scale::{Scale, power_of_two};
use crate::volume::{TABLE_BYTES, Volume, ranges_bytes};
use raw::RawHeader;

/// The checked header of a scene image.
///
/// # Invariants
/// After [`parse`](Self::parse): every segment lies inside the image, page-aligned, behind the header page,
/// apart from the others, and is as long as its count says; lengths of the grid are finite and in range. What
/// the segments themselves say is not checked here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// No record crosses a page of this size; a power of two, 4 KB to 2 MB.
    pub page_bytes: u32,
    /// Length of the image, a multiple of `page_bytes`.
    pub image_bytes: u64,
    /// What the scene uses.
    pub needs: SceneNeeds,
    /// Triangles of the mesh, collapsed ones included.
    pub triangles: u64,
    /// Spheres, those without a radius included.
    pub spheres: u64,
    /// Triangles and spheres that no ray can hit, since two of their corners are the same point or their radius
    /// is 0; they are not stored.
    pub collapsed: u64,
    /// Triangles and spheres that repeat an earlier one, corner for corner; they could never win a tie, and are
    /// not stored.
    pub repeated: u64,
    /// Vertices of the mesh, unused ones included.
    pub vertices: u64,
    /// Triangles and spheres stored in clusters; the excess over `triangles + spheres - collapsed - repeated` is
    /// duplication.
    pub primitives: u32,
    /// Records in the branch segment.
    pub branches: u32,
    /// Records in the leaf segment.
    pub leaves: u32,
    /// Clusters; the leaves that are not lists.
    pub clusters: u32,
    /// The volume, if there is one.
    pub volume: Option<Volume>,
    /// Bounds of all vertices of the mesh, of all spheres and of the volume, in world units.
    pub bounds: Bounds,
    /// What cameras look at, in world units: the bounds, unless the model says otherwise.
    pub view: Bounds,
    /// Where the grid lies, in grid units.
    pub grid: GridShape,
    /// Length of a typical triangle edge, or diameter of a typical sphere, in grid units.
    pub typical_edge: f32,
    /// Grid units are world units times `2^scale_exponent`.
    pub scale_exponent: i32,
    /// Where the segments lie.
    pub segments: Segments,
}

/// A box in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lowest corner.
    pub low: Vec3,
    /// Highest corner.
    pub high: Vec3,
}

/// The segments of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Segments {
    /// Branches of the grid, the root first.
    pub branches: Segment,
    /// Leaves of the grid.
    pub leaves: Segment,
    /// Clusters of triangles and of spheres.
    pub clusters: Segment,
    /// Number in the model of each primitive.
    pub ids: Segment,
    /// What the ranges of a volume count in.
    pub table: Segment,
    /// Tree of a volume's ranges, the root first.
    pub ranges: Segment,
    /// Samples of a volume.
    pub bricks: Segment,
}

/// A run of bytes in the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Segment {
    /// Where it begins, a multiple of the page size.
    pub offset: u64,
    /// Its length, without the padding of its last page.
    pub bytes: u64,
    /// XXH3-64 of its bytes.
    pub checksum: u64,
}

/// Names a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SegmentKind {
    /// Branches of the grid.
    Branches = 1,
    /// Leaves of the grid.
    Leaves = 2,
    /// Clusters of triangles and of spheres.
    Clusters = 3,
    /// Original ids.
    Ids = 4,
    /// What ranges count in.
    Table = 5,
    /// Tree of ranges.
    Ranges = 6,
    /// Bricks of samples.
    Bricks = 7,
}

/// Why bytes were refused as the header of a scene image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum HeaderError {
    /// Fewer bytes than a header.
    Truncated {
        /// Bytes of a header.
        needed: usize,
        /// Bytes there are.
        got: usize,
    },
    /// The first bytes are not those of a scene image.
    NotAnImage,
    /// An image of another version of the format.
    Version {
        /// Version of the image.
        found: u32,
    },
    /// The header's bytes do not match its checksum.
    Checksum,
    /// The image is shorter than its header says.
    Length {
        /// Length by the header.
        declared: u64,
        /// Bytes there are.
        got: u64,
    },
    /// The page size is no power of two from 4 KB to 2 MB, or does not divide the image.
    PageBytes(u32),
    /// The scene uses something that this version does not know.
    Needs(u32),
    /// The scene uses something that was left out of this build.
    LeftOut(SceneNeeds),
    /// A kind of segment that this build does not know.
    UnknownSegment(u32),
    /// A segment is absent or there twice.
    Segment(SegmentKind),
    /// A segment begins inside a page, or overlaps another, or the header, or the end of the image.
    SegmentPlace(SegmentKind),
    /// A segment's length does not follow from the counts.
    SegmentLength(SegmentKind),
    /// A length or count of the grid is out of range; which one.
    Grid(&'static str),
}

impl Header {
    /// Reads and checks a header from the first bytes of an image of `image_length` bytes.
    ///
    /// # Errors
    /// Says what is wrong first, from the outside in: too short, foreign, another version, corrupt,
    /// inconsistent.
    pub fn parse(bytes: &[u8], image_length: u64) -> Result<Self, HeaderError> {
        let magic = bytes
            .get(..MAGIC.len())
            .ok_or(HeaderError::Truncated { needed: HEADER_BYTES, got: bytes.len() })?;
        if magic != MAGIC {
            return Err(HeaderError::NotAnImage);
        }
        let bytes = bytes
            .get(..HEADER_BYTES)
            .ok_or(HeaderError::Truncated { needed: HEADER_BYTES, got: bytes.len() })?;
        let header = RawHeader::read(bytes)?.decode()?;
        if header.image_bytes > image_length {
            return Err(HeaderError::Length { declared: header.image_bytes, got: image_length });
        }
        header.check()?;
        Ok(header)
    }

    /// The bytes of this header, checksum included.
    pub fn emit(&self) -> [u8; HEADER_BYTES] {
        bytemuck::cast(RawHeader::encode(self))
    }

    /// The scale from world units to grid units.
    pub const fn scale(&self) -> Scale {
        Scale::new(self.scale_exponent)
    }

    fn check(&self) -> Result<(), HeaderError> {
        let left_out = self.needs.without(SceneNeeds::BUILT);
        if left_out != SceneNeeds::NONE {
            return Err(HeaderError::LeftOut(left_out));
        }
        let page = u64::from(self.page_bytes);
        if !self.page_bytes.is_power_of_two()
            || !(PAGE_BYTES_MIN..=PAGE_BYTES_MAX).contains(&self.page_bytes)
            || !self.image_bytes.is_multiple_of(page)
        {
            return Err(HeaderError::PageBytes(self.page_bytes));
        }
        self.check_grid()?;
        self.check_segments(page)
    }

    fn check_segments(&self, page: u64) -> Result<(), HeaderError> {
        let mut free = page;
        for (kind, segment) in self.segments.in_order() {
            let end = segment.offset.checked_add(segment.bytes).ok_or(HeaderError::SegmentPlace(kind))?;
            if segment.offset < free || !segment.offset.is_multiple_of(page) || end > self.image_bytes {
                return Err(HeaderError::SegmentPlace(kind));
            }
            free = end;
        }
        let lengths = [
            (
                SegmentKind::Branches,
                self.segments.branches.bytes == u64::from(self.branches) * BRANCH_BYTES as u64,
            ),
            (SegmentKind::Leaves, self.segments.leaves.bytes == u64::from(self.leaves) * LEAF_BYTES as u64),
            (SegmentKind::Clusters, self.segments.clusters.bytes <= CLUSTER_BYTES_MAX),
            (SegmentKind::Ids, self.segments.ids.bytes == u64::from(self.primitives) * 4),
            (SegmentKind::Table, self.segments.table.bytes == self.volume.map_or(0, |_| TABLE_BYTES as u64)),
            (
                SegmentKind::Ranges,
                self.segments.ranges.bytes == self.volume.map_or(0, |v| ranges_bytes(v.branches)),
            ),
            (
                SegmentKind::Bricks,
                self.segments.bricks.bytes == self.volume.map_or(0, |v| v.brick_offset(v.bricks)),
            ),
        ];
        lengths
            .into_iter()
            .find(|(_, right)| !right)
            .map_or(Ok(()), |(kind, _)| Err(HeaderError::SegmentLength(kind)))
    }

    fn check_grid(&self) -> Result<(), HeaderError> {
        let grid = &self.grid;
        let size_ok = grid.size.is_normal() && grid.size.to_bits().trailing_zeros() >= 23;
        let checks = [
            ("size", size_ok && (power_of_two(-20)..=power_of_two(3)).contains(&grid.size)),
            ("origin", grid.origin.is_finite() && grid.origin.abs().max_element() <= 8.0),
            ("slack", (0.0..=grid.size).contains(&grid.slack)),
            ("levels", (1..=LEVELS_MAX).contains(&(grid.levels as usize))),
            ("typical edge", self.typical_edge.is_finite() && self.typical_edge >= 0.0),
            ("scale", self.scale_exponent.abs() <= SCALE_EXPONENT_MAX),
            ("bounds", self.bounds.is_proper()),
            ("view", self.view.is_proper()),
            ("branches", self.branches > 0 || !self.needs.has_primitives()),
            ("volume", self.volume.is_none_or(|volume| volume.is_proper())),
        ];
        checks.into_iter().find(|(_, right)| !right).map_or(Ok(()), |(name, _)| Err(HeaderError::Grid(name)))
    }
}

impl Bounds {
    /// Whether both corners are finite and in order.
    pub fn is_proper(&self) -> bool {
        self.low.is_finite() && self.high.is_finite() && self.low.cmple(self.high).all()
    }
}

impl Segments {
    /// The segments with their kinds, in the order in which they lie in the image.
    pub const fn in_order(&self) -> [(SegmentKind, Segment); SEGMENTS] {
        [
            (SegmentKind::Branches, self.branches),
            (SegmentKind::Leaves, self.leaves),
            (SegmentKind::Clusters, self.clusters),
            (SegmentKind::Ids, self.ids),
            (SegmentKind::Table, self.table),
            (SegmentKind::Ranges, self.ranges),
            (SegmentKind::Bricks, self.bricks),
        ]
    }
}

impl fmt::Display for SegmentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Branches => "branches",
            Self::Leaves => "leaves",
            Self::Clusters => "clusters",
            Self::Ids => "ids",
            Self::Table => "table",
            Self::Ranges => "ranges",
            Self::Bricks => "bricks",
        })
    }
}

impl fmt::Display for HeaderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { needed, got } => {
                write!(f, "cut short: {got} bytes, the header alone has {needed}")
            }
            Self::NotAnImage => write!(f, "not a scene image: the first bytes are not its signature"),
            Self::Version { found } => write!(
                f,
                "scene image of format {found}; this build reads format {VERSION}, prepare it again"
            ),
            Self::Checksum => write!(f, "corrupt: the header does not match its checksum"),
            Self::Length { declared, got } => write!(f, "cut short: {got} bytes of {declared}"),
            Self::PageBytes(bytes) => write!(f, "inconsistent header: page size {bytes}"),
            Self::Needs(bits) => {
                write!(f, "the scene uses something this build does not know (bits {bits:#x})")
            }
            Self::LeftOut(needs) => {
                write!(f, "the scene needs {needs}, and this build was made without; enable the feature")
            }
            Self::UnknownSegment(kind) => write!(f, "inconsistent header: segment of unknown kind {kind}"),
            Self::Segment(kind) => write!(f, "inconsistent header: segment {kind} is not there exactly once"),
            Self::SegmentPlace(kind) => {
                write!(f, "inconsistent header: segment {kind} does not lie where it may")
            }
            Self::SegmentLength(kind) => write!(f, "inconsistent header: length of segment {kind}"),
            Self::Grid(what) => write!(f, "inconsistent header: {what} of the grid or volume"),
        }
    }
}

impl core::error::Error for HeaderError {}

/// First bytes of every scene image.
pub const MAGIC: [u8; 8] = *b"MEMSAVVY";

/// Version of the format that this build reads and writes.
pub const VERSION: u32 = 3;

/// Segments of an image, empty ones included.
pub const SEGMENTS: usize = 7;

/// Length of the header in bytes; the rest of page 0 is zero.
pub const HEADER_BYTES: usize = size_of::<RawHeader>();

/// Smallest page of an image.
pub const PAGE_BYTES_MIN: u32 = 4 << 10;

/// Largest page of an image.
pub const PAGE_BYTES_MAX: u32 = 2 << 20;

/// Longest cluster segment that a [`Leaf`](crate::grid::Leaf) can address.
pub const CLUSTER_BYTES_MAX: u64 = 1 << 35;

/// Largest exponent, either way, of the scale from world to grid units: meshes from 2^-100 to 2^100 in their
/// largest coordinate.
///
/// The rest of the range of `f32` is head-room for eyes and lights outside the mesh.
pub const SCALE_EXPONENT_MAX: i32 = 100;

const _: () = assert!(HEADER_BYTES == 1024 && HEADER_BYTES <= PAGE_BYTES_MIN as usize);
