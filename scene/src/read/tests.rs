use super::*;

fn ply(header: &str, body: &[u8]) -> Result<Mesh, ReadError> {
    let bytes = [b"ply\n", header.as_bytes(), b"end_header\n", body].concat();
    parse_mesh(&bytes, None)
}

fn message(result: Result<Mesh, ReadError>) -> String {
    result.expect_err("a refused file").to_string()
}

const TRIANGLE: &str = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

fn ascii(vertices: &str, faces: &str) -> String {
    format!(
        "format ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {faces}\nproperty list uchar int vertex_indices\n"
    )
}

#[test]
fn header_lines_may_end_in_any_way_even_before_binary_data_that_begins_with_a_line_feed() {
    // The first coordinate's first byte is 0x0a.
    let x = f32::from_bits(0x3f80_000a);
    let body: Vec<u8> = [x, 2.0, 3.0].into_iter().flat_map(f32::to_le_bytes).collect();
    let lines = [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 1",
        "property float x",
        "property float y",
        "property float z",
    ];
    for (line_end, last_end) in [("\n", "\n"), ("\r\n", "\r\n"), ("\r", "\r"), ("\n", "\r\n"), ("\r", "\n")] {
        let header: String = lines.iter().map(|line| format!("{line}{line_end}")).collect();
        let bytes = [header.as_bytes(), b"end_header", last_end.as_bytes(), &body].concat();
        let mesh =
            parse_mesh(&bytes, None).unwrap_or_else(|error| panic!("{line_end:?} {last_end:?}: {error}"));
        assert_eq!(mesh.positions, [[x, 2.0, 3.0]], "{line_end:?} {last_end:?}");
    }
}

#[test]
fn ascii_lines_may_end_in_carriage_returns_and_be_blank() {
    for end in ["\r", "\r\n", "\n\n", " \t\n"] {
        let mesh = ply(&ascii("3", "1"), TRIANGLE.replace('\n', end).as_bytes()).expect("readable");
        assert_eq!((mesh.positions.len(), mesh.triangles.as_slice()), (3, &[[0, 1, 2]][..]), "{end:?}");
    }
}

#[test]
fn all_types_and_both_endiannesses_are_read() {
    let names =
        [("char", "int8"), ("uchar", "uint8"), ("short", "int16"), ("ushort", "uint16"), ("int", "int32")];
    let bytes_of = |name: &str, value: u8, big: bool| {
        let length = match name {
            "char" | "int8" | "uchar" | "uint8" => 1,
            "short" | "int16" | "ushort" | "uint16" => 2,
            _ => 4,
        };
        let mut bytes = vec![0; length];
        bytes[if big { length - 1 } else { 0 }] = value;
        bytes
    };
    for name in names.into_iter().flat_map(|(old, new)| [old, new]).chain(["uint", "uint32"]) {
        for (encoding, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
            let header = format!(
                "format {encoding} 1.0\nelement vertex 3\nproperty {name} x\nproperty {name} y\nproperty {name} z\n\
                 property list uchar double weights\nelement face 1\nproperty list {name} {name} vertex_index\n"
            );
            let vertex = |v: [u8; 3]| [v.map(|x| bytes_of(name, x, big)).concat(), vec![0]].concat();
            let face = [3, 2, 1, 0].map(|i| bytes_of(name, i, big)).concat();
            let body = [vertex([1, 2, 3]), vertex([4, 5, 6]), vertex([7, 8, 9]), face].concat();
            let mesh = ply(&header, &body).unwrap_or_else(|error| panic!("{name} {encoding}: {error}"));
            assert_eq!(
                mesh.positions,
                [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]],
                "{name} {encoding}"
            );
            assert_eq!(mesh.triangles, [[2, 1, 0]], "{name} {encoding}");
        }
    }
}

#[test]
fn headers_that_lie_about_counts_cost_no_memory_and_no_time() {
    let huge = "1000000000000000000";
    let vertices_alone = ascii(huge, "0").split_once("element face").expect("has faces").0.to_owned();
    let truncated = "vertex 1 of 1000000000000000000: the file ends here";
    assert!(message(ply(&vertices_alone, b"0 0 0\n")).starts_with(truncated));
    assert_eq!(message(ply(&ascii(huge, "0"), b"0 0 0\n")), "more vertices than 32-bit indices can name");
    assert!(
        message(ply(&ascii("3", huge), TRIANGLE.as_bytes())).starts_with("face 1 of 1000000000000000000")
    );
    let empty_element =
        format!("format binary_little_endian 1.0\nelement nothing {huge}\n{}", vertex_and_face("int"));
    assert!(message(ply(&empty_element, &[])).starts_with("vertex 0 of 1"));
    let lists = "format binary_little_endian 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n\
                 element face 1\nproperty list int int vertex_indices\n";
    for length in [i32::MAX, -1] {
        assert!(ply(lists, &length.to_le_bytes()).is_err());
    }
    let too_long = "99999999999999999999999999999999999999";
    assert!(ply(&ascii(too_long, "0"), b"").is_err());
}

/// Declarations of one vertex and one face with indices of a type.
fn vertex_and_face(index: &str) -> String {
    format!(
        "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
         property list uchar {index} vertex_indices\n"
    )
}

#[test]
fn broken_files_are_refused_in_one_line_that_says_where() {
    let cases: [(String, &str, &str); 12] = [
        (
            ascii("3", "1"),
            "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
            "face 0 of 1: index 3 names no vertex; there are 3",
        ),
        (ascii("3", "1"), "0 0 0\n1 0 0\n0 1 0\n3 0 -1 2\n", "face 0 of 1: index -1 names no vertex"),
        (ascii("3", "1"), "0 0 0\n1 0 0\n0 1 0\n3 0 1.5 2\n", "face 0 of 1: not the numbers"),
        (ascii("3", "1"), "0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n", "vertex 1 of 3: not the numbers"),
        (ascii("3", "1"), "0 0 0\n1e39 0 0\n0 1 0\n3 0 1 2\n", "vertex 1 of 3: a coordinate is not finite"),
        (ascii("3", "1"), "0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "vertex 1 of 3: not the numbers"),
        (ascii("3", "1"), "0 0 0\n1 0 0\n", "vertex 2 of 3: the file ends here"),
        (ascii("3", "1").replace("float y", "float q"), TRIANGLE, "declares no coordinates"),
        (
            ascii("3", "1").replace("vertex_indices", "corners"),
            TRIANGLE,
            "declares no list of vertex indices",
        ),
        (ascii("3", "1").replace("list uchar int", "list uchar float"), TRIANGLE, "must be whole numbers"),
        (ascii("3", "1").replace("float y", "float x"), TRIANGLE, "line 5: declared twice"),
        (
            ascii("3", "1").replace("float y", "half y"),
            TRIANGLE,
            "this header line makes no sense: \"property half y\"",
        ),
    ];
    for (header, body, expected) in cases {
        let message = message(ply(&header, body.as_bytes()));
        assert!(message.contains(expected), "{message:?} for {expected:?}");
        assert!(!message.contains('\n'), "{message:?}");
    }
    assert_eq!(
        message(parse_mesh(b"ply\nformat ascii 1.0\n", None)),
        "line 3: the header has no end_header line"
    );
    assert_eq!(
        message(parse_mesh(b"solid cube", None)),
        "not a mesh that can be read: give a PLY or OBJ file"
    );
    assert_eq!(message(ply("element vertex 0\n", b"")), "the header has no format line");
}

#[test]
fn a_binary_coordinate_that_is_no_number_is_refused() {
    let header = "format binary_big_endian 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
    let body: Vec<u8> = [0.0, f64::NAN, 0.0].into_iter().flat_map(f64::to_be_bytes).collect();
    assert_eq!(
        message(ply(header, &body)),
        "vertex 0 of 1: a coordinate is not finite, or too large for a 32-bit float"
    );
}

#[test]
fn what_stands_behind_the_faces_is_not_looked_at() {
    let header = ascii("3", "1") + "element camera 5\nproperty float focal\n";
    assert_eq!(ply(&header, TRIANGLE.as_bytes()).expect("readable").triangles.len(), 1);
}

fn obj(text: &str) -> Result<Mesh, ReadError> {
    parse_mesh(text.as_bytes(), Some(Format::Obj))
}

#[test]
fn obj_records_other_than_vertices_and_faces_are_skipped() {
    let text = "# comment\nmtllib a\u{e4}.mtl\no thing\nv 0 0 0 1 0 0\nv 1 0 0 1\nv 0 1 0\nv 1 1 0\nvt 0 0\nvn 0 0 1\n\
                l 1 2 3\np 1 2 3\nf 1/1/1 2//1 \\\n 4/1\nf -4 -2 -1\ng x\nusemtl y\nf 1 2";
    let mesh = obj(text).expect("readable");
    assert_eq!((mesh.positions.len(), mesh.triangles), (4, vec![[0, 1, 3], [0, 2, 3]]));
    let latin_1 = b"# caf\xe9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(parse_mesh(latin_1, None).expect("readable").triangles.len(), 1);
}

#[test]
fn obj_faces_may_come_before_their_vertices() {
    assert_eq!(obj("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\n").expect("readable").triangles, [[0, 1, 2]]);
}

#[test]
fn broken_obj_files_are_refused_with_their_line() {
    let cases = [
        ("v 0 0\n", "line 1: not the numbers that belong here"),
        ("v 0 0 0\nv 0 inf 0\n", "line 2: a coordinate is not finite, or too large for a 32-bit float"),
        ("v 0 0 0\nf 1 1 0\n", "line 2: index 0 names no vertex; there are 1"),
        ("v 0 0 0\nf 1 1 -2\n", "line 2: index -2 names no vertex; there are 1"),
        ("v 0 0 0\nf 1 1 9\nv 1 1 1\n", "line 2: index 9 names no vertex; there are 2"),
        ("v 0 0 0\nf 1 1 9223372036854775808\n", "line 2: not the numbers that belong here"),
        (
            "v 0 0 0\nf 1 1 -9223372036854775808\n",
            "line 2: index -9223372036854775808 names no vertex; there are 1",
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(message(obj(text)), expected);
    }
}

#[test]
fn polygons_become_fans() {
    let mut triangles = Vec::new();
    append_fan(&[5, 6, 7, 8], &mut triangles);
    append_fan(&[1, 2], &mut triangles);
    append_fan(&[], &mut triangles);
    assert_eq!(triangles, [[5, 6, 7], [5, 7, 8]]);
}
