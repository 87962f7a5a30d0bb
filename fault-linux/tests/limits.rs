//! Systems that refuse: userfaultfd forbidden, mappings running out.

mod common;

use common::{Numbers, OTHER, Scene, is_child, read_word, run_in_child, word};
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use fault_linux::{BackendKind, Errno};

/// Has the kernel refuse `userfaultfd` to this process with EPERM, as a container's profile does.
fn forbid_userfaultfd() {
    const LOAD_NUMBER: u16 = 0x20; // BPF_LD | BPF_W | BPF_ABS
    const JUMP_EQUAL: u16 = 0x15; // BPF_JMP | BPF_JEQ | BPF_K
    const RETURN: u16 = 0x06; // BPF_RET | BPF_K
    let number = u32::try_from(libc::SYS_userfaultfd).unwrap();
    let refuse = libc::SECCOMP_RET_ERRNO | u32::try_from(libc::EPERM).unwrap();
    let mut program = [
        libc::sock_filter { code: LOAD_NUMBER, jt: 0, jf: 0, k: 0 },
        libc::sock_filter { code: JUMP_EQUAL, jt: 0, jf: 1, k: number },
        libc::sock_filter { code: RETURN, jt: 0, jf: 0, k: refuse },
        libc::sock_filter { code: RETURN, jt: 0, jf: 0, k: libc::SECCOMP_RET_ALLOW },
    ];
    let program = libc::sock_fprog { len: 4, filter: program.as_mut_ptr() };
    // SAFETY: gives up privileges for this process and its children, nothing else.
    assert_eq!(unsafe { libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) }, 0);
    // SAFETY: the program is valid for the call.
    let result = unsafe { libc::prctl(libc::PR_SET_SECCOMP, libc::SECCOMP_MODE_FILTER, &raw const program) };
    assert_eq!(result, 0);
}

#[test]
fn where_userfaultfd_is_refused_the_next_backend_is_used_and_the_reason_kept() {
    if is_child() {
        forbid_userfaultfd();
        let scene = Scene::SMALL;
        let region = scene.region(None);
        let choice = region.choice();
        assert_eq!(choice.used, BackendKind::Segv);
        assert_eq!(choice.declined.len(), 1);
        assert_eq!(
            (choice.declined[0].backend, choice.declined[0].why),
            (BackendKind::Uffd, Errno(libc::EPERM))
        );
        assert_eq!(choice.to_string(), "segv; not uffd: Operation not permitted (os error 1)");
        let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
        assert_eq!(read_word(attached.bytes(), scene.page_bytes, 2, 0), word(2, 0));
        return;
    }
    let output = run_in_child("where_userfaultfd_is_refused_the_next_backend_is_used_and_the_reason_kept");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn a_backend_asked_for_by_name_is_used_or_refused() {
    if is_child() {
        forbid_userfaultfd();
        let scene = Scene::SMALL;
        let config = scene.config();
        let setup = fault_linux::Setup {
            node: config,
            policy: PolicyKind::Fifo,
            reference: ReferenceSource::Nothing,
            hidden_per_cent: 0,
            prefetch: false,
            seed: 0,
            slot_count: 4,
            home: None,
            backend: Some(BackendKind::Uffd),
        };
        // SAFETY: no page is ever granted.
        let error = unsafe { fault_linux::Region::new(setup) }.unwrap_err();
        assert_eq!(
            error.to_string(),
            "no backend can be used here; uffd: Operation not permitted (os error 1)"
        );
        return;
    }
    let output = run_in_child("a_backend_asked_for_by_name_is_used_or_refused");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// `BOUNDED`, `segv`: pages of 4 KB, more slots than the kernel allows mappings. Alone in its process, since others
/// could not start threads beside it.
#[test]
fn near_the_limit_on_mappings_segv_withholds_slots_and_goes_on() {
    if is_child() {
        let scene = Scene {
            pages: 120_000,
            page_bytes: 4096,
            slots: 60_000,
            policy: PolicyKind::Random,
            ..Scene::SMALL
        };
        let region = scene.region(Some(BackendKind::Segv));
        let (slots, withheld) = (region.slot_count(), region.choice().slots_withheld);
        assert_eq!(slots + withheld, scene.slots);
        assert!(withheld > 0, "{slots} slots fit; the limit is higher here, and the test needs more pages");
        let attached = region.attach(scene.port(&scene.page_file(OTHER))).unwrap();
        let mut numbers = Numbers(3);
        for _ in 0..4 * slots {
            let page = numbers.below(scene.pages);
            assert_eq!(read_word(attached.bytes(), 4096, page, 1), word(page, 1));
        }
        attached.check().unwrap();
        assert!(region.stats().evicted_pages > u64::from(slots) / 4, "{:?}", region.stats());
        // The rest of the process is not sick: it can still start a thread and map memory.
        std::thread::spawn(|| vec![1u8; 8 << 20].len()).join().unwrap();
        return;
    }
    let output = run_in_child("near_the_limit_on_mappings_segv_withholds_slots_and_goes_on");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}
