//! Sessions that are made: ways that the eye goes.

use core::f64::consts::PI;
use core::fmt;
use core::str::FromStr;

use anyhow::{Context, Error, Result, bail};
use clap::ValueEnum;
use rt_core::camera::Aim;
use rt_core::shade::ALBEDO;

use super::{Moment, Session};
use crate::isovalue::{Isovalue, Surface};

/// The way that the eye goes, always looking at the scene's centre.
///
/// # The formulas
/// With frame `i` of `F`, a circle of `C` frames, radius `R`, elevation `e` and `a = 2 pi i / C`:
///
/// | way | eye |
/// |---|---|
/// | orbit | `R (sin a cos e, sin e, cos a cos e)` |
/// | walk | as an orbit, but of radius `R (1 - 2/3 i/F)` |
/// | jump | as an orbit; from frame `F/2` on, `a + pi`: all of a sudden on the other side |
/// | still | as the first frame of an orbit |
/// | volume | as an orbit; from frame `F/2` on, of radius `0.3 R`, where but a small part is in view |
///
/// Moment `i` is at `i / rate` seconds. An isovalue that sweeps from `v` to `w` is `v + (w - v) i / (F/2)` in the first
/// half of the frames, and `w` from there on. Divisions of `F` are without remainder; up is `(0, 1, 0)`, or where the
/// elevation is beyond 80 degrees `(-sin a sin e, cos e, -cos a sin e)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Way {
    /// Around the scene at one distance.
    Orbit,
    /// Around the scene and ever closer, in the last frame to a third of the distance.
    Walk,
    /// Around the scene, and in the middle of the session all of a sudden to its other side.
    Jump,
    /// One view, again and again.
    Still,
    /// For volumes: around the whole while the isovalue moves; from the middle of the session on close up.
    Volume,
}

/// A session to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// The way that the eye goes.
    pub way: Way,
    /// Frames.
    pub frames: u32,
    /// Frames that a full circle would take: how fast the eye moves; `None` for as many as there are frames.
    pub circle: Option<u32>,
    /// Distance of the eye from the scene's centre, in diagonals of the scene.
    pub radius: f64,
    /// Height of the eye, in degrees above the horizon.
    pub elevation: f64,
    /// Frames a second.
    pub rate: f64,
    /// The isovalue of the first frame, and of the middle and all later ones; `None` leaves it to whoever replays it.
    pub isovalues: Option<Sweep>,
}

/// An isovalue that moves. Written `FROM..TO`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Where it starts.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
}

/// Part of the radius from which a close-up is seen: outside of a ball that fills the bounds of a cube, and not by much.
const CLOSE: f64 = 0.3;

impl Default for Path {
    fn default() -> Self {
        let (way, circle, isovalues) = (Way::Orbit, None, None);
        Self { way, frames: 1, circle, radius: 1.5, elevation: 0.0, rate: 25.0, isovalues }
    }
}

impl Path {
    /// Makes the session. It is the same on every machine.
    ///
    /// # Errors
    /// A number makes no sense.
    pub fn session(&self) -> Result<Session> {
        self.check()?;
        let Self { way, frames, .. } = self;
        Session::new(format!("{way} of {frames}"), (0..*frames).map(|frame| self.moment(frame)).collect())
    }

    fn check(&self) -> Result<()> {
        if self.frames == 0 {
            bail!("--frames 0 renders nothing");
        }
        if self.circle == Some(0) {
            bail!("--circle 0 is no circle; give the frames that a full one would take");
        }
        if !self.radius.is_finite() || self.radius <= 0.0 {
            bail!("--radius is a distance in diagonals of the scene, above 0; got {}", self.radius);
        }
        if !(-90.0..=90.0).contains(&self.elevation) {
            bail!("--elevation is an angle from -90 to 90 degrees; got {}", self.elevation);
        }
        if !(0.001..=1.0e6).contains(&self.rate) {
            bail!("--rate is a number of frames a second from 0.001 to 1e6; got {}", self.rate);
        }
        Ok(())
    }

    fn moment(&self, frame: u32) -> Moment {
        let Self { way, frames, radius, .. } = *self;
        let part = f64::from(frame) / f64::from(frames);
        let is_late = frame >= frames / 2;
        let turn = 2.0 * PI * f64::from(frame) / f64::from(self.circle.unwrap_or(frames));
        let (turn, radius) = match way {
            Way::Walk => (turn, radius * (1.0 - part * 2.0 / 3.0)),
            Way::Jump if is_late => (turn + PI, radius),
            Way::Volume if is_late => (turn, radius * CLOSE),
            Way::Still => (0.0, radius),
            Way::Orbit | Way::Jump | Way::Volume => (turn, radius),
        };
        let isovalue = |sweep: Sweep| {
            let part = if is_late { 1.0 } else { f64::from(frame) / f64::from(frames / 2) };
            vec![Surface { isovalue: Isovalue::Value(sweep.at(part)), albedo: ALBEDO }]
        };
        Moment {
            time: f64::from(frame) / self.rate,
            aim: self.aim(turn, radius),
            isosurfaces: self.isovalues.map(isovalue),
            ..Moment::default()
        }
    }

    /// The eye on a ball of that radius, looking at its centre.
    fn aim(&self, turn: f64, radius: f64) -> Aim {
        let elevation = self.elevation * PI / 180.0;
        // Of libm, since the C libraries of two machines may differ in the last bit.
        let [(sin, cos), (height, level)] =
            [turn, elevation].map(|angle| (libm::sin(angle), libm::cos(angle)));
        let eye = [sin * level, height, cos * level].map(|one| one * radius);
        let is_steep = self.elevation.abs() > 80.0;
        let up = if is_steep { [-sin * height, level, -cos * height] } else { [0.0, 1.0, 0.0] };
        Aim { eye, at: [0.0; 3], up }
    }
}

impl Sweep {
    fn at(self, part: f64) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "samples are single precision")]
        let value = (self.from + (self.to - self.from) * part) as f32;
        value
    }
}

impl FromStr for Sweep {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let number =
            |text: &str| text.parse().ok().filter(|number: &f64| number.abs() <= f64::from(f32::MAX));
        let (from, to) = text.split_once("..").unwrap_or((text, text));
        let sweep = number(from).zip(number(to)).map(|(from, to)| Self { from, to });
        sweep.context("expected two isovalues, as in 40..120, or one")
    }
}

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.to_possible_value().as_ref().map_or("", |value| value.get_name()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::length;
    use super::*;

    fn moments(path: &Path) -> Vec<Moment> {
        path.session().unwrap().moments().to_vec()
    }

    fn distances(path: &Path) -> Vec<f64> {
        moments(path).iter().map(|moment| length(moment.aim.eye)).collect()
    }

    fn near(one: f64, other: f64) -> bool {
        (one - other).abs() < 1.0e-12
    }

    #[test]
    fn an_orbit_keeps_its_distance_and_closes_its_circle() {
        let path = Path { frames: 8, radius: 2.0, elevation: 30.0, ..Path::default() };
        assert!(distances(&path).into_iter().all(|distance| near(distance, 2.0)));
        let moments = moments(&path);
        assert_eq!(moments[0].aim.eye[0], 0.0);
        let (quarter, half) = (moments[2].aim.eye, moments[4].aim.eye);
        assert!(near(quarter[0], -half[2]) && near(quarter[2], 0.0) && near(quarter[1], 1.0));
        assert!(near(moments[7].time, 7.0 / 25.0));
    }

    #[test]
    fn a_walk_comes_closer_and_a_volume_is_seen_close_up_late() {
        let walk = distances(&Path { way: Way::Walk, frames: 4, ..Path::default() });
        assert!(near(walk[0], 1.5) && near(walk[3], 0.75) && walk.is_sorted_by(|a, b| a > b));
        let sweep = Some(Sweep { from: 10.0, to: 20.0 });
        let volume = Path { way: Way::Volume, frames: 8, isovalues: sweep, ..Path::default() };
        let far = distances(&volume);
        assert!(far[..4].iter().all(|distance| near(*distance, 1.5)));
        assert!(far[4..].iter().all(|distance| near(*distance, 0.45)));
        let values = moments(&volume).into_iter().map(|moment| moment.isosurfaces.unwrap()[0].isovalue);
        let expected = [10.0, 12.5, 15.0, 17.5, 20.0, 20.0, 20.0, 20.0].map(Isovalue::Value);
        assert_eq!(values.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_jump_lands_on_the_other_side_and_a_still_view_stays() {
        let jump = moments(&Path { way: Way::Jump, frames: 6, circle: Some(6000), ..Path::default() });
        let step = |index: usize| {
            length([0, 1, 2].map(|axis| jump[index].aim.eye[axis] - jump[index - 1].aim.eye[axis]))
        };
        assert!(step(3) > 2.9 && [1, 2, 4, 5].into_iter().all(|index| step(index) < 0.01));
        let still = moments(&Path { way: Way::Still, frames: 3, ..Path::default() });
        assert!(still.iter().all(|moment| moment.aim == still[0].aim) && still[2].time > 0.0);
    }

    #[test]
    fn straight_above_there_is_an_up() {
        for elevation in [-90.0, 80.5, 90.0] {
            let path = Path { frames: 7, elevation, ..Path::default() };
            assert_eq!(moments(&path).len(), 7);
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let path = Path::default();
        for (path, words) in [
            (Path { frames: 0, ..path.clone() }, "renders nothing"),
            (Path { circle: Some(0), ..path.clone() }, "no circle"),
            (Path { radius: 0.0, ..path.clone() }, "above 0"),
            (Path { radius: f64::NAN, ..path.clone() }, "above 0"),
            (Path { radius: 1.0e38, ..path.clone() }, "no camera"),
            (Path { elevation: 91.0, ..path.clone() }, "-90 to 90"),
            (Path { rate: 0.0, ..path.clone() }, "a second"),
        ] {
            assert!(format!("{:#}", path.session().unwrap_err()).contains(words), "{path:?}");
        }
        assert_eq!("40..-1e1".parse::<Sweep>().unwrap(), Sweep { from: 40.0, to: -10.0 });
        assert_eq!("7".parse::<Sweep>().unwrap(), Sweep { from: 7.0, to: 7.0 });
        for text in ["", "..", "1..", "1..x", "nan..2"] {
            assert!(text.parse::<Sweep>().is_err(), "{text}");
        }
    }
}
