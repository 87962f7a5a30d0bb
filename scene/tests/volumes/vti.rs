//! VTI files.

use super::*;

const fn type_of(sample: SampleType) -> &'static str {
    match sample {
        SampleType::U8 => "UInt8",
        SampleType::I8 => "Int8",
        SampleType::U16 => "UInt16",
        SampleType::I16 => "Int16",
        SampleType::U32 => "UInt32",
        SampleType::I32 => "Int32",
        SampleType::F32 => "Float32",
        SampleType::F64 => "Float64",
    }
}

/// How a file is written.
#[derive(Clone, Copy, Debug)]
struct Style {
    is_appended: bool,
    is_base64: bool,
    is_zlib: bool,
    word_bytes: usize,
}

fn styles() -> impl Iterator<Item = Style> {
    (0..16_usize).map(|bits| Style {
        is_appended: bits & 1 == 0,
        is_base64: bits & 1 == 1 || bits & 2 == 0,
        is_zlib: bits & 4 == 0,
        word_bytes: 4 + 4 * (bits >> 3),
    })
}

fn word(style: Style, endian: Endian, value: usize) -> Vec<u8> {
    let big = (value as u64).to_be_bytes()[8 - style.word_bytes..].to_vec();
    if endian == Endian::Big { big } else { big.into_iter().rev().collect() }
}

/// Samples with the numbers before them.
fn packed(samples: &Samples, style: Style) -> Vec<u8> {
    let word = |value| word(style, samples.endian, value);
    let encode = |bytes: &[u8]| {
        if style.is_base64 { STANDARD.encode(bytes).into_bytes() } else { bytes.to_vec() }
    };
    if !style.is_zlib {
        return encode(&[word(samples.bytes.len()), samples.bytes.clone()].concat());
    }
    let blocks: Vec<Vec<u8>> = samples.bytes.chunks(100).map(zlib).collect();
    let mut table = [word(blocks.len()), word(100), word(samples.bytes.len() % 100)].concat();
    table.extend(blocks.iter().flat_map(|block| word(block.len())));
    [encode(&table), encode(&blocks.concat())].concat()
}

/// A file with an array before the samples' own and one behind it.
fn file(samples: &Samples, style: Style) -> Vec<u8> {
    let [x, y, z] = samples.dims;
    let endian = if samples.endian == Endian::Big { "BigEndian" } else { "LittleEndian" };
    let compressor = if style.is_zlib { "compressor=\"vtkZLibDataCompressor\"" } else { "" };
    let body = packed(samples, style);
    let (format, content, appended) = if style.is_appended {
        let encoding = if style.is_base64 { "base64" } else { "raw" };
        let head = format!("<AppendedData encoding=\"{encoding}\">\n  _junk");
        let appended = [head.as_bytes(), &body, b"more</AppendedData>"].concat();
        ("appended\" offset=\"4", Vec::new(), appended)
    } else {
        ("binary", [b"\n      ".as_slice(), &body, b"\n    "].concat(), Vec::new())
    };
    let head = format!(
        "<?xml version=\"1.0\"?>\n<!-- made by a test --><VTKFile type='ImageData' version=\"1.0\" byte_order=\"{endian}\" \
         header_type=\"UInt{}\" {compressor}>\n<ImageData WholeExtent=\"0 {} -1 {} 10 {}\" Origin=\"1 2 3\" \
         Spacing=\"0.5 0.25 3\">\n<FieldData><DataArray type=\"Int8\" format=\"ascii\">1 2 3</DataArray></FieldData>\
         <Piece Extent=\"0 {} -1 {} 10 {}\"><PointData Vectors='v' Scalars='s'><DataArray type=\"UInt8\" Name=\"other\" \
         format=\"ascii\">9 9 9</DataArray>\n<DataArray type=\"{}\" Name=\"s\" format=\"{format}\">",
        8 * style.word_bytes,
        x - 1,
        y - 2,
        z + 9,
        x - 1,
        y - 2,
        z + 9,
        type_of(samples.sample),
    );
    let tail = b"</DataArray></PointData><CellData></CellData></Piece></ImageData>";
    [head.as_bytes(), &content, tail, &appended, b"</VTKFile>"].concat()
}

#[test]
fn samples_come_back_however_they_are_packed() {
    for samples in every_kind() {
        for style in styles() {
            let what = format!("{:?} {:?} {style:?}", samples.sample, samples.endian);
            let file = file(&samples, style);
            let mut volume = parse_volume(&file).unwrap_or_else(|error| panic!("{what}: {error}"));
            samples.check(&mut volume, &what);
            assert_eq!(volume.shape().spacing, [0.5, 0.25, 3.0]);
            assert_eq!(volume.shape().origin, [1.0, 1.75, 33.0], "the first sample of the extent");
        }
    }
}

#[test]
fn samples_in_text_come_back() {
    let text = GOOD.replace("LittleEndian", "BigEndian");
    let mut volume = parse_volume(text.as_bytes()).expect("readable");
    let mut samples = [0.0; 8];
    volume.read_samples(0, &mut samples).expect("eight numbers");
    assert_eq!(samples, [0.0, 1.0, 2.5, -3.0, 4e10, f32::INFINITY, 6.0, 7.0]);
}

#[test]
fn the_first_array_of_one_number_is_taken_when_none_is_named() {
    let other =
        "<DataArray type='Float32' NumberOfComponents='3' format='ascii'>1 2 3</DataArray><DataArray ";
    let file = GOOD.replacen("<DataArray ", other, 1);
    let mut volume = parse_volume(file.as_bytes()).expect("readable");
    let mut first = [0.0; 2];
    volume.read_samples(1, &mut first).expect("readable");
    assert_eq!(first, [1.0, 2.5]);
}

const GOOD: &str = "<VTKFile type='ImageData' byte_order='LittleEndian'><ImageData WholeExtent='0 1 0 1 0 1' \
                    Origin='0 0 0' Spacing='1 1 1'><Piece Extent='0 1 0 1 0 1'><PointData><DataArray type='Float32' \
                    format='ascii'>\n0 1\n2.5 -3 4e10 inf 6 7</DataArray></PointData></Piece></ImageData></VTKFile>";

#[test]
fn broken_headers_are_refused_in_one_line() {
    let cases = [
        (
            "'ImageData'",
            "'UnstructuredGrid'",
            "VTK data of type \"UnstructuredGrid\" is not read; give ImageData",
        ),
        ("'LittleEndian'", "'Middle'", "byte_order: \"Middle\" is not LittleEndian or BigEndian"),
        ("byte_order", "header_type='UInt16' byte_order", "header_type: \"UInt16\" is not UInt32 or UInt64"),
        (
            "byte_order",
            "compressor='vtkLZ4DataCompressor' byte_order",
            "compressor vtkLZ4DataCompressor is not read; save with zlib or none",
        ),
        ("WholeExtent='0 1 0 1 0 1' ", "", "image in several pieces"),
        (
            "WholeExtent='0 1 0 1 0 1'",
            "WholeExtent='0 1 0 1'",
            "WholeExtent: \"0 1 0 1\" is not first and last",
        ),
        ("'0 1 0 1 0 1'", "'0 1 0 1 0 3'", "an image in several pieces is not read; save it in one"),
        (
            "Spacing='1 1 1'",
            "Spacing='1 1 0'",
            "spacing: \"[1.0, 1.0, 0.0]\" is not three finite numbers above 0",
        ),
        ("Origin='0 0 0'", "Origin='0 0 nan'", "origin: "),
        ("<PointData>", "<CellData>", "does not say any array of point data; cell data are not read"),
        ("'Float32'", "'Int64'", "type: \"Int64\" is not one of Int8 to UInt32"),
        ("'Float32'", "'Float32' NumberOfComponents='3'", "an array of 3 numbers a sample is not read"),
        ("'Float32'", "'Float32' NumberOfComponents='x'", "NumberOfComponents: \"x\" is not a number"),
        ("'ascii'", "'lossy'", "format: \"lossy\" is not ascii, binary or appended"),
        ("'ascii'", "'appended'", "offset: \"\" is not a number of bytes"),
        ("'ascii'", "'appended' offset='0'", "does not say where AppendedData begin"),
        ("'ascii'", "'binary'", "samples: "),
        ("2.5", "two", "samples: cannot be decoded (\"two\" is no f32)"),
        (" 6 7", "", "samples: the file ends after 24 of 32 bytes"),
        ("type='ImageData'", "type='ImageData' type='ImageData'", "this makes no sense"),
        ("<Piece Extent", "<Piece & Extent", "this makes no sense"),
    ];
    for (from, to, message) in cases {
        let file = GOOD.replacen(from, to, 1);
        assert_ne!(file, GOOD);
        let read = parse_volume(file.as_bytes()).and_then(|mut volume| read_all(&mut volume));
        assert_refused(read, message, to);
    }
    for extent in ["0 -1 0 1 0 1", "-9223372036854775808 9223372036854775807 0 1 0 1"] {
        let file = GOOD.replace("0 1 0 1 0 1", extent);
        assert_refused(parse_volume(file.as_bytes()).map(|_| ()), "WholeExtent: ", extent);
    }
    let file = GOOD.replace("0 1 0 1 0 1", "0 4294967295 0 4294967295 0 1");
    assert_refused(parse_volume(file.as_bytes()).map(|_| ()), "more samples than 63 bits", "large");
}

#[test]
fn numbers_before_the_samples_that_lie_are_refused() {
    let samples = Samples::new(SampleType::U8, Endian::Little, [5, 5, 5], 1);
    let raw = Style { is_appended: true, is_base64: false, is_zlib: false, word_bytes: 8 };
    for style in [raw, Style { is_zlib: true, ..raw }] {
        let file = file(&samples, style);
        let begin = file.windows(5).position(|window| window == b"_junk").expect("appended") + 5;
        let numbers = if style.is_zlib { 3 } else { 1 };
        for (number, lie) in
            (0..numbers).flat_map(|number| [0, 1, u64::MAX, 1 << 40].map(|lie| (number, lie)))
        {
            let mut file = file.clone();
            file[begin + 8 * number..][..8].copy_from_slice(&lie.to_le_bytes());
            let read = parse_volume(&file).and_then(|mut volume| read_all(&mut volume));
            assert_refused(read, "samples: ", &format!("{style:?} {number} {lie}"));
        }
    }
}
