//! NRRD files: a text header, then samples, in the same file or in one beside it.

use std::collections::HashMap;
use std::io::BufRead;

use super::bytes::Bytes;
use super::error::{Trouble, VolumeError, shortened};
use super::file_volume::FileVolume;
use super::input::{Input, next_line};
use super::numbers;
use super::packing::{gzip, text};
use super::sample::{Endian, SampleType};
use super::shape::{Note, VolumeShape};

/// Opens a file that begins with [`MAGIC`].
pub(super) fn open(input: &Input) -> Result<FileVolume, VolumeError> {
    let header = Header::read(&mut input.buffered_at(0)?)?;
    let Some(name) = &header.data_file else {
        let begin = header.bytes;
        return header.open(input, begin);
    };
    let path = input.beside(name).ok_or_else(|| {
        let what = format!("a header in memory whose samples are in {name:?}");
        VolumeError::in_header(Trouble::unsupported(what, "give the file"))
    })?;
    header.open(&Input::data_file(path)?, 0)
}

/// What a header says.
struct Header {
    shape: VolumeShape,
    endian: Endian,
    encoding: Encoding,
    /// The file that has the samples when it is another.
    data_file: Option<String>,
    /// Lines before the samples, as they are in the file.
    line_skip: u64,
    /// Bytes before the samples, as they are after decompression; `None` when the samples are the last in the file.
    byte_skip: Option<u64>,
    /// Length of the header.
    bytes: u64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Text,
}

impl Header {
    fn read(reader: &mut impl BufRead) -> Result<Self, VolumeError> {
        let fields = Fields::read(reader)?;
        let sample = fields.required("type", "the type of its samples")?.parse(sample_type, TYPES)?;
        let (shape, kept) = fields.shape(sample)?;
        let shape = fields.placed(shape, &kept)?;
        let encoding = fields.required("encoding", "its encoding")?.encoding()?;
        let endian =
            fields.get("endian").map(|field| field.parse(Endian::named, "little or big")).transpose()?;
        if endian.is_none() && sample.bytes() > 1 && encoding != Encoding::Text {
            return Err(VolumeError::in_header(Trouble::Missing("endian: little or big")));
        }
        let count = "a number of 0 or more, or -1 for bytes";
        let skip = |key| fields.get(key).map_or(Ok(0), |field| field.parse(|text| text.parse().ok(), count));
        let byte_skip: i64 = skip("byteskip")?;
        let line_skip: i64 = skip("lineskip")?;
        if byte_skip < -1 || line_skip < 0 || (byte_skip == -1 && encoding != Encoding::Raw) {
            let trouble = Trouble::value(format!("{line_skip} lines, {byte_skip} bytes"), count);
            return Err(VolumeError::in_field("line skip, byte skip", trouble));
        }
        Ok(Self {
            shape,
            endian: endian.unwrap_or(Endian::Little),
            encoding,
            data_file: fields.get("datafile").map(Field::data_file).transpose()?,
            line_skip: line_skip.unsigned_abs(),
            byte_skip: u64::try_from(byte_skip).ok(),
            bytes: fields.bytes,
        })
    }

    /// Opens the samples, which are behind `begin` bytes of a file.
    fn open(self, input: &Input, begin: u64) -> Result<FileVolume, VolumeError> {
        let Self { shape, endian, encoding, line_skip, byte_skip, .. } = self;
        let begin = begin + lines_length(input, begin, line_skip)?;
        let length = input.length()?;
        let (bytes, endian) = match encoding {
            Encoding::Raw => {
                let last = length.saturating_sub(shape.bytes()).max(begin);
                let begin = byte_skip.map_or(last, |skip| begin.saturating_add(skip));
                (Bytes::plain(input.open_at(0)?, begin, length, shape.bytes())?, endian)
            }
            Encoding::Gzip => (gzip(input, begin, byte_skip.unwrap_or(0), &shape), endian),
            Encoding::Text => {
                (text(input, begin.saturating_add(byte_skip.unwrap_or(0)), &shape), Endian::NATIVE)
            }
        };
        Ok(FileVolume::new(shape, endian, bytes))
    }
}

/// The fields of a header by their names, small and without spaces.
struct Fields {
    by_name: HashMap<String, Field>,
    /// Length of the header, its last line included.
    bytes: u64,
}

/// A field and the line it is in, from 1.
struct Field {
    line: u64,
    text: String,
}

impl Fields {
    /// Reads lines up to the first blank one; comments and key/value pairs are left out.
    fn read(reader: &mut impl BufRead) -> Result<Self, VolumeError> {
        let mut fields = Self { by_name: HashMap::new(), bytes: 0 };
        for number in 1_u64.. {
            let line = next_line(reader, HEADER_BYTES_MAX.saturating_sub(fields.bytes))?;
            fields.bytes += line.bytes;
            match String::from_utf8_lossy(&line.text).trim() {
                "" if line.has_end => break,
                magic if number == 1 => check_magic(magic)?,
                comment if comment.is_empty() || comment.starts_with('#') => {}
                text => fields.add(number, text)?,
            }
            if !line.has_end {
                // Without samples behind it a header may end with its file.
                let is_whole = reader.fill_buf()?.is_empty() && fields.by_name.contains_key("datafile");
                let refused = || VolumeError::at_line(number, Trouble::EndlessHeader);
                return if is_whole { Ok(fields) } else { Err(refused()) };
            }
        }
        Ok(fields)
    }

    fn add(&mut self, line: u64, text: &str) -> Result<(), VolumeError> {
        let refused = |trouble| Err(VolumeError::at_line(line, trouble));
        let Some((name, value)) = text.split_once(':') else {
            return refused(Trouble::Senseless(shortened(text)));
        };
        if value.starts_with('=') {
            return Ok(());
        }
        let name: String = name.chars().filter(|letter| *letter != ' ').collect();
        let field = Field { line, text: value.trim().to_owned() };
        match self.by_name.insert(name.to_ascii_lowercase(), field) {
            Some(_) => refused(Trouble::Twice(shortened(&name))),
            None => Ok(()),
        }
    }

    fn get(&self, name: &str) -> Option<&Field> {
        self.by_name.get(name)
    }

    fn required(&self, name: &str, what: &'static str) -> Result<&Field, VolumeError> {
        self.get(name).ok_or_else(|| VolumeError::in_header(Trouble::Missing(what)))
    }

    /// The shape by the sizes, and which axes it has. Of more than three, those of one sample are left out, the last
    /// first.
    fn shape(&self, sample: SampleType) -> Result<(VolumeShape, Vec<usize>), VolumeError> {
        let dimension = self.required("dimension", "its dimension")?;
        let axes: usize = dimension.parse(|text| text.parse().ok(), "a number of axes")?;
        let field = self.required("sizes", "its sizes")?;
        let sizes: Vec<u64> =
            field.parse(|text| numbers::list(text.split_ascii_whitespace()), "a number for each axis")?;
        if sizes.len() != axes {
            return Err(VolumeError::at_line(
                field.line,
                Trouble::value(&field.text, "a number for each axis"),
            ));
        }
        let mut kept: Vec<usize> = (0..axes).collect();
        while kept.len() > 3 {
            match kept.iter().rposition(|axis| sizes[*axis] == 1) {
                Some(single) => kept.remove(single),
                None => break,
            };
        }
        let Ok(axes) = <[usize; 3]>::try_from(kept.as_slice()) else {
            let what = format!("an array of {} axes", kept.len());
            let trouble = Trouble::unsupported(what, "give three axes of one number a sample");
            return Err(VolumeError::at_line(field.line, trouble));
        };
        Ok((VolumeShape::new(axes.map(|axis| sizes[axis]), sample)?, kept))
    }

    /// The shape with its spacing and origin.
    fn placed(&self, shape: VolumeShape, kept: &[usize]) -> Result<VolumeShape, VolumeError> {
        let directions = self.get("spacedirections").map(Field::vectors).transpose()?;
        let plain = self.get("spacings").map(Field::distances).transpose()?;
        // An axis has a direction of its own, or a distance alone, or neither.
        let steps: Vec<Step> = kept
            .iter()
            .enumerate()
            .map(|(place, axis)| {
                let direction = directions.as_ref().and_then(|directions| directions.get(*axis)?.as_ref());
                let distance = plain.as_ref().and_then(|distances| distances.get(*axis)).copied();
                direction
                    .map_or_else(|| Step::of_distance(distance), |vector| Step::of_direction(vector, place))
            })
            .collect();
        let origin = self.get("spaceorigin").map(Field::vectors).transpose()?;
        let origin = origin.and_then(|origin| origin.first()?.as_deref()?.try_into().ok());
        let mut shape = shape
            .with_spacing([steps[0].distance, steps[1].distance, steps[2].distance])?
            .with_origin(origin.unwrap_or([0.0; 3]))?;
        if steps.iter().any(|step| !step.is_straight) {
            shape.notes.push(Note::Orientation);
        }
        if steps.iter().any(|step| !step.is_known) {
            shape.notes.push(Note::NoSpacing);
        }
        Ok(shape)
    }
}

/// The way from one sample of an axis to the next.
struct Step {
    distance: f64,
    /// Whether it goes along the axis of its own number, upwards.
    is_straight: bool,
    /// Whether the file says anything about it.
    is_known: bool,
}

impl Step {
    fn of_distance(distance: Option<f64>) -> Self {
        let known = distance.filter(|distance| !distance.is_nan());
        let distance = known.unwrap_or(1.0);
        Self { distance: distance.abs(), is_straight: distance >= 0.0, is_known: known.is_some() }
    }

    fn of_direction(vector: &[f64], place: usize) -> Self {
        let distance = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
        let is_straight = vector.get(place) == Some(&distance);
        Self { distance, is_straight, is_known: true }
    }
}

impl Field {
    fn parse<T>(
        &self,
        meaning: impl Fn(&str) -> Option<T>,
        expected: &'static str,
    ) -> Result<T, VolumeError> {
        let text = self.text.to_ascii_lowercase();
        let refused = || VolumeError::at_line(self.line, Trouble::value(&self.text, expected));
        meaning(&text).ok_or_else(refused)
    }

    fn encoding(&self) -> Result<Encoding, VolumeError> {
        match self.text.to_ascii_lowercase().as_str() {
            "raw" => Ok(Encoding::Raw),
            "gzip" | "gz" => Ok(Encoding::Gzip),
            "txt" | "text" | "ascii" => Ok(Encoding::Text),
            _ => {
                let what = format!("encoding {:?}", shortened(&self.text));
                let trouble = Trouble::Unsupported { what, instead: "save it as raw, gzip or ascii" };
                Err(VolumeError::at_line(self.line, trouble))
            }
        }
    }

    /// The one file that has the samples.
    fn data_file(&self) -> Result<String, VolumeError> {
        let several = self.text.starts_with("LIST") || self.text.contains('%');
        if several {
            let what = format!("data file {:?}, a list of files,", shortened(&self.text));
            return Err(VolumeError::at_line(
                self.line,
                Trouble::Unsupported { what, instead: "save all samples in one" },
            ));
        }
        Ok(self.text.clone())
    }

    /// One number for each axis.
    fn distances(&self) -> Result<Vec<f64>, VolumeError> {
        self.parse(|text| numbers::list(text.split_ascii_whitespace()), "a distance for each axis")
    }

    /// One vector such as `(1,0,0)` or the word `none` for each axis.
    fn vectors(&self) -> Result<Vec<Option<Vec<f64>>>, VolumeError> {
        let vector = |text: &str| match text.trim() {
            "none" => Some(None),
            text => numbers::list(text.strip_prefix('(')?.split(',')).map(Some),
        };
        // Blanks may be within vectors too: a vector ends with its bracket.
        let vectors = |text: &str| {
            let is_closed = text.matches('(').count() == text.matches(')').count();
            let text = text.replace("none", "none)");
            let text = is_closed.then_some(text)?;
            text.split_terminator(')').map(vector).collect::<Option<Vec<_>>>()
        };
        self.parse(vectors, "a vector such as (1,0,0) for each axis")
    }
}

fn check_magic(line: &str) -> Result<(), VolumeError> {
    match line.strip_prefix("NRRD000").and_then(|version| version.parse().ok()) {
        Some(1..=5_u8) => Ok(()),
        _ => {
            let trouble = Trouble::unsupported(line, "save it as NRRD0001 to NRRD0005");
            Err(VolumeError::at_line(1, trouble))
        }
    }
}

/// The names that the format gives the types.
fn sample_type(name: &str) -> Option<SampleType> {
    match name {
        "signed char" | "int8" | "int8_t" => Some(SampleType::I8),
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Some(SampleType::U8),
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            Some(SampleType::I16)
        }
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Some(SampleType::U16),
        "int" | "signed int" | "int32" | "int32_t" => Some(SampleType::I32),
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Some(SampleType::U32),
        "float" => Some(SampleType::F32),
        "double" => Some(SampleType::F64),
        _ => None,
    }
}

/// Length of so many lines.
fn lines_length(input: &Input, begin: u64, lines: u64) -> Result<u64, VolumeError> {
    let (mut reader, mut length) = (input.buffered_at(begin)?, 0);
    for _ in 0..lines {
        let line = next_line(&mut reader, LINE_BYTES_MAX)?;
        if !line.has_end {
            return Err(VolumeError::in_field("line skip", Trouble::EndlessHeader));
        }
        length += line.bytes;
    }
    Ok(length)
}

/// How a file begins.
pub(super) const MAGIC: &[u8] = b"NRRD";

/// Longest header that is read; those of scanners with all their remarks have some KB.
const HEADER_BYTES_MAX: u64 = 1 << 20;

const TYPES: &str = "a type that is read: 8 to 32 bits signed or unsigned, float, double";

/// Longest line that is skipped.
const LINE_BYTES_MAX: u64 = 1 << 20;
