//! Faults that are not ours die as they always did; each in a process of its own.

mod common;

use common::{OTHER, Scene, assert_died, is_child, read_word, run_in_child, word};
use fault_linux::BackendKind;

/// Runs `body` in a child, with this thread attached to a region of `backend` that has already served a fault.
fn attached_in_child(backend: BackendKind, body: impl FnOnce(&[u8], &Scene)) {
    let scene = Scene::SMALL;
    let region = scene.region(Some(backend));
    let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
    assert_eq!(read_word(attached.bytes(), scene.page_bytes, 2, 0), word(2, 0));
    body(attached.bytes(), &scene);
}

fn null_dereference(_: &[u8], _: &Scene) {
    let null = core::hint::black_box(core::ptr::null::<u64>());
    // SAFETY: there is none; this is the crash under test.
    unsafe { null.read_volatile() };
}

/// A store to a page that is there, or to one that is not.
fn write_to(bytes: &[u8], scene: &Scene, page: u32) {
    let word = bytes[page as usize * scene.page_bytes as usize..].as_ptr().cast_mut();
    // SAFETY: there is none; this is the crash under test.
    unsafe { word.write_volatile(1) };
}

#[inline(never)]
fn overflow(depth: u64) -> u64 {
    let frame = core::hint::black_box([depth; 64]);
    if depth == u64::MAX { 0 } else { overflow(depth + 1) + frame[usize::try_from(depth % 64).unwrap()] }
}

macro_rules! dies {
    ($($name:ident: $backend:expr, $signal:expr, $words:expr, $body:expr;)*) => {$(
        #[test]
        fn $name() {
            if is_child() {
                attached_in_child($backend, $body);
                return;
            }
            assert_died(&run_in_child(stringify!($name)), $signal, $words);
        }
    )*};
}

dies! {
    a_null_pointer_dies_of_sigsegv_with_uffd: BackendKind::Uffd, libc::SIGSEGV, "", null_dereference;
    a_null_pointer_dies_of_sigsegv_with_segv: BackendKind::Segv, libc::SIGSEGV, "", null_dereference;
    a_stack_overflow_is_still_told_as_one_with_uffd: BackendKind::Uffd, libc::SIGABRT, "has overflowed its stack",
        |_, _| { core::hint::black_box(overflow(0)); };
    a_stack_overflow_is_still_told_as_one_with_segv: BackendKind::Segv, libc::SIGABRT, "has overflowed its stack",
        |_, _| { core::hint::black_box(overflow(0)); };
    a_write_to_a_resident_page_dies_with_uffd: BackendKind::Uffd, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 2);
    a_write_to_a_resident_page_dies_with_segv: BackendKind::Segv, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 2);
    a_write_to_an_absent_page_dies_with_uffd: BackendKind::Uffd, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 7);
    a_write_to_an_absent_page_dies_with_segv: BackendKind::Segv, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 7);
    a_write_to_a_home_page_dies_with_uffd: BackendKind::Uffd, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 0);
    a_write_to_a_home_page_dies_with_segv: BackendKind::Segv, libc::SIGSEGV, "read-only",
        |bytes, scene| write_to(bytes, scene, 0);
    a_thread_that_is_not_attached_is_told_so_with_uffd: BackendKind::Uffd, libc::SIGBUS, "without being attached",
        read_elsewhere;
    a_thread_that_is_not_attached_is_told_so_with_segv: BackendKind::Segv, libc::SIGSEGV, "without being attached",
        read_elsewhere;
    a_signal_that_somebody_sent_is_obeyed_at_once: BackendKind::Segv, libc::SIGSEGV, "", |_, _| {
        // SAFETY: sends a signal to this thread.
        unsafe { libc::raise(libc::SIGSEGV) };
        // Where the signal was swallowed, this is reached and the child ends well.
        std::thread::park_timeout(core::time::Duration::from_secs(1));
    };
}

fn read_elsewhere(bytes: &[u8], scene: &Scene) {
    std::thread::scope(|scope| {
        scope.spawn(|| read_word(bytes, scene.page_bytes, 11, 0));
    });
}

/// What a child made by fork sees of the region: nothing, and its parent's pages stay as they are.
#[test]
fn a_child_made_by_fork_dies_of_reading_and_the_parent_goes_on() {
    for backend in [BackendKind::Uffd, BackendKind::Segv] {
        attached_in_child(backend, |bytes, scene| {
            for page in [2, 7] {
                // SAFETY: the child makes one load and ends; it takes no lock that another thread may hold.
                let child = unsafe { libc::fork() };
                if child == 0 {
                    read_word(bytes, scene.page_bytes, page, 0);
                    // SAFETY: ends the child at once.
                    unsafe { libc::_exit(0) };
                }
                let mut status = 0;
                // SAFETY: waits for the child just made.
                unsafe { libc::waitpid(child, &raw mut status, 0) };
                assert!(libc::WIFSIGNALED(status), "{backend}: page {page} was read by a child: {status}");
                assert_eq!(libc::WTERMSIG(status), libc::SIGSEGV);
            }
            assert_eq!(read_word(bytes, scene.page_bytes, 7, 0), word(7, 0));
        });
    }
}
