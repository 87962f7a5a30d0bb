//! How long to wait for an answer: the round trips measured so far, smoothed, in integers.

/// What the round trips to one peer have been like.
///
/// # Shape and units
/// Microseconds; kept eight times and four times as large, so that shifts take the place of fractions. 8 bytes.
///
/// # Edge cases
/// A round trip of 0 counts as 1. Beyond [`ROUND_TRIP_MAX_US`] (four and a half minutes) it counts as that.
///
/// # Source
/// Paxson, Allman, Chu, Sargent, RFC 6298, "Computing TCP's Retransmission Timer", 2011, with alpha = 1/8, beta = 1/4,
/// K = 4 and a clock granularity G of 1 us; the integer form is Jacobson's, "Congestion Avoidance and Control", 1988.
/// We differ: the least timeout is the caller's instead of one second (its rule 2.4), since a page on a local network
/// comes in tens of microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct RoundTrip {
    /// SRTT, times 8. 0: nothing has been measured.
    smoothed_x8: u32,
    /// RTTVAR, times 4, which is K times RTTVAR.
    variation_x4: u32,
}

/// Bounds of the time to a resending, in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    /// Before anything has been measured.
    pub(crate) first_us: u64,
    pub(crate) min_us: u64,
    pub(crate) max_us: u64,
}

/// The longest round trip that is told from longer ones.
pub(crate) const ROUND_TRIP_MAX_US: u32 = 1 << 28;

/// Doublings of a timeout after which it doubles no more: with any bounds it has met the greatest by then.
pub(crate) const BACKOFF_MAX: u8 = 32;

impl RoundTrip {
    /// Nothing has been measured.
    pub(crate) const NOTHING: Self = Self { smoothed_x8: 0, variation_x4: 0 };

    /// Takes a measurement into account. The caller knows which sending was answered.
    pub(crate) fn measure(&mut self, round_trip_us: u64) {
        let measured = u32::try_from(round_trip_us).unwrap_or(u32::MAX).clamp(1, ROUND_TRIP_MAX_US);
        if self.smoothed_x8 == 0 {
            // RFC 6298 (2.2): SRTT <- R, RTTVAR <- R/2.
            (self.smoothed_x8, self.variation_x4) = (measured * 8, measured * 2);
            return;
        }
        // (2.3): RTTVAR <- (1 - beta) * RTTVAR + beta * |SRTT - R'|, then SRTT <- (1 - alpha) * SRTT + alpha * R'.
        let difference = (self.smoothed_x8 / 8).abs_diff(measured);
        self.variation_x4 = self.variation_x4 - self.variation_x4 / 4 + difference;
        self.smoothed_x8 = (self.smoothed_x8 - self.smoothed_x8 / 8 + measured).max(8);
    }

    /// The time to a resending, doubled `backoff` times (rules 2.3, 2.4, 2.5, 5.5).
    pub(crate) fn timeout_us(&self, limits: Limits, backoff: u8) -> u64 {
        let base = if self.smoothed_x8 == 0 {
            limits.first_us
        } else {
            (u64::from(self.smoothed_x8 / 8) + u64::from(self.variation_x4.max(1))).max(limits.min_us)
        };
        let backoff = if crate::mutants::is_on(crate::mutants::Mutant::NeverBackOff) { 0 } else { backoff };
        base.saturating_mul(1 << backoff.min(BACKOFF_MAX)).min(limits.max_us)
    }

    /// The smoothed round trip in microseconds, or `None` before the first measurement.
    pub(crate) fn smoothed_us(&self) -> Option<u64> {
        (self.smoothed_x8 > 0).then_some(u64::from(self.smoothed_x8 / 8))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: Limits = Limits { first_us: 10_000, min_us: 1, max_us: 60_000_000 };

    /// The formulas of the RFC as they stand there, with fractions.
    struct Reference(Option<(f64, f64)>);

    impl Reference {
        fn measure(&mut self, measured: f64) {
            self.0 = Some(match self.0 {
                None => (measured, measured / 2.0),
                Some((smoothed, variation)) => (
                    smoothed * 7.0 / 8.0 + measured / 8.0,
                    variation * 3.0 / 4.0 + (smoothed - measured).abs() / 4.0,
                ),
            });
        }

        fn timeout(&self) -> f64 {
            self.0.map_or(10_000.0, |(smoothed, variation)| smoothed + (4.0 * variation).max(1.0))
        }
    }

    proptest! {
        #[test]
        fn integers_keep_close_to_the_formulas_of_the_rfc(trips in prop::collection::vec(0u32..25, 1..100)) {
            let (mut ours, mut theirs) = (RoundTrip::NOTHING, Reference(None));
            for power in trips {
                // 1 us to 10 s and a little beyond.
                let measured = 1u32 << power;
                ours.measure(measured.into());
                theirs.measure(measured.into());
                let (ours, theirs) = (ours.timeout_us(LIMITS, 0) as f64, theirs.timeout().min(60_000_000.0));
                prop_assert!((ours - theirs).abs() <= theirs * 0.01 + 16.0, "{ours} {theirs}");
            }
        }
    }

    #[test]
    fn before_the_first_answer_the_first_timeout_doubles() {
        let trip = RoundTrip::NOTHING;
        assert_eq!(
            [0, 1, 2, 255].map(|backoff| trip.timeout_us(LIMITS, backoff)),
            [10_000, 20_000, 40_000, 60_000_000]
        );
        assert_eq!(trip.smoothed_us(), None);
    }

    #[test]
    fn steady_round_trips_from_a_microsecond_to_ten_seconds_are_waited_for_and_little_more() {
        for micros in [1u64, 10, 1_000, 100_000, 10_000_000] {
            let mut trip = RoundTrip::NOTHING;
            (0..50).for_each(|_| trip.measure(micros));
            let timeout = trip.timeout_us(LIMITS, 0);
            assert!(timeout > micros && timeout <= micros + micros / 8 + 8, "{micros}: {timeout}");
        }
    }

    #[test]
    fn absurd_round_trips_are_survived() {
        let mut trip = RoundTrip::NOTHING;
        for micros in [u64::MAX, 0, u64::MAX, 0, 0] {
            trip.measure(micros);
            assert!((1..=LIMITS.max_us).contains(&trip.timeout_us(LIMITS, 255)));
        }
    }
}
