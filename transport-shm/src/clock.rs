//! The clock that deadlines are on.

use dsm_core::time::Instant;
use rustix::time::{ClockId, clock_gettime};

/// Now, on `CLOCK_MONOTONIC` in microseconds. Async-signal-safe.
#[must_use]
pub fn now() -> Instant {
    let time = clock_gettime(ClockId::Monotonic);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    let nanoseconds = u64::try_from(time.tv_nsec).unwrap_or(0);
    Instant::from_micros(seconds.saturating_mul(1_000_000).saturating_add(nanoseconds / 1000))
}
