//! What can be wrong with a volume.

use core::fmt;
use std::io;
use std::path::PathBuf;

/// Why a volume could not be read.
#[derive(Debug)]
#[non_exhaustive]
pub enum VolumeError {
    /// The file cannot be read.
    Io(io::Error),
    /// The file that a header names cannot be read.
    DataFile {
        /// Its path.
        path: PathBuf,
        /// Why it cannot.
        error: io::Error,
    },
    /// Neither content nor name is that of a format we read.
    UnknownFormat,
    /// The name or the file is broken: where, and what is wrong there.
    Broken {
        /// Where in the file or the name.
        place: Place,
        /// What is wrong.
        trouble: Trouble,
    },
}

/// A place in a volume's header, or in its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A line of text, from 1.
    Line(u64),
    /// A byte, from 0.
    Byte(u64),
    /// A field of the header.
    Field(&'static str),
    /// A part of the name that was given.
    Name(String),
    /// The header as a whole.
    Header,
    /// The samples.
    Samples,
}

/// What is wrong at a place.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trouble {
    /// There are fewer samples than the header declares.
    Truncated {
        /// Length of the samples by the header.
        declared: u64,
        /// Length of what there is.
        got: u64,
    },
    /// The header does not end, or is longer than any.
    EndlessHeader,
    /// Something that a volume needs is not declared.
    Missing(&'static str),
    /// Something is declared for the second time.
    Twice(String),
    /// A line or element of the header that makes no sense.
    Senseless(String),
    /// A value that is not what belongs here.
    Value {
        /// The value, shortened.
        value: String,
        /// What belongs here.
        expected: &'static str,
    },
    /// Something that exists and is not read.
    Unsupported {
        /// What it is.
        what: String,
        /// What to do.
        instead: &'static str,
    },
    /// An axis without samples.
    NoSamples,
    /// More samples than 63 bits can address.
    TooLarge {
        /// Samples along each axis.
        dims: [u64; 3],
    },
    /// Compressed or encoded samples do not decode.
    Corrupt(String),
}

impl VolumeError {
    pub(super) const fn at_line(line: u64, trouble: Trouble) -> Self {
        Self::Broken { place: Place::Line(line), trouble }
    }

    pub(super) const fn in_field(field: &'static str, trouble: Trouble) -> Self {
        Self::Broken { place: Place::Field(field), trouble }
    }

    pub(super) const fn in_header(trouble: Trouble) -> Self {
        Self::Broken { place: Place::Header, trouble }
    }

    pub(super) const fn in_samples(trouble: Trouble) -> Self {
        Self::Broken { place: Place::Samples, trouble }
    }

    pub(super) fn in_name(part: &str, trouble: Trouble) -> Self {
        Self::Broken { place: Place::Name(shortened(part)), trouble }
    }
}

impl Trouble {
    pub(super) fn value(value: impl AsRef<str>, expected: &'static str) -> Self {
        Self::Value { value: shortened(value.as_ref()), expected }
    }

    pub(super) fn unsupported(what: impl AsRef<str>, instead: &'static str) -> Self {
        Self::Unsupported { what: shortened(what.as_ref()), instead }
    }
}

impl fmt::Display for VolumeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot read the file: {error}"),
            Self::DataFile { path, error } => {
                write!(f, "cannot read {}, which has the samples: {error}", path.display())
            }
            Self::UnknownFormat => write!(
                f,
                "not a volume that can be read: give an NRRD, NIfTI or VTI file, a .json beside a raw file, \
                 or raw:FILE?dims=XxYxZ&type=u8"
            ),
            Self::Broken { place: Place::Header, trouble } => trouble.fmt(f),
            Self::Broken { place, trouble } => write!(f, "{place}: {trouble}"),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
            Self::Field(field) => f.write_str(field),
            Self::Name(part) => f.write_str(part),
            Self::Header => f.write_str("header"),
            Self::Samples => f.write_str("samples"),
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { declared, got } => write!(
                f,
                "the file ends after {got} of {declared} bytes; it was cut short, or dimensions or type are wrong"
            ),
            Self::EndlessHeader => {
                write!(f, "the header does not end; the file was cut short or is something else")
            }
            Self::Missing(what) => write!(f, "does not say {what}"),
            Self::Twice(what) => write!(f, "declared twice: {what:?}"),
            Self::Senseless(what) => write!(f, "this makes no sense: {what:?}"),
            Self::Value { value, expected } => write!(f, "{value:?} is not {expected}"),
            Self::Unsupported { what, instead } => write!(f, "{what} is not read; {instead}"),
            Self::NoSamples => write!(f, "an axis has no samples; give at least 1 along each"),
            Self::TooLarge { dims: [x, y, z] } => {
                write!(f, "{x} x {y} x {z} are more samples than 63 bits can address")
            }
            Self::Corrupt(why) => write!(f, "cannot be decoded ({why}); the file is damaged"),
        }
    }
}

impl core::error::Error for VolumeError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Self::Io(error) | Self::DataFile { error, .. } => Some(error),
            Self::UnknownFormat | Self::Broken { .. } => None,
        }
    }
}

impl From<io::Error> for VolumeError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// The beginning of a text, for a message of one line.
pub(super) fn shortened(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).take(60).collect()
}
