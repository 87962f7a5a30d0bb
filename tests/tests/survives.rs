//! `SURVIVES`: with two copies of each page, any one store and any one node may be killed at any moment while a frame
//! is drawn. The frame is completed, and it is the same picture.

use std::fs;

use memsavvy::report::RunReport;
use tests::{Folder, Running, error_line, render, run, run_well};

/// Moments at which processes are killed, of each kind of cluster.
const TIMES: u64 = 6;

const FRAMES: u64 = 3;

/// Tiles of a frame of 256x256.
const TILES: u64 = 64;

/// Three nodes, and who holds the pages: two stores, or they themselves.
#[derive(Clone, Copy, Debug)]
struct Cluster {
    stores: u64,
    transport: &'static str,
    backend: &'static str,
}

impl Cluster {
    fn arguments<'a>(&self, image: &'a str) -> Vec<&'a str> {
        let (stores, memory, displays) = if self.stores > 0 { ("2", "20%", "3") } else { ("0", "80%", "1") };
        let cluster = ["--nodes", "3", "--stores", stores, "--memory", memory, "--threads", "2"];
        let pages = ["--replicas", "2", "--transport", self.transport, "--backend", self.backend];
        let gather = ["--displays", displays];
        let view = ["--size", "256x256", "--frames", "3", "--radius", "0.8", "--deadline", "50"];
        [&[image][..], &cluster, &pages, &gather, &view].concat()
    }

    /// Whom to kill and when, as the seed says: a node, and a store if there are stores.
    fn kills(&self, seed: u64) -> Vec<String> {
        let mut random = Random(seed);
        let mut kill = |first, count| {
            let (process, frame) = (first + random.below(count), random.below(FRAMES));
            format!("{process}@{frame}:{}", random.below(TILES + 1))
        };
        let node = kill(0, 3);
        if self.stores > 0 { vec![node, kill(3, self.stores)] } else { vec![node] }
    }
}

/// `SplitMix64`.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % bound
    }
}

fn scene(folder: &Folder) -> String {
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "20000", "-o", &image, "--page", "4K", "--quiet"]);
    image
}

/// A run in which the processes are killed that `kills` names. It must end, and well, and warn of each.
fn disturbed(folder: &Folder, arguments: &[&str], kills: &[String], what: &str) -> RunReport {
    // Shown by a failing test; a run that hangs can say nothing itself.
    println!("{what}");
    let file = folder.file("disturbed.json");
    let mut all = [&["render"][..], arguments, &["--report", &file, "--quiet"]].concat();
    kills.iter().for_each(|kill| all.extend(["--kill", kill]));
    let output = Running::spawn(&all).end();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{what}: {said}");
    let warnings = said.lines().filter(|line| line.starts_with("warning: ") && line.contains("SIGKILL"));
    assert_eq!((warnings.count(), said.lines().count()), (kills.len(), kills.len()), "{what}: {said}");
    serde_json::from_slice(&fs::read(&file).unwrap()).unwrap()
}

#[test]
fn any_store_and_any_node_may_be_killed_and_the_picture_is_the_same() {
    let folder = Folder::new("survives");
    let image = scene(&folder);
    let (mut seed, mut dealt_again) = (0, 0);
    for (stores, transport) in [(2, "shm"), (2, "shm-ring"), (0, "shm"), (0, "shm-ring")] {
        for backend in ["uffd", "segv", "soft"] {
            let cluster = Cluster { stores, transport, backend };
            let arguments = cluster.arguments(&image);
            let whole = render(&folder, &arguments);
            assert!(whole.losses.is_empty() && whole.nodes.len() == 3 + usize::try_from(stores).unwrap());
            for _ in 0..TIMES {
                seed += 1;
                let kills = cluster.kills(seed);
                let what = format!("SURVIVES: seed {seed}, {cluster:?}, {kills:?}");
                let report = disturbed(&folder, &arguments, &kills, &what);
                assert_eq!(report.losses.len(), kills.len(), "{what}: {:?}", report.losses);
                assert_eq!(report.nodes.len() + kills.len(), whole.nodes.len(), "{what}");
                for (frame, same) in report.frames.iter().zip(&whole.frames) {
                    assert_eq!(frame.image_hash, same.image_hash, "{what}");
                    assert_eq!((frame.primary_rays, frame.lit), (same.primary_rays, same.lit), "{what}");
                }
                dealt_again += report.losses.iter().map(|loss| loss.tiles_dealt_again).sum::<usize>();
            }
        }
    }
    println!("{seed} runs, {dealt_again} tiles dealt again");
    assert!(dealt_again > 100, "no node died in the middle of a frame: {dealt_again} tiles dealt again");
}

#[test]
fn who_dies_while_pages_are_filled_is_not_missed() {
    let folder = Folder::new("dies-early");
    let image = scene(&folder);
    let mut early = 0;
    for (stores, transport, victims) in
        [(2, "shm", &["0@start", "4@start"][..]), (0, "shm-ring", &["2@start"]), (0, "shm", &["1@start"])]
    {
        let cluster = Cluster { stores, transport, backend: "uffd" };
        let arguments = cluster.arguments(&image);
        let whole = render(&folder, &arguments);
        let kills: Vec<String> = victims.iter().map(|kill| (*kill).to_owned()).collect();
        let report = disturbed(&folder, &arguments, &kills, &format!("{cluster:?}, {kills:?}"));
        assert_eq!(report.losses.len(), kills.len());
        early += report.losses.iter().filter(|loss| loss.doing == "the home pages were filled").count();
        let hashes = |report: &RunReport| -> Vec<String> {
            report.frames.iter().map(|frame| frame.image_hash.clone()).collect()
        };
        assert_eq!(hashes(&report), hashes(&whole));
    }
    assert!(early > 0, "all had filled their pages when they died");
}

#[test]
fn what_cannot_be_spared_ends_the_run_with_its_name() {
    let folder = Folder::new("not-spared");
    let image = scene(&folder);
    let view = ["render", &image, "--size", "256x256", "--frames", "3", "--deadline", "50", "--quiet"];
    for (flags, victim) in [
        (&["--nodes", "2", "--stores", "2", "--kill", "0@1:9"][..], "node 0"),
        (&["--nodes", "2", "--stores", "2", "--kill", "3@1:9"], "store 3"),
        (&["--nodes", "2", "--stores", "2", "--kill", "3@start"], "store 3"),
        (&["--nodes", "1", "--stores", "2", "--replicas", "2", "--kill", "0@1:9"], "node 0"),
        (
            &["--nodes", "2", "--stores", "2", "--replicas", "2", "--kill", "2@0:9", "--kill", "3@1:9"],
            "store 3",
        ),
    ] {
        let line = error_line(&Running::spawn(&[&view[..], flags].concat()).end());
        assert!(line.contains(&format!("{victim} was killed by SIGKILL")), "{flags:?}: {line}");
    }
}

#[test]
fn copies_that_cannot_be_are_refused_in_one_line() {
    let folder = Folder::new("copies");
    let image = scene(&folder);
    for (flags, words) in [
        (&["--stores", "1", "--replicas", "2"][..], "2 copies"),
        (&["--replicas", "0"], "too few"),
        (&["--replicas", "2", "--memory", "40%"], "fewer --replicas"),
        (&["--replicas", "2", "--backend", "replicated"], "holds them all"),
        (&["--kill", "1@2"], "PROCESS@FRAME:TILES"),
    ] {
        let output = run(&[&["render", &image, "--size", "16x16"][..], flags].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(words), "{flags:?}: {said}");
    }
}
