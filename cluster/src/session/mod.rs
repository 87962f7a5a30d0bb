//! Sessions: where the eye and the light are and which isosurfaces are shown, moment by moment. Made or recorded once,
//! replayed on any cluster.
//!
//! | module | what it holds |
//! |---|---|
//! | `file` | the file: one line of JSON for each moment |
//! | `way` | sessions that are made: an orbit, a walk, a jump, a still view, a volume |
//! | `replay` | which moment is drawn next: every one, or the one whose time has come |

mod file;
mod replay;
mod way;

pub use replay::{Replay, Step};
pub use way::{Path, Sweep, Way};

use anyhow::{Context, Result, bail};
use rt_core::camera::Aim;
use rt_core::{Bounds, Frame, ISOVALUES_MAX, Isosurface, Orbit, Solver};

use crate::isovalue::Surface;
use crate::size::PictureSize;

/// What is looked at and when: a list of moments, the first at any time, none before the one it follows.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    name: String,
    moments: Vec<Moment>,
}

/// One moment of a session.
///
/// # Shape and units
/// Points are offsets from the centre of the scene's bounds, in diagonals of them, so a session fits scenes of any place
/// and size. The axes are the scene's.
#[derive(Clone, Debug, PartialEq)]
pub struct Moment {
    /// Seconds since the session began.
    pub time: f64,
    /// Where the eye is, and what it looks at.
    pub aim: Aim,
    /// Where the point light is.
    pub light: [f64; 3],
    /// The isosurfaces of a volume; `None` where the session leaves them to whoever replays it.
    pub isosurfaces: Option<Vec<Surface>>,
}

/// Moments of a session at most; a day of a hundred a second.
pub const MOMENTS_MAX: usize = 8_640_000;

/// The farthest that a point may be from the centre, in diagonals.
const DISTANCE_MAX: f64 = 1.0e6;

/// The smallest sine of the angle between the line of sight and up.
const SINE_MIN: f64 = 1.0e-4;

/// Where the light is unless a session says so: above and to the right of the first camera.
const LIGHT: [f64; 3] = [1.0, 2.0, 1.5];

impl Session {
    /// A session of these moments.
    ///
    /// # Errors
    /// There are none or too many, or one makes no sense; the message tells which and why.
    pub fn new(name: impl Into<String>, moments: Vec<Moment>) -> Result<Self> {
        if moments.is_empty() || moments.len() > MOMENTS_MAX {
            bail!("a session has 1 to {MOMENTS_MAX} moments; got {}", moments.len());
        }
        for (index, moment) in moments.iter().enumerate() {
            let before = index.checked_sub(1).map(|before| moments[before].time);
            moment.check(before).with_context(|| format!("moment {index}"))?;
        }
        Ok(Self { name: name.into(), moments })
    }

    /// What it is called: how it was made, or the file it was read from.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its moments; there is at least one.
    #[must_use]
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// How many moments there are.
    pub(crate) fn count(&self) -> u32 {
        // At most `MOMENTS_MAX`.
        u32::try_from(self.moments.len()).unwrap_or(u32::MAX)
    }

    /// Whether it says which isosurfaces are shown.
    pub(crate) fn has_isosurfaces(&self) -> bool {
        self.moments.iter().any(|moment| moment.isosurfaces.is_some())
    }

    /// The frame of each moment, of a scene within these bounds. `resolve` finds the isosurfaces of a moment; it is given
    /// `None` where the session leaves that open.
    pub(crate) fn frames(
        &self,
        bounds: &Bounds,
        PictureSize { width, height }: PictureSize,
        solver: Solver,
        resolve: impl Fn(Option<&[Surface]>) -> Result<Vec<Isosurface>>,
    ) -> Result<Vec<Frame>> {
        let orbit = Orbit::around(bounds);
        let frame = |(number, moment): (u32, &Moment)| {
            let isosurfaces = resolve(moment.isosurfaces.as_deref())?;
            Frame::aimed(number, &orbit, &moment.aim, moment.light, [width, height])
                .and_then(|frame| frame.with_isosurfaces(&isosurfaces, solver))
                .with_context(|| format!("no camera at {:?} diagonals of this scene", moment.aim.eye))
        };
        (0..).zip(&self.moments).map(frame).collect()
    }
}

/// A still view from 1.5 diagonals.
impl Default for Session {
    fn default() -> Self {
        Self { name: "still".to_owned(), moments: vec![Moment::default()] }
    }
}

/// The start of an orbit at 1.5 diagonals.
impl Default for Moment {
    fn default() -> Self {
        let aim = Aim { eye: [0.0, 0.0, 1.5], at: [0.0; 3], up: [0.0, 1.0, 0.0] };
        Self { time: 0.0, aim, light: LIGHT, isosurfaces: None }
    }
}

impl Moment {
    /// Whether it can be drawn, after a moment of that time; says what is wrong and what to do.
    fn check(&self, before: Option<f64>) -> Result<()> {
        let Self { time, aim: Aim { eye, at, up }, light, isosurfaces } = self;
        if !(0.0..=1.0e9).contains(time) {
            bail!("time {time} is not a number of seconds from 0 to 1e9");
        }
        if let Some(before) = before.filter(|before| before > time) {
            bail!("time {time} is before {before} of the moment before; put the moments in order of time");
        }
        for (what, point) in [("eye", eye), ("at", at), ("light", light), ("up", up)] {
            if !point.iter().all(|one| one.abs() <= DISTANCE_MAX) {
                bail!(
                    "no camera with {what} {point:?}; its numbers are diagonals of the scene, from -1e6 to 1e6"
                );
            }
        }
        let sight = [0, 1, 2].map(|axis| at[axis] - eye[axis]);
        if length(sight) == 0.0 {
            bail!("eye and at are the same point, {eye:?}; at is what the eye looks at, as in [0,0,0]");
        }
        if length(cross(sight, *up)) < SINE_MIN * length(sight) * length(*up) || length(*up) == 0.0 {
            bail!("up {up:?} is along the line of sight; give another direction, as in [0,0,1]");
        }
        match isosurfaces.as_ref().map_or(1, Vec::len) {
            1..=ISOVALUES_MAX => Ok(()),
            got => bail!("{got} isovalues; give 1 to {ISOVALUES_MAX}"),
        }
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::isovalue::Isovalue;

    fn at(time: f64, eye: [f64; 3]) -> Moment {
        let aim = Aim { eye, ..Moment::default().aim };
        Moment { time, aim, ..Moment::default() }
    }

    #[test]
    fn moments_that_cannot_be_drawn_are_refused() {
        let surface = Surface { isovalue: Isovalue::Auto, albedo: 0.5 };
        let with = |surfaces| Moment { isosurfaces: Some(surfaces), ..Moment::default() };
        for (moments, words) in [
            (vec![], "1 to"),
            (vec![at(f64::NAN, [1.0; 3])], "moment 0: time NaN"),
            (vec![at(-1.0, [1.0; 3])], "seconds from 0"),
            (vec![at(2.0, [1.0; 3]), at(1.0, [1.0; 3])], "moment 1: time 1 is before 2"),
            (vec![at(0.0, [f64::INFINITY; 3])], "no camera with eye"),
            (vec![at(0.0, [2.0e6, 0.0, 0.0])], "no camera with eye"),
            (vec![at(0.0, [0.0; 3])], "the same point"),
            (vec![at(0.0, [0.0, 1.0, 0.00001])], "along the line of sight"),
            (vec![with(vec![])], "0 isovalues"),
            (vec![with(vec![surface; 5])], "5 isovalues"),
        ] {
            let error = format!("{:#}", Session::new("test", moments).unwrap_err());
            assert!(error.contains(words), "{words}: {error}");
        }
        let moments = [at(1.0, [1.0; 3]), at(1.0, [0.0, 1.0, 0.001]), with(vec![surface; 4])];
        assert!(Session::new("test", moments[..2].to_vec()).is_ok());
        assert!(Session::new("test", moments[2..].to_vec()).is_ok());
    }
}
