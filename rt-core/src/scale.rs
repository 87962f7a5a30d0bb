//! Exact scaling by powers of two.
//!
//! A scene image stores coordinates times a power of two, chosen so that the largest is about 1, and a ray's
//! direction is normalised by a power of two. Neither rounds (unless a value is so much smaller than the
//! largest that it becomes denormal), so a scene of 1e-18 or 1e18 units is traced with the very same
//! arithmetic as one of unit size.

use glam::Vec3;

/// Multiplication by `2^exponent`, for any exponent that turns one finite `f32` into another.
///
/// Two factors, since `2^exponent` itself may not be an `f32`; both push the same way, so a product that fits
/// never overflows or becomes denormal on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    exponent: i32,
    factors: [f32; 2],
}

impl Scale {
    /// The scale by 1.
    pub const ONE: Self = Self::new(0);

    /// The scale by `2^exponent`; exponents beyond ±[`Self::EXPONENT_MAX`] are taken as that.
    pub const fn new(exponent: i32) -> Self {
        let exponent = if exponent < -Self::EXPONENT_MAX { -Self::EXPONENT_MAX } else { exponent };
        let exponent = if exponent > Self::EXPONENT_MAX { Self::EXPONENT_MAX } else { exponent };
        let half = exponent / 2;
        Self { exponent, factors: [power_of_two(half), power_of_two(exponent - half)] }
    }

    /// The exponent of the power of two.
    pub const fn exponent(self) -> i32 {
        self.exponent
    }

    /// The scale that undoes this one.
    #[must_use]
    pub const fn inverse(self) -> Self {
        Self { exponent: -self.exponent, factors: [1.0 / self.factors[0], 1.0 / self.factors[1]] }
    }

    /// `value * 2^exponent`.
    #[inline]
    pub const fn apply(self, value: f32) -> f32 {
        value * self.factors[0] * self.factors[1]
    }

    /// `value * 2^exponent` for each component.
    #[inline]
    pub fn apply_to(self, value: Vec3) -> Vec3 {
        value * self.factors[0] * self.factors[1]
    }

    /// Largest exponent: it takes the smallest denormal to 2^103, well inside the range of `f32`.
    pub const EXPONENT_MAX: i32 = 252;
}

/// `2^exponent` for `exponent` in `-126..=127`.
///
/// # Panics
/// In debug builds when the exponent is outside that range.
#[inline]
pub const fn power_of_two(exponent: i32) -> f32 {
    debug_assert!(exponent >= -126 && exponent <= 127);
    #[expect(clippy::cast_sign_loss, reason = "the biased exponent is in 1..=254")]
    f32::from_bits(((exponent + 127) as u32) << 23)
}

/// The exponent `e` with `2^e <= |value| < 2^(e + 1)`; 0 for zero.
///
/// `value` is finite. Denormals give their true exponent, down to -149.
#[inline]
pub fn exponent_of(value: f32) -> i32 {
    let biased = (value.to_bits() >> 23) & 0xff;
    if biased != 0 {
        return biased.cast_signed() - 127;
    }
    if value == 0.0 { 0 } else { libm::frexpf(value).1 - 1 }
}

#[cfg(test)]
mod tests {
    use super::{Scale, exponent_of};

    #[test]
    fn scaling_forth_and_back_is_exact() {
        for exponent in -Scale::EXPONENT_MAX..=Scale::EXPONENT_MAX {
            let scale = Scale::new(exponent);
            for value in [1.0_f32, 1.999_999_9, -1.234_567_8, 3.0e-5] {
                let there = scale.apply(value);
                if (-126..=127).contains(&(exponent_of(value) + exponent)) {
                    assert_eq!(
                        scale.inverse().apply(there).to_bits(),
                        value.to_bits(),
                        "2^{exponent} of {value}"
                    );
                    assert_eq!(exponent_of(there), exponent_of(value) + exponent);
                }
            }
        }
    }

    #[test]
    fn exponents_of_powers_and_denormals() {
        assert_eq!(exponent_of(1.0), 0);
        assert_eq!(exponent_of(-0.75), -1);
        assert_eq!(exponent_of(1.0e-40), -133);
        assert_eq!(exponent_of(f32::from_bits(1)), -149);
        assert_eq!(exponent_of(f32::MAX), 127);
        assert_eq!(Scale::new(149).apply(f32::from_bits(1)), 1.0);
    }
}
