//! A running `peers/embree.cpp`: a child that draws when it is told to.

use core::fmt;
use std::path::Path;
use std::process::Command;

use anyhow::Result;
use rt_core::{Camera, Frame};
use serde::Deserialize;

use super::child::Obedient;
use super::drawn::Drawn;
use super::level::Level;
use super::stopwatch::Elapsed;

/// Embree of one version, with vectors of one width, and its structures over one scene.
#[derive(Debug)]
pub(crate) struct Peer {
    /// "Embree 3.13.5".
    pub(crate) name: String,
    pub(crate) level: Level,
    program: Obedient,
}

/// What Embree builds over a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Structure {
    pub(crate) edges: Edges,
    pub(crate) quality: Quality,
}

/// How many rays Embree is asked for at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    Single,
    Packet8,
    Packet16,
}

/// Whether rays may slip through between two triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Edges {
    /// They may.
    Fast,
    /// They may not, as in ours.
    Robust,
}

/// How much care the builder takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quality {
    /// By Morton codes.
    Low,
    Medium,
    High,
}

/// What building took, and Embree's own count of the bytes it then holds.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(crate) struct Built {
    #[serde(flatten)]
    pub(crate) time: Elapsed,
    pub(crate) bytes: u64,
}

/// The first answer.
#[derive(Debug, Deserialize)]
struct Hello {
    /// 31305 for 3.13.5.
    version: u32,
}

/// The answer to another scene.
#[derive(Debug, Deserialize)]
struct Loaded {}

impl Peer {
    /// Starts a program on the scene of a file. Nothing is built yet.
    pub(crate) fn start(program: &Path, scene: &Path, level: Level) -> Result<Self> {
        let mut command = Command::new(program);
        let name = program.display().to_string();
        let mut program = Obedient::start(&name, command.arg(scene).arg(level.configuration()))?;
        let Hello { version } = program.answer()?;
        let name = format!("Embree {}.{}.{}", version / 10_000, version / 100 % 100, version % 100);
        program.name = format!("{name} {}", level.name());
        Ok(Self { name, level, program })
    }

    /// Forgets all structures, and takes the scene of another file.
    pub(crate) fn load(&mut self, scene: &Path) -> Result<()> {
        let Loaded {} = self.program.ask(&format!("scene {}", scene.display()))?;
        Ok(())
    }

    /// Builds a structure anew.
    pub(crate) fn build(&mut self, structure: Structure) -> Result<Built> {
        self.program.ask(&format!("build {structure}"))
    }

    /// Draws a picture with a structure that was built.
    pub(crate) fn draw(&mut self, structure: Structure, mode: Mode, frame: &Frame) -> Result<Drawn> {
        self.program.ask(&format!("draw {structure} {} {}", mode.name(), numbers(frame)))
    }
}

/// The frame as the program reads it. Every number is read back as the same bits.
fn numbers(frame: &Frame) -> String {
    let Camera { eye, forward, right, up, x_first, x_step, y_first, y_step } = frame.camera;
    let mut words = vec![frame.width.to_string(), frame.height.to_string()];
    let vectors = [eye, forward, right, up].map(|vector| vector.to_array()).concat();
    let rest = [x_first, x_step, y_first, y_step];
    let light = frame.light.to_array();
    let numbers = vectors.into_iter().chain(rest).chain(light).chain([frame.shadow_offset]);
    words.extend(numbers.map(|number| number.to_string()));
    words.join(" ")
}

impl fmt::Display for Structure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.edges.name(), self.quality.name())
    }
}

impl Mode {
    pub(crate) const ALL: [Self; 3] = [Self::Single, Self::Packet8, Self::Packet16];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Packet8 => "packet8",
            Self::Packet16 => "packet16",
        }
    }
}

impl Edges {
    pub(crate) const fn of(self, quality: Quality) -> Structure {
        Structure { edges: self, quality }
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Robust => "robust",
        }
    }
}

impl Quality {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Medium => "medium",
            Self::High => "high",
        }
    }
}

#[cfg(test)]
mod tests {
    use rt_core::camera::OrbitPlace;
    use rt_core::{Bounds, Orbit};

    use super::*;
    use crate::peers::ours::without_light;

    #[test]
    fn a_frame_is_sent_without_loss_and_without_light() {
        let orbit = Orbit::around(&Bounds { low: [0.0; 3].into(), high: [1.0; 3].into() });
        let place = OrbitPlace { radius: 1.5, elevation: 20.0, frame: 1, frames: 3 };
        let frame = Frame::on_orbit(&orbit, &place, 64, 32).unwrap();
        let text = numbers(&frame);
        let words: Vec<&str> = text.split(' ').collect();
        assert_eq!((words.len(), words[0], words[1]), (22, "64", "32"));
        assert_eq!(words[2].parse(), Ok(frame.camera.eye.x));
        assert_eq!(words[21].parse(), Ok(frame.shadow_offset));
        assert!(numbers(&without_light(&frame)).contains("NaN NaN NaN"));
    }
}
