//! Medians, and how far the rest lies around them.

/// A measured number: the median of several, and the quarter of them that lies below and above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spread {
    pub(crate) median: f64,
    /// A quarter of the samples is not above this.
    pub(crate) low: f64,
    /// A quarter of the samples is not below this.
    pub(crate) high: f64,
}

impl Spread {
    /// The spread of `samples`; all zero when there are none.
    pub(crate) fn of(samples: &[f64]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let at = |share| between(&sorted, share);
        Self { median: at(0.5), low: at(0.25), high: at(0.75) }
    }

    /// The spread in another unit.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self { median: self.median * factor, low: self.low * factor, high: self.high * factor }
    }
}

/// The value at a share of the sorted ones, which may lie between two of them; 0 when there are none.
fn between(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    let at =
        |place: f64| quantile(sorted, place / sorted.len().saturating_sub(1).max(1) as f64).unwrap_or(0.0);
    let (below, above) = (at(place.floor()), at(place.ceil()));
    below + (above - below) * place.fract()
}

/// The value that a share of the sorted values does not exceed; `None` when there are none.
pub(crate) fn quantile<T: Copy>(sorted: &[T], share: f64) -> Option<T> {
    let last = sorted.len().checked_sub(1)?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in 0..=last")]
    let index = (share.clamp(0.0, 1.0) * last as f64).round() as usize;
    sorted.get(index).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_in_the_middle_whatever_the_order() {
        let spread = Spread::of(&[9.0, 1.0, 5.0, 3.0, 7.0]);
        assert_eq!(spread, Spread { median: 5.0, low: 3.0, high: 7.0 });
        assert_eq!(spread.scaled(2.0).high, 14.0);
        assert_eq!(Spread::of(&[4.0, 1.0]).median, 2.5);
        assert_eq!(Spread::of(&[4.0]).median, 4.0);
    }

    #[test]
    fn nothing_measured_is_zero() {
        assert_eq!(Spread::of(&[]).median, 0.0);
        assert_eq!(quantile::<u32>(&[], 0.5), None);
    }
}
