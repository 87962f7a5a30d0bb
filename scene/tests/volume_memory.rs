//! How much memory it takes to go through a volume and to prepare it, counted by the allocator and by the system.
//!
//! With `MEMSAVVY_ALL=1` also a volume of 2^33 samples.

use core::alloc::{GlobalAlloc, Layout};
use core::sync::atomic::{AtomicUsize, Ordering};
use std::alloc::System;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use rt_core::{Ray, Solver};
use scene::volume::{Histogram, VolumeName, VolumeSource};

/// The system's allocator, with a count of the bytes in use by all threads.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator with the arguments it came with; the counts are plain
// numbers beside it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // Relaxed: sums and a maximum; they order nothing.
        let now = IN_USE.fetch_add(layout.size(), Ordering::Relaxed) + layout.size();
        PEAK.fetch_max(now, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // Relaxed: as above.
        IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Bytes that were in use at most while `work` ran, beyond those before.
fn peak_of(work: impl FnOnce()) -> usize {
    let before = IN_USE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    work();
    PEAK.load(Ordering::Relaxed) - before
}

fn open(name: &str) -> Box<dyn VolumeSource> {
    let name = VolumeName::recognise(Path::new(name)).expect("a good name").expect("a volume");
    name.open().expect("readable")
}

/// One test, since the counts are for the whole process.
#[test]
fn no_volume_is_ever_whole_in_memory() {
    let folder = std::env::temp_dir().join(format!("memsavvy-volume-memory-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    prepare_sparse(&folder, [1024; 3], "f32", &1.0_f32.to_le_bytes());
    if std::env::var_os("MEMSAVVY_ALL").is_some() {
        prepare_sparse(&folder, [2048; 3], "u8", &[1]);
    }
    // 4 GB without a byte on the disk, but for the samples in the far corners.
    let sparse = folder.join("sparse.raw");
    let mut file = File::create(&sparse).expect("a writable folder");
    file.set_len(4 << 30).expect("a sparse file");
    file.write_all(&1.5_f64.to_le_bytes()).expect("writable");
    file.seek(SeekFrom::End(-8)).expect("a file");
    file.write_all(&2.5_f64.to_le_bytes()).expect("writable");
    let name = format!("raw:{}?dims=1024x512x1024&type=f64", sparse.display());
    let slices = peak_of(|| read_by_slices(&name));
    // The caller's nine slices have 18 MB.
    println!("4 GB by slabs of nine slices: {slices} bytes");
    assert!(slices < (18 << 20) + (1 << 20), "{slices}");

    let compressed = folder.join("compressed.raw.gz");
    let mut encoder =
        GzEncoder::new(File::create(&compressed).expect("a writable folder"), Compression::fast());
    let slice: Vec<u8> = (0..1 << 18).map(|i: u32| (i >> 6).to_le_bytes()[0]).collect();
    for _ in 0..256 {
        encoder.write_all(&slice).expect("writable");
    }
    encoder.finish().expect("writable");
    let name = format!("raw:{}?dims=512x512x256&type=u8", compressed.display());
    let histogram = peak_of(|| {
        let histogram = Histogram::of(&mut *open(&name), 256).expect("readable");
        assert_eq!(histogram.counts(), [1 << 18; 256]);
    });
    println!("64 MB of gzip for its histogram: {histogram} bytes");
    assert!(histogram < 4 << 20, "{histogram}");
    std::fs::remove_dir_all(&folder).expect("the folder is ours");
}

/// Goes through a volume of 1024 slices in slabs of nine that have one slice in common.
fn read_by_slices(name: &str) {
    let mut volume = open(name);
    let slice = usize::try_from(volume.shape().slice_samples()).expect("small");
    let mut slab = vec![0.0; 9 * slice];
    let mut sum = 0.0;
    for z in (0..1023).step_by(8) {
        let slab = &mut slab[..slice * usize::try_from(9.min(1024 - z)).expect("small")];
        volume.read_slices(z, slab).expect("readable");
        // The slice in common counts once.
        sum += slab[slice * usize::from(z > 0)..].iter().sum::<f32>();
    }
    assert_eq!(sum, 4.0, "first and last sample");
}

/// Prepares a volume of zeros whose first and last sample are 1, and looks at both corners of the image.
fn prepare_sparse(folder: &Path, dims: [u32; 3], kind: &str, one: &[u8]) {
    let (input, output) = (folder.join("corners.raw"), folder.join("corners.msv"));
    let bytes = dims.into_iter().map(u64::from).product::<u64>() * one.len() as u64;
    let mut file = File::create(&input).expect("a writable folder");
    file.write_all(one).expect("writable");
    file.set_len(bytes).expect("a sparse file");
    file.seek(SeekFrom::Start(bytes - one.len() as u64)).expect("a file");
    file.write_all(one).expect("writable");
    let [x, y, z] = dims;
    let mut volume = open(&format!("raw:{}?dims={x}x{y}x{z}&type={kind}", input.display()));
    let mut out = File::options().read(true).write(true).create_new(true).open(&output).expect("writable");
    let peak = peak_of(|| {
        let header =
            scene::write_volume(&mut *volume, None, None, 16384, &mut out, &|_| {}).expect("an image");
        assert_eq!(header.volume.expect("a volume").bricks, 2, "one for each corner");
    });
    let resident = peak_resident_bytes();
    println!("{bytes} bytes of {kind} prepared: {peak} bytes allocated, {resident} resident");
    assert!(peak < BYTES_MAX && resident < BYTES_MAX as u64, "{peak} {resident}");

    let image = std::fs::read(&output).expect("an image");
    let scene = scene::file::view_of(&image).expect("sound");
    let surfaces = scene.isosurfaces(&[0.5], Solver::default()).expect("sound").expect("a surface");
    let far = dims.map(|count| (count - 1) as f32);
    for (corner, inwards, cell) in [([0.0; 3], 1.0, [0; 3]), (far, -1.0, dims.map(|count| count - 2))] {
        // Along the diagonal of the corner's cell the value is (1 - t)^3.
        let ray = Ray { origin: corner.into(), direction: [inwards; 3].into(), t_max: f32::INFINITY };
        let hit = surfaces.nearest(&ray, &mut ()).expect("sound").expect("the corner");
        assert!((hit.t - (1.0 - 0.5_f32.cbrt())).abs() < 1.0e-3, "{hit:?}");
        assert_eq!(hit.cell, cell);
    }
    std::fs::remove_file(&input).expect("ours");
    std::fs::remove_file(&output).expect("ours");
}

/// What the system has counted as resident of this process at most.
fn peak_resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a process has a peak");
    let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().expect("a number");
    kilobytes << 10
}

/// Enough to prepare any volume of a few GB.
const BYTES_MAX: usize = 256 << 20;
