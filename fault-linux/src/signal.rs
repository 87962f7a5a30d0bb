//! Catching faults, and handing on those that are not ours.

use core::cell::Cell;
use core::ffi::{c_int, c_void};
use core::mem::MaybeUninit;
use core::ptr;
use core::sync::atomic::{AtomicUsize, Ordering};
use std::sync::OnceLock;

use crate::sys::{self, Errno};

/// What a thread that is attached to a region offers to the handler.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Server {
    /// The thread's worker; `serve` knows its type.
    pub(crate) worker: *mut c_void,
    /// Serves one fault.
    ///
    /// # Safety
    /// Called on the worker's own thread, with the `worker` beside it, while nobody else uses that.
    pub(crate) serve: unsafe fn(worker: *mut c_void, Fault) -> Outcome,
}

/// A fault as the handler sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    pub(crate) signal: c_int,
    pub(crate) address: usize,
    /// The load was a store. Known only where the processor's state tells.
    pub(crate) is_write: bool,
}

/// What became of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// The page is there, or reads as zeros; the load may be tried again.
    Served,
    /// The address is in no region of this thread.
    NotOurs,
    /// The program wrote to a region.
    Write,
}

thread_local! {
    /// This thread's server. Plain data with a constant start, so reading it in a handler is one load.
    static SERVER: Cell<Option<Server>> = const { Cell::new(None) };
}

/// The handlers that were there before ours.
struct Previous {
    bus: libc::sigaction,
    segv: libc::sigaction,
}

static PREVIOUS: OnceLock<Previous> = OnceLock::new();

/// The address ranges of all regions, so that a thread that is not attached gets told what it did.
static REGIONS: [Span; REGIONS_MAX] =
    [const { Span { start: AtomicUsize::new(0), end: AtomicUsize::new(0) } }; REGIONS_MAX];

/// Regions that a process can have at once.
pub(crate) const REGIONS_MAX: usize = 16;

struct Span {
    start: AtomicUsize,
    end: AtomicUsize,
}

/// A region's entry in the list, taken out on drop.
#[derive(Debug)]
pub(crate) struct Listed(usize);

impl Listed {
    /// Enters an address range, or gives `None` when the list is full.
    pub(crate) fn new(start: usize, end: usize) -> Option<Self> {
        let free =
            |span: &Span| span.start.compare_exchange(0, start, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        let index = REGIONS.iter().position(free)?;
        REGIONS[index].end.store(end, Ordering::Release);
        Some(Self(index))
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        REGIONS[self.0].end.store(0, Ordering::Release);
        REGIONS[self.0].start.store(0, Ordering::Release);
    }
}

/// Makes `server` this thread's, or takes it away again with `None`. Returns the one before.
pub(crate) fn set_server(server: Option<Server>) -> Option<Server> {
    SERVER.replace(server)
}

/// Installs the handler for both signals, once per process.
pub(crate) fn install() -> Result<(), Errno> {
    if PREVIOUS.get().is_some() {
        return Ok(());
    }
    // What was there is kept before ours can be called, so that ours always finds it.
    let previous = Previous { bus: current(libc::SIGBUS)?, segv: current(libc::SIGSEGV)? };
    if PREVIOUS.set(previous).is_ok() {
        replace(libc::SIGBUS, &our_action())?;
        replace(libc::SIGSEGV, &our_action())?;
    }
    Ok(())
}

/// Whether this thread blocks SIGBUS or SIGSEGV; the kernel would kill it at its first fault.
pub(crate) fn blocks_faults() -> bool {
    let mut mask = MaybeUninit::<libc::sigset_t>::uninit();
    // SAFETY: only asks, and writes the answer to `mask`.
    let result = unsafe { libc::pthread_sigmask(libc::SIG_BLOCK, ptr::null(), mask.as_mut_ptr()) };
    if result != 0 {
        return true;
    }
    // SAFETY: the call has filled it.
    let mask = unsafe { mask.assume_init() };
    [libc::SIGBUS, libc::SIGSEGV].into_iter().any(|signal| {
        // SAFETY: reads a set that is filled.
        unsafe { libc::sigismember(&raw const mask, signal) == 1 }
    })
}

fn our_action() -> libc::sigaction {
    let mut mask = MaybeUninit::<libc::sigset_t>::uninit();
    // SAFETY: fills the set.
    unsafe { libc::sigemptyset(mask.as_mut_ptr()) };
    for signal in [libc::SIGBUS, libc::SIGSEGV] {
        // Both stay blocked while the handler runs: a fault inside it is our bug and must die, not recurse.
        // SAFETY: the set is filled.
        unsafe { libc::sigaddset(mask.as_mut_ptr(), signal) };
    }
    libc::sigaction {
        sa_sigaction: handle as *const () as usize,
        // SAFETY: filled above.
        sa_mask: unsafe { mask.assume_init() },
        // SIGINFO: the address comes with it. ONSTACK: a stack overflow leaves no other stack to run on. RESTART: a
        // fault never interrupts a system call, but a signal somebody sends may.
        sa_flags: libc::SA_SIGINFO | libc::SA_ONSTACK | libc::SA_RESTART,
        sa_restorer: None,
    }
}

fn current(signal: c_int) -> Result<libc::sigaction, Errno> {
    let mut action = MaybeUninit::uninit();
    // SAFETY: only asks, and writes the answer to `action`.
    if unsafe { libc::sigaction(signal, ptr::null(), action.as_mut_ptr()) } != 0 {
        return Err(Errno::last());
    }
    // SAFETY: the call has filled it.
    Ok(unsafe { action.assume_init() })
}

fn replace(signal: c_int, action: &libc::sigaction) -> Result<(), Errno> {
    // SAFETY: our handler keeps to what a handler may do; see the crate's documentation.
    let result = unsafe { libc::sigaction(signal, action, ptr::null_mut()) };
    if result == 0 { Ok(()) } else { Err(Errno::last()) }
}

/// The handler of SIGBUS and SIGSEGV.
extern "C" fn handle(signal: c_int, info: *mut libc::siginfo_t, context: *mut c_void) {
    let errno = Errno::last();
    // SAFETY: the kernel gives a filled structure to a handler with SA_SIGINFO, and nobody else has it.
    let details = unsafe { &*info };
    if details.si_code <= 0 {
        return die_of(signal);
    }
    // SAFETY: for a fault, which a positive code says it is, the address field is the one in use.
    let address = unsafe { details.si_addr() }.addr();
    let fault = Fault { signal, address, is_write: is_write(context) };
    match serve(fault) {
        Outcome::Served => {}
        Outcome::NotOurs => hand_on(signal, info, context),
        Outcome::Write => {
            sys::complain(b"memsavvy: the program wrote to the shared scene, which is read-only\n");
            hand_on(signal, info, context);
        }
    }
    errno.restore();
}

fn serve(fault: Fault) -> Outcome {
    if let Some(server) = SERVER.get() {
        // SAFETY: the worker is this thread's, and the code that was interrupted by this fault is a load from the
        // region, which no method of the worker makes.
        let outcome = unsafe { (server.serve)(server.worker, fault) };
        if outcome != Outcome::NotOurs {
            return outcome;
        }
    }
    if is_in_a_region(fault.address) {
        sys::complain(b"memsavvy: a thread read the shared scene without being attached to it\n");
    }
    Outcome::NotOurs
}

fn is_in_a_region(address: usize) -> bool {
    REGIONS.iter().any(|span| {
        let end = span.end.load(Ordering::Acquire);
        (span.start.load(Ordering::Relaxed)..end).contains(&address)
    })
}

/// Somebody sent this signal; no load is waiting. Dies of it, as a process without our handler would.
///
/// Not handed on: the handler of Rust's library takes any such signal for a fault, restores the default and returns,
/// counting on the fault to come again; a signal that was sent does not.
fn die_of(signal: c_int) {
    set_default(signal);
    // SAFETY: sends to this thread; it arrives when the handler returns and unblocks it.
    unsafe { libc::raise(signal) };
}

/// Does what would have been done had we not been here. The load is tried again afterwards.
fn hand_on(signal: c_int, info: *mut libc::siginfo_t, context: *mut c_void) {
    let previous =
        PREVIOUS.get().map(|previous| if signal == libc::SIGBUS { &previous.bus } else { &previous.segv });
    match previous {
        Some(action) if !is_default(action.sa_sigaction) => call(action, signal, info, context),
        // To ignore a fault is not possible; the kernel kills either way.
        _ => set_default(signal),
    }
}

fn is_default(handler: usize) -> bool {
    handler == libc::SIG_DFL || handler == libc::SIG_IGN
}

fn call(action: &libc::sigaction, signal: c_int, info: *mut libc::siginfo_t, context: *mut c_void) {
    if action.sa_flags & libc::SA_SIGINFO != 0 {
        type Handler = extern "C" fn(c_int, *mut libc::siginfo_t, *mut c_void);
        // SAFETY: whoever installed it said by its flags that it is of this type.
        let handler = unsafe { core::mem::transmute::<usize, Handler>(action.sa_sigaction) };
        handler(signal, info, context);
    } else {
        type Handler = extern "C" fn(c_int);
        // SAFETY: as above.
        let handler = unsafe { core::mem::transmute::<usize, Handler>(action.sa_sigaction) };
        handler(signal);
    }
}

fn set_default(signal: c_int) {
    let mut mask = MaybeUninit::<libc::sigset_t>::uninit();
    // SAFETY: fills the set.
    unsafe { libc::sigemptyset(mask.as_mut_ptr()) };
    // SAFETY: filled above.
    let sa_mask = unsafe { mask.assume_init() };
    let action = libc::sigaction { sa_sigaction: libc::SIG_DFL, sa_mask, sa_flags: 0, sa_restorer: None };
    let _ = replace(signal, &action);
}

/// Whether the processor says that the access was a store.
#[cfg(target_arch = "x86_64")]
fn is_write(context: *mut c_void) -> bool {
    const ERROR_WRITE: i64 = 1 << 1;
    let context = context.cast::<libc::ucontext_t>();
    // SAFETY: the kernel gives a filled context to a handler with SA_SIGINFO.
    let registers = unsafe { &(*context).uc_mcontext.gregs };
    registers[libc::REG_ERR as usize] & ERROR_WRITE != 0
}

/// Whether the access was a store is not known here; `segv` finds out when a page that is there faults again.
#[cfg(not(target_arch = "x86_64"))]
fn is_write(_context: *mut c_void) -> bool {
    false
}
