//! Which moment of a session is drawn next.

use core::time::Duration;

use super::Session;

/// How a session is replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Replay {
    /// Every moment is a frame, as fast as frames can be drawn.
    #[default]
    Frames,
    /// As it was: a frame shows the latest moment whose time has come. A slow cluster leaves moments out, a fast one
    /// waits. The first and the last moment are always drawn.
    Time,
}

/// A moment to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Its place in the session.
    pub moment: usize,
    /// How long to wait before.
    pub wait: Duration,
}

impl Replay {
    /// The name under which it is chosen.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Time => "time",
        }
    }

    /// What is drawn after moment `drawn`, or at first; `None` when the session is over. `elapsed` counts from the first
    /// frame's beginning.
    #[must_use]
    pub fn next(self, session: &Session, drawn: Option<usize>, elapsed: Duration) -> Option<Step> {
        let moments = session.moments();
        let next = drawn.map_or(0, |drawn| drawn + 1);
        let (first, following) = (moments.first()?, moments.get(next)?);
        let now = match self {
            Self::Frames => return Some(Step { moment: next, wait: Duration::ZERO }),
            Self::Time => elapsed.as_secs_f64() + first.time,
        };
        // Moments lie in order of time.
        let due = moments.partition_point(|moment| moment.time <= now).max(1) - 1;
        let wait = Duration::try_from_secs_f64(following.time - now).unwrap_or(Duration::ZERO);
        Some(if due > next && drawn.is_some() {
            Step { moment: due, wait: Duration::ZERO }
        } else {
            Step { moment: next, wait }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Moment;
    use super::*;

    fn session(times: &[f64]) -> Session {
        let moments = times.iter().map(|time| Moment { time: *time, ..Moment::default() });
        Session::new("test", moments.collect()).unwrap()
    }

    /// Moments drawn, and when, when each frame takes so many milliseconds.
    fn replayed(replay: Replay, times: &[f64], ms: u64) -> (Vec<usize>, Vec<u128>) {
        let session = session(times);
        let (mut drawn, mut at, mut elapsed) = (Vec::new(), Vec::new(), Duration::ZERO);
        while let Some(Step { moment, wait }) = replay.next(&session, drawn.last().copied(), elapsed) {
            elapsed += wait;
            drawn.push(moment);
            at.push(elapsed.as_millis());
            elapsed += Duration::from_millis(ms);
        }
        (drawn, at)
    }

    #[test]
    fn by_frames_every_moment_is_drawn() {
        assert_eq!(replayed(Replay::Frames, &[0.0, 0.1, 9.0], 50), (vec![0, 1, 2], vec![0, 50, 100]));
    }

    #[test]
    fn by_time_a_fast_cluster_waits() {
        let expected = (vec![0, 1, 2, 3], vec![0, 125, 250, 500]);
        assert_eq!(replayed(Replay::Time, &[7.0, 7.125, 7.25, 7.5], 25), expected);
    }

    #[test]
    fn by_time_a_slow_cluster_leaves_moments_out_but_not_the_last() {
        let times = [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75];
        assert_eq!(replayed(Replay::Time, &times, 300), (vec![0, 2, 4, 6], vec![0, 300, 600, 900]));
        assert_eq!(replayed(Replay::Time, &times, 10_000), (vec![0, 6], vec![0, 10_000]));
        assert_eq!(replayed(Replay::Time, &[0.0, 0.0, 0.0], 1), (vec![0, 2], vec![0, 1]));
        assert_eq!(replayed(Replay::Time, &[3.0], 1), (vec![0], vec![0]));
    }
}
