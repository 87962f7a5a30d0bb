//! Ways in which files pack their samples.

use std::io::{self, BufRead, BufReader, Read};

use base64::engine::general_purpose::{GeneralPurpose, STANDARD};
use base64::read::DecoderReader;
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use super::bytes::Bytes;
use super::input::Input;
use super::sample::SampleType;
use super::shape::VolumeShape;

/// Samples compressed by gzip from `begin` on, `skip` bytes into what is decompressed.
pub(super) fn gzip(input: &Input, begin: u64, skip: u64, shape: &VolumeShape) -> Bytes {
    let input = input.clone();
    stream(shape, move || {
        let mut decoder = MultiGzDecoder::new(input.buffered_at(begin)?);
        io::copy(&mut (&mut decoder).take(skip), &mut io::sink())?;
        Ok(Box::new(decoder))
    })
}

/// Samples written as numbers from `begin` on, decoded to this machine's order of bytes.
pub(super) fn text(input: &Input, begin: u64, shape: &VolumeShape) -> Bytes {
    let (input, sample) = (input.clone(), shape.sample);
    stream(shape, move || Ok(Box::new(TextReader { reader: input.buffered_at(begin)?, sample })))
}

/// Samples in base64 from `begin` on, `skip` bytes into what is decoded.
pub(super) fn base64(input: &Input, begin: u64, skip: u64, shape: &VolumeShape) -> Bytes {
    let (input, length) = (input.clone(), skip.saturating_add(shape.bytes()));
    stream(shape, move || {
        let mut decoder = base64_reader(input.buffered_at(begin)?, length);
        io::copy(&mut (&mut decoder).take(skip), &mut io::sink())?;
        Ok(Box::new(decoder))
    })
}

/// Samples in blocks that were compressed by zlib one by one and lie behind each other from `begin` on; `encoded` is
/// their length when they are also in base64.
pub(super) fn zlib(
    input: &Input,
    begin: u64,
    blocks: u64,
    encoded: Option<u64>,
    shape: &VolumeShape,
) -> Bytes {
    let input = input.clone();
    stream(shape, move || {
        let reader = input.buffered_at(begin)?;
        Ok(match encoded {
            None => Box::new(ZlibChain::new(reader, blocks)),
            Some(length) => Box::new(ZlibChain::new(BufReader::new(base64_reader(reader, length)), blocks)),
        })
    })
}

/// Decodes `length` bytes from base64; blanks and line ends are left out.
pub(super) fn base64_reader<R: BufRead>(reader: R, length: u64) -> impl Read + use<R> {
    let left = base64_length(length);
    DecoderReader::<GeneralPurpose, _>::new(Base64Letters { reader, left }, &STANDARD)
}

/// Number of letters that so many bytes are in base64.
pub(super) const fn base64_length(bytes: u64) -> u64 {
    bytes.div_ceil(3).saturating_mul(4)
}

/// Samples out of a decoder; keeps a slice of them.
fn stream(
    shape: &VolumeShape,
    open: impl Fn() -> io::Result<Box<dyn Read + Send>> + Send + 'static,
) -> Bytes {
    let slice = shape.slice_samples() * shape.sample.bytes() as u64;
    Bytes::stream(open, shape.bytes(), usize::try_from(slice).unwrap_or(usize::MAX))
}

/// Hands on a number of letters and leaves out space between them.
struct Base64Letters<R> {
    reader: R,
    /// Letters to come.
    left: u64,
}

impl<R: BufRead> Read for Base64Letters<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let wanted = usize::try_from(self.left).unwrap_or(usize::MAX).min(buffer.len());
        let mut count = 0;
        while count == 0 && wanted > 0 {
            let text = self.reader.fill_buf()?;
            if text.is_empty() {
                break;
            }
            let mut looked_at = 0;
            for letter in text {
                if count == wanted {
                    break;
                }
                if !letter.is_ascii_whitespace() {
                    buffer[count] = *letter;
                    count += 1;
                }
                looked_at += 1;
            }
            self.reader.consume(looked_at);
        }
        self.left -= count as u64;
        Ok(count)
    }
}

/// Makes one stream of several that were compressed one by one.
struct ZlibChain<R> {
    /// Is there but for a moment within `read`.
    decoder: Option<ZlibDecoder<R>>,
    /// Streams to come after this one.
    left: u64,
}

impl<R: BufRead> ZlibChain<R> {
    /// A chain of so many streams; `None` of no stream.
    fn new(reader: R, streams: u64) -> Self {
        Self { decoder: (streams > 0).then(|| ZlibDecoder::new(reader)), left: streams.saturating_sub(1) }
    }
}

impl<R: BufRead> Read for ZlibChain<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(decoder) = &mut self.decoder {
            let count = decoder.read(buffer)?;
            if count > 0 || buffer.is_empty() || self.left == 0 || decoder.get_mut().fill_buf()?.is_empty() {
                return Ok(count);
            }
            self.left -= 1;
            self.decoder = self.decoder.take().map(|decoder| ZlibDecoder::new(decoder.into_inner()));
        }
        Ok(0)
    }
}

/// Makes bytes of numbers in text, up to a `<` or the end; whole numbers at a time.
struct TextReader<R> {
    reader: R,
    sample: SampleType,
}

impl<R: BufRead> Read for TextReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = self.sample.bytes();
        let mut count = 0;
        for bytes in buffer.chunks_exact_mut(length) {
            let word = self.word()?;
            if word.is_empty() {
                break;
            }
            self.sample.encode(&word, bytes).ok_or_else(|| not_a_sample(&word, self.sample))?;
            count += length;
        }
        Ok(count)
    }
}

impl<R: BufRead> TextReader<R> {
    /// The next word; an empty one when there is no more.
    fn word(&mut self) -> io::Result<String> {
        let mut word = String::new();
        loop {
            let Some(letter) = self.reader.fill_buf()?.first().copied() else { return Ok(word) };
            if letter == b'<' || (letter.is_ascii_whitespace() && !word.is_empty()) {
                return Ok(word);
            }
            self.reader.consume(1);
            if !letter.is_ascii_whitespace() {
                word.push(char::from(letter));
            }
            if word.len() > WORD_BYTES_MAX {
                return Err(not_a_sample(&word, self.sample));
            }
        }
    }
}

fn not_a_sample(word: &str, sample: SampleType) -> io::Error {
    let shown: String = word.chars().take(30).collect();
    io::Error::new(io::ErrorKind::InvalidData, format!("{shown:?} is no {sample}"))
}

/// Longest number in text; an exact double in plain decimals may have over 300 digits on either side of its point.
const WORD_BYTES_MAX: usize = 2000;
