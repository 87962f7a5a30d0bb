//! How much memory it takes to build a grid, counted by the allocator.

use core::alloc::{GlobalAlloc, Layout};
use core::sync::atomic::{AtomicUsize, Ordering};
use std::alloc::System;

use scene::{BuildOptions, Mesh, build, builtin};

/// The system's allocator, with a count of the bytes in use by all threads.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grow(bytes: usize) {
    // Relaxed: sums and a maximum; they order nothing.
    let now = IN_USE.fetch_add(bytes, Ordering::Relaxed) + bytes;
    PEAK.fetch_max(now, Ordering::Relaxed);
}

fn shrink(bytes: usize) {
    // Relaxed: as in `grow`.
    IN_USE.fetch_sub(bytes, Ordering::Relaxed);
}

// SAFETY: every call goes to the system's allocator with the arguments it came with; the counts are plain
// numbers beside it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // A moved block exists twice for a moment.
        grow(size);
        shrink(layout.size());
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        shrink(layout.size());
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Highest memory in use while a mesh is built, the mesh itself included, over the bytes of its positions and
/// indices.
fn peak_over_mesh(mesh: Mesh) -> f64 {
    let bytes = mesh.bytes() as f64;
    let before = IN_USE.load(Ordering::Relaxed) as f64 - bytes;
    PEAK.store(IN_USE.load(Ordering::Relaxed), Ordering::Relaxed);
    let scene = build(mesh, &BuildOptions::default(), &|_| {}).expect("builds");
    let peak = PEAK.load(Ordering::Relaxed) as f64;
    drop(scene);
    (peak - before) / bytes
}

/// A mesh without spare capacity.
fn fitted(mut mesh: Mesh) -> Mesh {
    mesh.positions.shrink_to_fit();
    mesh.triangles.shrink_to_fit();
    mesh
}

/// A mesh whose triangles are all the same, written as often as asked for.
fn coincident(triangles: usize) -> Mesh {
    let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    Mesh { positions, triangles: vec![[0, 1, 2]; triangles] }
}

/// Triangles as large as the scene, each with vertices of its own.
fn soup(triangles: u32) -> Mesh {
    // A fixed pseudo-random number in -1..1; the constants are those of Numerical Recipes.
    let mut seed = 1_u32;
    let mut number = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 / 8_388_608.0 - 1.0
    };
    let positions = (0..triangles * 3).map(|_| [number(), number(), number()]).collect();
    Mesh { positions, triangles: (0..triangles).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }
}

/// One test, since the counts are for the whole process.
#[test]
fn building_takes_at_most_three_times_the_mesh() {
    // The pool's threads bring memory of their own, once.
    drop(build(builtin::knot(10_000), &BuildOptions::default(), &|_| {}));
    let meshes = [
        ("knot of 100,000", builtin::knot(100_000)),
        ("knot of 1,000,000", builtin::knot(1_000_000)),
        ("1,000,000 times one triangle", coincident(1_000_000)),
        ("soup of 100,000", soup(100_000)),
    ];
    for (name, mesh) in meshes.map(|(name, mesh)| (name, fitted(mesh))) {
        let peak = peak_over_mesh(mesh);
        println!("{name}: peak {peak:.2} times the mesh");
        assert!(peak <= 3.0, "{name}: peak {peak:.2} times the mesh");
    }
}
