//! The header as bytes.

use bytemuck::{Pod, Zeroable};
use xxhash_rust::xxh3::xxh3_64;

use super::{
    Bounds, HEADER_BYTES, Header, HeaderError, MAGIC, SEGMENTS, Segment, SegmentKind, Segments, VERSION,
};
use crate::grid::GridShape;
use crate::needs::SceneNeeds;
use crate::volume::{SampleKind, Volume};

/// The header as it lies in the image. Fields that are zero in this version are reserved.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct RawHeader {
    magic: [u8; 8],
    version: u32,
    needs: u32,
    image_bytes: u64,
    triangles: u64,
    collapsed: u64,
    repeated: u64,
    vertices: u64,
    page_bytes: u32,
    primitives: u32,
    branches: u32,
    leaves: u32,
    clusters: u32,
    levels: u32,
    scale_exponent: i32,
    typical_edge: f32,
    bounds_low: [f32; 3],
    bounds_high: [f32; 3],
    grid_origin: [f32; 3],
    grid_size: f32,
    slack: f32,
    segment_count: u32,
    segments: [RawSegment; SEGMENTS_MAX],
    spheres: u64,
    view_low: [f32; 3],
    view_high: [f32; 3],
    volume: RawVolume,
    reserved: [[u64; 30]; 2],
    checksum: u64,
}

/// Zeros where there is no volume.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct RawVolume {
    dims: [u32; 3],
    sample: u32,
    origin: [f64; 3],
    spacing: [f64; 3],
    slope: f64,
    intercept: f64,
    low: f32,
    high: f32,
    levels: u32,
    reserved: u32,
    branches: u64,
    bricks: u64,
}

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct RawSegment {
    kind: u32,
    reserved: u32,
    offset: u64,
    bytes: u64,
    checksum: u64,
}

impl RawHeader {
    /// Reads a header of this version whose checksum is right.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, HeaderError> {
        let truncated = HeaderError::Truncated { needed: HEADER_BYTES, got: bytes.len() };
        let raw: Self = bytemuck::try_pod_read_unaligned(bytes).map_err(|_| truncated)?;
        if raw.version != VERSION {
            return Err(HeaderError::Version { found: raw.version });
        }
        if raw.checksum == raw.compute_checksum() { Ok(raw) } else { Err(HeaderError::Checksum) }
    }

    /// The header with its checksum.
    pub(super) fn encode(header: &Header) -> Self {
        let mut segments = [RawSegment::zeroed(); SEGMENTS_MAX];
        for (raw, (kind, segment)) in segments.iter_mut().zip(header.segments.in_order()) {
            *raw = RawSegment {
                kind: kind as u32,
                reserved: 0,
                offset: segment.offset,
                bytes: segment.bytes,
                checksum: segment.checksum,
            };
        }
        let mut raw = Self {
            magic: MAGIC,
            version: VERSION,
            needs: header.needs.bits(),
            image_bytes: header.image_bytes,
            triangles: header.triangles,
            collapsed: header.collapsed,
            repeated: header.repeated,
            vertices: header.vertices,
            page_bytes: header.page_bytes,
            primitives: header.primitives,
            branches: header.branches,
            leaves: header.leaves,
            clusters: header.clusters,
            levels: header.grid.levels,
            scale_exponent: header.scale_exponent,
            typical_edge: header.typical_edge,
            bounds_low: header.bounds.low.to_array(),
            bounds_high: header.bounds.high.to_array(),
            grid_origin: header.grid.origin.to_array(),
            grid_size: header.grid.size,
            slack: header.grid.slack,
            segment_count: segment_count(),
            segments,
            spheres: header.spheres,
            view_low: header.view.low.to_array(),
            view_high: header.view.high.to_array(),
            volume: header.volume.as_ref().map_or_else(RawVolume::zeroed, RawVolume::encode),
            reserved: [[0; 30]; 2],
            checksum: 0,
        };
        raw.checksum = raw.compute_checksum();
        raw
    }

    pub(super) fn decode(&self) -> Result<Header, HeaderError> {
        let needs = SceneNeeds::from_bits(self.needs).ok_or(HeaderError::Needs(self.needs))?;
        Ok(Header {
            page_bytes: self.page_bytes,
            image_bytes: self.image_bytes,
            needs,
            volume: needs.contains(SceneNeeds::VOLUME).then(|| self.volume.decode()).transpose()?,
            triangles: self.triangles,
            spheres: self.spheres,
            collapsed: self.collapsed,
            repeated: self.repeated,
            vertices: self.vertices,
            primitives: self.primitives,
            branches: self.branches,
            leaves: self.leaves,
            clusters: self.clusters,
            bounds: Bounds { low: self.bounds_low.into(), high: self.bounds_high.into() },
            view: Bounds { low: self.view_low.into(), high: self.view_high.into() },
            grid: GridShape {
                origin: self.grid_origin.into(),
                size: self.grid_size,
                slack: self.slack,
                levels: self.levels,
            },
            typical_edge: self.typical_edge,
            scale_exponent: self.scale_exponent,
            segments: self.decode_segments()?,
        })
    }

    fn decode_segments(&self) -> Result<Segments, HeaderError> {
        let listed =
            self.segments.get(..self.segment_count as usize).ok_or(HeaderError::Grid("segment count"))?;
        let known = Segments::default().in_order().map(|(kind, _)| kind as u32);
        if let Some(raw) = listed.iter().find(|raw| !known.contains(&raw.kind)) {
            return Err(HeaderError::UnknownSegment(raw.kind));
        }
        let find = |kind: SegmentKind| {
            let mut matching = listed.iter().filter(|raw| raw.kind == kind as u32);
            match (matching.next(), matching.next()) {
                (Some(raw), None) => {
                    Ok(Segment { offset: raw.offset, bytes: raw.bytes, checksum: raw.checksum })
                }
                _ => Err(HeaderError::Segment(kind)),
            }
        };
        Ok(Segments {
            branches: find(SegmentKind::Branches)?,
            leaves: find(SegmentKind::Leaves)?,
            clusters: find(SegmentKind::Clusters)?,
            ids: find(SegmentKind::Ids)?,
            table: find(SegmentKind::Table)?,
            ranges: find(SegmentKind::Ranges)?,
            bricks: find(SegmentKind::Bricks)?,
        })
    }

    fn compute_checksum(&self) -> u64 {
        xxh3_64(&bytemuck::bytes_of(self)[..HEADER_BYTES - size_of::<u64>()])
    }
}

impl RawVolume {
    fn encode(volume: &Volume) -> Self {
        let &Volume { dims, sample, levels, origin, spacing, slope, intercept, low, high, branches, bricks } =
            volume;
        Self {
            dims,
            sample: sample as u32,
            origin,
            spacing,
            slope,
            intercept,
            low,
            high,
            levels,
            reserved: 0,
            branches,
            bricks,
        }
    }

    fn decode(&self) -> Result<Volume, HeaderError> {
        let &Self {
            dims,
            sample,
            origin,
            spacing,
            slope,
            intercept,
            low,
            high,
            levels,
            branches,
            bricks,
            ..
        } = self;
        let sample = SampleKind::from_bits(sample).ok_or(HeaderError::Grid("samples"))?;
        Ok(Volume { dims, sample, levels, origin, spacing, slope, intercept, low, high, branches, bricks })
    }
}

const fn segment_count() -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "a handful")]
    let count = SEGMENTS as u32;
    count
}

/// Room in the directory.
const SEGMENTS_MAX: usize = 8;
