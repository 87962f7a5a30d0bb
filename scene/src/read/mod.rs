//! Reads meshes from files of other programs.
//!
//! - **PLY**: ascii and binary of both endiannesses; the element `vertex` (x, y, z of any type) and the
//!   element `face` (a list named `vertex_index` or `vertex_indices`); headers with any line ends and
//!   spacing. Other elements and properties are skipped. Faces given as floats, or as triangle strips, are
//!   refused.
//! - **OBJ**: `v` and `f` records, indices from the start or the end of the vertices, polygons. All other
//!   records are skipped: points, lines, curves, normals, groups, materials.
//!
//! Polygons become fans from their first corner; a face of fewer than three corners is no triangle. A file
//! without faces is a mesh without triangles, which [`build`](crate::build()) refuses.
//!
//! Nothing in a file is trusted: memory is bounded by a small multiple of the file's length whatever its
//! header declares, and a broken file ends in one [`ReadError`] that says where.

mod error;
mod obj;
mod ply;
mod ply_header;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

pub use error::{Place, ReadError, Trouble};

use crate::mesh::Mesh;

/// A mesh format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Stanford polygon format.
    Ply,
    /// Wavefront object.
    Obj,
}

impl Format {
    /// The format by the first bytes of a file, or else by the extension of its name.
    ///
    /// PLY has a signature. OBJ has none: it is taken by its extension, or when the first record is one of
    /// OBJ's.
    pub fn recognise(first: &[u8], path: Option<&Path>) -> Option<Self> {
        if first.starts_with(b"ply") {
            return Some(Self::Ply);
        }
        let extension = path.and_then(Path::extension).and_then(|extension| extension.to_str());
        let named_obj = extension.is_some_and(|extension| extension.eq_ignore_ascii_case("obj"));
        (named_obj || obj::looks_like_obj(first)).then_some(Self::Obj)
    }
}

/// Reads a mesh from a file.
///
/// # Errors
/// Says in one line what is wrong with the file, and where in it.
pub fn read_mesh(path: &Path) -> Result<Mesh, ReadError> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let first = reader.fill_buf()?;
    let format = Format::recognise(first, Some(path)).ok_or(ReadError::UnknownFormat)?;
    read_as(format, &mut reader, length)
}

/// Reads a mesh from bytes; `format` is recognised from them when it is not given.
///
/// # Errors
/// As [`read_mesh`].
pub fn parse_mesh(mut bytes: &[u8], format: Option<Format>) -> Result<Mesh, ReadError> {
    let format = format.or_else(|| Format::recognise(bytes, None)).ok_or(ReadError::UnknownFormat)?;
    let length = bytes.len() as u64;
    read_as(format, &mut bytes, length)
}

fn read_as(format: Format, reader: &mut impl BufRead, length: u64) -> Result<Mesh, ReadError> {
    match format {
        Format::Ply => ply::read(reader, length),
        Format::Obj => obj::read(reader),
    }
}

/// Splits a polygon into a fan of triangles from its first corner, and appends them.
fn append_fan(corners: &[u32], triangles: &mut Vec<[u32; 3]>) {
    if let [first, rest @ ..] = corners {
        triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}
