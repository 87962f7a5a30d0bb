//! NRRD files.

use super::*;

const fn type_of(sample: SampleType) -> &'static str {
    match sample {
        SampleType::U8 => "unsigned char",
        SampleType::I8 => "int8",
        SampleType::U16 => "ushort",
        SampleType::I16 => "signed short int",
        SampleType::U32 => "uint32_t",
        SampleType::I32 => "int",
        SampleType::F32 => "float",
        SampleType::F64 => "double",
    }
}

/// A header with an encoding and further lines, without the blank line at the end.
fn header(samples: &Samples, encoding: &str, further: &str) -> String {
    let ([x, y, z], sample, endian) = (samples.dims, type_of(samples.sample), name_of(samples.endian));
    format!(
        "NRRD0004\n# a comment: with a colon\ntype: {sample}\ndimension: 3\nsizes: {x} {y} {z}\n\
         encoding: {encoding}\nendian: {endian}\nname:=some: value\n{further}"
    )
}

#[test]
fn attached_samples_come_back_raw_and_compressed() {
    for samples in every_kind() {
        let what = format!("{:?} {:?}", samples.sample, samples.endian);
        let file = |encoding, body: &[u8]| [header(&samples, encoding, "\n").as_bytes(), body].concat();
        let raw = parse_volume(&file("raw", &samples.bytes));
        samples.check(&mut raw.expect("readable"), &what);
        for encoding in ["gzip", "GZ"] {
            let volume = parse_volume(&file(encoding, &gzip(&samples.bytes)));
            samples.check(&mut volume.expect("readable"), &what);
        }
    }
}

#[test]
fn samples_in_text_come_back_and_need_no_order_of_bytes() {
    for samples in every_kind() {
        let text: Vec<String> = samples.numbers.iter().map(|number| format!("{number:?}")).collect();
        let whole = |number: &String| number.trim_end_matches(".0").to_owned();
        let is_float = matches!(samples.sample, SampleType::F32 | SampleType::F64);
        let text: Vec<String> = if is_float { text } else { text.iter().map(whole).collect() };
        // Single precision does not hold every number of 32 bits.
        let exact = !matches!(samples.sample, SampleType::U32 | SampleType::I32);
        let header = header(&samples, "ascii", "\n").replace("endian: big\n", "");
        let volume = parse_volume(format!("{header}{}", text.join(" \n")).as_bytes());
        if exact {
            samples.check(&mut volume.expect("readable"), samples.sample.name());
        }
    }
}

#[test]
fn detached_samples_come_back_behind_skipped_lines_and_bytes() {
    let folder = Folder::new("nrrd-detached");
    let samples = Samples::new(SampleType::U16, Endian::Little, [6, 5, 4], 3);
    let skipped = [b"one\ntwo\nxyz".as_slice(), &samples.bytes].concat();
    let compressed = [b"one\ntwo\n".as_slice(), &gzip(&[b"xyz", samples.bytes.as_slice()].concat())].concat();
    folder.file("plain.raw", &samples.bytes);
    folder.file("skipped.raw", &skipped);
    folder.file("compressed.raw.gz", &compressed);
    let cases = [
        ("raw", "data file: plain.raw\n"),
        ("raw", "datafile: ./plain.raw\r\n\r\n"),
        ("raw", "data file: plain.raw"),
        ("raw", "data file: skipped.raw\nline skip: 2\nbyte skip: 3\n"),
        ("raw", "data file: skipped.raw\nbyteskip: -1\n"),
        ("gzip", "data file: compressed.raw.gz\nline skip: 2\nbyte skip: 3\n"),
    ];
    for (encoding, further) in cases {
        let path = folder.file("volume.nhdr", header(&samples, encoding, further).as_bytes());
        let mut volume = open_file(&path).unwrap_or_else(|error| panic!("{further}: {error}"));
        samples.check(&mut volume, further);
    }
}

#[test]
fn spacing_and_origin_are_taken_from_where_they_are() {
    let samples = Samples::new(SampleType::U8, Endian::Little, [2, 3, 4], 3);
    let upright = "space: left-posterior-superior\nspace directions: (0.5,0,0) (0,0.25, 0) ( 0,0,3)\n";
    let turned = "space directions: (0,3,4) (-2,0,0) (0,0,1)\nspace origin: (7,8,-9)\n";
    type Placed<'n> = ([f64; 3], [f64; 3], &'n [Note]);
    let cases: [(&str, Placed<'_>); 7] = [
        ("", ([1.0; 3], [0.0; 3], &[Note::NoSpacing])),
        ("spacings: 0.5 0.25 3\n", ([0.5, 0.25, 3.0], [0.0; 3], &[])),
        ("spacings: 0.5 nan 3\n", ([0.5, 1.0, 3.0], [0.0; 3], &[Note::NoSpacing])),
        ("spacings: 0.5 0.25 -3\n", ([0.5, 0.25, 3.0], [0.0; 3], &[Note::Orientation])),
        (upright, ([0.5, 0.25, 3.0], [0.0; 3], &[])),
        (turned, ([5.0, 2.0, 1.0], [7.0, 8.0, -9.0], &[Note::Orientation])),
        ("Space Origin: (7,8,-9)\nspacings: 1 1 1\n", ([1.0; 3], [7.0, 8.0, -9.0], &[])),
    ];
    for (further, placed) in cases {
        let file = [header(&samples, "raw", further).as_bytes(), b"\n", &samples.bytes].concat();
        let volume = parse_volume(&file).unwrap_or_else(|error| panic!("{further}: {error}"));
        let shape = volume.shape();
        assert_eq!((shape.spacing, shape.origin, shape.notes.as_slice()), placed, "{further}");
    }
}

#[test]
fn axes_of_one_sample_are_left_out() {
    let samples = Samples::new(SampleType::U8, Endian::Little, [2, 3, 4], 3);
    for (sizes, spacings) in [("2 3 4 1", "1 2 3 nan"), ("1 2 3 4", "nan 1 2 3"), ("2 3 1 4", "1 2 nan 3")] {
        let header = header(&samples, "raw", &format!("spacings: {spacings}\n\n"))
            .replace("dimension: 3\nsizes: 2 3 4", &format!("dimension: 4\nsizes: {sizes}"));
        let mut volume = parse_volume(&[header.as_bytes(), &samples.bytes].concat()).expect("readable");
        samples.check(&mut volume, sizes);
        assert_eq!(volume.shape().spacing, [1.0, 2.0, 3.0], "{sizes}");
    }
}

#[test]
fn broken_files_are_refused_in_one_line() {
    let good = "NRRD0005\ntype: short\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nendian: little\n\n0123456789abcdef";
    assert!(parse_volume(good.as_bytes()).is_ok());
    let cases = [
        ("NRRD0005", "NRRD0006", "line 1: NRRD0006 is not read; save it as NRRD0001 to NRRD0005"),
        ("\n\n", "\n", "line 7: this makes no sense: \"0123456789abcdef\""),
        ("\n\n0123456789abcdef", "\n", "line 7: the header does not end"),
        ("type: short", "type: block", "line 2: \"block\" is not a type that is read"),
        ("type: short\n", "", "does not say the type of its samples"),
        ("type: short", "type short", "line 2: this makes no sense: \"type short\""),
        ("type: short", "type: short\nTYPE: short", "line 3: declared twice: \"TYPE\""),
        ("dimension: 3\n", "", "does not say its dimension"),
        ("dimension: 3", "dimension: three", "line 3: \"three\" is not a number of axes"),
        ("dimension: 3", "dimension: 4", "line 4: \"2 2 2\" is not a number for each axis"),
        ("dimension: 3\nsizes: 2 2 2", "dimension: 2\nsizes: 2 4", "line 4: an array of 2 axes is not read"),
        (
            "dimension: 3\nsizes: 2 2 2",
            "dimension: 4\nsizes: 3 2 2 2",
            "line 4: an array of 4 axes is not read",
        ),
        ("sizes: 2 2 2\n", "", "does not say its sizes"),
        ("sizes: 2 2 2", "sizes: 2 2 two", "line 4: \"2 2 two\" is not a number for each axis"),
        ("sizes: 2 2 2", "sizes: 2 2 0", "dimensions: an axis has no samples"),
        (
            "sizes: 2 2 2",
            "sizes: 4294967296 4294967296 4294967296",
            "are more samples than 63 bits can address",
        ),
        ("sizes: 2 2 2", "sizes: 2 2 3", "samples: the file ends after 16 of 24 bytes"),
        ("sizes: 2 2 2", "sizes: 2097152 2097152 1000000", "samples: the file ends after 16 of"),
        ("encoding: raw\n", "", "does not say its encoding"),
        (
            "encoding: raw",
            "encoding: bzip2",
            "line 5: encoding \"bzip2\" is not read; save it as raw, gzip or ascii",
        ),
        ("encoding: raw", "encoding: hex", "line 5: encoding \"hex\" is not read"),
        ("encoding: raw", "encoding: gzip", "samples: cannot be decoded (invalid gzip header)"),
        ("encoding: raw", "encoding: ascii", "samples: cannot be decoded (\"0123456789abcdef\" is no i16)"),
        ("endian: little\n", "", "does not say endian: little or big"),
        ("endian: little", "endian: middle", "line 6: \"middle\" is not little or big"),
        (
            "endian: little",
            "endian: little\nbyte skip: -2",
            "line skip, byte skip: \"0 lines, -2 bytes\" is not",
        ),
        ("endian: little", "endian: little\nline skip: 9", "line skip: the header does not end"),
        ("endian: little", "endian: little\nbyte skip: 9223372036854775807", "ends after 0 of 16 bytes"),
        ("endian: little", "endian: little\nspacings: 1 1 0", "spacing: \"[1.0, 1.0, 0.0]\" is not"),
        (
            "endian: little",
            "endian: little\nspacings: 1 one 1",
            "line 7: \"1 one 1\" is not a distance for each",
        ),
        ("endian: little", "endian: little\nspace directions: (1,0", "line 7: \"(1,0\" is not a vector such"),
        (
            "endian: little",
            "endian: little\nspace directions: (0,0,0) none none",
            "spacing: \"[0.0, 1.0, 1.0]\"",
        ),
        ("endian: little", "endian: little\nspace origin: (1,inf,0)", "origin: \"[1.0, inf, 0.0]\" is not"),
        (
            "endian: little",
            "endian: little\ndata file: LIST",
            "line 7: data file \"LIST\", a list of files, is not",
        ),
        ("endian: little", "endian: little\ndata file: a%03d.raw 1 9 1", "a list of files, is not read"),
        ("endian: little", "endian: little\ndata file: gone.raw", "a header in memory whose samples are in"),
    ];
    for (from, to, message) in cases {
        let file = good.replacen(from, to, 1);
        let read = parse_volume(file.as_bytes()).and_then(|mut volume| read_all(&mut volume));
        assert_refused(read, message, to);
    }
    let folder = Folder::new("nrrd-broken");
    let path = folder.file("a.nhdr", good.replace("\n\n", "\ndata file: gone.raw\n\n").as_bytes());
    assert_refused(open_file(&path).map(|_| ()), "gone.raw, which has the samples: No such file", "gone");
    let path = folder.file("a.nhdr", good.replace("\n\n", "\ndata file: .\n\n").as_bytes());
    assert_refused(open_file(&path).map(|_| ()), "which has the samples: Is a directory", "folder");
}
