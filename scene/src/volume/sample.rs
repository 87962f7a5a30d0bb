//! Kinds of samples, and how their bytes become numbers.

use core::fmt;

/// What one sample of a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 32 bits.
    I32,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// Order of the bytes of one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endian {
    /// Lowest byte first.
    Little,
    /// Highest byte first.
    Big,
}

impl SampleType {
    /// Every type.
    pub const ALL: [Self; 8] =
        [Self::U8, Self::I8, Self::U16, Self::I16, Self::U32, Self::I32, Self::F32, Self::F64];

    /// The type of this name: `u8`, `i16`, `f32` and so on.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sample| sample.name() == name)
    }

    /// Name of the type.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// Length of one sample.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Lowest and highest value of a whole number of at most 16 bits; `None` for the other types.
    pub const fn narrow_range(self) -> Option<[i32; 2]> {
        match self {
            Self::U8 => Some([0, 0xff]),
            Self::I8 => Some([-0x80, 0x7f]),
            Self::U16 => Some([0, 0xffff]),
            Self::I16 => Some([-0x8000, 0x7fff]),
            Self::U32 | Self::I32 | Self::F32 | Self::F64 => None,
        }
    }

    /// Whether every sample is a whole number.
    pub const fn is_whole(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// Whether single precision holds every sample exactly.
    pub const fn is_exact_in_single(self) -> bool {
        !matches!(self, Self::U32 | Self::I32 | Self::F64)
    }

    /// Makes numbers of bytes.
    ///
    /// # Panics
    /// When there are not as many bytes as the numbers need.
    pub(super) fn decode(self, endian: Endian, bytes: &[u8], samples: &mut [f32]) {
        assert_eq!(bytes.len(), samples.len() * self.bytes(), "bytes of the samples");
        #[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest, as `VolumeSource` says")]
        match self {
            Self::U8 => decode_as(endian, bytes, samples, u8::from_ne_bytes, f32::from),
            Self::I8 => decode_as(endian, bytes, samples, i8::from_ne_bytes, f32::from),
            Self::U16 => decode_as(endian, bytes, samples, u16::from_ne_bytes, f32::from),
            Self::I16 => decode_as(endian, bytes, samples, i16::from_ne_bytes, f32::from),
            Self::U32 => decode_as(endian, bytes, samples, u32::from_ne_bytes, |value| value as f32),
            Self::I32 => decode_as(endian, bytes, samples, i32::from_ne_bytes, |value| value as f32),
            Self::F32 => decode_as(endian, bytes, samples, f32::from_ne_bytes, |value| value),
            Self::F64 => decode_as(endian, bytes, samples, f64::from_ne_bytes, |value| value as f32),
        }
    }

    /// Makes this machine's bytes of a number in text; `None` when it is no number of this type.
    ///
    /// # Panics
    /// When there are not as many bytes as the number needs.
    pub(super) fn encode(self, text: &str, bytes: &mut [u8]) -> Option<()> {
        match self {
            Self::U8 => bytes.copy_from_slice(&text.parse::<u8>().ok()?.to_ne_bytes()),
            Self::I8 => bytes.copy_from_slice(&text.parse::<i8>().ok()?.to_ne_bytes()),
            Self::U16 => bytes.copy_from_slice(&text.parse::<u16>().ok()?.to_ne_bytes()),
            Self::I16 => bytes.copy_from_slice(&text.parse::<i16>().ok()?.to_ne_bytes()),
            Self::U32 => bytes.copy_from_slice(&text.parse::<u32>().ok()?.to_ne_bytes()),
            Self::I32 => bytes.copy_from_slice(&text.parse::<i32>().ok()?.to_ne_bytes()),
            Self::F32 => bytes.copy_from_slice(&text.parse::<f32>().ok()?.to_ne_bytes()),
            Self::F64 => bytes.copy_from_slice(&text.parse::<f64>().ok()?.to_ne_bytes()),
        }
        Some(())
    }
}

impl Endian {
    /// The order of this machine.
    pub const NATIVE: Self = if cfg!(target_endian = "big") { Self::Big } else { Self::Little };

    /// The order of this name: `little` or `big`.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "little" => Some(Self::Little),
            "big" => Some(Self::Big),
            _ => None,
        }
    }
}

impl fmt::Display for SampleType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Decodes samples of `N` bytes; `from_bytes` takes them in this machine's order.
fn decode_as<const N: usize, T>(
    endian: Endian,
    bytes: &[u8],
    samples: &mut [f32],
    from_bytes: impl Fn([u8; N]) -> T,
    single: impl Fn(T) -> f32,
) {
    let (words, _) = bytes.as_chunks::<N>();
    if endian == Endian::NATIVE {
        for (sample, word) in samples.iter_mut().zip(words) {
            *sample = single(from_bytes(*word));
        }
    } else {
        for (sample, word) in samples.iter_mut().zip(words) {
            let mut word = *word;
            word.reverse();
            *sample = single(from_bytes(word));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(sample: SampleType, endian: Endian, bytes: &[u8]) -> Vec<f32> {
        let mut samples = vec![0.0; bytes.len() / sample.bytes()];
        sample.decode(endian, bytes, &mut samples);
        samples
    }

    #[test]
    fn every_type_is_decoded_in_both_orders() {
        let cases: [(SampleType, Vec<u8>, f32); 8] = [
            (SampleType::U8, vec![200], 200.0),
            (SampleType::I8, vec![200], -56.0),
            (SampleType::U16, 40_000_u16.to_le_bytes().to_vec(), 40_000.0),
            (SampleType::I16, (-1234_i16).to_le_bytes().to_vec(), -1234.0),
            (SampleType::U32, 4_000_000_000_u32.to_le_bytes().to_vec(), 4.0e9),
            (SampleType::I32, (-70_000_i32).to_le_bytes().to_vec(), -70_000.0),
            (SampleType::F32, 0.1_f32.to_le_bytes().to_vec(), 0.1),
            (SampleType::F64, 0.1_f64.to_le_bytes().to_vec(), 0.1),
        ];
        for (sample, mut bytes, value) in cases {
            assert_eq!(decoded(sample, Endian::Little, &bytes), [value], "{sample}");
            bytes.reverse();
            assert_eq!(decoded(sample, Endian::Big, &bytes), [value], "{sample}");
            assert_eq!(SampleType::named(sample.name()), Some(sample));
        }
        assert_eq!(SampleType::named("u64"), None);
    }

    #[test]
    fn what_is_no_number_passes_through() {
        let bytes: Vec<u8> =
            [f64::NAN, f64::INFINITY, -1.0e300, 1.0e-300].into_iter().flat_map(f64::to_be_bytes).collect();
        let samples = decoded(SampleType::F64, Endian::Big, &bytes);
        assert!(samples[0].is_nan());
        assert_eq!(samples[1..], [f32::INFINITY, f32::NEG_INFINITY, 0.0]);
    }
}
