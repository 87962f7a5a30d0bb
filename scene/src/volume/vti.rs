//! VTI files: image data of VTK, an XML header with samples in it or behind it.

use std::io::{BufRead, BufReader, Read, Take};

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Error, Reader};

use super::bytes::{Bytes, fill};
use super::error::{Place, Trouble, VolumeError, shortened};
use super::file_volume::FileVolume;
use super::input::{Input, Opened};
use super::numbers;
use super::packing::{base64, base64_length, base64_reader, text, zlib};
use super::sample::{Endian, SampleType};
use super::shape::{Note, VolumeShape};

/// Opens a file that begins like XML.
pub(super) fn open(input: &Input) -> Result<FileVolume, VolumeError> {
    let mut scan = Scan::new(input)?;
    let mut header = Header::default();
    let array = scan.array(&mut header)?;
    let shape = header.shape(&array)?;
    let (begin, is_base64) = match array.place {
        ArrayPlace::Text { begin } => {
            return Ok(FileVolume::new(shape.clone(), Endian::NATIVE, text(input, begin, &shape)));
        }
        ArrayPlace::Base64 { begin } => (begin, true),
        ArrayPlace::Appended { offset } => {
            let (begin, is_base64) = scan.appended()?;
            (begin.saturating_add(offset), is_base64)
        }
    };
    let bytes = Packed { input, header: &header, begin, is_base64 }.open(&shape)?;
    Ok(FileVolume::new(shape, header.endian, bytes))
}

/// Whether the first bytes of a file are those of a VTK file in XML.
pub(super) fn is_one(first: &[u8]) -> bool {
    let text = String::from_utf8_lossy(first);
    let text = text.trim_start_matches(['\u{feff}', ' ', '\t', '\r', '\n']);
    text.starts_with("<VTKFile") || (text.starts_with("<?xml") && text.contains("<VTKFile"))
}

/// What the elements around the samples say.
struct Header {
    endian: Endian,
    /// Length of a number that precedes samples in base64 or raw.
    word_bytes: usize,
    is_zlib: bool,
    /// First and last sample of each axis.
    extent: Option<[i64; 6]>,
    origin: Option<[f64; 3]>,
    spacing: Option<[f64; 3]>,
    is_rotated: bool,
}

impl Default for Header {
    fn default() -> Self {
        let (endian, extent) = (Endian::Little, None);
        Self { endian, word_bytes: 4, is_zlib: false, extent, origin: None, spacing: None, is_rotated: false }
    }
}

/// An array of samples.
#[derive(Clone, Debug)]
struct Array {
    name: Option<String>,
    type_name: String,
    components: u64,
    place: ArrayPlace,
}

/// Where an array's samples are.
#[derive(Clone, Copy, Debug)]
enum ArrayPlace {
    /// Numbers from this byte of the file on.
    Text { begin: u64 },
    /// Base64 from this byte of the file on.
    Base64 { begin: u64 },
    /// So many bytes into what is appended.
    Appended { offset: u64 },
}

/// Goes through the elements of a file; never holds more than one tag.
struct Scan {
    reader: Reader<Take<BufReader<Opened>>>,
    buffer: Vec<u8>,
}

/// A tag of the header; the name of one that ends an element begins with a slash.
struct Tag {
    name: String,
    attributes: Vec<(String, String)>,
    /// Whether the element has no content.
    is_empty: bool,
}

impl Scan {
    fn new(input: &Input) -> Result<Self, VolumeError> {
        let mut reader = Reader::from_reader(input.buffered_at(0)?.take(0));
        // A header that is cut short is found out when something is missing.
        reader.config_mut().check_end_names = false;
        Ok(Self { reader, buffer: Vec::new() })
    }

    /// Finds the array to draw: the one that PointData names as scalars, or else the first of one number a sample.
    fn array(&mut self, header: &mut Header) -> Result<Array, VolumeError> {
        let (mut is_points, mut scalars, mut found) = (false, None, None::<Array>);
        while let Some(tag) = self.next_tag()? {
            match tag.name.as_str() {
                "VTKFile" => header.read_file(&tag)?,
                "ImageData" => header.read_image(&tag)?,
                "Piece" => header.check_piece(&tag)?,
                "PointData" => (is_points, scalars) = (!tag.is_empty, tag.get("Scalars").map(str::to_owned)),
                "/PointData" | "/ImageData" | "AppendedData" => break,
                "DataArray" if is_points => {
                    let array = Array::read(&tag, self.reader.buffer_position())?;
                    if array.name.is_some() && array.name == scalars {
                        return Ok(array);
                    }
                    if found.as_ref().is_none_or(|found| found.components != 1 && array.components == 1) {
                        found = Some(array);
                    }
                }
                _ => {}
            }
            if tag.name == "DataArray" && !tag.is_empty {
                self.skip_text()?;
            }
        }
        let missing = Trouble::Missing("any array of point data; cell data are not read");
        found.ok_or_else(|| VolumeError::in_header(missing))
    }

    /// Where appended samples begin, and whether they are in base64.
    fn appended(&mut self) -> Result<(u64, bool), VolumeError> {
        let tag = loop {
            match self.next_tag()? {
                Some(tag) if tag.name == "AppendedData" => break tag,
                Some(tag) if tag.name == "DataArray" && !tag.is_empty => self.skip_text()?,
                Some(_) => {}
                None => return Err(VolumeError::in_header(Trouble::Missing("where AppendedData begin"))),
            }
        };
        let is_base64 = match tag.get("encoding") {
            Some("raw") => false,
            Some("base64") | None => true,
            Some(other) => return Err(refused("AppendedData encoding", other, "raw or base64")),
        };
        // "_" marks the beginning; offsets count from behind it.
        self.reader.get_mut().set_limit(TAG_BYTES_MAX);
        let mut letter = [b' '];
        while letter[0].is_ascii_whitespace() {
            if self.reader.stream().read(&mut letter)? == 0 {
                return Err(VolumeError::in_header(Trouble::EndlessHeader));
            }
        }
        if letter[0] != b'_' {
            return Err(refused(
                "AppendedData",
                &char::from(letter[0]).to_string(),
                "the _ before the samples",
            ));
        }
        Ok((self.reader.buffer_position(), is_base64))
    }

    /// The next tag; `None` at the end of the file.
    fn next_tag(&mut self) -> Result<Option<Tag>, VolumeError> {
        loop {
            self.buffer.clear();
            self.reader.get_mut().set_limit(TAG_BYTES_MAX);
            let event = self.reader.read_event_into(&mut self.buffer);
            match event.map_err(|error| senseless(error, self.reader.error_position()))? {
                Event::Start(start) => return Tag::read(&start, false).map(Some),
                Event::Empty(start) => return Tag::read(&start, true).map(Some),
                Event::End(end) => {
                    let name = format!("/{}", end.name().as_ref());
                    return Ok(Some(Tag { name, attributes: Vec::new(), is_empty: true }));
                }
                Event::Eof => return Ok(None),
                _ => {}
            }
        }
    }

    /// Goes to the next tag without a look at what is before it.
    fn skip_text(&mut self) -> Result<(), VolumeError> {
        self.reader.get_mut().set_limit(u64::MAX);
        let mut stream = self.reader.stream();
        loop {
            let text = stream.fill_buf()?;
            let tag = text.iter().position(|letter| *letter == b'<');
            let length = tag.unwrap_or(text.len());
            stream.consume(length);
            if tag.is_some() || length == 0 {
                return Ok(());
            }
        }
    }
}

impl Tag {
    fn read(start: &BytesStart<'_>, is_empty: bool) -> Result<Self, VolumeError> {
        let name = start.name().as_ref().to_owned();
        let attributes = start.attributes().map(|attribute| match attribute {
            Ok(attribute) => Ok((attribute.key.as_ref().to_owned(), attribute.value.into_owned())),
            Err(error) => {
                let trouble = Trouble::Senseless(shortened(&format!("<{name}>: {error}")));
                Err(VolumeError::in_header(trouble))
            }
        });
        Ok(Self { attributes: attributes.collect::<Result<_, _>>()?, name, is_empty })
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The numbers of an attribute, so many; `None` when there is no such attribute.
    fn numbers<T: core::str::FromStr, const N: usize>(
        &self,
        name: &'static str,
        expected: &'static str,
    ) -> Result<Option<[T; N]>, VolumeError> {
        let numbers = |text: &str| {
            let list = numbers::list(text.split_ascii_whitespace());
            list.and_then(|list| list.try_into().ok()).ok_or_else(|| refused(name, text, expected))
        };
        self.get(name).map(numbers).transpose()
    }
}

impl Header {
    fn read_file(&mut self, tag: &Tag) -> Result<(), VolumeError> {
        match tag.get("type") {
            Some("ImageData") => {}
            other => {
                let what = format!("VTK data of type {:?}", other.unwrap_or_default());
                return Err(VolumeError::in_header(Trouble::unsupported(what, "give ImageData")));
            }
        }
        self.endian = match tag.get("byte_order") {
            Some("LittleEndian") | None => Endian::Little,
            Some("BigEndian") => Endian::Big,
            Some(other) => return Err(refused("byte_order", other, "LittleEndian or BigEndian")),
        };
        self.word_bytes = match tag.get("header_type") {
            Some("UInt32") | None => 4,
            Some("UInt64") => 8,
            Some(other) => return Err(refused("header_type", other, "UInt32 or UInt64")),
        };
        self.is_zlib = match tag.get("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => {
                let trouble = Trouble::unsupported(format!("compressor {other}"), "save with zlib or none");
                return Err(VolumeError::in_header(trouble));
            }
        };
        Ok(())
    }

    fn read_image(&mut self, tag: &Tag) -> Result<(), VolumeError> {
        self.extent = tag.numbers("WholeExtent", EXTENT)?;
        self.origin = tag.numbers("Origin", "three coordinates")?;
        self.spacing = tag.numbers("Spacing", "three distances")?;
        let direction = tag.numbers::<f64, 9>("Direction", "nine numbers")?;
        self.is_rotated = direction.is_some_and(|direction| direction != UPRIGHT);
        Ok(())
    }

    fn check_piece(&self, tag: &Tag) -> Result<(), VolumeError> {
        let piece = tag.numbers::<i64, 6>("Extent", EXTENT)?;
        if piece.is_some() && piece != self.extent {
            let trouble = Trouble::unsupported("an image in several pieces", "save it in one");
            return Err(VolumeError::in_header(trouble));
        }
        Ok(())
    }

    fn shape(&self, array: &Array) -> Result<VolumeShape, VolumeError> {
        let extent =
            self.extent.ok_or_else(|| VolumeError::in_header(Trouble::Missing("its WholeExtent")))?;
        let length = |axis: usize| {
            let [first, last] = [extent[2 * axis], extent[2 * axis + 1]];
            let samples = last.checked_sub(first).and_then(|steps| u64::try_from(steps).ok()?.checked_add(1));
            samples.ok_or_else(|| refused("WholeExtent", &format!("{first} {last}"), EXTENT))
        };
        if array.components != 1 {
            let what = format!("an array of {} numbers a sample", array.components);
            return Err(VolumeError::in_header(Trouble::unsupported(what, "save one scalar")));
        }
        let sample = sample_type(&array.type_name).ok_or_else(|| refused("type", &array.type_name, TYPES))?;
        let spacing = self.spacing.unwrap_or([1.0; 3]);
        let first = [extent[0], extent[2], extent[4]].map(|first| first as f64);
        let origin = self.origin.unwrap_or([0.0; 3]);
        let mut shape = VolumeShape::new([length(0)?, length(1)?, length(2)?], sample)?
            .with_spacing(spacing)?
            .with_origin([0, 1, 2].map(|axis| origin[axis] + first[axis] * spacing[axis]))?;
        if self.is_rotated {
            shape.notes.push(Note::Orientation);
        }
        Ok(shape)
    }
}

impl Array {
    /// Reads the tag of an array whose content begins at a byte of the file.
    fn read(tag: &Tag, begin: u64) -> Result<Self, VolumeError> {
        let components = tag.get("NumberOfComponents").unwrap_or("1");
        let place = match tag.get("format") {
            Some("ascii") => ArrayPlace::Text { begin },
            Some("binary") => ArrayPlace::Base64 { begin },
            Some("appended") => {
                let offset = tag.get("offset").unwrap_or_default();
                let parsed = offset.trim().parse();
                ArrayPlace::Appended {
                    offset: parsed.map_err(|_| refused("offset", offset, "a number of bytes"))?,
                }
            }
            other => return Err(refused("format", other.unwrap_or_default(), "ascii, binary or appended")),
        };
        Ok(Self {
            name: tag.get("Name").map(str::to_owned),
            type_name: tag.get("type").unwrap_or_default().to_owned(),
            components: components
                .trim()
                .parse()
                .map_err(|_| refused("NumberOfComponents", components, "a number"))?,
            place,
        })
    }
}

/// Samples in raw or base64, with numbers before them that tell their length.
struct Packed<'p> {
    input: &'p Input,
    header: &'p Header,
    /// Where those numbers begin.
    begin: u64,
    is_base64: bool,
}

impl Packed<'_> {
    fn open(mut self, shape: &VolumeShape) -> Result<Bytes, VolumeError> {
        self.begin += self.space_before()?;
        if self.header.is_zlib {
            return self.open_blocks(shape);
        }
        let word_bytes = self.header.word_bytes as u64;
        let declared = self.words(1)?.next().transpose()?.unwrap_or_default();
        // With words of 32 bits the length of a large array is cut.
        let mask = if word_bytes == 4 { u64::from(u32::MAX) } else { u64::MAX };
        check_length(declared, shape.bytes() & mask)?;
        if self.is_base64 {
            return Ok(base64(self.input, self.begin, word_bytes, shape));
        }
        let begin = self.begin.saturating_add(word_bytes);
        Bytes::plain(self.input.open_at(0)?, begin, self.input.length()?, shape.bytes())
    }

    /// The numbers are: how many blocks, bytes of a block, bytes of the last when it has less, compressed bytes of each.
    fn open_blocks(&self, shape: &VolumeShape) -> Result<Bytes, VolumeError> {
        let first: Vec<u64> = self.words(3)?.collect::<Result<_, _>>()?;
        let [blocks, block_bytes, last_bytes] = first[..] else { return Err(self.cut_short(shape)) };
        let whole = if last_bytes == 0 { blocks } else { blocks.saturating_sub(1) };
        check_length(whole.saturating_mul(block_bytes).saturating_add(last_bytes), shape.bytes())?;
        let words = blocks.saturating_add(3);
        let table = words.saturating_mul(self.header.word_bytes as u64);
        if table > self.input.length()? {
            return Err(self.cut_short(shape));
        }
        if !self.is_base64 {
            return Ok(zlib(self.input, self.begin.saturating_add(table), blocks, None, shape));
        }
        let lengths = self.words(words)?.skip(3);
        let length = lengths.sum::<Result<_, _>>()?;
        let begin = self.begin.saturating_add(base64_length(table));
        Ok(zlib(self.input, begin, blocks, Some(length), shape))
    }

    /// The first numbers.
    fn words(&self, count: u64) -> Result<impl Iterator<Item = Result<u64, VolumeError>>, VolumeError> {
        let reader = self.input.buffered_at(self.begin)?;
        let word_bytes = self.header.word_bytes;
        let mut reader: Box<dyn Read> = if self.is_base64 {
            Box::new(base64_reader(reader, count.saturating_mul(word_bytes as u64)))
        } else {
            Box::new(reader)
        };
        let endian = self.header.endian;
        Ok((0..count).map(move |_| {
            let mut word = [0; 8];
            let corrupt = |error: String| VolumeError::in_samples(Trouble::Corrupt(error));
            let got =
                fill(&mut reader, &mut word[..word_bytes]).map_err(|error| corrupt(error.to_string()))?;
            if got < word_bytes {
                return Err(corrupt("the numbers before them are cut short".to_owned()));
            }
            if endian == Endian::Big {
                word[..word_bytes].reverse();
            }
            Ok(u64::from_le_bytes(word))
        }))
    }

    fn cut_short(&self, shape: &VolumeShape) -> VolumeError {
        VolumeError::in_samples(Trouble::Truncated { declared: shape.bytes(), got: 0 })
    }

    /// Length of the space before base64.
    fn space_before(&self) -> Result<u64, VolumeError> {
        if !self.is_base64 {
            return Ok(0);
        }
        let is_space = |byte: &Result<u8, _>| byte.as_ref().is_ok_and(u8::is_ascii_whitespace);
        Ok(self.input.buffered_at(self.begin)?.bytes().take_while(is_space).count() as u64)
    }
}

fn check_length(declared: u64, expected: u64) -> Result<(), VolumeError> {
    if declared == expected {
        return Ok(());
    }
    let trouble = Trouble::value(format!("{declared} bytes"), "as many as extent and type make");
    Err(VolumeError::in_samples(trouble))
}

fn refused(field: &'static str, value: &str, expected: &'static str) -> VolumeError {
    VolumeError::in_field(field, Trouble::value(value, expected))
}

fn senseless(error: Error, position: u64) -> VolumeError {
    match error {
        Error::Io(error) => std::io::Error::from(error.kind()).into(),
        other => {
            let trouble = Trouble::Senseless(shortened(&other.to_string()));
            VolumeError::Broken { place: Place::Byte(position), trouble }
        }
    }
}

fn sample_type(name: &str) -> Option<SampleType> {
    match name {
        "Int8" => Some(SampleType::I8),
        "UInt8" => Some(SampleType::U8),
        "Int16" => Some(SampleType::I16),
        "UInt16" => Some(SampleType::U16),
        "Int32" => Some(SampleType::I32),
        "UInt32" => Some(SampleType::U32),
        "Float32" => Some(SampleType::F32),
        "Float64" => Some(SampleType::F64),
        _ => None,
    }
}

/// Longest tag that is read.
const TAG_BYTES_MAX: u64 = 1 << 20;

/// A direction matrix that leaves everything as it is.
const UPRIGHT: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

const EXTENT: &str = "first and last sample of each axis, as in 0 255 0 255 0 127";
const TYPES: &str = "one of Int8 to UInt32, Float32, Float64";
