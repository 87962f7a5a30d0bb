//! What drawing a picture gave.

use core::ops::AddAssign;

use anyhow::{Result, ensure};
use serde::Deserialize;

use super::stopwatch::Elapsed;

/// One picture, or the sum of several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub(crate) struct Drawn {
    #[serde(flatten)]
    pub(crate) time: Elapsed,
    /// Rays from the eye.
    pub(crate) primary: u64,
    /// Those that met the scene.
    pub(crate) hits: u64,
    /// Rays towards the light.
    pub(crate) shadow: u64,
    /// Those that reached it.
    pub(crate) lit: u64,
    /// Sum of the greys of all pixels, in `0..=255` each.
    pub(crate) greys: u64,
}

impl Drawn {
    /// That two programs drew the same picture, but for the rounding of single rays.
    ///
    /// # Errors
    /// Says which count differs by more than 1 in 10,000. One ray more or less is always allowed, and a grey in
    /// 1,000, since a picture of few pixels may have an odd one.
    pub(crate) fn expect_like(&self, other: &Self) -> Result<()> {
        let counts = |of: &Self| {
            [
                ("rays from the eye", of.primary, 10_000),
                ("hits", of.hits, 10_000),
                ("shadow rays", of.shadow, 10_000),
                ("lit points", of.lit, 10_000),
                ("greys", of.greys, 1_000),
            ]
        };
        for ((what, here, part), (_, there, _)) in counts(self).into_iter().zip(counts(other)) {
            let allowed = here.max(there).div_ceil(part);
            ensure!(here.abs_diff(there) <= allowed, "SAME_RAYS: {here} {what} instead of {there}");
        }
        Ok(())
    }
}

impl AddAssign for Drawn {
    fn add_assign(&mut self, other: Self) {
        self.time += other.time;
        self.primary += other.primary;
        self.hits += other.hits;
        self.shadow += other.shadow;
        self.lit += other.lit;
        self.greys += other.greys;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_ray_in_ten_thousand_may_differ() {
        let drawn = Drawn { hits: 44_405, ..Drawn::default() };
        let other = |hits| Drawn { hits, ..drawn };
        assert!(drawn.expect_like(&other(44_410)).is_ok());
        let error = other(44_411).expect_like(&drawn).unwrap_err();
        assert_eq!(error.to_string(), "SAME_RAYS: 44411 hits instead of 44405");
    }

    #[test]
    fn a_program_answers_in_this_form() {
        let answer = r#"{"cpu_ms":1.5,"wall_ms":2,"primary":4,"hits":3,"shadow":2,"lit":1,"greys":9}"#;
        let time = Elapsed { cpu_ms: 1.5, wall_ms: 2.0 };
        let drawn = Drawn { time, primary: 4, hits: 3, shadow: 2, lit: 1, greys: 9 };
        assert_eq!(serde_json::from_str::<Drawn>(answer).unwrap(), drawn);
    }
}
