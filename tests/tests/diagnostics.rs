//! Diagnostics: pictures of who draws what, who owns what, where misses and time go. Asking for them changes no frame.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;

use tests::{Folder, error_line, render, run};

const KINDS: [&str; 5] = ["tile-owner", "page-owner", "misses", "cost", "diagnostic"];

/// The colours of a PNG file of red, green and blue.
fn colours(path: &str) -> HashSet<[u8; 3]> {
    let mut reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    assert_eq!(reader.info().color_type, png::ColorType::Rgb);
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels.as_chunks::<3>().0.iter().copied().collect()
}

/// Draws a scene with all diagnostics and without; gives back the colours of each kind.
fn drawn(name: &str, scene: &[&str]) -> Vec<HashSet<[u8; 3]>> {
    let folder = Folder::new(&format!("diagnostics-{name}"));
    let out = folder.file("out.png");
    let cluster = ["--nodes", "2", "--stores", "2", "--memory", "30%", "--page", "4K", "--size", "160x96"];
    let flags = [scene, &cluster].concat();
    let kinds = KINDS[..4].join(",");
    let with = render(&folder, &[&flags[..], &["-o", &out, "--diagnostic", &kinds]].concat());
    let without = render(&folder, &flags);
    assert_eq!(with.frames[0].image_hash, without.frames[0].image_hash, "SAME_IMAGE: {name}");
    assert_eq!(with.frames[0].hits, without.frames[0].hits);
    KINDS.iter().map(|kind| colours(&folder.file(&format!("out.{kind}.png")))).collect()
}

/// Colours that are no grey.
fn hues(colours: &HashSet<[u8; 3]>) -> usize {
    colours.iter().filter(|[red, green, blue]| red != green || green != blue).count()
}

#[test]
fn every_kind_is_drawn_of_surfaces_and_of_volumes() {
    for (name, scene) in [("mesh", "knot:30000"), ("spheres", "sphereflake:3"), ("volume", "gyroid:48")] {
        let of = drawn(name, &[scene, "--radius", "0.75"]);
        // Two nodes in two greys, and nothing in colour.
        assert!(hues(&of[0]) == 0 && of[0].contains(&[128; 3]) && of[0].contains(&[255; 3]), "{name}");
        // Two stores own the pages: shades of red for the one, of its opposite for the other.
        let of_first = |[red, green, blue]: &[u8; 3]| red > green && green == blue;
        let of_second = |[red, green, blue]: &[u8; 3]| red < green && green == blue;
        assert!(of[1].iter().any(of_first) && of[1].iter().any(of_second), "{name}: {:?}", of[1]);
        assert!(of[1].iter().all(|colour| of_first(colour) || of_second(colour) || colour[0] == colour[2]));
        // Some tile is the hottest, and its place on the scale is not that of all.
        for heat in &of[2..4] {
            assert!(heat.contains(&[255; 3]) && hues(heat) > 10, "{name}");
        }
        assert!(of[1].is_subset(&of[4]), "{name}: all side by side");
    }
}

#[test]
fn one_kind_alone_makes_no_sheet_and_none_makes_nothing() {
    let folder = Folder::new("diagnostics-one");
    let out = folder.file("out-%d.png");
    let view = ["knot:5000", "--size", "64x64", "--frames", "2", "-o", &out];
    let _ = render(&folder, &[&view[..], &["--diagnostic", "cost"]].concat());
    let there = |name: &str| Path::new(&folder.file(name)).exists();
    assert!(there("out-0.png") && there("out-1.cost.png"));
    assert!(!there("out-0.misses.png") && !there("out-0.diagnostic.png"));
    fs::remove_file(folder.file("out-1.cost.png")).unwrap();
    let _ = render(&folder, &view);
    assert!(!there("out-1.cost.png"));
    let nowhere = run(&["render", "knot:5000", "--diagnostic", "cost"]);
    assert!(!nowhere.status.success() && String::from_utf8_lossy(&nowhere.stderr).contains("--output"));
    let line =
        error_line(&run(&["render", "knot:5000", "-o", "no-such-folder/x.png", "--diagnostic", "cost"]));
    assert!(line.contains("no-such-folder"), "{line}");
}
