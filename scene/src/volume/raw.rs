//! Raw files: samples and nothing else, described by a name or by a JSON file beside them.

use core::str::FromStr;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::bytes::Bytes;
use super::error::{Place, Trouble, VolumeError, shortened};
use super::file_volume::FileVolume;
use super::input::Input;
use super::numbers;
use super::packing::gzip;
use super::sample::{Endian, SampleType};
use super::shape::{Note, VolumeShape};

/// A raw file with what it does not say itself; read from a name such as
/// `raw:engine.raw?dims=256x256x128&type=u8&endian=little&spacing=1x1x1`.
///
/// `dims` and `type` must be there. Others are `endian` (`little` unless said), `spacing`, `origin`, `skip` (bytes
/// before the first sample, of the file as it is) and `compression` (`none` or `gzip`; by the ending `.gz` unless said).
#[derive(Clone, Debug, PartialEq)]
pub struct RawVolume {
    /// The file.
    pub path: PathBuf,
    /// Its samples.
    pub shape: VolumeShape,
    /// Order of the bytes of one.
    pub endian: Endian,
    /// Bytes before the first sample.
    pub skip: u64,
    /// Whether the file is compressed.
    pub is_gzip: bool,
}

/// The JSON file beside a raw one; fields we do not need are left alone.
#[derive(Debug, Deserialize)]
struct Sidecar {
    file: PathBuf,
    compression: Option<String>,
    dims: [u64; 3],
    dtype: String,
    endian: Option<String>,
    spacing: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
    skip: Option<u64>,
}

impl RawVolume {
    /// Reads a description in JSON; `folder` is where the file it names is.
    ///
    /// # Errors
    /// When it is no such description; says in which line.
    pub fn from_json(json: &[u8], folder: &Path) -> Result<Self, VolumeError> {
        let sidecar: Sidecar = serde_json::from_slice(json).map_err(|error| {
            let text = error.to_string();
            let reason = text.rsplit_once(" at line ").map_or(text.as_str(), |(reason, _)| reason);
            VolumeError::at_line(error.line() as u64, Trouble::Senseless(shortened(reason)))
        })?;
        let sample = named(&sidecar.dtype, "dtype", SAMPLE_TYPES, SampleType::named)?;
        let endian = sidecar.endian.map(|name| named(&name, "endian", ENDIANS, Endian::named)).transpose()?;
        let is_gzip = sidecar.compression.map(|name| named(&name, "compression", COMPRESSIONS, compression));
        let shape = VolumeShape::new(sidecar.dims, sample)?
            .with_spacing(sidecar.spacing.unwrap_or([1.0; 3]))?
            .with_origin(sidecar.origin.unwrap_or([0.0; 3]))?;
        Ok(Self {
            is_gzip: is_gzip.transpose()?.unwrap_or_else(|| ends_in_gz(&sidecar.file)),
            path: folder.join(sidecar.file),
            shape,
            endian: endian.unwrap_or(Endian::Little),
            skip: sidecar.skip.unwrap_or(0),
        })
    }

    /// Reads the description in a file.
    ///
    /// # Errors
    /// As [`from_json`](Self::from_json), and when the file cannot be read.
    pub fn from_json_file(path: &Path) -> Result<Self, VolumeError> {
        let mut json = Vec::new();
        Input::File(path.to_owned()).open_at(0)?.take(JSON_BYTES_MAX).read_to_end(&mut json)?;
        Self::from_json(&json, path.parent().unwrap_or_else(|| Path::new("")))
    }

    /// Opens the file.
    ///
    /// # Errors
    /// When it cannot be read or is too short.
    pub fn open(self) -> Result<FileVolume, VolumeError> {
        let input = Input::data_file(self.path.clone())?;
        self.open_input(&input)
    }

    fn open_input(self, input: &Input) -> Result<FileVolume, VolumeError> {
        let Self { mut shape, endian, skip, is_gzip, .. } = self;
        if is_gzip {
            let bytes = gzip(input, skip, 0, &shape);
            return Ok(FileVolume::new(shape, endian, bytes));
        }
        let length = input.length()?;
        let bytes = Bytes::plain(input.open_at(0)?, skip, length, shape.bytes())?;
        let trailing = length - skip - shape.bytes();
        if trailing > 0 {
            shape.notes.push(Note::Trailing { bytes: trailing });
        }
        Ok(FileVolume::new(shape, endian, bytes))
    }
}

impl FromStr for RawVolume {
    type Err = VolumeError;

    fn from_str(name: &str) -> Result<Self, VolumeError> {
        let missing = |what| VolumeError::in_name(name, Trouble::Missing(what));
        let rest = name.strip_prefix(PREFIX).ok_or_else(|| missing("raw: before the file"))?;
        let (path, parameters) = rest.rsplit_once('?').ok_or_else(|| missing(DIMS_AND_TYPE))?;
        if path.is_empty() {
            return Err(missing("which file"));
        }
        let parameters = Parameters::read(parameters)?;
        let dims = parameters.dims.ok_or_else(|| missing("dims, as in dims=256x256x128"))?;
        let sample = parameters.sample.ok_or_else(|| missing("type, as in type=u8"))?;
        let shape = VolumeShape::new(dims, sample)?
            .with_spacing(parameters.spacing.unwrap_or([1.0; 3]))?
            .with_origin(parameters.origin.unwrap_or([0.0; 3]))?;
        let path = PathBuf::from(path);
        Ok(Self {
            shape,
            endian: parameters.endian.unwrap_or(Endian::Little),
            skip: parameters.skip.unwrap_or(0),
            is_gzip: parameters.is_gzip.unwrap_or_else(|| ends_in_gz(&path)),
            path,
        })
    }
}

/// What follows the question mark.
#[derive(Default)]
struct Parameters {
    dims: Option<[u64; 3]>,
    sample: Option<SampleType>,
    endian: Option<Endian>,
    spacing: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
    skip: Option<u64>,
    is_gzip: Option<bool>,
}

impl Parameters {
    fn read(text: &str) -> Result<Self, VolumeError> {
        let mut read = Self::default();
        for parameter in text.split('&') {
            let refused = |trouble| VolumeError::in_name(parameter, trouble);
            let (key, value) = parameter.split_once('=').ok_or_else(|| refused(unknown(parameter)))?;
            let bad = |expected| refused(Trouble::value(value, expected));
            let is_new = match key {
                "dims" => set(&mut read.dims, numbers::triple(value, 'x').ok_or_else(|| bad(DIMS))?),
                "type" => set(&mut read.sample, SampleType::named(value).ok_or_else(|| bad(SAMPLE_TYPES))?),
                "endian" => set(&mut read.endian, Endian::named(value).ok_or_else(|| bad(ENDIANS))?),
                "spacing" => set(&mut read.spacing, numbers::triple(value, 'x').ok_or_else(|| bad(SPACING))?),
                "origin" => set(&mut read.origin, numbers::triple(value, 'x').ok_or_else(|| bad(ORIGIN))?),
                "skip" => set(&mut read.skip, value.parse().map_err(|_| bad("a number of bytes"))?),
                "compression" => set(&mut read.is_gzip, compression(value).ok_or_else(|| bad(COMPRESSIONS))?),
                _ => return Err(refused(unknown(key))),
            };
            if !is_new {
                return Err(refused(Trouble::Twice(shortened(key))));
            }
        }
        Ok(read)
    }
}

/// Sets what was not set before; says whether it was so.
fn set<T>(place: &mut Option<T>, value: T) -> bool {
    place.replace(value).is_none()
}

fn unknown(key: &str) -> Trouble {
    Trouble::value(key, "one of dims=, type=, endian=, spacing=, origin=, skip=, compression=")
}

/// What a field's word stands for.
fn named<T>(
    name: &str,
    field: &'static str,
    expected: &'static str,
    meaning: impl Fn(&str) -> Option<T>,
) -> Result<T, VolumeError> {
    let refused =
        || VolumeError::Broken { place: Place::Field(field), trouble: Trouble::value(name, expected) };
    meaning(name).ok_or_else(refused)
}

fn compression(name: &str) -> Option<bool> {
    match name {
        "none" => Some(false),
        "gzip" => Some(true),
        _ => None,
    }
}

fn ends_in_gz(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"))
}

/// How the name of a raw volume begins.
pub(super) const PREFIX: &str = "raw:";

/// Descriptions are under 1 KB.
const JSON_BYTES_MAX: u64 = 1 << 20;

const DIMS_AND_TYPE: &str = "dims and type, as in raw:FILE?dims=256x256x128&type=u8";
const DIMS: &str = "three numbers of samples such as 256x256x128";
const SPACING: &str = "three distances such as 1x1x2.5";
const ORIGIN: &str = "three coordinates such as 0x0x-10";
const SAMPLE_TYPES: &str = "one of u8, i8, u16, i16, u32, i32, f32, f64";
const ENDIANS: &str = "little or big";
const COMPRESSIONS: &str = "none or gzip";
