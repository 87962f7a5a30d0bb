//! The state machine alone: what a fault costs it, whatever the number of pages, and what it keeps of each.

use core::hint::black_box;

use anyhow::{Result, ensure};
use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node::{Config, EVICT_BATCH_MAX, Fault, Node, Output};
use dsm_core::placement::Stripes;
use dsm_core::replacement::{Policy, PolicyKind};
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};
use dsm_core::time::Instant;
use dsm_core::wire::{HEADER_BYTES, Message};
use rustix::time::{ClockId, clock_gettime};

use crate::experiment::{Effort, Experiment};
use crate::findings::{Aim, Findings};
use crate::memory::{HugePages, Memory};
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

/// Who chooses victims, the size of the address space as a power of two, and what the memory lent for it lies in.
type Case = (PolicyKind, u32, HugePages);

const CASES: [Case; 9] = [
    (PolicyKind::Random, 10, HugePages::Never),
    (PolicyKind::Random, 16, HugePages::Never),
    (PolicyKind::Random, 16, HugePages::Advised),
    (PolicyKind::Random, 22, HugePages::Never),
    (PolicyKind::Random, 22, HugePages::Advised),
    (PolicyKind::Recall, 10, HugePages::Never),
    (PolicyKind::Recall, 16, HugePages::Never),
    (PolicyKind::Recall, 22, HugePages::Never),
    (PolicyKind::Recall, 22, HugePages::Advised),
];

fn run(effort: Effort) -> Result<Findings> {
    let heads = ["policy", "pages", "slots", "lent memory in pages of", "ns a fault", "its memory alone, ns"];
    let title = "One fault, granted, with an eviction: the state machine alone, one thread";
    let mut table = Table::new("core", title, &heads);
    let (mut points, mut aims) = (Vec::new(), Vec::new());
    for case in CASES {
        let (policy, power, huge_pages) = case;
        effort.say(&format!("{policy}, 2^{power} pages"));
        let Timed { fault_ns, memory_ns } = time(case, effort)?;
        let pages = 1_u32 << power;
        table.push(vec![
            Cell::Text(policy.to_string()),
            Cell::Count(pages.into()),
            Cell::Count((pages / PAGES_PER_SLOT).into()),
            Cell::text(name(huge_pages)),
            Cell::Spread(fault_ns, 0),
            Cell::Spread(memory_ns, 0),
        ]);
        if policy == PolicyKind::Random && huge_pages == HugePages::Never {
            points.push((f64::from(pages), fault_ns.median));
        }
        let what =
            format!("ns of the core per fault, {policy}, 2^{power} pages, lent in {}", name(huge_pages));
        aims.push(Aim::at_most(what, fault_ns.median, FAULT_NS_MAX));
    }
    table.note("each fault is of a random page that is absent; its grant is parsed and checked; its slot comes of an eviction");
    table.note("its memory alone: the same accesses to the entries of page, slot and victim, one after the other and without the state machine, less those of a table that fits the cache; recall looks at sixteen slots for one");
    aims.push(Aim::at_most("bytes per page of the address space", size_of::<PageEntry>() as f64, 8.0));
    aims.push(Aim::at_most("bytes per slot", size_of::<SlotEntry>() as f64, 32.0));
    Ok(Findings { tables: vec![table, memory()], aims, plot: Some(plot(points)) })
}

fn plot(points: Vec<(f64, f64)>) -> Plot {
    let line = Line { name: "fault".to_owned(), points };
    let x = Axis { label: "pages of the address space", is_logarithmic: true };
    let y = Axis { label: "ns", is_logarithmic: false };
    Plot {
        charts: vec![Chart {
            title: "one fault, granted, with an eviction".to_owned(),
            x,
            y,
            lines: vec![line],
        }],
    }
}

const fn name(huge_pages: HugePages) -> &'static str {
    match huge_pages {
        HugePages::Never => "4 KB",
        HugePages::Advised => "2 MB",
    }
}

/// Slots are for a sixteenth of the pages.
const PAGES_PER_SLOT: u32 = 16;

/// What the rounds of a case have shown.
struct Timed {
    fault_ns: Spread,
    memory_ns: Spread,
}

/// Times faults, and their accesses to memory, in turns.
fn time(case: Case, effort: Effort) -> Result<Timed> {
    let (_, power, huge_pages) = case;
    let (mut faults, mut accesses) = (Vec::new(), Vec::new());
    for _ in 0..effort.pick(9, 1) {
        faults.push(fault_ns(case, effort.pick(400_000, 1_000))?);
        let cached = memory_ns(1 << 10, huge_pages, effort.pick(1_000_000, 1_000))?;
        accesses.push(memory_ns(1 << power, huge_pages, effort.pick(1_000_000, 1_000))? - cached);
    }
    Ok(Timed { fault_ns: Spread::of(&faults), memory_ns: Spread::of(&accesses) })
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
fn fault_ns((policy, power, huge_pages): Case, faults: u32) -> Result<f64> {
    let pages = 1 << power;
    let slots = (pages / PAGES_PER_SLOT) as usize;
    let placement = Stripes::new(pages, 64, OWNER, 1)?;
    let config = Config { evict_batch: 16, ..Config::new(NodeId(0), placement, PAGE_BYTES) };
    let mut page_memory = Memory::array(pages as usize * size_of::<PageEntry>(), huge_pages)?;
    let mut slot_memory = Memory::array(slots * size_of::<SlotEntry>(), huge_pages)?;
    let (mut peers, mut requests) = ([PeerEntry::EMPTY], [RequestEntry::EMPTY; 16]);
    let storage = Storage {
        pages: page_memory.lend(PageEntry::EMPTY, pages as usize),
        slots: slot_memory.lend(SlotEntry::EMPTY, slots),
        peers: &mut peers,
        requests: &mut requests,
    };
    let mut node = Node::new(config, storage, Policy::new(policy, 1))?;
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
    let start = processor_ns();
    fetch(&mut node, faults);
    let elapsed_ns = processor_ns() - start;
    let after = node.stats();
    let fetched = after.fetched_pages - before.fetched_pages;
    ensure!(fetched == u64::from(faults), "{fetched} pages were fetched by {faults} faults");
    ensure!(
        after.evicted_pages - before.evicted_pages + 32 >= fetched,
        "each page that comes makes one leave"
    );
    Ok(elapsed_ns / f64::from(faults))
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
    let mut work = Work::default();
    work.gather(node);
    for page in core::mem::take(&mut work.victims) {
        node.handle_unmapped(now, page);
        work.gather(node);
    }
    if let Some(grant) = work.grant.take() {
        let believed = node.handle_message(now, &grant);
        debug_assert!(believed.is_ok(), "a grant that was asked for");
        work.gather(node);
    }
    if let Some(page) = work.arrived.take() {
        node.handle_filled(now, page);
        work.gather(node);
    }
}

/// What inputs have caused. To wake somebody is nothing here: nobody sleeps.
#[derive(Default)]
struct Work {
    victims: heapless::Vec<PageId, { EVICT_BATCH_MAX as usize }>,
    /// The answer to the request that was sent.
    grant: Option<[u8; HEADER_BYTES]>,
    arrived: Option<PageId>,
}

impl Work {
    /// Polls until the node is idle, as a driver must before its next input.
    fn gather(&mut self, node: &mut Node<'_>) {
        let mut buffer = [0; HEADER_BYTES];
        loop {
            match node.poll(&mut buffer) {
                Output::Idle(_) => return,
                Output::Transmit { to, len, .. } => {
                    if let Ok(request) = Message::parse(&buffer[..len]) {
                        let mut grant = [0; HEADER_BYTES];
                        request.grant(to, PAGE_BYTES).emit(&mut grant);
                        self.grant = Some(grant);
                    }
                }
                Output::Unmap { page, .. } => {
                    let pushed = self.victims.push(page);
                    debug_assert!(pushed.is_ok(), "a batch is bounded");
                }
                Output::Map { page, .. } => self.arrived = Some(page),
                Output::Store { .. } | Output::Hide { .. } | Output::WakePage { .. } | Output::WakeSlots => {}
            }
        }
    }
}

/// Nanoseconds of the memory accesses alone that a fault makes at random places, one after the other: the entries of the
/// page, of a slot, and of the page that leaves it.
fn memory_ns(pages: u32, huge_pages: HugePages, faults: u32) -> Result<f64> {
    let slots = (pages / PAGES_PER_SLOT) as usize;
    let mut page_memory = Memory::array(pages as usize * size_of::<PageEntry>(), huge_pages)?;
    let mut slot_memory = Memory::array(slots * size_of::<SlotEntry>(), huge_pages)?;
    let table = page_memory.lend(0_u32, pages as usize);
    // As long as the entry of a slot.
    let slots = slot_memory.lend([0_u32; 7], slots);
    for (slot, page) in slots.iter_mut().zip((0..pages).step_by(PAGES_PER_SLOT as usize)) {
        slot[0] = page;
    }
    let mut numbers = Numbers::new(2004);
    let nothing = black_box(0);
    let mut last = 0;
    let start = processor_ns();
    for _ in 0..faults {
        // What was read decides, as far as the compiler knows, where to read next.
        let page = numbers.below(table.len()) + last;
        let slot = (numbers.below(slots.len()) + (table[page] & nothing) as usize) % slots.len();
        let victim = slots[slot][0];
        slots[slot][..3].copy_from_slice(&[u32::try_from(page).unwrap_or(0), 1, 2]);
        table[page] = u32::try_from(slot).unwrap_or(0);
        last = (core::mem::take(&mut table[victim as usize]) & nothing) as usize;
    }
    black_box(&table);
    Ok((processor_ns() - start) / f64::from(faults))
}

/// Processor time of this thread so far: other programs do not count, but that they use the caches too.
fn processor_ns() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}
