use super::*;
use crate::volume::SampleKind;

fn header() -> Header {
    Header {
        page_bytes: 4096,
        image_bytes: 9 * 4096,
        needs: SceneNeeds::KNOWN,
        triangles: 100,
        spheres: 20,
        collapsed: 1,
        repeated: 0,
        vertices: 50,
        primitives: 101,
        branches: 3,
        leaves: 7,
        clusters: 6,
        volume: Some(Volume {
            dims: [9, 300, 2],
            sample: SampleKind::U16,
            levels: 3,
            origin: [-1.0, 0.0, 1.0e-3],
            spacing: [0.1, 0.01, 1.0e-7],
            slope: -2.0,
            intercept: 7.0,
            low: 1.0,
            high: 60_000.0,
            branches: 2,
            bricks: 3,
        }),
        bounds: Bounds { low: Vec3::ZERO, high: Vec3::ONE },
        view: Bounds { low: Vec3::NEG_ONE, high: Vec3::ONE },
        grid: GridShape { origin: Vec3::ZERO, size: 1.0, slack: 0.01, levels: 2 },
        typical_edge: 0.02,
        scale_exponent: 0,
        segments: Segments {
            branches: Segment { offset: 4096, bytes: 96, checksum: 1 },
            leaves: Segment { offset: 2 * 4096, bytes: 112, checksum: 2 },
            clusters: Segment { offset: 3 * 4096, bytes: 8000, checksum: 3 },
            ids: Segment { offset: 5 * 4096, bytes: 404, checksum: 4 },
            table: Segment { offset: 6 * 4096, bytes: TABLE_BYTES as u64, checksum: 5 },
            ranges: Segment { offset: 7 * 4096, bytes: 288, checksum: 6 },
            bricks: Segment { offset: 8 * 4096, bytes: 3072, checksum: 7 },
        },
    }
}

/// Parses a header after `change`, as if the file had been written so.
fn parse_changed(change: impl FnOnce(&mut Header)) -> Result<Header, HeaderError> {
    let mut header = header();
    change(&mut header);
    Header::parse(&header.emit(), 9 * 4096)
}

#[test]
fn emit_and_parse_round_trip() {
    assert_eq!(parse_changed(|_| ()), Ok(header()));
    assert_eq!(Header::parse(&header().emit(), u64::MAX), Ok(header()));
}

#[test]
fn foreign_short_and_corrupt_bytes_are_refused() {
    let bytes = header().emit();
    let needed = HEADER_BYTES;
    assert_eq!(Header::parse(&[], 0), Err(HeaderError::Truncated { needed, got: 0 }));
    assert_eq!(
        Header::parse(&bytes[..needed - 1], 9 * 4096),
        Err(HeaderError::Truncated { needed, got: needed - 1 })
    );
    assert_eq!(Header::parse(&[b'x'; 1100], 1100), Err(HeaderError::NotAnImage));
    assert_eq!(Header::parse(&bytes, 4096), Err(HeaderError::Length { declared: 9 * 4096, got: 4096 }));
    for at in 0..needed {
        let mut bytes = bytes;
        bytes[at] ^= 0x10;
        let error = Header::parse(&bytes, 9 * 4096).expect_err("a flipped bit");
        let expected = match at {
            0..8 => HeaderError::NotAnImage,
            8..12 => HeaderError::Version { found: VERSION ^ (0x10 << (8 * (at - 8))) },
            _ => HeaderError::Checksum,
        };
        assert_eq!(error, expected, "byte {at}");
    }
}

#[test]
fn inconsistent_headers_are_refused_by_name() {
    use SegmentKind::{Branches, Bricks, Ids, Leaves, Ranges, Table};
    fn volume(header: &mut Header) -> &mut Volume {
        header.volume.as_mut().expect("there is one")
    }
    type Case = (fn(&mut Header), HeaderError);
    let cases: [Case; 26] = [
        (|h| h.page_bytes = 5000, HeaderError::PageBytes(5000)),
        (|h| h.page_bytes = 2048, HeaderError::PageBytes(2048)),
        (|h| h.image_bytes = 4097, HeaderError::PageBytes(4096)),
        (|h| h.segments.branches.offset = 0, HeaderError::SegmentPlace(Branches)),
        (|h| h.segments.leaves.offset = 4096, HeaderError::SegmentPlace(Leaves)),
        (|h| h.segments.leaves.offset += 16, HeaderError::SegmentPlace(Leaves)),
        (|h| h.segments.clusters.bytes = 8193, HeaderError::SegmentPlace(Ids)),
        (|h| h.segments.ids.bytes = u64::MAX, HeaderError::SegmentPlace(Ids)),
        (|h| h.branches = 4, HeaderError::SegmentLength(Branches)),
        (|h| h.primitives = 100, HeaderError::SegmentLength(Ids)),
        (|h| h.grid.size = 0.75, HeaderError::Grid("size")),
        (|h| h.grid.size = f32::INFINITY, HeaderError::Grid("size")),
        (|h| h.grid.origin.y = f32::NAN, HeaderError::Grid("origin")),
        (|h| h.grid.levels = 11, HeaderError::Grid("levels")),
        (|h| h.scale_exponent = i32::MIN + 1, HeaderError::Grid("scale")),
        (|h| h.bounds.low.x = 2.0, HeaderError::Grid("bounds")),
        (|h| h.view.high.z = f32::NAN, HeaderError::Grid("view")),
        (|h| volume(h).dims[1] = 0, HeaderError::Grid("volume")),
        (|h| volume(h).dims[2] = u32::MAX, HeaderError::Grid("volume")),
        (|h| volume(h).levels = 4, HeaderError::Grid("volume")),
        (|h| volume(h).spacing[0] = 0.0, HeaderError::Grid("volume")),
        (|h| volume(h).spacing[2] = 1.0e300, HeaderError::Grid("volume")),
        (|h| volume(h).bricks = u64::MAX, HeaderError::Grid("volume")),
        (|h| volume(h).bricks = 4, HeaderError::SegmentLength(Bricks)),
        (|h| volume(h).branches = 3, HeaderError::SegmentLength(Ranges)),
        (|h| h.needs = SceneNeeds::TRIANGLES, HeaderError::SegmentLength(Table)),
    ];
    for (change, expected) in cases {
        assert_eq!(parse_changed(change), Err(expected));
    }
}

#[test]
fn messages_are_one_lower_case_line() {
    let errors = [
        HeaderError::Truncated { needed: 1024, got: 3 },
        HeaderError::Version { found: 9 },
        HeaderError::LeftOut(SceneNeeds::SPHERES),
        HeaderError::Segment(SegmentKind::Ids),
        HeaderError::Grid("size"),
    ];
    for error in errors {
        let text = std::format!("{error}");
        assert!(
            !text.contains('\n') && !text.ends_with('.') && !text.starts_with(char::is_uppercase),
            "{text}"
        );
    }
}
