//! What is written is every sample of the volume, where the tree says, with ranges that hold it.

use std::io::{Cursor, Error, Result as IoResult, SeekFrom};

use rt_core::volume::{BRICK_EDGE, RangeBranch, VolumeTable, range_offset};
use rt_core::{Flat, SceneView};

use super::*;
use crate::file::view_of;
use crate::volume::{SampleType, VolumeError, VolumeShape};

/// A volume in memory that notes what was read of it.
struct Given {
    shape: VolumeShape,
    samples: Vec<f32>,
    /// First sample and count of each reading.
    readings: Vec<(u64, usize)>,
}

impl Given {
    fn new(dims: [u64; 3], sample: SampleType, value: impl Fn([u64; 3]) -> f32) -> Self {
        let [x, y, z] = dims;
        let samples = (0..x * y * z).map(|i| value([i % x, i / x % y, i / x / y])).collect();
        Self { shape: VolumeShape::new(dims, sample).expect("a shape"), samples, readings: Vec::new() }
    }

    fn at(&self, at: [u64; 3]) -> f32 {
        let [x, y, _] = self.shape.dims;
        self.samples[index((at[2] * y + at[1]) * x + at[0])]
    }

    fn image(&mut self, stored: Option<StoredType>) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        write_volume(self, None, stored, 4096, &mut out, &|_| {}).expect("an image");
        out.into_inner()
    }
}

impl VolumeSource for Given {
    fn shape(&self) -> &VolumeShape {
        &self.shape
    }

    fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
        self.readings.push((first, samples.len()));
        samples.copy_from_slice(&self.samples[index(first)..][..samples.len()]);
        Ok(())
    }
}

fn index(number: u64) -> usize {
    usize::try_from(number).expect("small")
}

/// Stripes, a hollow and a constant half: bricks of all kinds.
fn stripes(dims: [u64; 3], sample: SampleType) -> Given {
    Given::new(dims, sample, |[x, y, z]| {
        if z > 40 || x > 30 && y > 12 { 7.0 } else { ((x * 3 + y * y + z * 5) % 251) as f32 }
    })
}

/// Finds a brick by its place: the ranges of all branches above it and its own, and its number if it is stored.
fn find(scene: &SceneView<Flat<'_>>, image: &[u8], at: [u32; 3]) -> (Vec<(u8, u8)>, Option<u64>) {
    let header = scene.header();
    let volume = header.volume.expect("a volume");
    let (mut ranges, mut branch) = (Vec::new(), 0);
    for level in (0..volume.levels).rev() {
        let start = index(header.segments.ranges.offset + range_offset(branch));
        let record: &RangeBranch =
            &bytemuck::pod_read_unaligned(&image[start..start + size_of::<RangeBranch>()]);
        let cell = rt_core::grid::cell_index(at.map(|x| x >> (2 * level) & 3));
        if record.present >> cell & 1 == 0 {
            return (ranges, None);
        }
        ranges.push((record.low[cell as usize], record.high[cell as usize]));
        branch = record.child_of(cell).expect("a child");
    }
    (ranges, Some(branch))
}

fn table(scene: &SceneView<Flat<'_>>, image: &[u8]) -> VolumeTable {
    let start = index(scene.header().segments.table.offset);
    bytemuck::pod_read_unaligned(&image[start..start + TABLE_BYTES])
}

/// The samples of a brick of a volume, each with its place in the brick.
fn samples_of(given: &Given, at: [u32; 3]) -> Vec<(usize, f32)> {
    let mut samples = Vec::new();
    for i in 0..BRICK_EDGE * BRICK_EDGE * BRICK_EDGE {
        let inside = [i % 8, i / 8 % 8, i / 64];
        let place: [u64; 3] = [0, 1, 2].map(|axis| u64::from(at[axis]) * 7 + inside[axis] as u64);
        if (0..3).all(|axis| place[axis] < given.shape.dims[axis]) {
            samples.push((i, given.at(place)));
        }
    }
    samples
}

fn number(stored: StoredType, bytes: &[u8]) -> f32 {
    match stored {
        StoredType::U8 => f32::from(bytes[0]),
        StoredType::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        StoredType::F32 => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
    }
}

#[test]
fn every_sample_is_in_its_brick_and_in_every_range_above_it() {
    for dims in [[50, 23, 64], [8, 8, 8], [2, 2, 2], [9, 8, 15], [3, 230, 2]] {
        for stored in StoredType::ALL {
            let mut given = stripes(dims, SampleType::U8);
            let image = given.image(Some(stored));
            let scene = view_of(&image).expect("sound");
            let volume = scene.header().volume.expect("a volume");
            let edges = table(&scene, &image).edges.map(f64::from);
            let [columns, rows, layers] = volume.dims.map(rt_core::volume::bricks_along);
            let mut present = 0;
            for i in 0..columns * rows * layers {
                let at = [i % columns, i / columns % rows, i / columns / rows];
                let samples = samples_of(&given, at);
                let (ranges, brick) = find(&scene, &image, at);
                let Some(brick) = brick else {
                    assert!(
                        samples.iter().all(|one| one.1 == samples[0].1),
                        "{dims:?} {at:?} shows something"
                    );
                    continue;
                };
                present += 1;
                let bytes = scene.brick(brick).expect("a brick");
                for (place, sample) in samples {
                    let code = number(stored, &bytes[place * stored.bytes()..]);
                    assert_eq!(volume.value(code), f64::from(sample), "{dims:?} {stored} {at:?} {place}");
                    for (low, high) in &ranges {
                        let range = edges[usize::from(*low)]..=edges[usize::from(*high)];
                        assert!(range.contains(&f64::from(code)), "{code} in {range:?}");
                    }
                }
            }
            assert_eq!(present, volume.bricks);
        }
    }
}

#[test]
fn the_source_is_read_twice_forwards_a_layer_of_bricks_at_a_time() {
    let mut given = stripes([20, 11, 51], SampleType::F32);
    given.image(None);
    let slice = 20 * 11;
    let read: u64 = given.readings.iter().map(|reading| reading.1 as u64).sum();
    assert_eq!(read, 2 * given.samples.len() as u64);
    assert!(given.readings.iter().all(|reading| reading.1 <= 8 * slice), "{:?}", given.readings);
    let (first, second) = given.readings.split_at(given.readings.len() / 2);
    assert_eq!(first, second);
    let ends = first.iter().map(|(start, count)| start + *count as u64);
    assert!(ends.zip(&first[1..]).all(|(end, next)| end == next.0), "{first:?}");
}

#[test]
fn the_histogram_counts_every_sample_once_and_absent_ones_apart() {
    let mut given = stripes([50, 23, 64], SampleType::F32);
    given.samples[17] = f32::NAN;
    given.samples[4000] = f32::INFINITY;
    let image = given.image(None);
    let table = table(&view_of(&image).expect("sound"), &image);
    assert_eq!(table.absent, 2);
    assert_eq!(table.histogram.iter().sum::<u64>() + 2, given.samples.len() as u64);
    assert!(table.edges.is_sorted(), "{:?}", table.edges);
}

#[test]
fn an_image_may_begin_anywhere_and_what_stands_before_it_stays() {
    let mut given = stripes([30, 20, 10], SampleType::U8);
    let alone = given.image(None);
    let mut out = Cursor::new(vec![0xa5; 3 * alone.len()]);
    out.seek(SeekFrom::Start(1000)).expect("in memory");
    let header = write_volume(&mut given, None, None, 4096, &mut out, &|_| {}).expect("an image");
    assert_eq!(out.position(), 1000 + header.image_bytes);
    let bytes = out.into_inner();
    assert!(bytes[1000..][..alone.len()] == alone, "the image depends on what stood there before");
    assert!(bytes[..1000].iter().chain(&bytes[1000 + alone.len()..]).all(|&byte| byte == 0xa5));
}

/// A file on a disk that is full after so many writes.
struct Full {
    file: Cursor<Vec<u8>>,
    writes_left: usize,
}

impl Read for Full {
    fn read(&mut self, buffer: &mut [u8]) -> IoResult<usize> {
        self.file.read(buffer)
    }
}

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        self.writes_left = self.writes_left.checked_sub(1).ok_or_else(|| Error::other("the disk is full"))?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> IoResult<()> {
        Ok(())
    }
}

impl Seek for Full {
    fn seek(&mut self, to: SeekFrom) -> IoResult<u64> {
        self.file.seek(to)
    }
}

#[test]
fn half_an_image_is_not_taken_for_one() {
    let mut given = stripes([30, 20, 60], SampleType::U8);
    let mut write = |writes_left| {
        let mut out = Full { file: Cursor::new(Vec::new()), writes_left };
        let done = write_volume(&mut given, None, None, 4096, &mut out, &|_| {});
        (done, out.file.into_inner())
    };
    let enough = (0..1000).find(|&writes| write(writes).0.is_ok()).expect("it ends");
    assert!(enough > 5, "{enough}");
    for writes in 0..enough {
        let (done, bytes) = write(writes);
        assert!(matches!(done, Err(PrepareError::Write(_))), "{done:?}");
        assert!(view_of(&bytes).is_err(), "after {writes} of {enough} writes");
    }
    assert!(view_of(&write(enough).1).is_ok());
}

#[test]
fn volumes_that_no_image_can_hold_are_refused_before_they_are_read() {
    for (dims, spacing) in [([1 << 31, 2, 2], 1.0), ([4, 4, 4], 1.0e300)] {
        let shape = VolumeShape::new(dims, SampleType::U8).and_then(|shape| shape.with_spacing([spacing; 3]));
        let Ok(shape) = shape else { continue };
        let samples = vec![1.0; if dims[0] == 4 { 64 } else { 0 }];
        let mut given = Given { shape, samples, readings: Vec::new() };
        let mut out = Cursor::new(Vec::new());
        let refused = write_volume(&mut given, None, None, 4096, &mut out, &|_| {}).expect_err("refused");
        assert!(matches!(refused, PrepareError::TooLong { .. } | PrepareError::OutOfRange), "{refused}");
        assert!(out.into_inner().is_empty(), "nothing was written");
    }
}
