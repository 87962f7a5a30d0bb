//! `WHOLE_PAGE`: no reader ever sees a page half filled, with any number of threads.
//!
//! Eight threads, a tiny cache, pages that arrive slowly. The same stress is run on the way of the paper, which makes
//! a page appear and then fills it in place; there it must find half-filled pages, or it would prove nothing.

mod common;

use core::sync::atomic::{AtomicU64, Ordering};

use common::{ME, Numbers, OTHER, Scene, assert_died, is_child, read_word, run_in_child, word};
use dsm_core::home::{Answer, Home};
use dsm_core::id::{NodeId, PageId};
use dsm_core::transport::{Body, Received, SendError, Transport};
use dsm_core::wire::HEADER_BYTES;
use fault_linux::BackendKind;

const THREADS: u64 = 8;
const SCENE: Scene = Scene { pages: 64, page_bytes: 65536, deadline_us: 20_000_000, ..Scene::SMALL };

/// Makes the other owner's pages word by word, giving way to other threads in between.
#[derive(Debug)]
struct SlowPort {
    home: Home,
    answer: Option<Answer>,
    page: Vec<u8>,
}

impl SlowPort {
    fn new() -> Self {
        let config = SCENE.config();
        let home = Home::new(OTHER, config.cluster, config.epoch, config.placement, SCENE.page_bytes);
        Self { home, answer: None, page: vec![0; SCENE.page_bytes as usize] }
    }
}

impl Transport for SlowPort {
    fn send(&mut self, _to: NodeId, message: &[u8]) -> Result<(), SendError> {
        self.answer = self.home.handle_message(message).ok();
        Ok(())
    }

    fn receive(&mut self, _deadline: dsm_core::time::Instant) -> Option<Received<'_>> {
        let Some(Answer::Grant { message, .. }) = self.answer.take() else { return None };
        fill_slowly(message.page, &mut self.page);
        let mut header = [0; HEADER_BYTES];
        message.emit(&mut header);
        Some(Received { header, body: Body::new(&self.page) })
    }
}

fn fill_slowly(page: PageId, bytes: &mut [u8]) {
    for (index, bytes) in bytes.chunks_mut(8).enumerate() {
        bytes.copy_from_slice(&word(page.0, u32::try_from(index).unwrap()).to_le_bytes());
        if index % 1024 == 700 {
            std::thread::yield_now();
        }
    }
}

/// What one thread reads: every other page at random, the others where all threads are at that moment. Counts wrong
/// words.
fn read_many(bytes: &[u8], thread: u64, rounds: u64, clock: &AtomicU64, wrong: &AtomicU64) {
    let mut numbers = Numbers(thread * 31 + 5);
    for round in 0..rounds {
        let hot = u32::try_from(clock.fetch_add(1, Ordering::Relaxed) / 16 % u64::from(SCENE.pages)).unwrap();
        let page = if round % 2 == 0 { numbers.below(SCENE.pages) } else { hot };
        for index in [8191, 4095, 0, 6000, 2800] {
            if read_word(bytes, SCENE.page_bytes, page, index) != word(page, index) {
                wrong.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

#[test]
fn whole_page() {
    for backend in [BackendKind::Uffd, BackendKind::Segv] {
        let region = SCENE.region(Some(backend));
        let (clock, wrong) = (AtomicU64::new(0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for thread in 0..THREADS {
                let (region, clock, wrong) = (&region, &clock, &wrong);
                scope.spawn(move || {
                    let attached = region.attach(SlowPort::new()).unwrap();
                    read_many(attached.bytes(), thread, 1500, clock, wrong);
                    attached.check().unwrap();
                });
            }
        });
        let stats = region.stats();
        assert_eq!(wrong.into_inner(), 0, "{backend}: WHOLE_PAGE");
        // The stress was one: threads met on pages, and pages went.
        assert!(stats.merged_faults > 100 && stats.evicted_pages > 1000, "{backend}: {stats:?}");
    }
}

/// The paper's Figure 2 in one function: map an empty page where the fault was, then receive into it.
mod in_place {
    use super::{PageId, SCENE, fill_slowly};
    use core::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

    const ABSENT: u32 = 0;
    const COMING: u32 = 1;
    const LOADED: u32 = 2;

    static START: AtomicUsize = AtomicUsize::new(0);
    static HAND: AtomicUsize = AtomicUsize::new(0);
    static STATES: [AtomicU32; SCENE.pages as usize] =
        [const { AtomicU32::new(ABSENT) }; SCENE.pages as usize];

    fn moves(page: usize, from: u32, to: u32) -> bool {
        STATES[page].compare_exchange(from, to, Ordering::SeqCst, Ordering::SeqCst).is_ok()
    }

    /// Maps fresh memory over `page`.
    fn map(page: usize, protection: i32) -> *mut u8 {
        let place = START.load(Ordering::Relaxed) + page * SCENE.page_bytes as usize;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED;
        let place = core::ptr::with_exposed_provenance_mut(place);
        // SAFETY: the page lies in the reservation. That other threads may be reading it is the point.
        unsafe { libc::mmap(place, SCENE.page_bytes as usize, protection, flags, -1, 0) }.cast()
    }

    fn evict_one() {
        let loaded = (0..STATES.len()).map(|_| HAND.fetch_add(1, Ordering::Relaxed) % STATES.len());
        if let Some(victim) = loaded.into_iter().find(|page| moves(*page, LOADED, ABSENT)) {
            map(victim, libc::PROT_NONE);
        }
    }

    extern "C" fn handle(_: i32, info: *mut libc::siginfo_t, _: *mut libc::c_void) {
        // SAFETY: the kernel fills it.
        let details = unsafe { &*info };
        // SAFETY: a fault has an address.
        let address = unsafe { details.si_addr() }.addr();
        let page = (address - START.load(Ordering::Relaxed)) / SCENE.page_bytes as usize;
        if !moves(page, ABSENT, COMING) {
            return; // another thread is mapping it
        }
        if STATES.iter().filter(|state| state.load(Ordering::Relaxed) == LOADED).count()
            >= SCENE.slots as usize
        {
            evict_one();
        }
        let place = map(page, libc::PROT_READ | libc::PROT_WRITE);
        // SAFETY: just mapped, and not evicted before it is loaded. Other threads read it meanwhile.
        let bytes = unsafe { core::slice::from_raw_parts_mut(place, SCENE.page_bytes as usize) };
        fill_slowly(PageId(u32::try_from(page).unwrap()), bytes);
        STATES[page].store(LOADED, Ordering::SeqCst);
    }

    /// Reserves the scene's range and serves its faults as the paper does.
    pub(super) fn region() -> &'static [u8] {
        let bytes = SCENE.pages as usize * SCENE.page_bytes as usize;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE;
        // SAFETY: at an address of the kernel's choice.
        let start = unsafe { libc::mmap(core::ptr::null_mut(), bytes, libc::PROT_NONE, flags, -1, 0) };
        START.store(start.expose_provenance(), Ordering::Relaxed);
        // SAFETY: all zero is a value of it.
        let mut action: libc::sigaction = unsafe { core::mem::zeroed() };
        action.sa_sigaction = handle as *const () as usize;
        action.sa_flags = libc::SA_SIGINFO;
        // SAFETY: installs the handler above.
        unsafe { libc::sigaction(libc::SIGSEGV, &raw const action, core::ptr::null_mut()) };
        // SAFETY: readable, by way of the handler, for the life of the process. Its bytes do change; the test reads
        // them by volatile loads only, and looks for that very change.
        unsafe { core::slice::from_raw_parts(start.cast(), bytes) }
    }
}

#[test]
fn the_stress_finds_half_filled_pages_where_they_are_filled_in_place() {
    if is_child() {
        let bytes = in_place::region();
        let (clock, wrong) = (AtomicU64::new(0), AtomicU64::new(0));
        std::thread::scope(|scope| {
            for thread in 0..THREADS {
                let (clock, wrong) = (&clock, &wrong);
                scope.spawn(move || {
                    // In stretches, so that it ends as soon as it has found what it looks for.
                    for stretch in 0..2000 {
                        read_many(bytes, thread * 7919 + stretch, 20, clock, wrong);
                        if wrong.load(Ordering::Relaxed) > 0 {
                            eprintln!("half-filled pages were read");
                            std::process::abort();
                        }
                    }
                });
            }
        });
        return;
    }
    let test = "the_stress_finds_half_filled_pages_where_they_are_filled_in_place";
    assert_died(&run_in_child(test), libc::SIGABRT, "half-filled pages were read");
}

#[test]
fn the_reader_s_own_node_is_not_asked() {
    // A guard on the scene of this file: were everything at home, nothing would be tested.
    let placement = SCENE.config().placement;
    assert_eq!(placement.home_pages(ME), placement.home_pages(OTHER));
}
