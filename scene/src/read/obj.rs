//! Wavefront OBJ: positions and faces.
//!
//! Written here rather than taken from a crate: the one that fits best reads polylines as faces, refuses
//! names that are not UTF-8, drops unused vertices, copies those that several groups share, and cannot say in
//! which line it stopped.

use std::io::{self, BufRead};

use super::{ReadError, Trouble, append_fan};
use crate::mesh::Mesh;

pub(super) fn read(reader: &mut impl BufRead) -> Result<Mesh, ReadError> {
    let mut mesh = Mesh::default();
    let mut corners = Vec::new();
    // Faces may name vertices that come later; where each face stands is kept until all vertices are known.
    let mut forward = None;
    let mut lines = Lines::new(reader);
    while let Some((number, line)) = lines.next()? {
        let mut words = line.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty());
        let result = match words.next() {
            Some(b"v") => vertex(words).map(|position| mesh.positions.push(position)),
            Some(b"f") => face(words, mesh.positions.len(), &mut corners).map(|highest| {
                if highest >= mesh.positions.len() as u64 {
                    forward = forward.max(Some((highest, number)));
                }
                append_fan(&corners, &mut mesh.triangles);
            }),
            _ => Ok(()),
        };
        result.map_err(|trouble| ReadError::at_line(number, trouble))?;
    }
    let vertices = mesh.positions.len() as u64;
    match forward {
        Some((highest, line)) if highest >= vertices => {
            let index = i64::try_from(highest).map_or(i64::MAX, |highest| highest + 1);
            Err(ReadError::at_line(line, Trouble::NoSuchVertex { index, vertices }))
        }
        _ => Ok(mesh),
    }
}

/// Whether the first record that is no comment is one of OBJ's.
pub(super) fn looks_like_obj(first: &[u8]) -> bool {
    let mut lines = first.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let record = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let word = record.and_then(|line| line.split(u8::is_ascii_whitespace).next());
    word.is_some_and(|word| {
        [&b"v"[..], b"vt", b"vn", b"f", b"o", b"g", b"mtllib", b"usemtl", b"s"].contains(&word)
    })
}

/// The position of a `v` record: three numbers; a weight or colour behind them is not read.
fn vertex<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Result<[f32; 3], Trouble> {
    let mut position = [0.0_f32; 3];
    for coordinate in &mut position {
        *coordinate = words.next().and_then(parse).ok_or(Trouble::BadValue)?;
    }
    if position.iter().all(|coordinate| coordinate.is_finite()) {
        Ok(position)
    } else {
        Err(Trouble::NotFinite)
    }
}

/// The corners of an `f` record, as indices from 0 into all vertices of the file; returns the highest.
fn face<'a>(
    words: impl Iterator<Item = &'a [u8]>,
    vertices: usize,
    corners: &mut Vec<u32>,
) -> Result<u64, Trouble> {
    corners.clear();
    let mut highest = 0;
    for word in words {
        let position = word.split(|&byte| byte == b'/').next().unwrap_or(word);
        let index: i64 = parse(position).ok_or(Trouble::BadValue)?;
        let no_such = Trouble::NoSuchVertex { index, vertices: vertices as u64 };
        // From 1 on, or from -1 backwards, the last vertex before this record.
        let from_zero = if index > 0 {
            Some(index - 1)
        } else {
            (vertices as i64).checked_add(index).filter(|_| index < 0)
        };
        let corner = from_zero.and_then(|index| u32::try_from(index).ok()).ok_or(no_such)?;
        highest = highest.max(u64::from(corner));
        corners.push(corner);
    }
    Ok(highest)
}

fn parse<T: core::str::FromStr>(word: &[u8]) -> Option<T> {
    core::str::from_utf8(word).ok()?.parse().ok()
}

/// The lines of a file, with a backslash at a line's end joining the next one to it.
struct Lines<'r, R> {
    reader: &'r mut R,
    line: Vec<u8>,
    next_number: u64,
}

impl<'r, R: BufRead> Lines<'r, R> {
    const fn new(reader: &'r mut R) -> Self {
        Self { reader, line: Vec::new(), next_number: 1 }
    }

    /// The next line without its end, and the number of its first part.
    fn next(&mut self) -> io::Result<Option<(u64, &[u8])>> {
        let number = self.next_number;
        self.line.clear();
        while self.reader.read_until(b'\n', &mut self.line)? > 0 {
            self.next_number += 1;
            let length = self.line.trim_ascii_end().len();
            self.line.truncate(length);
            if self.line.last() != Some(&b'\\') {
                return Ok(Some((number, &self.line)));
            }
            self.line.pop();
        }
        Ok((self.next_number > number).then_some((number, &self.line)))
    }
}
