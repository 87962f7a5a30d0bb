//! PLY, element by element through `ply-rs-bw`.
//!
//! The crate knows types, encodings and lists. The header is brought into clean form first ([`ply_header`]),
//! and elements are read one at a time into what we keep, so memory follows the data and never a count in the
//! header.

use std::io::{BufRead, ErrorKind};

use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    BeginList, ElementDef, Encoding, Header, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use super::{Place, ReadError, Trouble, append_fan, ply_header};
use crate::mesh::Mesh;

/// Reads a PLY file of `length` bytes.
pub(super) fn read(reader: &mut impl BufRead, length: u64) -> Result<Mesh, ReadError> {
    let header = parse_header(&ply_header::read(reader)?.text)?;
    let vertices = check_declarations(&header)?;
    let mut body = Body { reader, encoding: header.encoding, line: Vec::new() };
    let mut mesh = Mesh::default();
    let mut wanted = ["vertex", "face"].map(|name| header.elements.contains_key(name));
    for element in header.elements.values() {
        // What stands behind the last element of interest is not looked at.
        if wanted == [false; 2] {
            break;
        }
        let most =
            usize::try_from(length / smallest_record(element)).unwrap_or(usize::MAX).min(element.count);
        match element.name.as_str() {
            "vertex" => {
                mesh.positions.reserve(most);
                body.each(element, |vertex: Vertex| {
                    mesh.positions.push(vertex.position()?);
                    Ok(())
                })?;
                wanted[0] = false;
            }
            "face" => {
                mesh.triangles.reserve(most);
                let mut corners = Vec::new();
                body.each(element, |face: Face| {
                    face.corners(vertices, &mut corners)?;
                    append_fan(&corners, &mut mesh.triangles);
                    Ok(())
                })?;
                wanted[1] = false;
            }
            _ => body.each(element, |_: Skipped| Ok(()))?,
        }
    }
    Ok(mesh)
}

fn parse_header(text: &str) -> Result<Header, ReadError> {
    Parser::<Skipped>::new().read_header(&mut Reader::new(text.as_bytes())).map_err(|error| {
        let line = error.line().and_then(|line| text.lines().nth(line.checked_sub(1)?));
        let trouble = line.map_or(Trouble::NoFormat, |line| Trouble::HeaderLine(ply_header::shortened(line)));
        ReadError::in_file(trouble)
    })
}

/// Checks that vertices have coordinates and faces have indices; returns the number of vertices.
fn check_declarations(header: &Header) -> Result<u64, ReadError> {
    let missing = |what| ReadError::in_file(Trouble::Missing(what));
    let vertex = header.elements.get("vertex");
    if let Some(vertex) = vertex {
        let is_scalar =
            |name| matches!(vertex.properties.get(name).map(|p| &p.data_type), Some(PropertyType::Scalar(_)));
        if !["x", "y", "z"].into_iter().all(is_scalar) {
            return Err(missing("coordinates x, y and z of the vertices"));
        }
    }
    if let Some(face) = header.elements.get("face") {
        let lists = INDEX_NAMES.map(|name| face.properties.get(name).map(|p| &p.data_type));
        match lists {
            [Some(_), Some(_)] => return Err(ReadError::in_file(Trouble::Twice(INDEX_NAMES.join(" and ")))),
            [Some(PropertyType::List(_, ScalarType::Float | ScalarType::Double)), None]
            | [None, Some(PropertyType::List(_, ScalarType::Float | ScalarType::Double))] => {
                return Err(ReadError::in_file(Trouble::WrongType("the indices of faces")));
            }
            [Some(PropertyType::List(..)), None] | [None, Some(PropertyType::List(..))] => {}
            _ => return Err(missing("list of vertex indices of the faces")),
        }
    }
    let vertices = vertex.map_or(0, |vertex| vertex.count as u64);
    if vertices > u64::from(u32::MAX) && header.elements.contains_key("face") {
        return Err(ReadError::in_file(Trouble::TooMany));
    }
    Ok(vertices)
}

/// The part of a file behind the header.
struct Body<'r, R> {
    reader: &'r mut R,
    encoding: Encoding,
    line: Vec<u8>,
}

impl<R: BufRead> Body<'_, R> {
    /// Reads all elements of a kind and hands each to `take`.
    fn each<E: PropertyAccess>(
        &mut self,
        element: &ElementDef,
        mut take: impl FnMut(E) -> Result<(), Trouble>,
    ) -> Result<(), ReadError> {
        // An element without properties has no bytes, and its count may be anything.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        let parser = Parser::<E>::new();
        for index in 0..count {
            let broken = |trouble| ReadError::Broken {
                place: Place::Element {
                    name: element.name.clone(),
                    index: index as u64,
                    declared: element.count as u64,
                },
                trouble,
            };
            let read = match self.encoding {
                Encoding::BinaryLittleEndian => parser.read_little_endian_element(self.reader, element),
                Encoding::BinaryBigEndian => parser.read_big_endian_element(self.reader, element),
                Encoding::Ascii => {
                    let line = self.next_line()?.ok_or_else(|| broken(Trouble::Truncated))?;
                    let line = core::str::from_utf8(line).map_err(|_| broken(Trouble::BadValue))?;
                    parser.read_ascii_element(line, element)
                }
            };
            let element = match read {
                Ok(element) => element,
                Err(error) => return Err(trouble_of(&error).map_or_else(|| io_error(error), broken)),
            };
            take(element).map_err(broken)?;
        }
        Ok(())
    }

    /// The next line that is not blank, without its end, which may be LF, CR LF or CR.
    fn next_line(&mut self) -> Result<Option<&[u8]>, ReadError> {
        self.line.clear();
        loop {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() {
                return Ok((!self.line.trim_ascii().is_empty()).then_some(self.line.as_slice()));
            }
            let end = buffer.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
            self.line.extend_from_slice(&buffer[..end.unwrap_or(buffer.len())]);
            let used = end.map_or(buffer.len(), |end| end + 1);
            self.reader.consume(used);
            if end.is_some() {
                if !self.line.trim_ascii().is_empty() {
                    return Ok(Some(&self.line));
                }
                self.line.clear();
            }
        }
    }
}

/// What an error of the crate means for the file; `None` when the file could not be read at all.
fn trouble_of(error: &ParseError) -> Option<Trouble> {
    match error.kind() {
        ErrorKind::UnexpectedEof => Some(Trouble::Truncated),
        ErrorKind::InvalidInput | ErrorKind::InvalidData => Some(Trouble::BadValue),
        _ => None,
    }
}

fn io_error(error: ParseError) -> ReadError {
    ReadError::Io(error.into())
}

/// The fewest bytes of a file that a vertex or a triangle takes, unless the file is a most unusual one.
fn smallest_record(element: &ElementDef) -> u64 {
    // Every property has a byte at least; a triangle has three corners more, and text has spaces.
    element.properties.len() as u64 + 3
}

/// A vertex: its coordinates, whatever their type.
struct Vertex([f64; 3]);

impl Vertex {
    fn position(&self) -> Result<[f32; 3], Trouble> {
        #[expect(clippy::cast_possible_truncation, reason = "a mesh has single precision")]
        let position = self.0.map(|coordinate| coordinate as f32);
        if position.iter().all(|coordinate| coordinate.is_finite()) {
            Ok(position)
        } else {
            Err(Trouble::NotFinite)
        }
    }

    fn set(&mut self, name: &str, value: impl Into<f64>) -> PropertyAccessResult {
        let axis = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return PropertyAccessResult::Ignored,
        };
        self.0[axis] = value.into();
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([0.0; 3])
    }

    fn set_char(&mut self, name: &str, value: i8) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_uchar(&mut self, name: &str, value: u8) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_short(&mut self, name: &str, value: i16) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_ushort(&mut self, name: &str, value: u16) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_int(&mut self, name: &str, value: i32) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_uint(&mut self, name: &str, value: u32) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set(name, value)
    }
}

/// A face: its list of corners, in the usual types without a copy, else as `other`.
struct Face {
    signed: Vec<i32>,
    unsigned: Vec<u32>,
    other: Vec<i64>,
}

impl Face {
    /// The corners, each below `vertices`.
    fn corners(&self, vertices: u64, corners: &mut Vec<u32>) -> Result<(), Trouble> {
        corners.clear();
        let signed = self.signed.iter().map(|&index| i64::from(index));
        let unsigned = self.unsigned.iter().map(|&index| i64::from(index));
        for index in signed.chain(unsigned).chain(self.other.iter().copied()) {
            let corner = u32::try_from(index).ok().filter(|&corner| u64::from(corner) < vertices);
            corners.push(corner.ok_or(Trouble::NoSuchVertex { index, vertices })?);
        }
        Ok(())
    }

    fn set<T: Into<i64>>(&mut self, name: &str, value: Vec<T>) -> PropertyAccessResult {
        if !INDEX_NAMES.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.other = value.into_iter().map(Into::into).collect();
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self { signed: Vec::new(), unsigned: Vec::new(), other: Vec::new() }
    }

    fn begin_list_int(&mut self, name: &str, _length: usize) -> BeginList<'_, i32> {
        if INDEX_NAMES.contains(&name) { BeginList::Fill(&mut self.signed) } else { BeginList::UseSetter }
    }

    fn begin_list_uint(&mut self, name: &str, _length: usize) -> BeginList<'_, u32> {
        if INDEX_NAMES.contains(&name) { BeginList::Fill(&mut self.unsigned) } else { BeginList::UseSetter }
    }

    fn set_list_char(&mut self, name: &str, value: Vec<i8>) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_list_uchar(&mut self, name: &str, value: Vec<u8>) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_list_short(&mut self, name: &str, value: Vec<i16>) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn set_list_ushort(&mut self, name: &str, value: Vec<u16>) -> PropertyAccessResult {
        self.set(name, value)
    }
}

/// An element of which nothing is kept.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

/// What exporters call the list of a face's corners.
const INDEX_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];
