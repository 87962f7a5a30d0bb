//! Bytes of samples at any offset, of files that can be sought in and of streams that cannot.

use core::fmt;
use std::collections::VecDeque;
use std::io::{self, Read, Seek, SeekFrom};

use super::error::{Trouble, VolumeError};
use super::input::Opened;

/// The decoded bytes of all samples.
#[derive(Debug)]
pub(super) struct Bytes {
    /// How many there should be.
    declared: u64,
    access: Access,
}

enum Access {
    /// Samples lie in the file as they are, from an offset on.
    Plain { file: Opened, begin: u64 },
    /// Samples come out of a decoder.
    Stream(Stream),
}

/// A decoder that goes forward only, and starts again when it must go back.
struct Stream {
    open: Box<dyn Fn() -> io::Result<Box<dyn Read + Send>> + Send>,
    /// Opened when first needed.
    decoder: Option<Box<dyn Read + Send>>,
    /// Bytes that were decoded so far.
    position: u64,
    /// The last of them, for callers that go back a little.
    kept: VecDeque<u8>,
    /// How many are kept.
    kept_max: usize,
}

impl Bytes {
    /// Bytes of a file from `begin` on.
    ///
    /// # Errors
    /// When the file of `length` bytes is too short.
    pub(super) fn plain(file: Opened, begin: u64, length: u64, declared: u64) -> Result<Self, VolumeError> {
        let got = length.saturating_sub(begin);
        if got < declared {
            return Err(VolumeError::in_samples(Trouble::Truncated { declared, got }));
        }
        Ok(Self { declared, access: Access::Plain { file, begin } })
    }

    /// Bytes of a decoder that `open` makes; the last `kept_max` are kept.
    pub(super) fn stream(
        open: impl Fn() -> io::Result<Box<dyn Read + Send>> + Send + 'static,
        declared: u64,
        kept_max: usize,
    ) -> Self {
        let (open, kept) = (Box::new(open), VecDeque::new());
        let stream = Stream { open, decoder: None, position: 0, kept, kept_max };
        Self { declared, access: Access::Stream(stream) }
    }

    /// Reads bytes from `offset` on.
    pub(super) fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> Result<(), VolumeError> {
        let read = match &mut self.access {
            Access::Plain { file, begin } => {
                file.seek(SeekFrom::Start(*begin + offset))?;
                fill(file, buffer).map(|got| offset + got as u64)
            }
            Access::Stream(stream) => stream.read_at(offset, buffer),
        };
        let (declared, end) = (self.declared, offset + buffer.len() as u64);
        match read {
            Ok(reached) if reached < end => {
                Err(VolumeError::in_samples(Trouble::Truncated { declared, got: reached }))
            }
            Ok(_) if end == declared => self.check_end(),
            Ok(_) => Ok(()),
            Err(error) => Err(decoding(error)),
        }
    }

    /// Has a decoder look behind the last sample, where checksums are.
    fn check_end(&mut self) -> Result<(), VolumeError> {
        match &mut self.access {
            Access::Stream(Stream { decoder: Some(decoder), .. }) => {
                decoder.read(&mut [0]).map(|_| ()).map_err(decoding)
            }
            _ => Ok(()),
        }
    }
}

impl Stream {
    /// Reads bytes from `offset` on; returns how far it came, which is less than asked when the stream ends.
    fn read_at(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<u64> {
        if offset + (self.kept.len() as u64) < self.position {
            self.decoder = None;
            self.position = 0;
            self.kept.clear();
        }
        self.skip_to(offset)?;
        if self.position < offset {
            return Ok(self.position);
        }
        let again = usize::try_from(self.position - offset).unwrap_or(usize::MAX).min(buffer.len());
        let (again, new) = buffer.split_at_mut(again);
        let from =
            self.kept.len().saturating_sub(usize::try_from(self.position - offset).unwrap_or(usize::MAX));
        for (byte, kept) in again.iter_mut().zip(self.kept.range(from..)) {
            *byte = *kept;
        }
        if !new.is_empty() {
            self.decode(new)?;
        }
        Ok(self.position)
    }

    fn skip_to(&mut self, offset: u64) -> io::Result<()> {
        let mut buffer = [0; 4096];
        while self.position < offset {
            let run = usize::try_from(offset - self.position).unwrap_or(usize::MAX).min(buffer.len());
            if self.decode(&mut buffer[..run])? < run {
                break;
            }
        }
        Ok(())
    }

    /// Decodes the next bytes and keeps the last; returns how many there were.
    fn decode(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.decoder.is_none() {
            self.decoder = Some((self.open)()?);
        }
        let Some(decoder) = &mut self.decoder else { return Ok(0) };
        let got = fill(decoder, buffer)?;
        self.position += got as u64;
        let fresh = &buffer[got.saturating_sub(self.kept_max)..got];
        let stale = (self.kept.len() + fresh.len()).saturating_sub(self.kept_max);
        self.kept.drain(..stale);
        self.kept.extend(fresh);
        Ok(got)
    }
}

impl fmt::Debug for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plain { begin, .. } => {
                f.debug_struct("Plain").field("begin", begin).finish_non_exhaustive()
            }
            Self::Stream(Stream { position, .. }) => {
                f.debug_struct("Stream").field("position", position).finish_non_exhaustive()
            }
        }
    }
}

/// Reads until the buffer is full or the input ends; returns how much there was.
pub(super) fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut got = 0;
    while got < buffer.len() {
        match reader.read(&mut buffer[got..]) {
            Ok(0) => break,
            Ok(count) => got += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            // A decoder's way to say that its input ends.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => break,
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}

/// What a decoder complains about is the file's fault, not the system's.
fn decoding(error: io::Error) -> VolumeError {
    match error.kind() {
        io::ErrorKind::InvalidData | io::ErrorKind::InvalidInput | io::ErrorKind::UnexpectedEof => {
            VolumeError::in_samples(Trouble::Corrupt(error.to_string()))
        }
        _ => VolumeError::Io(error),
    }
}
