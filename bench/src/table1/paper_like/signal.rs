//! The reading thread's half: the paper's `memintercept`.

use core::cell::UnsafeCell;
use core::ffi::{c_int, c_void};
use core::marker::PhantomData;
use core::mem::MaybeUninit;
use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};
use std::io;

use super::Shared;
use crate::space::Space;

/// Faults are caught while this lives, on the thread that made it. Whoever caught them before gets them back.
#[derive(Debug)]
pub(in super::super) struct Caught<'a> {
    shared: &'a Shared,
    before: libc::sigaction,
    not_send: PhantomData<*mut ()>,
}

/// A counting semaphore of the system's library.
#[derive(Debug)]
pub(super) struct Semaphore(Box<UnsafeCell<libc::sem_t>>);

/// Whose faults the handler serves.
static CURRENT: AtomicPtr<Shared> = AtomicPtr::new(ptr::null_mut());

impl<'a> Caught<'a> {
    pub(super) fn new(shared: &'a Shared) -> io::Result<Self> {
        CURRENT.store(ptr::from_ref(shared).cast_mut(), Ordering::Release);
        let action = libc::sigaction {
            sa_sigaction: memintercept as *const () as usize,
            sa_mask: empty_set(),
            // SIGINFO: the address comes with it. ONSTACK: as the library's own handler of stack overflows.
            sa_flags: libc::SA_SIGINFO | libc::SA_ONSTACK,
            sa_restorer: None,
        };
        Ok(Self { shared, before: replace(&action)?, not_send: PhantomData })
    }

    pub(in super::super) fn space(&self) -> Space {
        self.shared.space
    }

    /// Faults so far.
    pub(in super::super) fn faults(&self) -> u64 {
        self.shared.faults.load(Ordering::Relaxed)
    }

    /// Loads a word, counted from the start of the space.
    pub(in super::super) fn load(&self, index: usize) -> u64 {
        assert!(index < self.shared.space.words());
        let place = self.shared.area.start().cast::<u64>().wrapping_add(index);
        // SAFETY: the place lies in the reserved range and is aligned. If its page is absent the load faults, and the
        // handler, which is installed as long as `self` lives, has it mapped and filled before the load goes on. Only
        // this thread reads, and the communication thread writes or evicts only while this thread waits.
        unsafe { place.read_volatile() }
    }
}

impl Drop for Caught<'_> {
    fn drop(&mut self) {
        let replaced = replace(&self.before);
        debug_assert!(replaced.is_ok());
        CURRENT.store(ptr::null_mut(), Ordering::Release);
    }
}

/// The handler: finds the page, asks its owner for it, and waits until the communication thread has brought it.
extern "C" fn memintercept(signal: c_int, info: *mut libc::siginfo_t, _context: *mut c_void) {
    // SAFETY: the kernel gives a filled structure to a handler with SA_SIGINFO, and nobody else has it.
    let info = unsafe { &*info };
    // SAFETY: for a fault, the address field is the one in use.
    let address = unsafe { info.si_addr() }.addr();
    // SAFETY: `Caught` keeps what the pointer points at borrowed for as long as this handler is installed.
    let shared = unsafe { CURRENT.load(Ordering::Acquire).as_ref() };
    match shared.and_then(|shared| Some((shared, shared.page_at(address)?))) {
        Some((shared, page)) => {
            shared.faults.fetch_add(1, Ordering::Relaxed);
            shared.ask_for(page);
            shared.arrived.wait();
        }
        // Not ours: the load is tried again and the process dies of it, as it should.
        // SAFETY: sets the default action.
        None => unsafe {
            libc::signal(signal, libc::SIG_DFL);
        },
    }
}

// SAFETY: a semaphore is for several threads; the library's calls on it are made for that.
unsafe impl Send for Semaphore {}
// SAFETY: as above.
unsafe impl Sync for Semaphore {}

impl Semaphore {
    pub(super) fn new() -> io::Result<Self> {
        // SAFETY: all zeros are bytes of a semaphore that is not in use yet.
        let semaphore = Self(Box::new(UnsafeCell::new(unsafe { core::mem::zeroed() })));
        // SAFETY: the box keeps it in place as long as it lives.
        match unsafe { libc::sem_init(semaphore.0.get(), 0, 0) } {
            0 => Ok(semaphore),
            _ => Err(io::Error::last_os_error()),
        }
    }

    pub(super) fn post(&self) {
        // SAFETY: initialised by `new`.
        unsafe { libc::sem_post(self.0.get()) };
    }

    /// Waits for a post. Interruptions by other signals do not count.
    fn wait(&self) {
        // SAFETY: initialised by `new`.
        while unsafe { libc::sem_wait(self.0.get()) } != 0 {}
    }
}

impl Drop for Semaphore {
    fn drop(&mut self) {
        // SAFETY: initialised by `new`; whoever waits borrows it.
        unsafe { libc::sem_destroy(self.0.get()) };
    }
}

/// Installs an action for SIGSEGV and gives back the one before.
fn replace(action: &libc::sigaction) -> io::Result<libc::sigaction> {
    let mut before = MaybeUninit::uninit();
    // SAFETY: the action is either ours, which keeps to what a handler may do, or the one that was there before.
    match unsafe { libc::sigaction(libc::SIGSEGV, action, before.as_mut_ptr()) } {
        // SAFETY: the call has filled it.
        0 => Ok(unsafe { before.assume_init() }),
        _ => Err(io::Error::last_os_error()),
    }
}

fn empty_set() -> libc::sigset_t {
    let mut set = MaybeUninit::uninit();
    // SAFETY: fills the set.
    unsafe { libc::sigemptyset(set.as_mut_ptr()) };
    // SAFETY: filled above.
    unsafe { set.assume_init() }
}
