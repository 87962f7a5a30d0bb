//! Why a volume could not be made into a scene image.

use core::fmt;
use std::io;

use rt_core::volume::SAMPLES_MAX;

use crate::volume::VolumeError;
use crate::write::WriteError;

/// Why a volume could not be made into a scene image.
#[derive(Debug)]
#[non_exhaustive]
pub enum PrepareError {
    /// The volume cannot be read, or not be stored as asked.
    Volume(VolumeError),
    /// The image cannot be written.
    Write(WriteError),
    /// More samples along an axis than an image can hold.
    TooLarge {
        /// Samples along each axis.
        dims: [u32; 3],
    },
    /// More samples along an axis than 32 bits can number.
    TooLong {
        /// Samples along that axis.
        samples: u64,
    },
    /// Spacing or origin are so extreme that single-precision coordinates overflow.
    OutOfRange,
}

impl fmt::Display for PrepareError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Volume(error) => error.fmt(f),
            Self::Write(error) => error.fmt(f),
            Self::TooLarge { dims: [x, y, z] } => {
                write!(f, "a volume of {x}x{y}x{z} samples has more bricks than this machine can number")
            }
            Self::TooLong { samples } => {
                write!(f, "{samples} samples along an axis; an image holds at most {SAMPLES_MAX}")
            }
            Self::OutOfRange => {
                write!(f, "the volume's origin or spacing overflow single precision; choose other units")
            }
        }
    }
}

impl core::error::Error for PrepareError {}

impl From<VolumeError> for PrepareError {
    fn from(error: VolumeError) -> Self {
        Self::Volume(error)
    }
}

impl From<WriteError> for PrepareError {
    fn from(error: WriteError) -> Self {
        Self::Write(error)
    }
}

impl From<io::Error> for PrepareError {
    fn from(error: io::Error) -> Self {
        Self::Write(error.into())
    }
}
