//! What a region promises its readers, with every backend.

mod common;

use core::sync::atomic::{AtomicUsize, Ordering};
use core::time::Duration;
use std::os::fd::AsFd;
use std::sync::Barrier;
use std::sync::RwLock;
use std::time::Instant;

use common::{Numbers, OTHER, Scene, read_word, word};
use dsm_core::failure::Failure;
use dsm_core::id::{NodeId, PageId};
use dsm_core::replacement::PolicyKind;
use dsm_core::transport::{Lossy, Received, SendError, Transport};
use fault_linux::{AttachError, BackendKind, Reason, Region};

const BY_HARDWARE: [BackendKind; 2] = [BackendKind::Uffd, BackendKind::Segv];

#[test]
fn every_page_reads_as_its_owner_has_it_with_few_slots() {
    for backend in BY_HARDWARE {
        for slots in [1, 2, 5, 32, 100] {
            for policy in PolicyKind::ALL {
                let scene = Scene { slots, policy, ..Scene::SMALL };
                let region = scene.region(Some(backend));
                let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
                let mut numbers = Numbers(9);
                for _ in 0..2000 {
                    let (page, index) = (numbers.below(scene.pages), numbers.below(scene.words_per_page()));
                    let found = read_word(attached.bytes(), scene.page_bytes, page, index);
                    assert_eq!(found, word(page, index), "{backend} {policy} page {page}");
                }
                attached.check().unwrap();
                let stats = region.stats();
                assert_eq!(stats.fetched_pages + stats.soft_faults, stats.faults);
                assert_eq!(stats.received_bytes, stats.fetched_pages * u64::from(scene.page_bytes));
                assert!(stats.fetched_pages >= 32 && (slots >= 32 || stats.evicted_pages > 0), "{stats:?}");
                assert_eq!(attached.stats().miss_ns.count(), stats.faults);
            }
        }
    }
}

#[test]
fn records_read_the_same_with_every_backend() {
    for backend in [BackendKind::Uffd, BackendKind::Segv, BackendKind::Soft] {
        for policy in PolicyKind::ALL {
            let scene = Scene { policy, ..Scene::SMALL };
            let region = scene.region(Some(backend));
            let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
            let mut numbers = Numbers(5);
            for _ in 0..2000 {
                let (page, index) = (numbers.below(scene.pages), numbers.below(scene.words_per_page() - 1));
                let offset = u64::from(page) * u64::from(scene.page_bytes) + u64::from(index) * 8;
                let record = attached.record(offset, 16).unwrap();
                assert_eq!(record[..8], word(page, index).to_le_bytes());
                assert_eq!(record[8..], word(page, index + 1).to_le_bytes());
            }
            let end = u64::from(scene.pages) * u64::from(scene.page_bytes);
            assert!(attached.record(end - 8, 8).is_some());
            for (offset, length) in
                [(end - 8, 9), (end, 1), (u64::MAX, 1), (u64::from(scene.page_bytes) - 4, 8)]
            {
                assert!(attached.record(offset, length).is_none(), "{offset} {length}");
            }
            assert!(region.stats().evicted_pages > 0);
        }
    }
}

#[test]
fn threads_that_want_the_same_pages_fetch_them_once() {
    for backend in BY_HARDWARE {
        let scene = Scene { slots: 32, ..Scene::SMALL };
        let region = scene.region(Some(backend));
        let pages = scene.page_file(OTHER);
        let barrier = Barrier::new(4);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    let attached = region.attach(scene.port(&pages)).unwrap();
                    for page in 0..scene.pages {
                        barrier.wait();
                        assert_eq!(read_word(attached.bytes(), scene.page_bytes, page, 7), word(page, 7));
                    }
                });
            }
        });
        let stats = region.stats();
        assert_eq!(stats.fetched_pages, 32, "{stats:?}");
    }
}

#[test]
fn many_threads_make_progress_with_one_slot() {
    for backend in [BackendKind::Uffd, BackendKind::Segv, BackendKind::Soft] {
        let scene = Scene { slots: 1, page_bytes: 4096, ..Scene::SMALL };
        let region = scene.region(Some(backend));
        let pages = scene.page_file(OTHER);
        std::thread::scope(|scope| {
            for thread in 1..=3 {
                let (region, pages) = (&region, &pages);
                scope.spawn(move || {
                    let attached = region.attach(scene.port(pages)).unwrap();
                    let mut numbers = Numbers(thread);
                    for _ in 0..300 {
                        let page = numbers.below(scene.pages);
                        let record = attached.record(u64::from(page) * 4096 + 24, 8).unwrap();
                        assert_eq!(record[..], word(page, 3).to_le_bytes());
                    }
                });
            }
        });
    }
}

#[test]
fn lost_messages_cost_time_and_nothing_else() {
    let scene = Scene { deadline_us: 20_000_000, ..Scene::SMALL };
    let region = scene.region(None);
    let attached = region.attach(Lossy::new(scene.port(&scene.page_file(OTHER)), 200, 3)).unwrap();
    for page in 0..scene.pages {
        assert_eq!(read_word(attached.bytes(), scene.page_bytes, page, 100), word(page, 100));
    }
    assert!(region.stats().resends > 0);
    attached.check().unwrap();
}

/// Takes every request and answers none.
#[derive(Debug)]
struct Silence;

impl Transport for Silence {
    fn send(&mut self, _to: NodeId, _message: &[u8]) -> Result<(), SendError> {
        Ok(())
    }

    fn receive(&mut self, deadline: dsm_core::time::Instant) -> Option<Received<'_>> {
        let rest = deadline.since(transport_shm::now());
        std::thread::park_timeout(Duration::from_micros(rest));
        None
    }
}

#[test]
fn a_silent_owner_ends_every_wait_by_the_deadline() {
    for backend in [BackendKind::Uffd, BackendKind::Segv, BackendKind::Soft] {
        let scene = Scene { deadline_us: 200_000, ..Scene::SMALL };
        let region = scene.region(Some(backend));
        let start = Instant::now();
        std::thread::scope(|scope| {
            for thread in 0..4u32 {
                let region = &region;
                scope.spawn(move || {
                    let attached = region.attach(Silence).unwrap();
                    // Two want the same page, two others.
                    let page = [2u32, 2, 3, 6][thread as usize];
                    let offset = u64::from(page) * u64::from(scene.page_bytes);
                    match attached.record(offset, 8) {
                        Some(record) => assert_eq!(record[..], [0; 8], "a failed page reads as zeros"),
                        None => assert_eq!(backend, BackendKind::Soft),
                    }
                    let failure = attached.check().unwrap_err();
                    assert_eq!(failure.reason, Reason::Cluster(Failure::NoAnswer { from: OTHER }));
                });
            }
        });
        assert!(start.elapsed() < Duration::from_secs(5), "{backend}: {:?}", start.elapsed());
    }
}

#[test]
fn the_replicated_baseline_faults_on_nothing() {
    let scene = Scene::SMALL;
    let image = scene.image();
    // SAFETY: nobody writes the image.
    let region =
        unsafe { Region::replicated(image.as_fd(), scene.pages, scene.page_bytes as usize) }.unwrap();
    let attached = region.attach(Silence).unwrap();
    for page in 0..scene.pages {
        assert_eq!(read_word(attached.bytes(), scene.page_bytes, page, 11), word(page, 11));
    }
    assert_eq!(region.stats().faults, 0);
    assert_eq!(region.choice().used, BackendKind::Replicated);
}

#[test]
fn pages_larger_and_smaller_than_usual() {
    for backend in BY_HARDWARE {
        for page_bytes in [4096, 65536, 2 << 20] {
            let scene = Scene { pages: 12, page_bytes, slots: 2, ..Scene::SMALL };
            let region = scene.region(Some(backend));
            let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
            for page in (0..scene.pages).rev().chain(0..scene.pages) {
                let last = scene.words_per_page() - 1;
                assert_eq!(read_word(attached.bytes(), page_bytes, page, last), word(page, last));
            }
        }
    }
}

#[test]
fn a_missed_page_brings_along_what_follows_it_for_as_long_as_that_is_used() {
    const TILES: u32 = 256;
    for backend in [BackendKind::Uffd, BackendKind::Segv, BackendKind::Soft] {
        let scene =
            Scene { pages: 4 * TILES, page_bytes: 4096, slots: 64, neighbours_max: 4, ..Scene::SMALL };
        // Of each four pages the last two are the other owner's. A tile uses both, or one.
        let draw = |is_used: bool| {
            let region = scene.region(Some(backend));
            let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
            region.begin_frame(&(0..TILES).collect::<Vec<_>>());
            for tile in 0..TILES {
                attached.begin_tile(tile);
                let pages = if is_used { 4 * tile + 2..4 * tile + 4 } else { 4 * tile + 2..4 * tile + 3 };
                for page in pages.clone() {
                    let record = attached.record(u64::from(page) * 4096 + 40, 8).unwrap();
                    assert_eq!(record[..], word(page, 5).to_le_bytes(), "{backend}: page {page}");
                }
                attached.end_tile(tile, &pages.map(PageId).collect::<Vec<_>>());
            }
            attached.check().unwrap();
            region.stats()
        };
        let stats = draw(true);
        assert_eq!(
            (stats.fetched_pages, stats.neighbour_prefetch.wasted),
            (2 * u64::from(TILES), 0),
            "{backend}"
        );
        assert_eq!(stats.requests, stats.faults + stats.neighbour_prefetch.asked, "{backend}");
        assert!(stats.neighbour_prefetch.used > 200, "{backend}: {stats:?}");
        let stats = draw(false);
        assert!((1..40).contains(&stats.neighbour_prefetch.asked), "{backend}: {stats:?}");
    }
}

#[test]
fn a_thread_is_attached_to_one_region_at_a_time_and_can_come_back() {
    let scene = Scene::SMALL;
    let (one, two) = (scene.region(None), scene.region(None));
    let attached = one.attach(Silence).unwrap();
    assert_eq!(two.attach(Silence).unwrap_err(), AttachError::Already);
    drop(attached);
    let pages = scene.page_file(OTHER);
    for region in [&two, &one] {
        let attached = region.attach(scene.port(&pages)).unwrap();
        assert_eq!(read_word(attached.bytes(), scene.page_bytes, 3, 0), word(3, 0));
    }
}

#[test]
fn a_thread_that_blocks_the_signals_is_not_attached() {
    let region = Scene::SMALL.region(None);
    std::thread::spawn(move || {
        // SAFETY: an all-zero set is what `sigemptyset` makes on Linux.
        let mut set: libc::sigset_t = unsafe { core::mem::zeroed() };
        // SAFETY: the set is this thread's own.
        unsafe { libc::sigaddset(&raw mut set, libc::SIGBUS) };
        // SAFETY: changes this thread's mask, and this thread ends soon.
        unsafe { libc::pthread_sigmask(libc::SIG_BLOCK, &raw const set, core::ptr::null_mut()) };
        assert_eq!(region.attach(Silence).unwrap_err(), AttachError::SignalsBlocked);
    })
    .join()
    .unwrap();
}

#[test]
fn the_kernel_is_told_efault_until_the_range_is_touched() {
    for backend in BY_HARDWARE {
        let scene = Scene { slots: 8, ..Scene::SMALL };
        let region = scene.region(Some(backend));
        let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
        let page_bytes = scene.page_bytes as usize;
        // The pipe's end is anything that takes bytes: a file that forgets them would not look at them.
        let file = std::fs::File::from(
            transport_shm::PageFile::create(1 << 20).unwrap().as_fd().try_clone_to_owned().unwrap(),
        );
        // Pages 2 and 3 are the other owner's.
        let range = 2 * page_bytes + 100..4 * page_bytes - 100;
        let write = || std::os::unix::fs::FileExt::write_at(&file, &attached.bytes()[range.clone()], 0);
        assert_eq!(write().unwrap_err().raw_os_error(), Some(libc::EFAULT), "{backend}");
        attached.touch(range.clone()).unwrap();
        assert_eq!(write().unwrap(), range.len(), "{backend}");
    }
}

#[test]
fn the_error_number_survives_a_fault() {
    let scene = Scene::SMALL;
    let region = scene.region(None);
    let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
    // SAFETY: without arguments.
    let errno = unsafe { libc::__errno_location() };
    // SAFETY: the address of this thread's own error number, good while the thread lives.
    let errno = unsafe { &mut *errno };
    *errno = 77;
    let found = read_word(attached.bytes(), scene.page_bytes, 2, 0);
    assert_eq!(*errno, 77);
    assert_eq!(found, word(2, 0));
}

#[test]
fn no_more_pages_are_resident_than_there_are_slots() {
    for backend in BY_HARDWARE {
        let scene = Scene { pages: 512, page_bytes: 4096, slots: 64, ..Scene::SMALL };
        let region = scene.region(Some(backend));
        let pages = scene.page_file(OTHER);
        let most = AtomicUsize::new(0);
        // The system's count goes page by page: nothing may come or go meanwhile.
        let still = RwLock::new(());
        std::thread::scope(|scope| {
            for thread in 1..=2 {
                let (region, pages, most, still) = (&region, &pages, &most, &still);
                scope.spawn(move || {
                    let attached = region.attach(scene.port(pages)).unwrap();
                    let mut numbers = Numbers(thread);
                    for round in 0..4000 {
                        let page = numbers.below(scene.pages);
                        let reading = still.read().unwrap();
                        assert_eq!(read_word(attached.bytes(), 4096, page, 5), word(page, 5));
                        drop(reading);
                        if round % 100 == 0 {
                            let _counting = still.write().unwrap();
                            most.fetch_max(resident_pages(attached.bytes()), Ordering::Relaxed);
                        }
                    }
                });
            }
        });
        let most = most.into_inner();
        // Half of the pages are home pages, and always there.
        assert!((256 + 32..=256 + 64).contains(&most), "{backend}: {most}");
    }
}

/// Pages of the range that the system says are in memory, by `mincore`, or by reading the process's page map where
/// the range is private: that tells of each page whether this process has it.
fn resident_pages(bytes: &[u8]) -> usize {
    let map = std::fs::File::open("/proc/self/pagemap").unwrap();
    let mut entries = vec![0u8; bytes.len() / 4096 * 8];
    let first = bytes.as_ptr().addr() as u64 / 4096;
    std::os::unix::fs::FileExt::read_exact_at(&map, &mut entries, first * 8).unwrap();
    entries.chunks(8).filter(|entry| entry[7] & 0x80 != 0).count()
}
