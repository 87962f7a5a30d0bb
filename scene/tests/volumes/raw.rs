//! Raw files by name and by sidecar, and names of volumes.

use super::*;

#[test]
fn names_describe_files() {
    let folder = Folder::new("raw-names");
    let samples = Samples::new(SampleType::I16, Endian::Big, [4, 5, 6], 1);
    let path = folder.file("a.raw", &[b"head", samples.bytes.as_slice(), b"tail!"].concat());
    let name = format!(
        "raw:{}?dims=4x5x6&type=i16&endian=big&spacing=1x0.5x2.5&origin=-1x0x1e3&skip=4",
        path.display()
    );
    let mut volume = open_name(&name).expect("readable");
    samples.check(&mut *volume, &name);
    let shape = volume.shape();
    assert_eq!((shape.spacing, shape.origin), ([1.0, 0.5, 2.5], [-1.0, 0.0, 1000.0]));
    assert_eq!(shape.notes, [Note::Trailing { bytes: 5 }]);
}

#[test]
fn sidecars_describe_files() {
    let folder = Folder::new("sidecars");
    let samples = Samples::new(SampleType::F32, Endian::Little, [4, 5, 6], 1);
    folder.file("b.raw.gz", &gzip(&samples.bytes));
    let json = r#"{"file": "b.raw.gz", "compression": "gzip", "dims": [4, 5, 6], "dtype": "f32", "endian": "little",
        "spacing": [1, 1, 2], "isovalues": [{"value": 3}], "note": "whatever else"}"#;
    let json = folder.file("b.json", json.as_bytes());
    for path in [json, folder.0.join("b.raw.gz")] {
        let mut volume = open_file(&path).expect("readable");
        samples.check(&mut volume, &path.display().to_string());
        assert_eq!(volume.shape().spacing, [1.0, 1.0, 2.0]);
    }
}

#[test]
fn broken_names_and_sidecars_are_refused_in_one_line() {
    let folder = Folder::new("raw-broken");
    let short = folder.file("short.raw", &[0; 10]);
    let cut = folder.file("cut.raw.gz", &gzip(&[7; 1000])[..15]);
    let not_gz = folder.file("not.raw.gz", &[7; 1000]);
    folder.file("alone.raw", &[0; 10]);
    let short = short.display();
    let cases = [
        ("raw:a.raw", "does not say dims and type, as in raw:FILE?dims=256x256x128&type=u8"),
        ("raw:?dims=1x1x1&type=u8", "does not say which file"),
        ("raw:a?type=u8", "does not say dims, as in dims=256x256x128"),
        ("raw:a?dims=1x1x1", "does not say type, as in type=u8"),
        ("raw:a?dims=1x1&type=u8", "dims=1x1: \"1x1\" is not three numbers of samples such as 256x256x128"),
        ("raw:a?dims=1x1x-1&type=u8", "dims=1x1x-1: \"1x1x-1\" is not three numbers of samples"),
        ("raw:a?dims=1x0x1&type=u8", "dimensions: an axis has no samples"),
        ("raw:a?dims=4294967296x4294967296x2&type=u8", "are more samples than 63 bits can address"),
        ("raw:a?dims=99999999999999999999x1x1&type=u8", "is not three numbers of samples"),
        ("raw:a?dims=1x1x1&type=u64", "type=u64: \"u64\" is not one of u8, i8, u16"),
        ("raw:a?dims=1x1x1&type=u8&type=u8", "type=u8: declared twice: \"type\""),
        ("raw:a?dims=1x1x1&type=u8&endian=middle", "\"middle\" is not little or big"),
        (
            "raw:a?dims=1x1x1&type=u8&spacing=0x1x1",
            "spacing: \"[0.0, 1.0, 1.0]\" is not three finite numbers above 0",
        ),
        ("raw:a?dims=1x1x1&type=u8&spacing=nanx1x1", "is not three finite numbers above 0"),
        ("raw:a?dims=1x1x1&type=u8&origin=infx1x1", "is not three finite numbers"),
        ("raw:a?dims=1x1x1&type=u8&skip=-1", "\"-1\" is not a number of bytes"),
        ("raw:a?dims=1x1x1&type=u8&shape=1", "shape=1: \"shape\" is not one of dims=, type=, endian="),
        ("raw:a?dims=1x1x1&type=u8&", "\"\" is not one of dims="),
        ("raw:nowhere?dims=1x1x1&type=u8", "cannot read nowhere, which has the samples: No such file"),
        (&format!("raw:{short}?dims=3x3x3&type=u8"), "samples: the file ends after 10 of 27 bytes"),
        (&format!("raw:{short}?dims=1x1x1&type=u8&skip=11"), "samples: the file ends after 0 of 1 bytes"),
        (&format!("raw:{short}?dims=3x3x1&type=u8&skip=18446744073709551615"), "the file ends after 0 of 9"),
        (&format!("raw:{}?dims=10x10x10&type=u8", cut.display()), "samples: the file ends after"),
        (
            &format!("raw:{}?dims=10x10x10&type=u8", not_gz.display()),
            "cannot be decoded (invalid gzip header)",
        ),
        (&format!("{}/alone.raw", folder.0.display()), "does not say its dims and type; give raw:FILE?dims="),
        ("nowhere.raw", "cannot read the file: No such file"),
        ("gyroid:1", "gyroid:1: \"1\" is not a number of samples along an axis from 2 to 1321122"),
        ("ml:many", "ml:many: \"many\" is not a number of samples"),
        ("gyroid:", "gyroid:: \"\" is not a number of samples"),
        ("mesh.ply", "not a volume that can be read: give an NRRD, NIfTI or VTI file"),
    ];
    for (name, message) in cases {
        assert_refused(open_name(name).and_then(|mut volume| read_all(&mut *volume)), message, name);
    }
    let jsons = [
        ("", "line 1: this makes no sense: \"EOF while parsing a value\""),
        ("{\"file\": \"a\",\n\"dims\": [1, 2]}", "line 2: this makes no sense: \"invalid length 2"),
        ("{\"file\": \"a\"}", "missing field `dims`"),
        ("{\"file\": \"a\", \"dims\": [1,1,1], \"dtype\": \"u7\"}", "dtype: \"u7\" is not one of u8"),
        (
            "{\"file\": \"a\", \"dims\": [1,1,1], \"dtype\": \"u8\", \"compression\": \"xz\"}",
            "\"xz\" is not none or gzip",
        ),
        ("{\"file\": \"a\", \"dims\": [1,1,0], \"dtype\": \"u8\"}", "an axis has no samples"),
        ("{\"file\": \"a\", \"dims\": [1,1,1], \"dtype\": \"u8\", \"spacing\": [1,1,-1]}", "spacing:"),
        (
            "{\"file\": \"gone\", \"dims\": [1,1,1], \"dtype\": \"u8\"}",
            "gone, which has the samples: No such file",
        ),
    ];
    for (json, message) in jsons {
        let path = folder.file("c.json", json.as_bytes());
        assert_refused(open_file(&path).map(|_| ()), message, json);
    }
}

proptest! {
    #[test]
    fn any_dims_type_and_order_come_back(
        dims in [1..20_u64, 1..20_u64, 1..20_u64],
        sample in proptest::sample::select(SampleType::ALL.to_vec()),
        big: bool,
        compressed: bool,
        skip in 0..9_usize,
        seed in 0..u64::MAX / 2,
    ) {
        let endian = if big { Endian::Big } else { Endian::Little };
        let samples = Samples::new(sample, endian, dims, seed);
        let folder = Folder::new("raw-any");
        let body = if compressed { gzip(&samples.bytes) } else { samples.bytes.clone() };
        let path = folder.file("any.raw", &[&vec![0xa5; skip], body.as_slice()].concat());
        let [x, y, z] = dims;
        let name = format!(
            "raw:{}?dims={x}x{y}x{z}&type={sample}&endian={}&skip={skip}&compression={}",
            path.display(), name_of(endian), if compressed { "gzip" } else { "none" }
        );
        samples.check(&mut *open_name(&name).expect("readable"), &name);
    }
}
