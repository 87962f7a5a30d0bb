//! How samples are stored in a scene image.

use core::fmt;

use super::error::{Trouble, VolumeError};
use super::shape::{ValueMap, VolumeShape};

/// A number as it is stored for one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoredType {
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Single precision.
    F32,
}

/// How samples become stored numbers, and these become values.
///
/// # Invariants
/// A stored number is `(sample - low) / step`; rounded to the nearest and kept within its type when that is U8 or
/// U16, the sample itself when it is F32 (`low` is 0, `step` is 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storage {
    /// What is stored.
    pub stored: StoredType,
    /// Makes a value of a stored number: the isovalue a user gives is looked for at
    /// `world.invert(isovalue)` among stored numbers.
    pub world: ValueMap,
    /// Whether every stored number stands for the very sample that was read.
    pub is_exact: bool,
    /// Makes a sample of a stored number.
    sample: ValueMap,
}

/// What is known of all samples of a volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleRange {
    /// Lowest finite sample.
    pub low: f32,
    /// Highest finite sample.
    pub high: f32,
    /// Whether every sample is finite.
    pub is_finite: bool,
}

impl Storage {
    /// The smallest storage that loses nothing of the samples as they are read.
    ///
    /// Whole numbers of 8 and 16 bits are stored in as many, signed ones from their lowest on; everything else in
    /// single precision. With a known range, whole numbers are stored in as many bits as their range needs.
    pub fn lossless(shape: &VolumeShape, range: Option<&SampleRange>) -> Self {
        let narrow = |[low, high]: [f64; 2]| {
            let stored = [StoredType::U8, StoredType::U16].into_iter();
            stored
                .into_iter()
                .find(|stored| stored.codes().is_some_and(|codes| high - low <= codes))
                .map(|stored| (stored, low))
        };
        let by_type = shape.sample.narrow_range().map(|range| range.map(f64::from));
        let by_range =
            range.filter(|range| shape.sample.is_whole() && range.is_exact_whole()).map(SampleRange::ends);
        match by_range.or(by_type).and_then(narrow) {
            // The type's own lowest value where it fits as well: numbers are then those of the file.
            Some((stored, _)) if by_type.and_then(narrow).is_some_and(|(by_type, _)| by_type == stored) => {
                Self::stepped(shape, stored, by_type.map_or(0.0, |[low, _]| low), 1.0, true)
            }
            Some((stored, low)) => Self::stepped(shape, stored, low, 1.0, true),
            None => Self::stepped(shape, StoredType::F32, 0.0, 1.0, true),
        }
    }

    /// Storage of the type asked for: without loss where that is possible, else in equal steps from the lowest to
    /// the highest sample.
    ///
    /// # Errors
    /// When steps are needed and a sample is not finite, since no step stands for such a one.
    pub fn asked(shape: &VolumeShape, stored: StoredType, range: &SampleRange) -> Result<Self, VolumeError> {
        let smallest = Self::lossless(shape, Some(range));
        let Some(codes) = stored.codes() else {
            return Ok(Self::stepped(shape, stored, 0.0, 1.0, true));
        };
        if smallest.stored.codes().is_some_and(|needed| needed <= codes) {
            return Ok(Self { stored, ..smallest });
        }
        if !range.is_finite {
            let what = format!("storing samples that are NaN or infinite as {stored}");
            let trouble = Trouble::Unsupported { what, instead: "store them as f32" };
            return Err(VolumeError::in_samples(trouble));
        }
        let [low, high] = range.ends();
        let step = if high > low { (high - low) / codes } else { 1.0 };
        Ok(Self::stepped(shape, stored, low, step, high == low))
    }

    fn stepped(shape: &VolumeShape, stored: StoredType, low: f64, step: f64, is_exact: bool) -> Self {
        let sample = ValueMap { slope: step, intercept: low };
        Self { stored, world: shape.world.after(sample), is_exact, sample }
    }

    /// The stored number of a sample. Of a sample below the lowest or NaN it is 0, above the highest the highest,
    /// where the type is not F32.
    pub fn encode(&self, sample: f32) -> f32 {
        let Some(codes) = self.stored.codes() else { return sample };
        #[expect(clippy::cast_possible_truncation, reason = "a whole number of at most 16 bits")]
        let code = self.sample.invert(f64::from(sample)).round().clamp(0.0, codes) as f32;
        if code.is_nan() { 0.0 } else { code }
    }

    /// The value of a stored number.
    pub fn value(&self, code: f32) -> f64 {
        self.world.apply(f64::from(code))
    }
}

impl SampleRange {
    /// Lowest and highest sample.
    fn ends(&self) -> [f64; 2] {
        [self.low, self.high].map(f64::from)
    }

    /// Whether single precision tells all whole numbers of the range apart.
    fn is_exact_whole(&self) -> bool {
        self.is_finite && self.low.abs().max(self.high.abs()) < WHOLE_MAX
    }
}

impl StoredType {
    /// Every type, smallest first.
    pub const ALL: [Self; 3] = [Self::U8, Self::U16, Self::F32];

    /// The type of this name: `u8`, `u16` or `f32`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stored| stored.name() == name)
    }

    /// Name of the type.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::F32 => "f32",
        }
    }

    /// Length of one stored number.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// The highest stored number, the lowest being 0; `None` for single precision.
    const fn codes(self) -> Option<f64> {
        match self {
            Self::U8 => Some(255.0),
            Self::U16 => Some(65_535.0),
            Self::F32 => None,
        }
    }
}

impl fmt::Display for StoredType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// From here on single precision skips whole numbers.
const WHOLE_MAX: f32 = 16_777_216.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::SampleType;

    fn shape(sample: SampleType) -> VolumeShape {
        VolumeShape::new([2; 3], sample).expect("small")
    }

    fn range(low: f32, high: f32) -> SampleRange {
        SampleRange { low, high, is_finite: true }
    }

    #[test]
    fn what_is_stored_without_loss_is_the_sample_again() {
        let cases: [(SampleType, StoredType, &[f32]); 8] = [
            (SampleType::U8, StoredType::U8, &[0.0, 17.0, 255.0]),
            (SampleType::I8, StoredType::U8, &[-128.0, 0.0, 127.0]),
            (SampleType::U16, StoredType::U16, &[0.0, 300.0, 65_535.0]),
            (SampleType::I16, StoredType::U16, &[-32_768.0, -1.0, 32_767.0]),
            (SampleType::U32, StoredType::F32, &[0.0, 4.0e9]),
            (SampleType::I32, StoredType::F32, &[-2.0e9, 5.0]),
            (SampleType::F32, StoredType::F32, &[-1.0e30, 1.0e-30, f32::INFINITY]),
            (SampleType::F64, StoredType::F32, &[0.1]),
        ];
        for (sample, stored, values) in cases {
            let storage = Storage::lossless(&shape(sample), None);
            assert_eq!((storage.stored, storage.is_exact), (stored, true), "{sample}");
            for value in values {
                assert_eq!(storage.value(storage.encode(*value)), f64::from(*value), "{sample} {value}");
            }
        }
    }

    #[test]
    fn a_known_range_saves_bits_and_keeps_every_number() {
        let cases = [
            (SampleType::I16, range(-1024.0, 3071.0), StoredType::U16, -32_768.0),
            (SampleType::I16, range(1000.0, 1255.0), StoredType::U8, 1000.0),
            (SampleType::U16, range(0.0, 255.0), StoredType::U8, 0.0),
            (SampleType::U16, range(0.0, 256.0), StoredType::U16, 0.0),
            (SampleType::I32, range(-5.0, 65_530.0), StoredType::U16, -5.0),
            (SampleType::I32, range(-5.0, 65_531.0), StoredType::F32, 0.0),
            (SampleType::U32, range(4.0e9, 4.0e9), StoredType::F32, 0.0),
            (SampleType::F32, range(0.0, 1.0), StoredType::F32, 0.0),
        ];
        for (sample, range, stored, lowest) in cases {
            let storage = Storage::lossless(&shape(sample), Some(&range));
            assert_eq!((storage.stored, storage.value(0.0)), (stored, lowest), "{sample} {range:?}");
            for value in [range.low, range.high] {
                assert_eq!(storage.value(storage.encode(value)), f64::from(value), "{sample} {range:?}");
            }
        }
    }

    #[test]
    fn the_type_asked_for_is_exact_where_it_can_be_and_else_off_by_half_a_step() {
        let whole =
            Storage::asked(&shape(SampleType::U8), StoredType::U16, &range(0.0, 255.0)).expect("wider");
        assert!(whole.is_exact && whole.stored == StoredType::U16 && whole.encode(200.0) == 200.0);
        let steps =
            Storage::asked(&shape(SampleType::F32), StoredType::U8, &range(-1.0, 1.0)).expect("finite");
        assert!(!steps.is_exact);
        for value in [-1.0, -0.3, 0.0, 0.77, 1.0] {
            let error = steps.value(steps.encode(value)) - f64::from(value);
            assert!(error.abs() <= 1.0 / 255.0, "{value}: {error}");
        }
        assert_eq!([-9.0, f32::NAN, 9.0].map(|value| steps.encode(value)), [0.0, 0.0, 255.0]);
        let flat =
            Storage::asked(&shape(SampleType::F32), StoredType::U8, &range(0.3, 0.3)).expect("constant");
        assert!(flat.is_exact && flat.value(flat.encode(0.3)) == f64::from(0.3_f32));
    }

    #[test]
    fn steps_have_no_place_for_what_is_not_finite() {
        let range = SampleRange { is_finite: false, ..range(0.0, 1.0) };
        let error = Storage::asked(&shape(SampleType::F32), StoredType::U16, &range).expect_err("refused");
        let message =
            "samples: storing samples that are NaN or infinite as u16 is not read; store them as f32";
        assert_eq!(error.to_string(), message);
        assert!(Storage::asked(&shape(SampleType::F32), StoredType::F32, &range).is_ok());
    }

    #[test]
    fn values_of_the_file_go_through_both_maps() {
        let world = ValueMap { slope: 2.0, intercept: -1000.0 };
        let shape = VolumeShape { world, ..shape(SampleType::I16) };
        let storage = Storage::lossless(&shape, None);
        assert_eq!(storage.value(storage.encode(-3.0)), -1006.0);
        assert_eq!(storage.world.invert(-1006.0), 32_765.0);
    }
}
