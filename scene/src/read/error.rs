//! What can be wrong with a mesh file.

use core::fmt;
use std::io;

/// Why a mesh could not be read.
#[derive(Debug)]
#[non_exhaustive]
pub enum ReadError {
    /// The file cannot be read.
    Io(io::Error),
    /// Neither content nor name is that of a format we read.
    UnknownFormat,
    /// The file is broken: where, and what is wrong there.
    Broken {
        /// Where in the file.
        place: Place,
        /// What is wrong.
        trouble: Trouble,
    },
}

/// A place in a mesh file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A line of text, from 1.
    Line(u64),
    /// One of a PLY file's elements, from 0; the element's name and how many the header declares.
    Element {
        /// Name of the element, such as `vertex`.
        name: String,
        /// Number of this one, from 0.
        index: u64,
        /// Number of them by the header.
        declared: u64,
    },
    /// The file as a whole.
    File,
}

/// What is wrong at a place.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trouble {
    /// The file ends here.
    Truncated,
    /// The header does not end.
    EndlessHeader,
    /// A line of a header that makes no sense.
    HeaderLine(String),
    /// A second format line, element of the same name, or property of the same name in one element.
    Twice(String),
    /// A header without a line that says its format.
    NoFormat,
    /// Something that a mesh needs is not declared.
    Missing(&'static str),
    /// Something is declared with a type that cannot be it.
    WrongType(&'static str),
    /// A value that is no number, or a line with too few or too many of them.
    BadValue,
    /// A coordinate is NaN, infinite, or too large for 32 bits.
    NotFinite,
    /// An index names a vertex that does not exist.
    NoSuchVertex {
        /// The index as it stands in the file.
        index: i64,
        /// Vertices there are.
        vertices: u64,
    },
    /// More vertices than 32-bit indices can name.
    TooMany,
}

impl ReadError {
    pub(super) const fn at_line(line: u64, trouble: Trouble) -> Self {
        Self::Broken { place: Place::Line(line), trouble }
    }

    pub(super) const fn in_file(trouble: Trouble) -> Self {
        Self::Broken { place: Place::File, trouble }
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot read the file: {error}"),
            Self::UnknownFormat => write!(f, "not a mesh that can be read: give a PLY or OBJ file"),
            Self::Broken { place: Place::File, trouble } => trouble.fmt(f),
            Self::Broken { place: Place::Line(line), trouble } => write!(f, "line {line}: {trouble}"),
            Self::Broken { place: Place::Element { name, index, declared }, trouble } => {
                write!(f, "{name} {index} of {declared}: {trouble}")
            }
        }
    }
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => {
                write!(f, "the file ends here; it was cut short, or its header declares too much")
            }
            Self::EndlessHeader => write!(f, "the header has no end_header line"),
            Self::HeaderLine(line) => write!(f, "this header line makes no sense: {line:?}"),
            Self::Twice(what) => write!(f, "declared twice: {what:?}"),
            Self::NoFormat => write!(f, "the header has no format line"),
            Self::Missing(what) => write!(f, "the header declares no {what}"),
            Self::WrongType(what) => {
                write!(f, "{what} must be whole numbers, but are declared as float or double")
            }
            Self::BadValue => write!(f, "not the numbers that belong here"),
            Self::NotFinite => write!(f, "a coordinate is not finite, or too large for a 32-bit float"),
            Self::NoSuchVertex { index, vertices } => {
                write!(f, "index {index} names no vertex; there are {vertices}")
            }
            Self::TooMany => write!(f, "more vertices than 32-bit indices can name"),
        }
    }
}

impl core::error::Error for ReadError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        if let Self::Io(error) = self { Some(error) } else { None }
    }
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}
