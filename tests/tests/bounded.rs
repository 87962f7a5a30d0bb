//! `BOUNDED`: a node never holds more than its budget, checked against what the system counts as resident.

use memsavvy::report::{ProcessReport, RunReport};
use tests::{Folder, render, run_well};

/// Stacks, buffers and the allocator's own: what a process takes beside the program, whatever the scene.
const OVERHEAD_BYTES_MAX: u64 = 4 << 20;

/// What is resident of the program and its libraries: files, shared by all processes. As they are built for tests.
const PROGRAM_BYTES_MAX: u64 = 8 << 20;

const MEGABYTE: u64 = 1 << 20;

fn check(report: &RunReport) -> u64 {
    let nodes: Vec<&ProcessReport> = report.nodes.iter().filter(|node| node.role == "node").collect();
    for node in &nodes {
        let ProcessReport {
            peak_resident_bytes: peak,
            program_bytes: program,
            budget_bytes: budget,
            held_bytes_max: held,
            ..
        } = node;
        println!(
            "node {}: peak {:.2} MB, budget {:.2} MB, program {:.2} MB, beyond what is held {:.2} MB ({})",
            node.node,
            *peak as f64 / MEGABYTE as f64,
            *budget as f64 / MEGABYTE as f64,
            *program as f64 / MEGABYTE as f64,
            node.overhead_bytes() as f64 / MEGABYTE as f64,
            node.backend,
        );
        assert!(held <= budget, "BOUNDED: {node:?}");
        assert!(*program <= PROGRAM_BYTES_MAX, "BOUNDED: {node:?}");
        assert!(*peak <= budget + program + OVERHEAD_BYTES_MAX, "BOUNDED: {node:?}");
        // It would be easy to stay within a budget that nobody fills.
        assert!(peak - program > held - held / 10, "the cache was not filled: {node:?}");
        assert!(node.evictions > 0, "{node:?}");
    }
    nodes.iter().map(|node| node.overhead_bytes()).max().unwrap()
}

/// A scene image of at least `bytes` bytes.
fn knot(folder: &Folder, triangles: u64, page: &str, bytes: u64) -> String {
    let path = folder.file(&format!("knot-{triangles}-{page}.msv"));
    run_well(&["prepare", "--builtin", &triangles.to_string(), "-o", &path, "--page", page, "--quiet"]);
    assert!(std::fs::metadata(&path).unwrap().len() >= bytes);
    path
}

#[test]
fn bounded_at_a_tenth_of_a_large_scene_and_the_overhead_does_not_grow() {
    let folder = Folder::new("bounded");
    let (small, large) = (knot(&folder, 400_000, "16K", 0), knot(&folder, 14_500_000, "16K", 256 * MEGABYTE));
    for backend in ["uffd", "segv", "soft"] {
        let flags =
            ["--nodes", "2", "--stores", "1", "--memory", "10%", "--backend", backend, "--radius", "0.6"];
        let view = ["--size", "512x512", "--frames", "2", "--deadline", "60"];
        let overhead = |image: &str| check(&render(&folder, &[&[image][..], &flags, &view].concat()));
        let (of_small, of_large) = (overhead(&small), overhead(&large));
        assert!(of_large <= of_small + MEGABYTE, "{backend}: overhead grew from {of_small} to {of_large}");
    }
}

/// `segv` at 4 KB pages: the kernel allows some 65,000 mappings, and this budget is for more pages.
#[test]
fn bounded_near_the_limit_on_mappings() {
    let folder = Folder::new("bounded-mappings");
    let image = knot(&folder, 14_500_000, "4K", 256 * MEGABYTE);
    let flags = [
        "--nodes",
        "1",
        "--stores",
        "1",
        "--threads",
        "2",
        "--memory",
        "60%",
        "--backend",
        "segv",
        "--radius",
        "0.5",
    ];
    let view = ["--size", "800x800", "--frames", "12", "--deadline", "60"];
    let report = render(&folder, &[&[image.as_str()][..], &flags, &view].concat());
    let node = &report.nodes[0];
    println!("slots {}, withheld {}, evicted {}", node.slots, node.slots_withheld, node.evictions);
    assert!(node.slots_withheld > 0, "the limit on mappings is higher here: {node:?}");
    assert!(node.evictions > 0, "the cache was not filled: {node:?}");
    assert!(node.program_bytes <= PROGRAM_BYTES_MAX, "BOUNDED: {node:?}");
    assert!(node.overhead_bytes() <= OVERHEAD_BYTES_MAX, "BOUNDED: {node:?}");
    let same =
        render(&folder, &[&[image.as_str(), "--nodes", "1"][..], &view, &["--radius", "0.5"]].concat());
    assert_eq!(report.frames[11].image_hash, same.frames[11].image_hash);
}
