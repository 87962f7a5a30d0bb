//! NIfTI-1 files: a header of 348 bytes, then samples, in the same file or in one beside it.

use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

use super::bytes::{Bytes, fill};
use super::error::{Trouble, VolumeError};
use super::file_volume::FileVolume;
use super::input::{Input, without_gz};
use super::packing::gzip;
use super::sample::{Endian, SampleType};
use super::shape::{Note, ValueMap, VolumeShape};

/// Opens a file that [`is_one`].
pub(super) fn open(input: &Input) -> Result<FileVolume, VolumeError> {
    let header = Header::parse(&first_bytes(input, HEADER_BYTES)?)?;
    if header.is_alone {
        return header.open(input);
    }
    let Input::File(path) = input else {
        let what = "a header in memory whose samples are in another file";
        return Err(VolumeError::in_header(Trouble::unsupported(what, "give the file")));
    };
    header.open(&Input::data_file(image_beside(path))?)
}

/// Whether the first bytes of a file, decompressed, are those of a NIfTI header, of either version.
pub(super) fn is_one(first: &[u8]) -> bool {
    let length = first.first_chunk::<4>();
    length.is_some_and(|length| {
        [348, 540]
            .into_iter()
            .any(|known: i32| *length == known.to_le_bytes() || *length == known.to_be_bytes())
    })
}

/// The same of the first bytes of a compressed file.
pub(super) fn is_one_compressed(first: &[u8]) -> bool {
    let mut length = [0; 4];
    first.starts_with(&GZIP_MAGIC)
        && fill(&mut MultiGzDecoder::new(first), &mut length).is_ok()
        && is_one(&length)
}

/// The header of a file with the samples alone, which ends in `.img`; `None` for other files.
pub(super) fn header_beside(path: &Path) -> Option<PathBuf> {
    let stem = without_gz(path);
    let is_image = stem.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("img"));
    let headers = is_image.then(|| ["hdr", "hdr.gz"].map(|extension| stem.with_extension(extension)));
    headers.into_iter().flatten().find(|path| path.exists())
}

/// The first bytes of a file, decompressed when it is compressed.
fn first_bytes(input: &Input, count: usize) -> Result<Vec<u8>, VolumeError> {
    let mut bytes = vec![0; count];
    let mut reader = input.buffered_at(0)?;
    let got = if is_gzip(input)? {
        let decoder = &mut MultiGzDecoder::new(reader);
        fill(decoder, &mut bytes)
            .map_err(|error| VolumeError::in_header(Trouble::Corrupt(error.to_string())))?
    } else {
        fill(&mut reader, &mut bytes)?
    };
    bytes.truncate(got);
    Ok(bytes)
}

/// What a header says.
#[derive(Debug)]
struct Header {
    shape: VolumeShape,
    endian: Endian,
    /// Bytes before the samples, in the file that has them.
    begin: u64,
    /// Whether header and samples are in one file.
    is_alone: bool,
}

impl Header {
    /// Reads a header from the first bytes of a file.
    fn parse(bytes: &[u8]) -> Result<Self, VolumeError> {
        let bytes = bytes.first_chunk().ok_or_else(|| VolumeError::in_header(Trouble::EndlessHeader))?;
        let raw = RawHeader::new(bytes)?;
        let is_alone = raw.is_alone()?;
        let (shape, is_first_of) = raw.shape()?;
        let mut shape = raw.placed(shape)?;
        shape.world = raw.world()?;
        shape.notes.extend(is_first_of);
        Ok(Self { shape, endian: raw.endian, begin: raw.begin(is_alone)?, is_alone })
    }

    /// Opens the samples in the file that has them.
    fn open(self, input: &Input) -> Result<FileVolume, VolumeError> {
        let Self { shape, endian, begin, .. } = self;
        let bytes = if is_gzip(input)? {
            gzip(input, 0, begin, &shape)
        } else {
            Bytes::plain(input.open_at(0)?, begin, input.length()?, shape.bytes())?
        };
        Ok(FileVolume::new(shape, endian, bytes))
    }
}

/// The bytes of a header and their order.
struct RawHeader<'b> {
    bytes: &'b [u8; HEADER_BYTES],
    endian: Endian,
}

impl<'b> RawHeader<'b> {
    /// The order is the one in which the header's first number is its length.
    fn new(bytes: &'b [u8; HEADER_BYTES]) -> Result<Self, VolumeError> {
        let orders = [Endian::Little, Endian::Big].map(|endian| Self { bytes, endian });
        let lengths = orders.each_ref().map(|raw| raw.i32_at(0));
        if lengths.contains(&540) {
            let trouble = Trouble::unsupported("NIfTI-2", "save it as NIfTI-1 or NRRD");
            return Err(VolumeError::in_header(trouble));
        }
        let known = orders.into_iter().zip(lengths).find(|(_, length)| *length == 348);
        let refused = || Trouble::value(lengths[0].to_string(), "348, the length of a header");
        known.map(|(raw, _)| raw).ok_or_else(|| VolumeError::in_field("sizeof_hdr", refused()))
    }

    fn is_alone(&self) -> Result<bool, VolumeError> {
        match &self.bytes[344..348] {
            b"n+1\0" => Ok(true),
            b"ni1\0" => Ok(false),
            magic => {
                let what = format!("magic {:?}", String::from_utf8_lossy(magic));
                let trouble = Trouble::unsupported(what, "Analyze 7.5 and others: save as NIfTI-1");
                Err(VolumeError::in_field("magic", trouble))
            }
        }
    }

    /// Samples along the axes and their type; a note when there are more than three axes.
    fn shape(&self) -> Result<(VolumeShape, Option<Note>), VolumeError> {
        let dim: [i16; 8] = core::array::from_fn(|axis| self.i16_at(40 + 2 * axis));
        let axes = usize::try_from(dim[0]).ok().filter(|axes| (1..=7).contains(axes));
        let refused = |expected| VolumeError::in_field("dim", Trouble::value(format!("{dim:?}"), expected));
        let axes = axes.ok_or_else(|| refused("a number of axes from 1 to 7 with their samples"))?;
        let sizes: Option<Vec<u64>> = dim[1..=axes].iter().map(|size| u64::try_from(*size).ok()).collect();
        let mut sizes = sizes.ok_or_else(|| refused("a number of axes with 0 or more samples each"))?;
        sizes.resize(sizes.len().max(3), 1);
        let (first, further) = sizes.split_at(3);
        let shape = VolumeShape::new([first[0], first[1], first[2]], self.sample()?)?;
        let count = further.iter().product();
        Ok((shape, (count > 1).then_some(Note::FirstOf { count })))
    }

    fn sample(&self) -> Result<SampleType, VolumeError> {
        let (code, bits) = (self.i16_at(70), self.i16_at(72));
        let sample = match code {
            2 => SampleType::U8,
            4 => SampleType::I16,
            8 => SampleType::I32,
            16 => SampleType::F32,
            64 => SampleType::F64,
            256 => SampleType::I8,
            512 => SampleType::U16,
            768 => SampleType::U32,
            _ => {
                let what = format!("type {code}{}", name_of(code));
                let trouble = Trouble::unsupported(what, "save 8 to 32 bits, single or double precision");
                return Err(VolumeError::in_field("datatype", trouble));
            }
        };
        if usize::try_from(bits) != Ok(8 * sample.bytes()) {
            let expected = "the number of bits that datatype has";
            return Err(VolumeError::in_field("bitpix", Trouble::value(bits.to_string(), expected)));
        }
        Ok(sample)
    }

    /// The shape with spacing and origin, by the method of the header's choice.
    fn placed(&self, shape: VolumeShape) -> Result<VolumeShape, VolumeError> {
        let pixdim = [1, 2, 3].map(|axis| f64::from(self.f32_at(76 + 4 * axis)).abs());
        let rows = [280, 296, 312].map(|row| [0, 1, 2, 3].map(|i| f64::from(self.f32_at(row + 4 * i))));
        let (qform, sform) = (self.i16_at(252), self.i16_at(254));
        let origin = if sform > 0 {
            rows.map(|row| row[3])
        } else if qform > 0 {
            [268, 272, 276].map(|offset| f64::from(self.f32_at(offset)))
        } else {
            [0.0; 3]
        };
        let is_known = pixdim.iter().all(|distance| *distance > 0.0);
        let spacing = pixdim.map(|distance| if distance == 0.0 { 1.0 } else { distance });
        let mut shape = shape.with_spacing(spacing)?.with_origin(origin)?;
        let by_rows = |axis: usize| {
            (0..3).all(|other| {
                (rows[axis][other] > 0.0) == (other == axis) && (other == axis || rows[axis][other] == 0.0)
            })
        };
        let quaternion = [256, 260, 264].map(|offset| self.f32_at(offset));
        let is_straight = if sform > 0 {
            (0..3).all(by_rows)
        } else {
            qform <= 0 || (quaternion == [0.0; 3] && self.f32_at(76) >= 0.0)
        };
        if !is_straight {
            shape.notes.push(Note::Orientation);
        }
        if !is_known {
            shape.notes.push(Note::NoSpacing);
        }
        Ok(shape)
    }

    /// "If the scl_slope field is nonzero, then each voxel value in the dataset should be scaled" (nifti1.h).
    fn world(&self) -> Result<ValueMap, VolumeError> {
        let [slope, intercept] = [self.f32_at(112), self.f32_at(116)].map(f64::from);
        if slope == 0.0 || !slope.is_finite() {
            return Ok(ValueMap::IDENTITY);
        }
        if !intercept.is_finite() {
            let trouble = Trouble::value(intercept.to_string(), "a finite number");
            return Err(VolumeError::in_field("scl_inter", trouble));
        }
        Ok(ValueMap { slope, intercept })
    }

    /// Where the samples begin: behind the header and what extends it, or anywhere in a file of their own.
    fn begin(&self, is_alone: bool) -> Result<u64, VolumeError> {
        let offset = self.f32_at(108);
        if is_alone && offset == 0.0 {
            return Ok(ALONE_BEGIN_MIN);
        }
        let least = if is_alone { ALONE_BEGIN_MIN } else { 0 };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked right after")]
        let begin = offset as u64;
        if begin as f32 != offset || begin < least {
            let expected = "a whole number of bytes behind the header";
            return Err(VolumeError::in_field("vox_offset", Trouble::value(offset.to_string(), expected)));
        }
        Ok(begin)
    }

    fn i16_at(&self, offset: usize) -> i16 {
        i16::from_ne_bytes(self.bytes_at(offset))
    }

    fn i32_at(&self, offset: usize) -> i32 {
        i32::from_ne_bytes(self.bytes_at(offset))
    }

    fn f32_at(&self, offset: usize) -> f32 {
        f32::from_ne_bytes(self.bytes_at(offset))
    }

    /// Bytes of a number in this machine's order; offsets are those of the format.
    fn bytes_at<const N: usize>(&self, offset: usize) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.bytes[offset..offset + N]);
        if self.endian != Endian::NATIVE {
            bytes.reverse();
        }
        bytes
    }
}

/// Names of some types that are not read.
const fn name_of(code: i16) -> &'static str {
    match code {
        1 => " (bits)",
        32 | 1792 | 2048 => " (complex numbers)",
        128 | 2304 => " (colours)",
        1024 | 1280 => " (64-bit whole numbers)",
        1536 => " (128-bit floats)",
        _ => "",
    }
}

/// The file with the samples of a header alone: `.img`, or `.img.gz` when that is there.
fn image_beside(header: &Path) -> PathBuf {
    let stem = without_gz(header);
    let [plain, compressed] = ["img", "img.gz"].map(|extension| stem.with_extension(extension));
    if !plain.exists() && compressed.exists() { compressed } else { plain }
}

fn is_gzip(input: &Input) -> Result<bool, VolumeError> {
    let mut first = [0; 2];
    let got = fill(&mut input.open_at(0)?.take(2), &mut first)?;
    Ok(got == 2 && first == GZIP_MAGIC)
}

/// Length of a header.
const HEADER_BYTES: usize = 348;

/// Samples in the same file begin behind the header and four bytes that say whether something extends it.
const ALONE_BEGIN_MIN: u64 = 352;

/// How a gzip stream begins.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
