//! Time taken by a program.

use core::ops::AddAssign;

use rustix::time::{ClockId, Timespec, clock_gettime};
use serde::Deserialize;

/// Time that something took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub(crate) struct Elapsed {
    /// Processor time of all threads of the process: other programs do not count, helping threads do.
    pub(crate) cpu_ms: f64,
    /// By the clock on the wall.
    pub(crate) wall_ms: f64,
}

/// Does something and tells how long it took.
pub(crate) fn time<T>(work: impl FnOnce() -> T) -> (Elapsed, T) {
    let now_ms = || {
        [ClockId::ProcessCPUTime, ClockId::Monotonic].map(|clock| {
            let Timespec { tv_sec, tv_nsec } = clock_gettime(clock);
            tv_sec as f64 * 1e3 + tv_nsec as f64 / 1e6
        })
    };
    let before = now_ms();
    let done = work();
    let after = now_ms();
    (Elapsed { cpu_ms: after[0] - before[0], wall_ms: after[1] - before[1] }, done)
}

impl AddAssign for Elapsed {
    fn add_assign(&mut self, other: Self) {
        self.cpu_ms += other.cpu_ms;
        self.wall_ms += other.wall_ms;
    }
}
