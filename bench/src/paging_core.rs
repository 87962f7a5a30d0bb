//! The state machine alone: what a fault costs it, whatever the number of pages, and what it keeps of each.

use std::time::Instant as Stopwatch;

use anyhow::{Result, ensure};
use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node::{Config, Fault, Node, Output};
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
    let heads = ["pages", "slots", "ns per fault, grant and eviction"];
    let mut table =
        Table::new("core", "The paging core, one thread, slots for a sixteenth of the pages", &heads);
    let mut points = Vec::new();
    let mut slowest = 0.0_f64;
    for power in [10, 16, 22] {
        let pages = 1u32 << power;
        let samples: Vec<f64> = (0..effort.pick(9, 1))
            .map(|_| fault_ns(pages, effort.pick(400_000, 1_000)))
            .collect::<Result<_>>()?;
        let spread = Spread::of(&samples);
        slowest = slowest.max(spread.median);
        points.push((f64::from(pages), spread.median));
        table.push(vec![
            Cell::Count(pages.into()),
            Cell::Count((pages / 16).into()),
            Cell::Spread(spread, 0),
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

/// Does at once what the node says; requests are granted.
fn drive(node: &mut Node<'_>, now: Instant) {
    let mut buffer = [0; HEADER_BYTES];
    // Victims are unmapped when the node is drained, as a driver does.
    let mut victims = [PageId(0); 32];
    let (mut victim_count, mut granted, mut mapped) = (0, false, None);
    loop {
        match node.poll(&mut buffer) {
            Output::Idle(_) => break,
            Output::Transmit { to, len, .. } => {
                if let Ok(request) = Message::parse(&buffer[..len]) {
                    request.grant(to, PAGE_BYTES).emit(&mut buffer);
                    granted = true;
                    break;
                }
            }
            Output::Unmap { page, .. } => {
                victims[victim_count] = page;
                victim_count += 1;
            }
            Output::Map { page, .. } => mapped = Some(page),
            Output::Store { .. } | Output::Hide { .. } | Output::WakePage { .. } | Output::WakeSlots => {}
        }
    }
    for page in &victims[..victim_count] {
        node.handle_unmapped(now, *page);
        while !matches!(node.poll(&mut buffer), Output::Idle(_)) {}
    }
    if granted && node.handle_message(now, &buffer).is_ok() {
        drive(node, now);
    }
    if let Some(page) = mapped {
        node.handle_filled(now, page);
        while !matches!(node.poll(&mut buffer), Output::Idle(_)) {}
    }
}
