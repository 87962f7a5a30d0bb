//! What a volume is, its samples aside.

use core::fmt;

use super::error::{Place, Trouble, VolumeError};
use super::sample::SampleType;

/// Number of samples, where they are, and what they mean.
///
/// # Shape and units
/// Sample `(i, j, k)` is at `origin + spacing * (i, j, k)` in world units. Eight samples bound a voxel cell, so
/// there are `dims - 1` cells along an axis; a volume of one sample along an axis has none.
#[derive(Clone, Debug, PartialEq)]
pub struct VolumeShape {
    /// Samples along x, y and z; at least 1 each. Their product fits 63 bits, and so do their bytes in the file.
    pub dims: [u64; 3],
    /// Distance from one sample to the next along each axis, in world units; positive and finite.
    pub spacing: [f64; 3],
    /// Place of the first sample, in world units; finite.
    pub origin: [f64; 3],
    /// What a sample is in the file.
    pub sample: SampleType,
    /// Makes the value of a sample, the one isovalues are given in.
    pub world: ValueMap,
    /// What was not taken as it stands in the file; each is worth a line to the user.
    pub notes: Vec<Note>,
}

/// A straight line: `slope * x + intercept`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueMap {
    /// Finite and not zero.
    pub slope: f64,
    /// Finite.
    pub intercept: f64,
}

/// Something that a reader left out or changed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Note {
    /// Samples are rounded to single precision.
    Rounded(SampleType),
    /// Axes in the file are rotated or mirrored; the volume is taken along its own.
    Orientation,
    /// The file does not say how far samples are apart; taken as 1.
    NoSpacing,
    /// Only the first of several volumes, or of several numbers for each sample, is read.
    FirstOf {
        /// How many there are.
        count: u64,
    },
    /// The file goes on behind the last sample.
    Trailing {
        /// For so many bytes.
        bytes: u64,
    },
}

impl VolumeShape {
    /// A shape with spacing 1 and its origin in zero, whose samples are their values.
    ///
    /// # Errors
    /// When there are no samples, or more than 63 bits can number bytes for.
    pub fn new(dims: [u64; 3], sample: SampleType) -> Result<Self, VolumeError> {
        let refused = |trouble| VolumeError::Broken { place: Place::Field("dimensions"), trouble };
        if dims.contains(&0) {
            return Err(refused(Trouble::NoSamples));
        }
        let bytes = dims.into_iter().try_fold(sample.bytes() as u64, u64::checked_mul);
        if bytes.is_none_or(|bytes| i64::try_from(bytes).is_err()) {
            return Err(refused(Trouble::TooLarge { dims }));
        }
        let notes = if sample.is_exact_in_single() { Vec::new() } else { vec![Note::Rounded(sample)] };
        Ok(Self { dims, spacing: [1.0; 3], origin: [0.0; 3], sample, world: ValueMap::IDENTITY, notes })
    }

    /// The same with other spacing.
    ///
    /// # Errors
    /// When a distance is not positive and finite.
    pub fn with_spacing(mut self, spacing: [f64; 3]) -> Result<Self, VolumeError> {
        if !spacing.iter().all(|distance| distance.is_finite() && *distance > 0.0) {
            let trouble = Trouble::value(format!("{spacing:?}"), "three finite numbers above 0");
            return Err(VolumeError::Broken { place: Place::Field("spacing"), trouble });
        }
        self.spacing = spacing;
        Ok(self)
    }

    /// The same with its first sample elsewhere.
    ///
    /// # Errors
    /// When a coordinate is not finite.
    pub fn with_origin(mut self, origin: [f64; 3]) -> Result<Self, VolumeError> {
        if !origin.iter().all(|coordinate| coordinate.is_finite()) {
            let trouble = Trouble::value(format!("{origin:?}"), "three finite numbers");
            return Err(VolumeError::Broken { place: Place::Field("origin"), trouble });
        }
        self.origin = origin;
        Ok(self)
    }

    /// Number of samples.
    pub const fn samples(&self) -> u64 {
        self.dims[0] * self.dims[1] * self.dims[2]
    }

    /// Number of samples of a slice.
    pub const fn slice_samples(&self) -> u64 {
        self.dims[0] * self.dims[1]
    }

    /// Length of all samples in the file, uncompressed.
    pub const fn bytes(&self) -> u64 {
        self.samples() * self.sample.bytes() as u64
    }

    /// Number of voxel cells along each axis.
    pub fn cells(&self) -> [u64; 3] {
        self.dims.map(|samples| samples - 1)
    }
}

impl ValueMap {
    /// Leaves numbers as they are.
    pub const IDENTITY: Self = Self { slope: 1.0, intercept: 0.0 };

    /// The value of a sample.
    pub fn apply(self, sample: f64) -> f64 {
        self.slope * sample + self.intercept
    }

    /// The sample whose value is this one; any number between two samples too.
    pub fn invert(self, value: f64) -> f64 {
        (value - self.intercept) / self.slope
    }

    /// This line after another.
    #[must_use]
    pub fn after(self, first: Self) -> Self {
        Self { slope: self.slope * first.slope, intercept: self.apply(first.intercept) }
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rounded(sample) => write!(f, "samples of type {sample} are rounded to single precision"),
            Self::Orientation => {
                write!(f, "the file's axes are rotated or mirrored; the volume is drawn along its own axes")
            }
            Self::NoSpacing => write!(f, "the file does not say how far samples are apart; taken as 1"),
            Self::FirstOf { count } => write!(f, "the first of {count} volumes in the file is read"),
            Self::Trailing { bytes } => {
                write!(f, "{bytes} bytes behind the last sample are left out; check dimensions and type")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_beyond_64_bits_are_refused_and_the_largest_within_is_not() {
        let shape = |dims, sample| VolumeShape::new(dims, sample);
        assert!(shape([1 << 21, 1 << 21, 1 << 20], SampleType::U8).is_ok());
        let far = shape([5120; 3], SampleType::F64).expect("a large volume");
        assert_eq!(far.bytes(), 1_073_741_824_000);
        for dims in [[1 << 21, 1 << 21, 1 << 21], [u64::MAX, 2, 1], [1 << 32, 1 << 32, 1]] {
            let error = shape(dims, SampleType::U8).expect_err("too large").to_string();
            assert!(error.contains("more samples than 63 bits can address"), "{error}");
        }
        assert!(shape([1 << 21, 1 << 21, 1 << 20], SampleType::U16).is_err());
        let error = shape([3, 0, 3], SampleType::U8).expect_err("no samples").to_string();
        assert_eq!(error, "dimensions: an axis has no samples; give at least 1 along each");
    }

    #[test]
    fn maps_are_undone_by_their_inverse_and_chain() {
        let celsius = ValueMap { slope: 0.5, intercept: -40.0 };
        let offset = ValueMap { slope: 1.0, intercept: -32_768.0 };
        assert_eq!(celsius.invert(celsius.apply(17.0)), 17.0);
        let both = celsius.after(offset);
        assert_eq!(both.apply(100.0), celsius.apply(offset.apply(100.0)));
    }
}
