//! Gathering: only what changed travels, as far as credit goes, and several displays put together the same picture.

use memsavvy::report::RunReport;
use tests::{Folder, error_line, render, run, run_well};

/// Bytes that a node may have under way to a display.
const CREDIT: u64 = 128 << 10;

fn hashes(report: &RunReport) -> Vec<&str> {
    report.frames.iter().map(|frame| frame.image_hash.as_str()).collect()
}

#[test]
fn what_stands_still_travels_once() {
    let folder = Folder::new("gathering-still");
    let file = folder.file("still.jsonl");
    run_well(&["session", "still", "--frames", "4", "--radius", "0.75", "-o", &file, "--quiet"]);
    // A tile that changes hands travels whole; here each has its node.
    let flags = ["knot:20000", "--nodes", "3", "--threads", "2", "--size", "250x190", "--session", &file];
    let report = render(&folder, &[&flags[..], &["--balance", "static"]].concat());
    let [first, later @ ..] = &report.frames[..] else { panic!("four frames") };
    assert_eq!(first.changed_tiles, 8 * 6);
    assert!(first.gather_bytes > 5_000 && first.gather_bytes < 250 * 190, "{}", first.gather_bytes);
    for frame in later {
        assert_eq!((frame.changed_tiles, &frame.image_hash), (0, &first.image_hash));
        // Twelve bytes a tile at most, and the head of a parcel, of which there are no more than tiles.
        assert!(frame.gather_bytes <= (12 + 4) * 48, "{}", frame.gather_bytes);
    }
    assert_eq!(report.totals.gather_bytes, report.frames.iter().map(|frame| frame.gather_bytes).sum::<u64>());
}

#[test]
fn what_stands_still_travels_again_only_when_it_changes_hands() {
    let folder = Folder::new("gathering-hands");
    let file = folder.file("still.jsonl");
    run_well(&["session", "still", "--frames", "8", "--radius", "0.75", "-o", &file, "--quiet"]);
    let flags = ["knot:20000", "--nodes", "3", "--threads", "2", "--size", "250x190", "--session", &file];
    let report = render(&folder, &[&flags[..], &["--balance", "steal-near", "--displays", "2"]].concat());
    for (before, frame) in report.frames.iter().zip(&report.frames[1..]) {
        assert_eq!(frame.image_hash, before.image_hash, "SAME_IMAGE");
        // Whoever did not draw a tile in the last frame cannot know what the display has: who has taken it from another now,
        // and, where cores are shared, who had it taken then and has it back.
        let moved_tiles = u64::from(before.moved_tiles) + u64::from(frame.moved_tiles);
        assert!(frame.changed_tiles <= moved_tiles, "{} of {moved_tiles}", frame.changed_tiles);
    }
}

#[test]
fn any_number_of_displays_puts_the_same_picture_together() {
    let folder = Folder::new("gathering-displays");
    let view = ["knot:20000", "--nodes", "2", "--size", "200x150", "--frames", "3", "--radius", "0.75"];
    let view = [&view[..], &["--balance", "static"]].concat();
    let draw = |displays: &str| render(&folder, &[&view[..], &["--displays", displays]].concat());
    let one = draw("1");
    assert!(one.displays == 1 && one.frames.iter().all(|frame| frame.changed_tiles > 0));
    // 16 are more than there are rows of tiles.
    for displays in ["2", "3", "16"] {
        let several = draw(displays);
        assert_eq!(hashes(&several), hashes(&one), "SAME_IMAGE: {displays} displays");
        let counts = |report: &RunReport| -> Vec<_> {
            report.frames.iter().map(|frame| (frame.primary_rays, frame.lit, frame.changed_tiles)).collect()
        };
        assert_eq!(counts(&several), counts(&one), "{displays} displays");
    }
    for displays in ["0", "17"] {
        let line = error_line(&run(&[&["render"][..], &view, &["--displays", displays]].concat()));
        assert!(line.contains("from 1 to 16"), "{line}");
    }
}

#[test]
fn a_frame_larger_than_all_credit_arrives() {
    let folder = Folder::new("gathering-credit");
    let view =
        ["sphereflake:5", "--size", "1200x1000", "--radius", "0.5", "--elevation", "20", "--frames", "2"];
    let draw = |more: &[&str]| render(&folder, &[&view[..], more].concat());
    let one = draw(&["--nodes", "1", "--threads", "1"]);
    assert!(one.frames.iter().all(|frame| frame.gather_bytes > CREDIT), "{:?}", one.totals);
    let many = draw(&["--nodes", "3", "--threads", "3", "--displays", "2"]);
    assert_eq!(hashes(&many), hashes(&one), "SAME_IMAGE");
}
