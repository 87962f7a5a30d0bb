//! A running `peers/embree.cpp`: a child that draws when it is told to.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result};
use rt_core::{Camera, Frame};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::drawn::Drawn;
use super::level::Level;
use super::stopwatch::Elapsed;

/// Embree of one version, with vectors of one width, and its structures over one scene.
#[derive(Debug)]
pub(super) struct Peer {
    /// "Embree 3.13.5".
    pub(super) name: String,
    pub(super) level: Level,
    child: Child,
    /// `None` once the child was told to end.
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

/// How many rays Embree is asked for at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Single,
    Packet8,
    Packet16,
}

/// Whether rays may slip through between two triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Edges {
    /// They may.
    Fast,
    /// They may not, as in ours.
    Robust,
}

/// How much care the builder takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quality {
    Medium,
    High,
}

/// What building took, and Embree's own count of the bytes it then holds.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Built {
    #[serde(flatten)]
    pub(super) time: Elapsed,
    pub(super) bytes: u64,
}

/// The first answer.
#[derive(Debug, Deserialize)]
struct Hello {
    /// 31305 for 3.13.5.
    version: u32,
}

impl Peer {
    /// Starts a program on the scene of a file. Nothing is built yet.
    pub(super) fn start(program: &Path, scene: &Path, level: Level) -> Result<Self> {
        let mut command = Command::new(program);
        command.arg(scene).arg(level.configuration()).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        let requests = child.stdin.take();
        let answers = BufReader::new(child.stdout.take().context("the peer has no output")?);
        let mut peer = Self { name: String::new(), level, child, requests, answers };
        let Hello { version } = peer.answer()?;
        peer.name = format!("Embree {}.{}.{}", version / 10_000, version / 100 % 100, version % 100);
        Ok(peer)
    }

    /// Builds a structure anew.
    pub(super) fn build(&mut self, edges: Edges, quality: Quality) -> Result<Built> {
        self.ask(&format!("build {} {}", edges.name(), quality.name()))
    }

    /// Draws a picture with the structure that was built last for such edges.
    pub(super) fn draw(&mut self, edges: Edges, mode: Mode, frame: &Frame) -> Result<Drawn> {
        self.ask(&format!("draw {} {} {}", edges.name(), mode.name(), numbers(frame)))
    }

    fn ask<T: DeserializeOwned>(&mut self, request: &str) -> Result<T> {
        let requests = self.requests.as_mut().context("the peer was told to end")?;
        writeln!(requests, "{request}").with_context(|| format!("{} has ended", self.name))?;
        self.answer()
    }

    fn answer<T: DeserializeOwned>(&mut self) -> Result<T> {
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        serde_json::from_str(&line)
            .with_context(|| format!("{} {} answers {line:?}", self.name, self.level.name()))
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

impl Drop for Peer {
    fn drop(&mut self) {
        // The end of its input ends the program.
        self.requests = None;
        let _ = self.child.wait();
    }
}

impl Mode {
    pub(super) const ALL: [Self; 3] = [Self::Single, Self::Packet8, Self::Packet16];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Packet8 => "packet8",
            Self::Packet16 => "packet16",
        }
    }
}

impl Edges {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Robust => "robust",
        }
    }
}

impl Quality {
    pub(super) const fn name(self) -> &'static str {
        match self {
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
    use crate::embree::ours::without_light;

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
