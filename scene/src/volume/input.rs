//! Where the bytes of a volume file come from.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::VolumeError;

/// A file, or bytes in its place; can be opened again and again.
#[derive(Clone, Debug)]
pub(super) enum Input {
    File(PathBuf),
    Memory(Arc<[u8]>),
}

/// An opened input.
pub(super) type Opened = Box<dyn ReadSeek>;

pub(super) trait ReadSeek: Read + Seek + Send {}

impl<T: Read + Seek + Send> ReadSeek for T {}

impl Input {
    /// Opens the input at a place.
    pub(super) fn open_at(&self, offset: u64) -> io::Result<Opened> {
        let mut opened: Opened = match self {
            Self::File(path) => Box::new(File::open(path)?),
            Self::Memory(bytes) => Box::new(Cursor::new(Arc::clone(bytes))),
        };
        opened.seek(SeekFrom::Start(offset))?;
        Ok(opened)
    }

    /// The same with a buffer before it.
    pub(super) fn buffered_at(&self, offset: u64) -> io::Result<BufReader<Opened>> {
        Ok(BufReader::with_capacity(1 << 16, self.open_at(offset)?))
    }

    /// Length in bytes.
    pub(super) fn length(&self) -> io::Result<u64> {
        match self {
            Self::File(path) => Ok(std::fs::metadata(path)?.len()),
            Self::Memory(bytes) => Ok(bytes.len() as u64),
        }
    }

    /// The first bytes, at most `count`.
    pub(super) fn first(&self, count: u64) -> io::Result<Vec<u8>> {
        let mut first = Vec::new();
        self.open_at(0)?.take(count).read_to_end(&mut first)?;
        Ok(first)
    }

    /// The file of this name in the folder of this one; `None` for bytes in memory.
    pub(super) fn beside(&self, name: &str) -> Option<PathBuf> {
        match self {
            Self::File(path) => Some(path.parent().unwrap_or_else(|| Path::new("")).join(name)),
            Self::Memory(_) => None,
        }
    }

    /// A file that a header names; refuses early what cannot be opened.
    pub(super) fn data_file(path: PathBuf) -> Result<Self, VolumeError> {
        // A folder opens, but has no bytes.
        let opened = File::open(&path).and_then(|mut file| file.read(&mut [0]));
        match opened {
            Ok(_) => Ok(Self::File(path)),
            Err(error) => Err(VolumeError::DataFile { path, error }),
        }
    }
}

/// A line of text.
pub(super) struct Line {
    /// With its end.
    pub(super) text: Vec<u8>,
    /// Length of the text.
    pub(super) bytes: u64,
    /// Whether it has an end; the last of a file may not, nor one longer than was looked for.
    pub(super) has_end: bool,
}

/// The next line, of at most `limit` bytes.
pub(super) fn next_line(reader: &mut impl BufRead, limit: u64) -> io::Result<Line> {
    let mut text = Vec::new();
    let bytes = reader.take(limit).read_until(b'\n', &mut text)? as u64;
    let has_end = text.last() == Some(&b'\n');
    Ok(Line { text, bytes, has_end })
}

/// The path without a last `.gz`.
pub(super) fn without_gz(path: &Path) -> PathBuf {
    let is_gz = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"));
    if is_gz { path.with_extension("") } else { path.to_owned() }
}
