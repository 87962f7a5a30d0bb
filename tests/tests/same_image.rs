//! `SAME_IMAGE`: the image is bit-identical for any number of nodes and threads, any memory, page size, backend,
//! policy, source of reference bits, transport, displays and balancer, and equals the replicated one.
//!
//! There are some thousand combinations. Continuous integration runs a part of them in which every value and most
//! pairs of values occur; `./ci.sh same-image` runs all (`MEMSAVVY_ALL=1`).

use memsavvy::report::RunReport;
use rt_core::Kernel;
use tests::{Folder, data, render, run_well};

const NODES: [u32; 3] = [1, 2, 4];
const THREADS: [u32; 2] = [1, 3];
const MEMORY: [&str; 4] = ["8%", "16%", "50%", "100%"];
const PAGES: [&str; 3] = ["4K", "16K", "64K"];
const BACKENDS: [&str; 3] = ["uffd", "segv", "soft"];
const POLICIES: [&str; 6] = ["random", "fifo", "clock", "sieve", "s3-fifo", "recall"];
const REFERENCES: [&str; 3] = ["none", "hints", "soft-faults"];
const TRANSPORTS: [&str; 2] = ["shm", "shm-ring"];
const DISPLAYS: [u32; 2] = [1, 3];
const BALANCERS: [&str; 4] = ["static", "demand", "steal", "steal-near"];
const COMBINATIONS: usize = 3 * 2 * 4 * 3 * 3 * 6 * 2 * 3 * 2 * 4;

/// Runs in continuous integration: every 1249th, a number that shares no divisor with any of the counts above.
const STRIDE: usize = 1249;

#[derive(Clone, Copy, Debug)]
struct Combination {
    nodes: u32,
    threads: u32,
    memory: &'static str,
    page: &'static str,
    backend: &'static str,
    policy: &'static str,
    transport: &'static str,
    reference: &'static str,
    displays: u32,
    balancer: &'static str,
}

impl Combination {
    /// The combination with this number, in `0..COMBINATIONS`.
    fn new(mut number: usize) -> Self {
        let mut digit = |base: usize| {
            let digit = number % base;
            number /= base;
            digit
        };
        Self {
            nodes: NODES[digit(3)],
            threads: THREADS[digit(2)],
            memory: MEMORY[digit(4)],
            page: PAGES[digit(3)],
            backend: BACKENDS[digit(3)],
            policy: POLICIES[digit(6)],
            transport: TRANSPORTS[digit(2)],
            reference: REFERENCES[digit(3)],
            displays: DISPLAYS[digit(2)],
            balancer: BALANCERS[digit(4)],
        }
    }

    /// Its flags, with stores where a node's memory does not reach for its home pages.
    fn flags(&self) -> Vec<String> {
        let share: u32 = self.memory.trim_end_matches('%').parse().unwrap();
        let stores = if share * self.nodes < 120 && share < 100 { 2 } else { 0 };
        let Self { nodes, threads, memory, page, backend, policy, transport, reference, displays, balancer } =
            self;
        format!(
            "--nodes {nodes} --stores {stores} --threads {threads} --memory {memory} --page {page} --backend {backend} \
             --replacement {policy} --transport {transport} --reference {reference} --displays {displays} \
             --balance {balancer} --deadline 60"
        )
        .split_whitespace()
        .map(str::to_owned)
        .collect()
    }
}

fn hashes(report: &RunReport) -> Vec<String> {
    report.frames.iter().map(|frame| frame.image_hash.clone()).collect()
}

/// Renders one scene in many ways and compares with the replicated picture of a single thread. Of the combinations,
/// one in `share` of those that are run for every scene.
fn same_image(scene: &str, name: &str, size: &str, share: usize) {
    let folder = Folder::new(&format!("same-image-{name}"));
    for page in PAGES {
        let image = folder.file(&format!("{page}.msv"));
        run_well(&["prepare", scene, "-o", &image, "--page", page, "--quiet"]);
    }
    let view = ["--size", size, "--radius", "0.75", "--frames", "2"];
    let image = folder.file("16K.msv");
    let mut flags = vec![image.as_str(), "--nodes", "1", "--threads", "1", "--backend", "replicated"];
    flags.extend(view);
    let expected = hashes(&render(&folder, &flags));
    assert!(expected.len() == 2 && expected[0] != expected[1]);

    let stride = if std::env::var_os("MEMSAVVY_ALL").is_some() { 1 } else { STRIDE * share };
    for combination in (0..COMBINATIONS).step_by(stride).map(Combination::new) {
        let mut flags = vec![folder.file(&format!("{}.msv", combination.page))];
        flags.extend(combination.flags());
        flags.extend(view.map(str::to_owned));
        let report = render(&folder, &flags);
        assert_eq!(hashes(&report), expected, "SAME_IMAGE: {name}, {combination:?}");
        // Paged it was, unless everything fits.
        let fetched = report.totals.fetched_pages > 0;
        assert!(fetched || combination.nodes == 1, "{combination:?}: {:?}", report.totals);
    }
}

#[test]
fn same_image_of_the_bunny() {
    if let Some(mesh) = data("meshes/bunny.ply") {
        same_image(mesh.to_str().unwrap(), "bunny", "160x128", 1);
    }
}

#[test]
fn same_image_of_the_dragon() {
    if let Some(mesh) = data("meshes/dragon.ply") {
        same_image(mesh.to_str().unwrap(), "dragon", "96x96", 1);
    }
}

#[test]
fn same_image_of_spheres_and_triangles() {
    // Deep enough that 8 % of it is more than a page of 64 KB. The share divides none of the counts, as the stride does not.
    same_image("sphereflake:5", "sphereflake", "128x96", 5);
}

#[test]
fn same_image_of_a_volume() {
    // 8 % of it is more than a page of 64 KB.
    same_image("gyroid:64", "gyroid", "96x96", 5);
}

#[test]
fn any_kernel_draws_the_same() {
    let folder = Folder::new("kernels");
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "20000", "-o", &image, "--quiet"]);
    let view = [image.as_str(), "--size", "200x150", "--frames", "2", "--nodes", "2", "--memory", "60%"];
    let draw = |kernel: Kernel| render(&folder, &[&view[..], &["--kernel", kernel.name()]].concat());
    let expected = draw("rays-portable".parse().unwrap());
    for kernel in Kernel::available() {
        let report = draw(kernel);
        assert_eq!(hashes(&report), hashes(&expected), "SAME_IMAGE: {kernel}");
        assert!(report.nodes.iter().all(|node| node.kernel == kernel.name()), "{kernel}");
    }
}

#[test]
fn lost_messages_do_not_show() {
    let folder = Folder::new("lost-messages");
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "20000", "-o", &image, "--quiet"]);
    let view = [image.as_str(), "--size", "64x64", "--deadline", "60"];
    let expected = render(&folder, &[&view[..], &["--nodes", "1"]].concat());
    for transport in TRANSPORTS {
        let flags =
            ["--nodes", "2", "--stores", "1", "--memory", "30%", "--lose", "100", "--transport", transport];
        let report = render(&folder, &[&view[..], &flags].concat());
        assert_eq!(hashes(&report), hashes(&expected));
        assert!(report.nodes.iter().any(|node| node.resends > 0), "{transport}: nothing was lost");
    }
}

#[test]
fn the_combinations_cover_every_value() {
    let chosen: Vec<Combination> = (0..COMBINATIONS).step_by(STRIDE).map(Combination::new).collect();
    let covers =
        |value: &str| chosen.iter().any(|combination| combination.flags().contains(&value.to_owned()));
    let words = [&MEMORY[..], &PAGES, &BACKENDS, &POLICIES, &TRANSPORTS, &REFERENCES, &BALANCERS].concat();
    assert!(words.iter().all(|value| covers(value)));
    for nodes in NODES {
        for threads in THREADS {
            assert!(chosen.iter().any(|one| one.nodes == nodes && one.threads == threads));
        }
        assert!(DISPLAYS.iter().all(|count| chosen.iter().any(|one| one.displays == *count)));
    }
}
