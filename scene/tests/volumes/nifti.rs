//! NIfTI-1 files.

use super::*;

/// A header by the offsets of nifti1.h.
struct Header {
    bytes: Vec<u8>,
    endian: Endian,
}

impl Header {
    fn new(samples: &Samples, magic: &[u8; 4]) -> Self {
        let mut header = Self { bytes: vec![0; 352], endian: samples.endian };
        let code = match samples.sample {
            SampleType::U8 => 2,
            SampleType::I16 => 4,
            SampleType::I32 => 8,
            SampleType::F32 => 16,
            SampleType::F64 => 64,
            SampleType::I8 => 256,
            SampleType::U16 => 512,
            SampleType::U32 => 768,
        };
        header.put(0, 348_i32.to_be_bytes());
        let dims = samples.dims.map(|dim| i16::try_from(dim).expect("small"));
        for (axis, dim) in [3].into_iter().chain(dims).enumerate() {
            header.put_i16(40 + 2 * axis, dim);
        }
        header.put_i16(70, code);
        header.put_i16(72, i16::try_from(8 * samples.sample.bytes()).expect("small"));
        for (axis, spacing) in [1.0, 0.5, 0.25, 3.0].into_iter().enumerate() {
            header.put_f32(76 + 4 * axis, spacing);
        }
        header.put_f32(108, if magic == b"n+1\0" { 352.0 } else { 0.0 });
        header.bytes[344..348].copy_from_slice(magic);
        header
    }

    fn put<const N: usize>(&mut self, offset: usize, mut big: [u8; N]) {
        if self.endian == Endian::Little {
            big.reverse();
        }
        self.bytes[offset..offset + N].copy_from_slice(&big);
    }

    fn put_i16(&mut self, offset: usize, value: i16) {
        self.put(offset, value.to_be_bytes());
    }

    fn put_f32(&mut self, offset: usize, value: f32) {
        self.put(offset, value.to_be_bytes());
    }
}

#[test]
fn single_files_come_back_plain_and_compressed() {
    for samples in every_kind() {
        let what = format!("{:?} {:?}", samples.sample, samples.endian);
        let file = [Header::new(&samples, b"n+1\0").bytes, samples.bytes.clone()].concat();
        for file in [gzip(&file), file] {
            let mut volume = parse_volume(&file).unwrap_or_else(|error| panic!("{what}: {error}"));
            samples.check(&mut volume, &what);
            assert_eq!(volume.shape().spacing, [0.5, 0.25, 3.0]);
        }
    }
}

#[test]
fn pairs_come_back_by_either_name() {
    let samples = Samples::new(SampleType::I16, Endian::Big, [4, 3, 5], 9);
    let header = Header::new(&samples, b"ni1\0").bytes[..348].to_vec();
    let folder = Folder::new("nifti-pairs");
    let pairs = [
        ("a.hdr", header.clone(), "a.img", samples.bytes.clone()),
        ("b.hdr", header.clone(), "b.img.gz", gzip(&samples.bytes)),
        ("c.hdr.gz", gzip(&header), "c.img.gz", gzip(&samples.bytes)),
    ];
    for (header_name, header, image_name, image) in pairs {
        let names = [(header_name, header), (image_name, image)];
        for path in names.map(|(name, bytes)| folder.file(name, &bytes)) {
            let mut volume = open_file(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            samples.check(&mut volume, header_name);
        }
    }
}

#[test]
fn samples_become_values_by_slope_and_intercept() {
    let samples = Samples::new(SampleType::I16, Endian::Little, [2, 2, 2], 9);
    let line = |slope, intercept| ValueMap { slope, intercept };
    let cases = [
        (0.0, 7.0, line(1.0, 0.0)),
        (0.5, -1024.0, line(0.5, -1024.0)),
        (f32::NAN, 0.0, line(1.0, 0.0)),
        (-2.0, 0.0, line(-2.0, 0.0)),
    ];
    for (slope, intercept, world) in cases {
        let mut header = Header::new(&samples, b"n+1\0");
        header.put_f32(112, slope);
        header.put_f32(116, intercept);
        let volume = parse_volume(&[header.bytes, samples.bytes.clone()].concat()).expect("readable");
        assert_eq!(volume.shape().world, world);
    }
}

#[test]
fn origin_orientation_and_further_volumes_are_noted() {
    let samples = Samples::new(SampleType::U8, Endian::Little, [2, 2, 2], 9);
    let shape = |change: &dyn Fn(&mut Header)| -> VolumeShape {
        let mut header = Header::new(&samples, b"n+1\0");
        change(&mut header);
        let volume = parse_volume(&[header.bytes, samples.bytes.clone()].concat()).expect("readable");
        volume.shape().clone()
    };
    let rows = |header: &mut Header, diagonal: [f32; 3]| {
        header.put_i16(254, 1);
        for (row, value) in diagonal.into_iter().enumerate() {
            header.put_f32(280 + 16 * row + 4 * row, value);
            header.put_f32(280 + 16 * row + 12, 10.0 + f32::from(u8::try_from(row).expect("small")));
        }
    };
    let upright = shape(&|header| rows(header, [0.5, 0.25, 3.0]));
    assert_eq!((upright.origin, upright.notes.as_slice()), ([10.0, 11.0, 12.0], &[][..]));
    let mirrored = shape(&|header| rows(header, [-0.5, 0.25, 3.0]));
    assert_eq!(mirrored.notes, [Note::Orientation]);
    let by_quaternion = shape(&|header| {
        header.put_i16(252, 1);
        header.put_f32(268, -5.0);
    });
    assert_eq!((by_quaternion.origin, by_quaternion.notes.as_slice()), ([-5.0, 0.0, 0.0], &[][..]));
    let turned = shape(&|header| {
        header.put_i16(252, 1);
        header.put_f32(260, 1.0);
    });
    assert_eq!(turned.notes, [Note::Orientation]);
    let several = shape(&|header| {
        header.put_i16(40, 5);
        header.put_i16(48, 10);
        header.put_i16(50, 3);
    });
    assert_eq!(several.notes, [Note::FirstOf { count: 30 }]);
    let unspaced = shape(&|header| header.put_f32(80, 0.0));
    assert_eq!((unspaced.spacing[0], unspaced.notes.as_slice()), (1.0, &[Note::NoSpacing][..]));
}

#[test]
fn broken_headers_are_refused_in_one_line() {
    let samples = Samples::new(SampleType::I16, Endian::Little, [2, 2, 2], 9);
    type Change<'c> = &'c dyn Fn(&mut Header);
    let cases: [(Change<'_>, &str); 14] = [
        (&|header| header.put(0, 540_i32.to_be_bytes()), "NIfTI-2 is not read; save it as NIfTI-1 or NRRD"),
        (&|header| header.bytes[344] = 0, "magic: magic \"\\0+1\\0\" is not read; Analyze 7.5 and others"),
        (
            &|header| header.put_i16(40, 0),
            "dim: \"[0, 2, 2, 2, 0, 0, 0, 0]\" is not a number of axes from 1 to 7",
        ),
        (&|header| header.put_i16(40, 8), "is not a number of axes from 1 to 7"),
        (&|header| header.put_i16(42, -2), "is not a number of axes with 0 or more samples each"),
        (&|header| header.put_i16(42, 0), "dimensions: an axis has no samples"),
        (&|header| header.put_i16(42, i16::MAX), "samples: the file ends after 16 of 262136 bytes"),
        (&|header| header.put_i16(70, 128), "datatype: type 128 (colours) is not read; save 8 to 32 bits"),
        (&|header| header.put_i16(72, 8), "bitpix: \"8\" is not the number of bits that datatype has"),
        (
            &|header| header.put_f32(108, 100.0),
            "vox_offset: \"100\" is not a whole number of bytes behind the header",
        ),
        (&|header| header.put_f32(108, f32::NAN), "vox_offset: \"NaN\" is not"),
        (&|header| header.put_f32(108, 1.0e30), "vox_offset: \"1000000000000000000000000000000\" is not"),
        (
            &|header| header.put_f32(84, f32::INFINITY),
            "spacing: \"[0.5, inf, 3.0]\" is not three finite numbers",
        ),
        (
            &|header| {
                header.put_f32(112, 1.0);
                header.put_f32(116, f32::NAN);
            },
            "scl_inter: \"NaN\" is not a finite number",
        ),
    ];
    for (change, message) in cases {
        let mut header = Header::new(&samples, b"n+1\0");
        change(&mut header);
        let file = [header.bytes, samples.bytes.clone()].concat();
        assert_refused(parse_volume(&file).map(|_| ()), message, message);
    }
    let whole = Header::new(&samples, b"n+1\0").bytes;
    assert_refused(parse_volume(&whole[..347]).map(|_| ()), "the header does not end", "short");
    assert_refused(parse_volume(&gzip(&whole[..347])).map(|_| ()), "the header does not end", "short");
    let pair = Header::new(&samples, b"ni1\0").bytes;
    assert_refused(
        parse_volume(&pair).map(|_| ()),
        "a header in memory whose samples are in another",
        "pair",
    );
    let folder = Folder::new("nifti-alone");
    let alone = folder.file("alone.hdr", &pair);
    assert_refused(open_file(&alone).map(|_| ()), "alone.img, which has the samples: No such file", "alone");
}
