//! Volume files: what is written comes back, whatever the format; what is broken is refused in one line.

mod nifti;
mod nrrd;
mod raw;
mod real;
mod vti;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use proptest::prelude::*;
use scene::volume::{
    Endian, Note, SampleType, ValueMap, VolumeError, VolumeName, VolumeShape, VolumeSource, open_file,
    parse_volume,
};

/// A folder of a test's own that goes away with it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("memsavvy-volumes-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder for temporary files");
        Self(path)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        fs::write(&path, bytes).expect("a writable folder");
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Samples of a type and an order of bytes, and the numbers they are.
#[derive(Clone, Debug)]
struct Samples {
    sample: SampleType,
    endian: Endian,
    dims: [u64; 3],
    bytes: Vec<u8>,
    numbers: Vec<f32>,
}

impl Samples {
    /// Makes samples of arbitrary bits.
    #[expect(clippy::cast_possible_truncation, reason = "arbitrary bits are cut to the type")]
    fn new(sample: SampleType, endian: Endian, dims: [u64; 3], seed: u64) -> Self {
        let count = dims.iter().product::<u64>();
        let (mut bytes, mut numbers) = (Vec::new(), Vec::new());
        for index in 0..count {
            let bits = (index + seed).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
            let (number, word) = match sample {
                SampleType::U8 => (f32::from(bits as u8), (bits as u8).to_be_bytes().to_vec()),
                SampleType::I8 => (f32::from(bits as i8), (bits as i8).to_be_bytes().to_vec()),
                SampleType::U16 => (f32::from(bits as u16), (bits as u16).to_be_bytes().to_vec()),
                SampleType::I16 => (f32::from(bits as i16), (bits as i16).to_be_bytes().to_vec()),
                SampleType::U32 => (bits as u32 as f32, (bits as u32).to_be_bytes().to_vec()),
                SampleType::I32 => (bits as i32 as f32, (bits as i32).to_be_bytes().to_vec()),
                SampleType::F32 => (f32::from_bits(bits as u32), (bits as u32).to_be_bytes().to_vec()),
                SampleType::F64 => (f64::from_bits(bits) as f32, bits.to_be_bytes().to_vec()),
            };
            numbers.push(number);
            let big = endian == Endian::Big;
            bytes.extend(if big { word } else { word.into_iter().rev().collect() });
        }
        Self { sample, endian, dims, bytes, numbers }
    }

    /// Asserts that a volume is these samples, read in several ways.
    fn check(&self, volume: &mut dyn VolumeSource, what: &str) {
        assert_eq!((volume.shape().dims, volume.shape().sample), (self.dims, self.sample), "{what}");
        let slice = usize::try_from(volume.shape().slice_samples()).expect("small");
        // All at once; again from the start; slabs of two slices with one in common; a part; the last sample.
        let slabs = (0..self.dims[2].saturating_sub(1)).map(|z| (z, 2 * slice));
        let whole = [(0, self.numbers.len()), (0, slice)];
        for (z, count) in whole.into_iter().chain(slabs) {
            let mut samples = vec![0.0; count];
            volume.read_slices(z, &mut samples).unwrap_or_else(|error| panic!("{what}: {error}"));
            let first = usize::try_from(z).expect("small") * slice;
            assert!(same(&samples, &self.numbers[first..][..count]), "{what}: slice {z}");
        }
        for (first, count) in [(slice / 2, slice / 2), (self.numbers.len() - 1, 1), (0, 1), (1, 0)] {
            let mut samples = vec![0.0; count];
            volume.read_samples(first as u64, &mut samples).unwrap_or_else(|error| panic!("{what}: {error}"));
            assert!(same(&samples, &self.numbers[first..][..count]), "{what}: samples from {first}");
        }
    }
}

/// Whether numbers are the same bits, or both not numbers.
fn same(ours: &[f32], theirs: &[f32]) -> bool {
    let equal = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan());
    ours.len() == theirs.len() && ours.iter().zip(theirs).all(equal)
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// Every type in both orders of bytes, in a volume of uneven sizes.
fn every_kind() -> impl Iterator<Item = Samples> {
    let orders = [Endian::Little, Endian::Big];
    let kinds = SampleType::ALL.into_iter().flat_map(move |sample| orders.map(|endian| (sample, endian)));
    kinds.zip(0..).map(|((sample, endian), seed)| Samples::new(sample, endian, [5, 3, 7], seed))
}

const fn name_of(endian: Endian) -> &'static str {
    match endian {
        Endian::Little => "little",
        Endian::Big => "big",
    }
}

fn open_name(name: &str) -> Result<Box<dyn VolumeSource>, VolumeError> {
    let name = VolumeName::recognise(Path::new(name))?;
    name.ok_or(VolumeError::UnknownFormat)?.open()
}

#[test]
fn files_cut_anywhere_are_read_or_refused() {
    let samples = Samples::new(SampleType::U16, Endian::Little, [4, 4, 4], 5);
    let vti = "<?xml version='1.0'?><VTKFile type='ImageData' byte_order='LittleEndian' header_type='UInt64' \
               compressor='vtkZLibDataCompressor'><ImageData WholeExtent='0 3 0 3 0 3'><Piece><PointData>\
               <DataArray type='UInt16' format='binary'>";
    let block = zlib(&samples.bytes);
    let table = [1, 128, 0, block.len() as u64].map(u64::to_le_bytes).concat();
    let nrrd = "NRRD0001\ntype: ushort\ndimension: 3\nsizes: 4 4 4\nencoding: gzip\nendian: little\n\n";
    let files = [
        [vti, &STANDARD.encode(table), &STANDARD.encode(block), "</DataArray>"].concat().into_bytes(),
        [nrrd.as_bytes(), &gzip(&samples.bytes)].concat(),
    ];
    for file in files {
        samples.check(&mut parse_volume(&file).expect("the whole file is good"), "whole");
        let mut refused = 0;
        for length in 0..file.len() {
            let read = parse_volume(&file[..length]).and_then(|mut volume| read_all(&mut volume));
            refused += usize::from(read.is_err());
            if let Err(error) = read {
                assert_is_one_line(&error);
            }
        }
        assert!(refused > file.len() - 20, "{refused} of {}", file.len());
    }
}

#[test]
fn damaged_samples_are_found_by_their_checksum() {
    let samples = Samples::new(SampleType::U8, Endian::Little, [8, 8, 8], 5);
    let mut file = gzip(&samples.bytes);
    let checksum = file.len() - 8;
    file[checksum] ^= 1;
    let folder = Folder::new("checksum");
    let path = folder.file("a.raw.gz", &file);
    let name = format!("raw:{}?dims=8x8x8&type=u8", path.display());
    let read = open_name(&name).and_then(|mut volume| read_all(&mut *volume));
    assert_refused(read, "samples: cannot be decoded (corrupt gzip stream", "checksum");
}

/// Reads every sample.
fn read_all(volume: &mut dyn VolumeSource) -> Result<(), VolumeError> {
    let mut left = volume.shape().samples();
    let (mut first, mut samples) = (0, vec![0.0; 1000]);
    while left > 0 {
        let count = left.min(1000);
        volume.read_samples(first, &mut samples[..usize::try_from(count).expect("small")])?;
        (first, left) = (first + count, left - count);
    }
    Ok(())
}

fn assert_refused<T>(read: Result<T, VolumeError>, message: &str, what: &str) {
    let Err(error) = read else { panic!("{what}: not refused, expected {message}") };
    assert_is_one_line(&error);
    assert!(error.to_string().contains(message), "{what}: {error}\nexpected {message}");
}

fn assert_is_one_line(error: &VolumeError) {
    let text = error.to_string();
    assert!(!text.contains('\n') && text.len() < 250, "{text:?}");
}
