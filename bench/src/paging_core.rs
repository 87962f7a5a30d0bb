//! The state machine alone: what a fault costs it, whatever the number of pages, and what it keeps of each.

use core::hint::black_box;
use std::time::Instant as Stopwatch;

use anyhow::{Result, ensure};
use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node::{Config, EVICT_BATCH_MAX, Fault, Node, Output};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{HEADER_BYTES, Message};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::plot::{Axis, Chart, Line, Plot};
use crate::space::Numbers;
use crate::spread::Spread;
use crate::table::{Cell, Table};

pub(crate) const EXPERIMENT: Experiment = Experiment {
    name: "core",
    shows: "what one fault costs the paging core, at 2^10 to 2^22 pages, and what it keeps of each page",
    run,
};

const PAGE_BYTES: u32 = 16384;
const OWNER: NodeId = NodeId(1);
const PORT: PortId = PortId(0);

/// Nanoseconds that a fault may cost.
const FAULT_NS_MAX: f64 = 200.0;

fn run(effort: Effort) -> Result<Findings> {
    let heads =
        ["pages", "slots", "ns per fault, grant and eviction", "ns of its random memory accesses alone"];
    let mut table =
        Table::new("core", "The paging core, one thread, slots for a sixteenth of the pages", &heads);
    let mut points = Vec::new();
    let mut slowest = 0.0_f64;
    for power in [10, 16, 22] {
        let pages = 1u32 << power;
        let samples: Vec<f64> = (0..effort.pick(9, 1))
            .map(|_| fault_ns(pages, effort.pick(400_000, 1_000)))
            .collect::<Result<_>>()?;
        let memory: Vec<f64> =
            (0..effort.pick(9, 1)).map(|_| memory_ns(pages, effort.pick(2_000_000, 1_000))).collect();
        let spread = Spread::of(&samples);
        slowest = slowest.max(spread.median);
        points.push((f64::from(pages), spread.median));
        table.push(vec![
            Cell::Count(pages.into()),
            Cell::Count((pages / 16).into()),
            Cell::Spread(spread, 0),
            Cell::Spread(Spread::of(&memory), 0),
        ]);
    }
    table.note("each fault is of a random page that is absent; its grant is parsed and checked; its slot comes of an eviction");
    let memory = memory();
    let line = Line { name: "fault".to_owned(), points };
    let x = Axis { label: "pages of the address space", is_logarithmic: true };
    let y = Axis { label: "ns", is_logarithmic: false };
    let chart = Chart { title: "one fault, granted, with an eviction".to_owned(), x, y, lines: vec![line] };
    let aims = vec![
        Aim::at_most("ns of the core per fault, whatever the number of pages", slowest, FAULT_NS_MAX),
        Aim::at_most("bytes per page of the address space", size_of::<PageEntry>() as f64, 8.0),
        Aim::at_most("bytes per slot", size_of::<SlotEntry>() as f64, 32.0),
    ];
    Ok(Findings { tables: vec![table, memory], aims, plot: Some(Plot { charts: vec![chart] }) })
}

/// What is lent for one of each.
fn memory() -> Table {
    let mut table = Table::new("memory", "What the core keeps of one of each", &["of one", "bytes"]);
    let sizes = [
        ("page of the address space", size_of::<PageEntry>()),
        ("slot", size_of::<SlotEntry>()),
        ("owner", size_of::<PeerEntry>()),
        ("request under way", size_of::<RequestEntry>()),
    ];
    for (of, bytes) in sizes {
        table.push(vec![Cell::Text(of.to_owned()), Cell::Count(bytes as u64)]);
    }
    table
}

/// Nanoseconds of one fault, all that the state machine does for it, over `faults` faults.
fn fault_ns(pages: u32, faults: u32) -> Result<f64> {
    let slots = pages as usize / 16;
    let placement = Stripes::new(pages, 64, OWNER, 1)?;
    let config = Config { evict_batch: 16, ..Config::new(NodeId(0), placement, PAGE_BYTES) };
    let mut entries = (vec![PageEntry::EMPTY; pages as usize], vec![SlotEntry::EMPTY; slots]);
    let (mut peers, mut requests) = ([PeerEntry::EMPTY], [RequestEntry::EMPTY; 16]);
    let storage =
        Storage { pages: &mut entries.0, slots: &mut entries.1, peers: &mut peers, requests: &mut requests };
    let mut node = Node::new(config, storage, Policy::new(PolicyKind::Random, 1))?;
    let mut numbers = Numbers::new(2004);
    let mut now = 0;
    let mut fetch = |node: &mut Node<'_>, count: u32| {
        let mut fetched = 0;
        while fetched < count {
            let page = PageId(u32::try_from(numbers.below(pages as usize)).unwrap_or(0));
            now += 10;
            fetched += u32::from(bring(node, Instant::from_micros(now), page));
        }
    };
    // Until the cache is full, faults find free slots.
    fetch(&mut node, u32::try_from(slots)?);
    let before = node.stats();
    let start = Stopwatch::now();
    fetch(&mut node, faults);
    let elapsed = start.elapsed();
    let after = node.stats();
    let fetched = after.fetched_pages - before.fetched_pages;
    ensure!(fetched == u64::from(faults), "{fetched} pages were fetched by {faults} faults");
    ensure!(
        after.evicted_pages - before.evicted_pages + 32 >= fetched,
        "each page that comes makes one leave"
    );
    Ok(elapsed.as_nanos() as f64 / f64::from(faults))
}

/// Faults on a page and brings it in. Tells whether it had to be fetched.
fn bring(node: &mut Node<'_>, now: Instant, page: PageId) -> bool {
    let mut answer = node.handle_fault(now, page, PORT);
    let was_absent = answer != Fault::Ready;
    while answer != Fault::Ready {
        drive(node, now);
        answer = node.handle_fault_again(now, page, PORT, now);
    }
    was_absent
}

/// Does what the node says, all of it, then what comes of that: victims leave, requests are granted, pages filled.
fn drive(node: &mut Node<'_>, now: Instant) {
    let mut work = gather(node);
    for page in &work.victims {
        node.handle_unmapped(now, *page);
        gather(node);
    }
    if let Some(grant) = work.grant.take() {
        let believed = node.handle_message(now, &grant);
        debug_assert!(believed.is_ok(), "a grant that was asked for");
        work.arrived = gather(node).arrived;
    }
    if let Some(page) = work.arrived {
        node.handle_filled(now, page);
        gather(node);
    }
}

/// What one input has caused. To wake somebody is nothing here: nobody sleeps.
#[derive(Default)]
struct Work {
    victims: heapless::Vec<PageId, { EVICT_BATCH_MAX as usize }>,
    /// The answer to the request that was sent.
    grant: Option<[u8; HEADER_BYTES]>,
    arrived: Option<PageId>,
}

/// Polls until the node is idle, as a driver must before its next input.
fn gather(node: &mut Node<'_>) -> Work {
    let mut work = Work::default();
    let mut buffer = [0; HEADER_BYTES];
    loop {
        match node.poll(&mut buffer) {
            Output::Idle(_) => return work,
            Output::Transmit { to, len, .. } => {
                if let Ok(request) = Message::parse(&buffer[..len]) {
                    let mut grant = [0; HEADER_BYTES];
                    request.grant(to, PAGE_BYTES).emit(&mut grant);
                    work.grant = Some(grant);
                }
            }
            Output::Unmap { page, .. } => {
                let pushed = work.victims.push(page);
                debug_assert!(pushed.is_ok(), "a batch is bounded");
            }
            Output::Map { page, .. } => work.arrived = Some(page),
            Output::Store { .. } | Output::Hide { .. } | Output::WakePage { .. } | Output::WakeSlots => {}
        }
    }
}

/// Nanoseconds of the memory accesses alone that a fault makes at random places, one after the other: the entries of the
/// page, of a slot, and of the page that leaves it.
fn memory_ns(pages: u32, faults: u32) -> f64 {
    let mut table = vec![0u32; pages as usize];
    let mut slots: Vec<[u32; 3]> = (0..pages / 16).map(|slot| [slot * 16, 0, 0]).collect();
    let mut numbers = Numbers::new(2004);
    let nothing = black_box(0);
    let mut last = 0;
    let start = Stopwatch::now();
    for _ in 0..faults {
        // What was read decides, as far as the compiler knows, where to read next.
        let page = numbers.below(table.len()) + last;
        let slot = (numbers.below(slots.len()) + (table[page] & nothing) as usize) % slots.len();
        let victim = slots[slot][0];
        slots[slot] = [u32::try_from(page).unwrap_or(0), 1, 2];
        table[page] = u32::try_from(slot).unwrap_or(0);
        last = (core::mem::take(&mut table[victim as usize]) & nothing) as usize;
    }
    black_box(&table);
    start.elapsed().as_nanos() as f64 / f64::from(faults)
}
