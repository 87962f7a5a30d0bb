//! `NO_ALLOC`: both cores linked into a program that has no allocator, no C library and no unwinder, and put to work
//! in it: a page is faulted in, tiles of triangles and of spheres are traced, and two nodes share the tiles of a frame. The exit code says how far it came; 0 is all the way.
//!
//! `./ci.sh nostd` builds it, runs it, and looks through its symbols.
#![no_std]
#![no_main]

use core::arch::{asm, naked_asm};
use core::panic::PanicInfo;

use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node::{Config, Fault, Node, Output};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{HEADER_BYTES, Message};
use rt_core::camera::OrbitPlace;
use rt_core::schedule::ledger::{self, Arrival, DealtNode, DealtTile, LedgerConfig};
use rt_core::schedule::message::MESSAGE_BYTES_MAX;
use rt_core::schedule::worker::{self, PeerEntry as NodeEntry, TileEntry, WorkerConfig};
use rt_core::schedule::{self, Balancer, Ledger, LedgerStorage, PageMap, Worker, WorkerStorage};
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TILE_SIZE, TileId, Tiles, WorkCounts, render_tile};

/// A scene image as a file on disk or a page from the network would have it, aligned as a page is.
#[repr(align(4096))]
struct Aligned<T: ?Sized>(T);

static TRIANGLES: &Aligned<[u8]> = &Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/knot.msv")));
static SPHERES: &Aligned<[u8]> = &Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/sphereflake.msv")));

/// What goes wrong, as an exit code.
#[derive(Clone, Copy)]
enum Trouble {
    Paging = 1,
    Tracing = 2,
    Balancing = 3,
}

fn work() -> Result<(), Trouble> {
    for kind in PolicyKind::ALL {
        page_in(kind).ok_or(Trouble::Paging)?;
    }
    for image in [TRIANGLES, SPHERES] {
        trace(&image.0).filter(|hits| *hits > 0).ok_or(Trouble::Tracing)?;
    }
    balance().ok_or(Trouble::Balancing)
}

/// Faults on each page of another node in turn, through a cache of two.
fn page_in(kind: PolicyKind) -> Option<()> {
    let placement = Stripes::new(16, 1, NodeId(0), 2).ok()?;
    let mut pages = [PageEntry::EMPTY; 16];
    let mut slots = [SlotEntry::EMPTY; 2];
    let (mut peers, mut requests) = ([PeerEntry::EMPTY; 2], [RequestEntry::EMPTY; 4]);
    let storage =
        Storage { pages: &mut pages, slots: &mut slots, peers: &mut peers, requests: &mut requests };
    let config = Config::new(NodeId(0), placement, 4096);
    let mut node = Node::new(config, storage, Policy::new(kind, 1)).ok()?;
    for page in (1..16).step_by(2).map(PageId) {
        let now = Instant::from_micros(u64::from(page.0));
        let mut answer = node.handle_fault(now, page, PortId(0));
        while answer != Fault::Ready {
            drive(&mut node, now)?;
            answer = node.handle_fault_again(now, page, PortId(0), now);
        }
    }
    (node.stats().evicted_pages == 6).then_some(())
}

/// Does what the state machine says: every request is granted at once, every page appears and leaves at once.
fn drive(node: &mut Node<'_>, now: Instant) -> Option<()> {
    let mut buffer = [0; HEADER_BYTES];
    loop {
        match node.poll(&mut buffer) {
            Output::Idle(_) => return Some(()),
            Output::Transmit { to, len, .. } => {
                let grant = Message::parse(&buffer[..len]).ok()?.grant(to, 4096);
                grant.emit(&mut buffer);
                node.handle_message(now, &buffer).ok()?;
            }
            Output::Map { page, .. } => node.handle_filled(now, page),
            Output::Unmap { page, .. } => node.handle_unmapped(now, page),
            Output::Hide { page, .. } => node.handle_covered(now, page),
            Output::Store { .. } | Output::WakePage { .. } | Output::WakeSlots => {}
        }
    }
}

/// Traces a small picture and counts the hits.
fn trace(image: &[u8]) -> Option<u64> {
    let scene = SceneView::new(Flat::new(image)).ok()?;
    let orbit = Orbit::around(&scene.header().view);
    let place = OrbitPlace { radius: 0.75, elevation: 10.0, frame: 1, frames: 8 };
    let frame = Frame::on_orbit(&orbit, &place, 48, 32).ok()?;
    let tiles = Tiles::of(frame.width, frame.height);
    let kernel = Kernel::fastest();
    let mut counts = WorkCounts::default();
    let mut hits = 0;
    for id in 0..tiles.count() {
        let tile = tiles.get(TileId(id))?;
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        let counted = render_tile(&scene, &frame, tile, kernel, &mut pixels[..tile.pixels()], &mut counts);
        if counted.damaged > 0 {
            return None;
        }
        hits += counted.hits;
    }
    Some(hits)
}

/// Has two nodes draw a frame, of which the second is much faster and takes what the first has too much of.
fn balance() -> Option<()> {
    const TILES: usize = 16;
    let tiles = Tiles::of(4 * TILE_SIZE, 4 * TILE_SIZE);
    let (balancer, resend_us, seed) = (Balancer::StealNear, 1000, 1);
    let (mut dealt, mut order, mut nodes) = ([DealtTile::EMPTY; TILES], [0; TILES], [DealtNode::EMPTY; 2]);
    let config = LedgerConfig {
        epoch: 1,
        nodes: 2,
        threads: 1,
        threads_per_core: 1,
        tiles,
        balancer,
        resend_us,
        confirms: false,
        seed,
    };
    let storage = LedgerStorage { tiles: &mut dealt, order: &mut order, nodes: &mut nodes };
    let mut ledger = Ledger::new(config, storage);
    let mut entries = [[TileEntry::EMPTY; TILES]; 2];
    let mut orders = [[0; TILES]; 2];
    let mut peers = [[NodeEntry::EMPTY; 3]; 2];
    let ([first, second], [one, other], [left, right]) = (&mut entries, &mut orders, &mut peers);
    let worker = |me, tiles_of, order, peers| {
        let config = WorkerConfig {
            epoch: 1,
            me,
            nodes: 2,
            threads: 1,
            threads_per_core: 1,
            tiles,
            balancer,
            resend_us,
            is_display_reliable: true,
            seed,
        };
        Worker::new(config, WorkerStorage { tiles: tiles_of, order, peers })
    };
    let mut workers = [worker(0, first, one, left), worker(1, second, other, right)];
    ledger.begin(1);
    for step in 0..1000 {
        pass_messages(&mut ledger, &mut workers)?;
        if ledger.missing() == 0 {
            return (workers[1].stats().taken > 0).then_some(());
        }
        // The first has its turn once in eight.
        let index = usize::from(step % 8 != 0);
        if let Some(tile) = workers[index].take(0) {
            workers[index].handle_drawn(0, 1, tile, 1000, PageMap::of([tile.0], 16)).then_some(())?;
            let node = if index == 0 { 0 } else { 1 };
            (ledger.handle_drawn(node, 1, tile) == Arrival::First).then_some(())?;
        }
    }
    None
}

/// Delivers all that the two nodes and the display have to say.
fn pass_messages(ledger: &mut Ledger<'_>, workers: &mut [Worker<'_>; 2]) -> Option<()> {
    let mut buffer = [0; MESSAGE_BYTES_MAX];
    loop {
        let mut is_quiet = true;
        while let ledger::Output::Transmit { to, length } = ledger.poll(0, &mut buffer) {
            let (message, _) = schedule::Message::parse(&buffer[..length]).ok()?;
            workers.get_mut(usize::from(to))?.handle_message(0, &message).ok()?;
        }
        for index in 0..2 {
            while let worker::Output::Transmit { to, length } = workers[index].poll(0, &mut buffer) {
                is_quiet = false;
                let (message, _) = schedule::Message::parse(&buffer[..length]).ok()?;
                match workers.get_mut(usize::from(to)) {
                    Some(worker) => worker.handle_message(0, &message).ok()?,
                    None => ledger.handle_message(&message).ok()?,
                }
            }
        }
        if is_quiet {
            return Some(());
        }
    }
}

extern "C" fn start() -> ! {
    match work() {
        Ok(()) => exit(0),
        Err(trouble) => exit(trouble as i32),
    }
}

/// Where the kernel enters: aligns the stack as functions expect it.
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn _start() -> ! {
    naked_asm!("and rsp, -16", "call {start}", "ud2", start = sym start)
}

fn exit(code: i32) -> ! {
    const EXIT: i64 = 60;
    // SAFETY: ends the process.
    unsafe { asm!("syscall", in("rax") EXIT, in("rdi") i64::from(code), options(noreturn)) }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    exit(101)
}

/// The four functions that compiled code may call without being asked. A C library has them; there is none here.
mod memory {
    use core::arch::asm;

    #[unsafe(no_mangle)]
    unsafe extern "C" fn memcpy(to: *mut u8, from: *const u8, length: usize) -> *mut u8 {
        // SAFETY: the caller vouches for both ranges.
        unsafe { asm!("rep movsb", inout("rcx") length => _, inout("rdi") to => _, inout("rsi") from => _) };
        to
    }

    #[unsafe(no_mangle)]
    unsafe extern "C" fn memmove(to: *mut u8, from: *const u8, length: usize) -> *mut u8 {
        if to.addr().wrapping_sub(from.addr()) >= length {
            // SAFETY: copying upwards never reads what it has written.
            return unsafe { memcpy(to, from, length) };
        }
        let (last_to, last_from) =
            (to.wrapping_add(length).wrapping_sub(1), from.wrapping_add(length).wrapping_sub(1));
        // SAFETY: the caller vouches for both ranges; copying downwards never reads what it has written.
        unsafe {
            asm!("std", "rep movsb", "cld", inout("rcx") length => _, inout("rdi") last_to => _, inout("rsi") last_from => _);
        };
        to
    }

    #[unsafe(no_mangle)]
    unsafe extern "C" fn memset(to: *mut u8, byte: i32, length: usize) -> *mut u8 {
        // SAFETY: the caller vouches for the range.
        unsafe { asm!("rep stosb", inout("rcx") length => _, inout("rdi") to => _, in("al") byte as u8) };
        to
    }

    #[unsafe(no_mangle)]
    unsafe extern "C" fn memcmp(one: *const u8, other: *const u8, length: usize) -> i32 {
        for index in 0..length {
            // SAFETY: the caller vouches for the range.
            let a = unsafe { one.add(index).read_volatile() };
            // SAFETY: as above.
            let b = unsafe { other.add(index).read_volatile() };
            if a != b {
                return i32::from(a) - i32::from(b);
            }
        }
        0
    }
}
