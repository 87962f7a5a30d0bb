//! The file of a session: lines of JSON.
//!
//! # Layout
//! ```text
//! {"memsavvy_session":1}
//! {"time":0.0,"eye":[0.0,0.0,1.5],"at":[0.0,0.0,0.0],"up":[0.0,1.0,0.0],"light":[1.0,2.0,1.5],"isovalues":[80.5]}
//! {"time":0.04,"eye":[0.1,0.0,1.5],"isovalues":[81.5,"120@0.4"]}
//! {"time":0.08}
//! ```
//! The first line names the format and its version. Each further line is a moment; what it leaves out is as in the line
//! before, and before the first line of all as above but without isovalues. `time` is in seconds; `eye`, `at` and `light`
//! are offsets from the centre of the scene's bounds in diagonals of them, `up` is a direction of any length. An
//! isovalue is a number, or text as after `--iso`. The vertical field of view is 45 degrees. Numbers are read to the
//! nearest double, so a session replays as it was recorded.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use rt_core::camera::Aim;
use rt_core::shade::ALBEDO;
use serde::{Deserialize, Serialize};

use super::{MOMENTS_MAX, Moment, Session};
use crate::isovalue::{Isovalue, Surface};

/// The first line.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    memsavvy_session: u32,
}

/// Any other line.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    time: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    eye: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    up: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    light: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    isovalues: Option<Vec<Shown>>,
}

/// An isosurface: its value, or text as after `--iso`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum Shown {
    Value(f32),
    Text(String),
}

const VERSION: u32 = 1;

/// What begins the first line of every version.
const MAGIC: &[u8] = br#"{"memsavvy_session":"#;

/// Bytes of the longest file.
const FILE_BYTES_MAX: u64 = 1 << 30;

impl Session {
    /// Writes the session.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        serde_json::to_writer(&mut *to, &Head { memsavvy_session: VERSION })?;
        writeln!(to)?;
        let mut before = None;
        for moment in self.moments() {
            serde_json::to_writer(&mut *to, &Line::new(moment, before))?;
            writeln!(to)?;
            before = Some(moment);
        }
        Ok(())
    }

    /// Reads and checks a session.
    ///
    /// # Errors
    /// It cannot be read, or a line is none: the message has the file, the number of the line, what is wrong and what to
    /// do.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let mut text = String::new();
        let read = File::open(path).and_then(|file| file.take(FILE_BYTES_MAX + 1).read_to_string(&mut text));
        read.with_context(|| format!("cannot read {name}"))?;
        if text.len() as u64 > FILE_BYTES_MAX {
            bail!("{name} is longer than sessions are, 1 GB; cut it into several");
        }
        let moments = parse(&text).with_context(|| format!("cannot use {name}"))?;
        Self::new(name, moments)
    }

    /// Whether a file begins as sessions do.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn is_one(path: &Path) -> io::Result<bool> {
        let mut start = Vec::new();
        File::open(path)?.take(MAGIC.len() as u64).read_to_end(&mut start)?;
        Ok(start == MAGIC)
    }
}

/// The moments of a file, each checked.
fn parse(text: &str) -> Result<Vec<Moment>> {
    let mut lines = (1..).zip(text.lines());
    let head = lines.next().map_or("", |(_, head)| head);
    match serde_json::from_str(head) {
        Ok(Head { memsavvy_session: VERSION }) => {}
        Ok(Head { memsavvy_session: other }) => {
            bail!("line 1: a session of version {other}, and this program reads {VERSION}; make it anew")
        }
        Err(_) => bail!(
            "line 1: no session begins so, but with {{\"memsavvy_session\":{VERSION}}}; make one with `memsavvy \
             session orbit -o FILE`"
        ),
    }
    let mut moments: Vec<Moment> = Vec::new();
    for (number, line) in lines {
        if moments.len() == MOMENTS_MAX {
            bail!("line {number}: more than {MOMENTS_MAX} moments; cut the session into several");
        }
        let moment = moment(line, moments.last()).with_context(|| format!("line {number}"))?;
        moments.push(moment);
    }
    if moments.is_empty() {
        bail!("line 2: a session has a moment at least, as in {EXAMPLE}");
    }
    Ok(moments)
}

fn moment(line: &str, before: Option<&Moment>) -> Result<Moment> {
    let read: Line = match serde_json::from_str(line) {
        Ok(read) => read,
        Err(error) => {
            // It counts lines of its own, of which this is the first.
            let what = error.to_string();
            let what = what.split(" at line ").next().unwrap_or_default();
            bail!("{what}, at column {}; a moment is a line as in {EXAMPLE}", error.column())
        }
    };
    let moment = read.moment(before)?;
    moment.check(before.map(|before| before.time))?;
    Ok(moment)
}

const EXAMPLE: &str = r#"{"time":0.04,"eye":[0.1,0,1.5],"at":[0,0,0]}"#;

impl Line {
    /// A moment, without what is as in the one before it.
    fn new(moment: &Moment, before: Option<&Moment>) -> Self {
        let changed = |of: fn(&Moment) -> [f64; 3]| {
            let value = of(moment);
            (before.map(of) != Some(value)).then_some(value)
        };
        let surfaces = moment
            .isosurfaces
            .as_ref()
            .filter(|surfaces| before.and_then(|before| before.isosurfaces.as_ref()) != Some(surfaces));
        Self {
            time: moment.time,
            eye: changed(|of| of.aim.eye),
            at: changed(|of| of.aim.at),
            up: changed(|of| of.aim.up),
            light: changed(|of| of.light),
            isovalues: surfaces.map(|surfaces| surfaces.iter().map(Shown::new).collect()),
        }
    }

    fn moment(self, before: Option<&Moment>) -> Result<Moment> {
        let Moment { aim, light, isosurfaces, .. } = before.cloned().unwrap_or_default();
        let aim = Aim {
            eye: self.eye.unwrap_or(aim.eye),
            at: self.at.unwrap_or(aim.at),
            up: self.up.unwrap_or(aim.up),
        };
        let shown = self.isovalues.map(|shown| shown.iter().map(Shown::surface).collect()).transpose()?;
        let light = self.light.unwrap_or(light);
        Ok(Moment { time: self.time, aim, light, isosurfaces: shown.or(isosurfaces) })
    }
}

impl Shown {
    fn new(surface: &Surface) -> Self {
        match *surface {
            Surface { isovalue: Isovalue::Value(value), albedo } if albedo == ALBEDO => Self::Value(value),
            other => Self::Text(other.to_string()),
        }
    }

    fn surface(&self) -> Result<Surface> {
        match self {
            Self::Value(value) if value.is_finite() => {
                Ok(Surface { isovalue: Isovalue::Value(*value), albedo: ALBEDO })
            }
            Self::Value(value) => bail!("isovalue {value} is beyond what samples can be; give a smaller one"),
            Self::Text(text) => text.parse().with_context(|| format!("isovalue {text:?}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Path, Sweep, Way};
    use super::*;

    fn written(session: &Session) -> String {
        let mut bytes = Vec::new();
        session.write(&mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_session_reads_as_it_was_written() {
        let sweep = Some(Sweep { from: 0.1, to: 1.0e-30 });
        for way in [Way::Orbit, Way::Walk, Way::Jump, Way::Still, Way::Volume] {
            let path = Path { way, frames: 57, radius: 0.7, elevation: 33.3, ..Path::default() };
            for isovalues in [None, sweep] {
                let session = Path { isovalues, ..path.clone() }.session().unwrap();
                assert_eq!(parse(&written(&session)).unwrap(), session.moments());
            }
        }
        let mut moment = Moment::default();
        let surface = |isovalue, albedo| Surface { isovalue, albedo };
        moment.isosurfaces = Some(vec![surface(Isovalue::Auto, 0.1), surface(Isovalue::Value(-2.5), 1.0)]);
        let session = Session::new("test", vec![moment]).unwrap();
        assert_eq!(parse(&written(&session)).unwrap(), session.moments());
    }

    #[test]
    fn what_a_line_leaves_out_is_as_before() {
        let text = "{\"memsavvy_session\":1}\n{\"time\":1}\n{\"time\":2,\"eye\":[1,0,0],\"isovalues\":[3]}\n{\"time\":2}\n";
        let moments = parse(text).unwrap();
        assert_eq!(moments[0], Moment { time: 1.0, ..Moment::default() });
        assert_eq!((moments[1].aim.eye, moments[1].light), ([1.0, 0.0, 0.0], moments[0].light));
        assert_eq!(moments[2], moments[1]);
        let session = Path { way: Way::Still, frames: 3, ..Path::default() }.session().unwrap();
        let lines: Vec<String> = written(&session).lines().map(str::to_owned).collect();
        assert_eq!(lines[2..], ["{\"time\":0.04}", "{\"time\":0.08}"]);
    }

    #[test]
    fn bad_lines_are_refused_with_their_number() {
        let head = "{\"memsavvy_session\":1}\n";
        let good = "{\"time\":0}\n";
        for (text, words) in [
            (String::new(), "line 1: no session begins so"),
            (good.to_owned(), "line 1: no session"),
            ("{\"memsavvy_session\":2}\n".to_owned(), "line 1: a session of version 2"),
            (head.to_owned(), "line 2: a session has a moment"),
            (format!("{head}{good}{{\"time\":\n"), "line 3: EOF while parsing"),
            (format!("{head}\n"), "line 2: EOF"),
            (format!("{head}{{}}"), "missing field `time`"),
            (format!("{head}{{\"time\":0,\"eyes\":[0,0,1]}}"), "unknown field `eyes`"),
            (format!("{head}{{\"time\":0,\"eye\":[0,0]}}"), "at column 21; a moment is a line as in {"),
            (format!("{head}{{\"time\":1e999}}"), "number out of range"),
            (format!("{head}{{\"time\":0,\"isovalues\":[1e300]}}"), "beyond what samples can be"),
            (format!("{head}{{\"time\":0,\"isovalues\":[\"x\"]}}"), "isovalue \"x\": expected auto"),
            (format!("{head}{good}{good}{{\"time\":-1}}"), "line 4: time -1 is not"),
            (format!("{head}{{\"time\":2}}\n{{\"time\":1}}"), "line 3: time 1 is before 2"),
            (format!("{head}{{\"time\":0,\"up\":[0,0,1]}}"), "line 2: up"),
        ] {
            let error = format!("{:#}", parse(&text).unwrap_err());
            assert!(error.starts_with("line ") && error.contains(words), "{text}: {error}");
        }
    }
}
