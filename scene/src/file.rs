//! Opens scene images and checks them.

use core::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use rt_core::image::{HEADER_BYTES, MAGIC, SegmentKind};
use rt_core::volume::TABLE_BYTES;
use rt_core::{Flat, Header, HeaderError, SceneView};
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use crate::info::Info;
use crate::volume::Histogram;

/// A scene image on disk whose header was checked.
#[derive(Debug)]
pub struct SceneFile {
    file: File,
    header: Header,
}

/// Why a file was refused as a scene image.
#[derive(Debug)]
#[non_exhaustive]
pub enum OpenError {
    /// The file cannot be read.
    Io(io::Error),
    /// The header was refused.
    Header(HeaderError),
    /// There are bytes behind the end of the image.
    Trailing {
        /// Length by the header.
        declared: u64,
        /// Length of the file.
        got: u64,
    },
    /// The bytes of a segment do not match its checksum.
    Checksum(SegmentKind),
}

impl SceneFile {
    /// Opens an image and verifies the checksum of every segment, which reads the whole file.
    ///
    /// # Errors
    /// When the file cannot be read, is no scene image, or is corrupt; says which.
    pub fn open(path: &Path) -> Result<Self, OpenError> {
        let mut scene = Self::open_unverified(path)?;
        scene.verify()?;
        Ok(scene)
    }

    /// Opens an image and checks its header only: for a process that reads a part of a file which another one
    /// verified.
    ///
    /// # Errors
    /// When the file cannot be read or its header is refused.
    pub fn open_unverified(path: &Path) -> Result<Self, OpenError> {
        let mut file = File::open(path)?;
        let got = file.metadata()?.len();
        let mut bytes = Vec::new();
        (&mut file).take(HEADER_BYTES as u64).read_to_end(&mut bytes)?;
        let header = Header::parse(&bytes, got)?;
        if got != header.image_bytes {
            return Err(OpenError::Trailing { declared: header.image_bytes, got });
        }
        Ok(Self { file, header })
    }

    /// Whether the file begins like a scene image, of whatever version.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn is_one(path: &Path) -> io::Result<bool> {
        let mut first = Vec::new();
        File::open(path)?.take(MAGIC.len() as u64).read_to_end(&mut first)?;
        Ok(first == MAGIC)
    }

    /// Verifies the checksum of every segment.
    ///
    /// # Errors
    /// [`OpenError::Checksum`] names the first that does not match.
    pub fn verify(&mut self) -> Result<(), OpenError> {
        let mut buffer = vec![0; BUFFER_BYTES];
        for (kind, segment) in self.header.segments.in_order() {
            self.file.seek(SeekFrom::Start(segment.offset))?;
            let mut left = segment.bytes;
            let mut hash = Xxh3::new();
            while left > 0 {
                let run = usize::try_from(left).unwrap_or(usize::MAX).min(BUFFER_BYTES);
                self.file.read_exact(&mut buffer[..run])?;
                hash.update(&buffer[..run]);
                left -= run as u64;
            }
            if hash.digest() != segment.checksum {
                return Err(OpenError::Checksum(kind));
            }
        }
        Ok(())
    }

    /// Reads `buffer.len()` bytes of the image from `offset` on. Bytes behind the end of the image read as
    /// zero, so that a run with larger pages than the image's can read its last page.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<()> {
        let inside = usize::try_from(self.header.image_bytes.saturating_sub(offset)).unwrap_or(usize::MAX);
        let (inside, outside) = buffer.split_at_mut(inside.min(buffer.len()));
        outside.fill(0);
        self.file.seek(SeekFrom::Start(offset))?;
        self.file.read_exact(inside)
    }

    /// The whole image.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read_all(&mut self) -> io::Result<Vec<u8>> {
        let length = usize::try_from(self.header.image_bytes).map_err(io::Error::other)?;
        let mut bytes = vec![0; length];
        self.read_at(0, &mut bytes)?;
        Ok(bytes)
    }

    /// How the samples of the image's volume are spread, if it has one.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn histogram(&mut self) -> io::Result<Option<Histogram>> {
        let Some(volume) = self.header.volume else { return Ok(None) };
        let mut bytes = vec![0; TABLE_BYTES];
        self.read_at(self.header.segments.table.offset, &mut bytes)?;
        Ok(Histogram::of_image(&volume, &bytes))
    }

    /// The header of the image.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The facts that `memsavvy info` prints.
    pub fn info(&self) -> Info {
        Info::from(&self.header)
    }

    /// The file itself, for callers that map it.
    pub const fn file(&self) -> &File {
        &self.file
    }
}

/// Checks an image in memory, header and checksums, and returns a view of it.
///
/// # Errors
/// As [`SceneFile::open`].
pub fn view_of(bytes: &[u8]) -> Result<SceneView<Flat<'_>>, OpenError> {
    let view = SceneView::new(Flat::new(bytes))?;
    for (kind, segment) in view.header().segments.in_order() {
        let place = usize::try_from(segment.offset).ok().zip(usize::try_from(segment.bytes).ok());
        let content = place.and_then(|(offset, length)| bytes.get(offset..)?.get(..length));
        if content.map(xxh3_64) != Some(segment.checksum) {
            return Err(OpenError::Checksum(kind));
        }
    }
    Ok(view)
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot read the scene image: {error}"),
            Self::Header(error) => error.fmt(f),
            Self::Trailing { declared, got } => {
                write!(f, "not a whole scene image: {got} bytes, but the header declares {declared}")
            }
            Self::Checksum(kind) => write!(f, "corrupt: the {kind} do not match their checksum"),
        }
    }
}

impl core::error::Error for OpenError {}

impl From<io::Error> for OpenError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<HeaderError> for OpenError {
    fn from(error: HeaderError) -> Self {
        Self::Header(error)
    }
}

const BUFFER_BYTES: usize = 1 << 20;
