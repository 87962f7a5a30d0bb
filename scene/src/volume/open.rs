//! What a name given by a user stands for.

use core::fmt;
use core::str::FromStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::analytic::{self, Analytic, Formula};
use super::error::{Trouble, VolumeError};
use super::file_volume::FileVolume;
use super::input::{Input, without_gz};
use super::raw::{self, RawVolume};
use super::{VolumeSource, nifti, nrrd, vti};

/// A volume by its name: `gyroid:256`, `ml`, `raw:FILE?dims=256x256x128&type=u8`, or a file.
#[derive(Clone, Debug, PartialEq)]
pub enum VolumeName {
    /// A formula, with so many samples along each axis.
    Analytic {
        /// The formula.
        formula: Formula,
        /// Samples along each axis.
        n: u64,
    },
    /// A raw file with its description.
    Raw(Box<RawVolume>),
    /// A file that says what it is.
    File(PathBuf),
}

/// A format of volume files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VolumeFormat {
    /// Nearly raw raster data, of Teem.
    Nrrd,
    /// NIfTI-1, of neuroimaging; maybe compressed.
    Nifti,
    /// Image data in XML, of VTK.
    Vti,
    /// A description in JSON of a raw file.
    Json,
    /// Samples alone, maybe compressed; the description is in a JSON file of the same name.
    Raw,
}

impl VolumeName {
    /// What `name` stands for; `None` when it is no volume, but maybe a mesh. A file goes before a formula of the
    /// same name.
    ///
    /// # Errors
    /// When it is the name of a volume and broken, or a file that cannot be read.
    pub fn recognise(name: &Path) -> Result<Option<Self>, VolumeError> {
        let exists = name.exists();
        let named = name.to_str().filter(|_| !exists).map(str::parse::<Self>);
        match named {
            Some(Err(VolumeError::UnknownFormat)) | None => {}
            Some(named) => return named.map(Some),
        }
        let is_one = if exists && !name.is_dir() {
            VolumeFormat::of(&Input::File(name.to_owned()))?.is_some()
        } else {
            VolumeFormat::by_extension(name).is_some()
        };
        Ok(is_one.then(|| Self::File(name.to_owned())))
    }

    /// Opens the volume.
    ///
    /// # Errors
    /// Says in one line what is wrong with the file, and where in it.
    pub fn open(self) -> Result<Box<dyn VolumeSource>, VolumeError> {
        Ok(match self {
            Self::Analytic { formula, n } => Box::new(Analytic::new(formula, n)?),
            Self::Raw(raw) => Box::new(raw.open()?),
            Self::File(path) => Box::new(open_file(&path)?),
        })
    }
}

/// Opens a volume file.
///
/// # Errors
/// Says in one line what is wrong with the file, and where in it.
pub fn open_file(path: &Path) -> Result<FileVolume, VolumeError> {
    let input = Input::File(path.to_owned());
    match VolumeFormat::of(&input)?.ok_or(VolumeError::UnknownFormat)? {
        VolumeFormat::Nrrd => nrrd::open(&input),
        VolumeFormat::Nifti => nifti::open(&nifti::header_beside(path).map_or(input, Input::File)),
        VolumeFormat::Vti => vti::open(&input),
        VolumeFormat::Json => RawVolume::from_json_file(path)?.open(),
        VolumeFormat::Raw => {
            let json = without_gz(path).with_extension("json");
            if !json.exists() {
                let missing =
                    Trouble::Missing("its dims and type; give raw:FILE?dims=XxYxZ&type=u8, or FILE.json");
                return Err(VolumeError::in_header(missing));
            }
            RawVolume::from_json_file(&json)?.open()
        }
    }
}

/// Reads a volume from the bytes of a file, whose format they tell.
///
/// # Errors
/// As [`open_file`]; and when the samples are in another file.
pub fn parse_volume(bytes: &[u8]) -> Result<FileVolume, VolumeError> {
    let input = Input::Memory(Arc::from(bytes));
    match VolumeFormat::of(&input)? {
        Some(VolumeFormat::Nrrd) => nrrd::open(&input),
        Some(VolumeFormat::Nifti) => nifti::open(&input),
        Some(VolumeFormat::Vti) => vti::open(&input),
        Some(VolumeFormat::Json | VolumeFormat::Raw) | None => Err(VolumeError::UnknownFormat),
    }
}

impl VolumeFormat {
    /// The format by the first bytes, or else by the name.
    fn of(input: &Input) -> Result<Option<Self>, VolumeError> {
        let first = input.first(FIRST_BYTES)?;
        let by_content = if first.starts_with(nrrd::MAGIC) {
            Some(Self::Nrrd)
        } else if vti::is_one(&first) {
            Some(Self::Vti)
        } else if nifti::is_one(&first) || nifti::is_one_compressed(&first) {
            Some(Self::Nifti)
        } else {
            None
        };
        let by_name = || if let Input::File(path) = input { Self::by_extension(path) } else { None };
        Ok(by_content.or_else(by_name))
    }

    fn by_extension(path: &Path) -> Option<Self> {
        let path = without_gz(path);
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "nrrd" | "nhdr" => Some(Self::Nrrd),
            "nii" | "hdr" | "img" => Some(Self::Nifti),
            "vti" => Some(Self::Vti),
            "json" => Some(Self::Json),
            "raw" => Some(Self::Raw),
            _ => None,
        }
    }
}

impl FromStr for VolumeName {
    type Err = VolumeError;

    /// Reads a name that is no file's; [`VolumeError::UnknownFormat`] when it is none of these either.
    fn from_str(name: &str) -> Result<Self, VolumeError> {
        if name.starts_with(raw::PREFIX) {
            return name.parse().map(|raw| Self::Raw(Box::new(raw)));
        }
        let (formula, number) =
            name.split_once(':').map_or((name, None), |(name, number)| (name, Some(number)));
        let formula = Formula::named(formula).ok_or(VolumeError::UnknownFormat)?;
        let refused =
            || VolumeError::in_name(name, Trouble::value(number.unwrap_or_default(), analytic::EXPECTED));
        let n = number.map_or(Some(ANALYTIC_SAMPLES), |number| number.parse().ok());
        let n = n.filter(|n| analytic::SIZES.contains(n)).ok_or_else(refused)?;
        Ok(Self::Analytic { formula, n })
    }
}

impl fmt::Display for VolumeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Analytic { formula, n } => write!(f, "{formula} of {n} samples a side"),
            Self::Raw(raw) => raw.path.display().fmt(f),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

/// Samples along each axis of a formula when nobody says.
const ANALYTIC_SAMPLES: u64 = 256;

/// Bytes that tell a format; the declaration and comments before `<VTKFile` fit too.
const FIRST_BYTES: u64 = 4096;
