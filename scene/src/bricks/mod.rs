//! Writes volumes into scene images: bricks, the tree of their ranges, and what the ranges count in.
//!
//! A volume is read twice, a layer of bricks at a time: once to learn the range of its samples, how they are spread
//! and which bricks show anything ([`survey`]); then, with places and storage known, to write the bricks where they
//! belong. In memory are eight slices as single-precision numbers, one bit for each brick, and the tree: about 3 bytes
//! for each brick that is stored.

mod coder;
mod error;
mod slabs;
mod survey;
#[cfg(test)]
mod tests;
mod tree;
mod writer;

use std::io::{Read, Seek, Write};

use rt_core::image::Segment;
use rt_core::scale::exponent_of;
use rt_core::volume::{SAMPLES_MAX, SampleKind, TABLE_BYTES, Volume, levels_for, ranges_bytes};
use rt_core::{Bounds, Header, SceneNeeds};

pub use error::PrepareError;

use crate::build::{Progress, Scene};
use crate::volume::{Storage, StoredType, VolumeSource};
use coder::Coder;
use slabs::for_each_slab;
use survey::Survey;
use tree::RangeTree;
use writer::Bricks;

impl Scene {
    /// A scene without triangles and spheres, in which a volume with these bounds can lie.
    fn around(bounds: &Bounds) -> Self {
        let largest = bounds.low.abs().max(bounds.high.abs()).max_element();
        Self::without_primitives(*bounds, -exponent_of(largest))
    }
}

/// Writes the image of a volume, and of a scene of triangles and spheres that it stands in, with pages of `page_bytes`;
/// returns its header. Samples are stored as asked, or in the smallest type that loses nothing.
///
/// What stands in `out` before is overwritten from the current position on. The header is written last: until then its
/// page is zero, so half an image is not taken for one.
///
/// # Errors
/// When the volume cannot be read or is too large, the page size is impossible, or `out` fails.
pub fn write_volume<W: Read + Write + Seek>(
    source: &mut dyn VolumeSource,
    scene: Option<&Scene>,
    stored: Option<StoredType>,
    page_bytes: u32,
    out: &mut W,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Header, PrepareError> {
    let shape = source.shape().clone();
    let dims = shape.dims.map(|count| u32::try_from(count).ok().filter(|count| *count <= SAMPLES_MAX));
    let [Some(x), Some(y), Some(z)] = dims else {
        return Err(PrepareError::TooLong { samples: shape.dims.into_iter().max().unwrap_or(0) });
    };
    let dims = [x, y, z];
    let survey = Survey::of(source, dims)?;
    let storage = match stored {
        Some(stored) => Storage::asked(&shape, stored, &survey.range())?,
        None => lossless(source, &survey),
    };
    let tree = RangeTree::over(&survey, levels_for(dims));
    let table = survey.table(&storage);
    let range = survey.range();
    drop(survey);
    let volume = Volume {
        dims,
        sample: kind_of(storage.stored),
        levels: tree.levels,
        origin: shape.origin,
        spacing: shape.spacing,
        slope: storage.world.slope,
        intercept: storage.world.intercept,
        low: storage.encode(range.low),
        high: storage.encode(range.high),
        branches: tree.branches.len() as u64,
        bricks: tree.bricks,
    };
    let bounds = volume.bounds().ok_or(PrepareError::OutOfRange)?;
    let alone = scene.is_none().then(|| Scene::around(&bounds));
    let Some(scene) = scene.or(alone.as_ref()) else { return Err(PrepareError::OutOfRange) };

    let start = out.stream_position()?;
    let mut header = scene.write_primitives(page_bytes, out, progress)?;
    add_volume(&mut header, volume, &bounds, scene.model.view.is_none());
    let mut writer =
        Bricks { out, start, header, coder: Coder { storage, table }, tree, progress, written: 0 };
    for_each_slab(source, dims, |slab| writer.write_slab(slab))?;
    writer.finish()
}

/// The storage that loses nothing; whole numbers in as many bits as their range needs.
fn lossless(source: &dyn VolumeSource, survey: &Survey) -> Storage {
    let range = survey.range();
    // Only in single precision a sample can be absent.
    Storage::lossless(source.shape(), range.is_finite.then_some(&range))
}

/// Enters a volume into the header of an image, with its segments behind all others.
fn add_volume(header: &mut Header, volume: Volume, bounds: &Bounds, is_view: bool) {
    let page = u64::from(header.page_bytes);
    let mut end = header.image_bytes;
    let mut segment = |bytes: u64| {
        let offset = end;
        end = (offset + bytes).next_multiple_of(page);
        Segment { offset, bytes, checksum: 0 }
    };
    header.segments.table = segment(TABLE_BYTES as u64);
    header.segments.ranges = segment(ranges_bytes(volume.branches));
    header.segments.bricks = segment(volume.brick_offset(volume.bricks));
    header.image_bytes = end;
    if header.needs.has_primitives() {
        let old = header.bounds;
        header.bounds = Bounds { low: old.low.min(bounds.low), high: old.high.max(bounds.high) };
        if is_view {
            header.view = header.bounds;
        }
    }
    header.needs = header.needs.with(SceneNeeds::VOLUME);
    header.volume = Some(volume);
}

const fn kind_of(stored: StoredType) -> SampleKind {
    match stored {
        StoredType::U8 => SampleKind::U8,
        StoredType::U16 => SampleKind::U16,
        StoredType::F32 => SampleKind::F32,
    }
}
