//! `CRASH_SAFE` input: whatever a file holds, the command ends with a picture or with one clear line.

use std::fs;

use tests::{Folder, data, error_line, run, run_well};

/// Renders a file, small, and says whether a picture came of it. Anything but that and one clear line fails.
fn picture_or_error(folder: &Folder, path: &str) -> Result<(), String> {
    let picture = folder.file("picture.png");
    let _ = fs::remove_file(&picture);
    let output = run(&[
        "render", path, "-o", &picture, "--size", "32x32", "--nodes", "2", "--quiet", "--memory", "100%",
    ]);
    if output.status.success() {
        assert!(fs::metadata(&picture).unwrap().len() > 50, "{path}: no picture");
        return Ok(());
    }
    let line = error_line(&output);
    assert!(!fs::exists(&picture).unwrap(), "{path}: an error and a picture: {line}");
    Err(line)
}

#[test]
fn every_dialect_is_rendered_or_refused_in_one_line() {
    let Some(dialects) = data("meshes-dialects") else { return };
    let folder = Folder::new("dialects");
    let mut refused = Vec::new();
    for entry in fs::read_dir(dialects).unwrap() {
        let path = entry.unwrap().path();
        if let Err(line) = picture_or_error(&folder, path.to_str().unwrap()) {
            println!("{line}");
            refused.push(path.file_name().unwrap().to_str().unwrap().to_owned());
        }
    }
    refused.sort();
    // Files that hold no triangle, and nothing else.
    let empty = [
        "empty-zero-vertices.ply",
        "header-only-no-elements.ply",
        "points-int-coordinates.ply",
        "points-unknown-list-element.ply",
    ];
    assert_eq!(refused, empty);
}

#[test]
fn truncated_copies_are_rendered_or_refused_in_one_line() {
    let Some(dialects) = data("meshes-dialects") else { return };
    let folder = Folder::new("truncated");
    let copy = |name: &str, length: usize| {
        let bytes = fs::read(dialects.join(name)).unwrap();
        let path = folder.file(&format!("{length}-{name}"));
        fs::write(&path, &bytes[..length.min(bytes.len())]).unwrap();
        path
    };
    for (name, lengths) in [
        ("cube-vcglib-binary.ply", &[0, 3, 50, 200, 300, 330][..]),
        ("sphere-doubles-ascii.ply", &[10, 200, 1000, 5000, 15000]),
        ("rhino6-cr-header.ply", &[100, 400, 500, 900]),
        ("quadknot.obj", &[0, 1, 100, 5000, 60000]),
    ] {
        for length in lengths {
            let _ = picture_or_error(&folder, &copy(name, *length));
        }
    }
}

#[test]
fn broken_scene_images_are_refused_in_one_line() {
    let folder = Folder::new("broken-images");
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "5000", "-o", &image, "--quiet"]);
    let good = fs::read(&image).unwrap();
    assert!(picture_or_error(&folder, &image).is_ok());
    let broken = folder.file("broken.msv");
    for length in [0, 7, 8, 100, 4095, 4096, good.len() / 2, good.len() - 1] {
        fs::write(&broken, &good[..length]).unwrap();
        assert!(picture_or_error(&folder, &broken).is_err(), "{length} bytes were taken for an image");
    }
    for place in (0..good.len()).step_by(good.len() / 60).chain(0..160) {
        let mut bytes = good.clone();
        bytes[place] ^= 0x41;
        fs::write(&broken, &bytes).unwrap();
        // A byte that only fills a page may be anything.
        let _ = picture_or_error(&folder, &broken);
    }
    fs::write(&broken, [&good[..], &[0]].concat()).unwrap();
    assert!(picture_or_error(&folder, &broken).is_err(), "bytes behind the end were taken");
}

#[test]
fn impossible_flags_get_one_clear_line() {
    let folder = Folder::new("flags");
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "5000", "-o", &image, "--quiet"]);
    for (flags, words) in [
        (&["--nodes", "0"][..], "nobody to render"),
        (&["--nodes", "60", "--stores", "60"], "more than the 64"),
        (&["--memory", "10%"], "--stores"),
        (&["--memory", "1K", "--stores", "1"], "a single page of others"),
        (&["--page", "4K"], "prepare it anew"),
        (&["--frames", "0"], "renders nothing"),
        (&["--radius", "0"], "above 0"),
        (&["--radius", "nan"], "above 0"),
        (&["--radius", "1e38"], "no camera"),
        (&["--threads", "300"], "at most 256"),
        (&["--backend", "replicated", "--stores", "1"], "every node holds them all"),
        (&["--backend", "replicated", "--memory", "50%"], "holds the whole image"),
        (&["-o", "no-such-folder/out.png"], "cannot write"),
        (&["-o", "out-%x.png"], "%"),
        (&["--report", "/"], "a file in a folder"),
    ] {
        let arguments = [&["render", &image, "--size", "16x16"][..], flags].concat();
        let line = error_line(&run(&arguments));
        assert!(line.contains(words), "{flags:?}: {line}");
    }
    for arguments in
        [&["info", "/dev/null"][..], &["info", "no-such-file"], &["prepare", &image, "-o", "x.msv"]]
    {
        let _ = error_line(&run(arguments));
    }
}

#[test]
fn help_has_examples_everywhere() {
    let commands = [&["--help"][..], &["render", "--help"], &["prepare", "--help"], &["info", "--help"]];
    for arguments in commands.into_iter().chain([&["session", "--help"][..], &["trace", "--help"]]) {
        let help = run_well(arguments);
        assert!(help.contains("Examples:\n  memsavvy"), "{help}");
    }
}
