//! How much memory it takes to go through a volume, counted by the allocator.

use core::alloc::{GlobalAlloc, Layout};
use core::sync::atomic::{AtomicUsize, Ordering};
use std::alloc::System;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
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
