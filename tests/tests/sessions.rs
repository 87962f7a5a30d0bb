//! Sessions: the same one shows the same pictures on any configuration, by frames and by time, and a bad line is refused.

use std::fs;

use memsavvy::report::{FrameReport, RunReport};
use tests::{Folder, error_line, render, run, run_well};

/// Clusters that have little in common.
const CLUSTERS: [&[&str]; 4] = [
    &["--nodes", "1", "--threads", "1", "--backend", "replicated", "--kernel", "rays-portable"],
    &["--nodes", "2", "--threads", "3", "--memory", "70%", "--backend", "uffd"],
    &[
        "--nodes",
        "4",
        "--stores",
        "2",
        "--memory",
        "20%",
        "--page",
        "64K",
        "--backend",
        "segv",
        "--transport",
        "shm-ring",
    ],
    &[
        "--nodes",
        "3",
        "--stores",
        "1",
        "--replicas",
        "1",
        "--memory",
        "12%",
        "--backend",
        "soft",
        "--replacement",
        "fifo",
    ],
];

/// What does not depend on who drew a frame and when.
fn shown(frame: &FrameReport) -> (u32, String, u64, u64, Vec<f32>) {
    (frame.moment, frame.image_hash.clone(), frame.hits, frame.lit, frame.isovalues.clone())
}

fn all_shown(report: &RunReport) -> Vec<(u32, String, u64, u64, Vec<f32>)> {
    report.frames.iter().map(shown).collect()
}

/// Makes a session with these arguments and renders it on all clusters.
fn same_everywhere(name: &str, scene: &str, session: &[&str]) -> RunReport {
    let folder = Folder::new(&format!("session-{name}"));
    let (image, file) = (folder.file("scene.msv"), folder.file("session.jsonl"));
    run_well(&["prepare", scene, "-o", &image, "--page", "16K", "--quiet"]);
    run_well(&[&["session"][..], session, &["-o", &file, "--quiet"]].concat());
    let reports = CLUSTERS.map(|cluster| {
        let flags = [&image, "--session", &file, "--size", "80x64", "--deadline", "60"];
        render(&folder, &[&flags[..], cluster].concat())
    });
    for (report, cluster) in reports.iter().zip(CLUSTERS) {
        assert_eq!(all_shown(report), all_shown(&reports[0]), "SAME_IMAGE: {name}, {cluster:?}");
    }
    let [first, ..] = reports;
    assert!(first.session.ends_with("session.jsonl"), "{}", first.session);
    first
}

#[test]
fn a_session_shows_the_same_on_any_cluster() {
    let walk = ["walk", "--frames", "5", "--circle", "40", "--elevation", "15"];
    let report = same_everywhere("walk", "knot:60000", &walk);
    assert_eq!(report.frames.len(), 5);
    let moments: Vec<u32> = report.frames.iter().map(|frame| frame.moment).collect();
    assert_eq!(moments, [0, 1, 2, 3, 4]);
    assert!(report.frames.windows(2).all(|two| two[0].image_hash != two[1].image_hash));
    assert!(report.frames[4].hits > report.frames[0].hits, "a walk comes closer");
}

#[test]
fn an_isovalue_moves_and_shows_the_same_on_any_cluster() {
    let scan = ["volume", "--frames", "6", "--circle", "100000", "--iso", "-0.9..0.6"];
    let report = same_everywhere("volume", "gyroid:64", &scan);
    let isovalues: Vec<&[f32]> = report.frames.iter().map(|frame| &frame.isovalues[..]).collect();
    assert_eq!(isovalues, [&[-0.9][..], &[-0.4], &[0.1], &[0.6], &[0.6], &[0.6]]);
    let hits: Vec<u64> = report.frames.iter().map(|frame| frame.hits).collect();
    assert!(hits[0] != hits[1] && hits[1] != hits[2] && hits[3] > hits[2], "{hits:?}");
}

#[test]
fn flags_are_a_way_to_make_a_session() {
    let folder = Folder::new("session-flags");
    let file = folder.file("orbit.jsonl");
    let eye = ["--frames", "3", "--radius", "0.7", "--elevation", "40"];
    run_well(&[&["session", "orbit", "-o", &file, "--quiet"][..], &eye].concat());
    let view = ["knot:5000", "--size", "64x64"];
    let (by_flags, by_file) = (
        render(&folder, &[&view[..], &eye].concat()),
        render(&folder, &[&view[..], &["--session", &file]].concat()),
    );
    assert_eq!(all_shown(&by_flags), all_shown(&by_file));
    assert!(run_well(&["info", &file]).contains("moments  3"));
    let both = run(&[&["render"][..], &view, &["--session", &file, "--frames", "3"]].concat());
    assert!(!both.status.success() && String::from_utf8_lossy(&both.stderr).contains("cannot be used with"));
}

#[test]
fn by_time_moments_are_left_out_and_those_drawn_are_the_same() {
    let folder = Folder::new("session-time");
    let file = folder.file("walk.jsonl");
    let draw = |rate: &str, replay: &str| {
        let session = ["session", "walk", "--frames", "9", "--rate", rate, "-o", &file, "--quiet"];
        run_well(&session);
        render(&folder, &["knot:5000", "--size", "64x64", "--session", &file, "--replay", replay])
    };
    let all = draw("1000000", "frames");
    assert_eq!((all.frames.len(), all.replay.as_str()), (9, "frames"));
    // All but the first and the last are over before the first is drawn.
    let fast = draw("1000000", "time");
    assert_eq!(fast.replay, "time");
    let expected = [&all.frames[0], &all.frames[8]].map(shown);
    assert_eq!(all_shown(&fast), expected);
    assert_eq!([fast.frames[0].frame, fast.frames[1].frame], [0, 1]);
    // Now and then one may be left out by a slow machine; whichever are drawn are the same.
    let slow = draw("20", "time");
    assert!(slow.frames.iter().all(|frame| all_shown(&all).contains(&shown(frame))));
}

#[test]
fn a_trace_takes_a_session_and_isosurfaces_touch_pages() {
    let folder = Folder::new("session-trace");
    let (session, trace) = (folder.file("still.jsonl"), folder.file("still.trace"));
    run_well(&["session", "still", "--frames", "2", "-o", &session, "--quiet"]);
    let scene = ["trace", "gyroid:64", "-o", &trace, "--size", "64x64", "--session", &session];
    let touched = |iso: &str| -> u64 {
        let said = run_well(&[&scene[..], &["--iso", iso]].concat());
        let line = said.lines().find(|line| line.trim().starts_with("touched")).expect("the pages touched");
        line.split_whitespace().nth(1).and_then(|count| count.parse().ok()).expect("a count")
    };
    // Outside of all samples there is nothing but the tops of the tree.
    assert!(touched("0") > 4 * touched("1000"));
}

#[test]
fn bad_sessions_are_refused_in_one_line_that_says_where() {
    let folder = Folder::new("session-bad");
    let file = folder.file("bad.jsonl");
    let head = "{\"memsavvy_session\":1}\n";
    for (text, words) in [
        ("", "line 1: no session begins so"),
        ("{\"memsavvy_session\":7}\n", "line 1: a session of version 7"),
        (head, "line 2: a session has a moment"),
        (&format!("{head}{{\"time\":0}}\nnonsense\n"), "line 3: expected ident"),
        (&format!("{head}{{\"time\":0,\"eye\":[0,0,0]}}\n"), "line 2: eye and at are the same point"),
        (&format!("{head}{{\"time\":0,\"isovalues\":[3]}}\n"), "isovalues, which are for volumes"),
    ] {
        fs::write(&file, text).unwrap();
        let line = error_line(&run(&["render", "knot:5000", "--size", "16x16", "--session", &file]));
        assert!(line.contains(words), "{text}: {line}");
        assert!(line.contains("bad.jsonl") || words.contains("volumes"), "{line}");
    }
    fs::write(&file, [head.as_bytes(), &[0xFF, 0xFE]].concat()).unwrap();
    let _ = error_line(&run(&["render", "knot:5000", "--session", &file]));
    let _ = error_line(&run(&["render", "knot:5000", "--session", &folder.file("none")]));
    fs::write(&file, format!("{head}{{\"time\":0,\"isovalues\":[0.1]}}\n")).unwrap();
    let line = error_line(&run(&["render", "gyroid:16", "--session", &file, "--iso", "0"]));
    assert!(line.contains("leave --iso out"), "{line}");
}
