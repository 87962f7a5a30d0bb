//! Virtual time agrees with arithmetic.

use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::Ended;
use dsm_sim::network::{Card, Cards, Link, Links, Network};
use dsm_sim::paging::{Config, Costs, Memory, Report, Workload, World};
use dsm_sim::time::{ms, us};

/// 8 Gbit/s: a byte takes a nanosecond.
const BYTE_A_NS: u64 = 8_000_000_000;
const HEADER_BYTES: u64 = dsm_core::wire::HEADER_BYTES as u64;
const PAGE_BYTES: u64 = 16384;

/// Readers that touch each page once, in order, from one store; a slot for every page.
fn readers(count: u16, pages: u32, change: impl Fn(&mut Config)) -> Report {
    let mut config = Config::with_stores(count, 1, pages).unwrap();
    config.network = Network {
        links: Links::Same(Link::new(us(20))),
        cards: Cards::Same(Card::new(BYTE_A_NS)),
        overhead_bytes: 0,
    };
    config.costs = Costs::NONE;
    config.workload = Workload::Window { pages: 1, touches_a_page: 1 };
    (config.threads, config.touches, config.slots, config.think_ns) = (1, pages, pages, 0);
    change(&mut config);
    let report = World::new(&mut Memory::new(config).unwrap(), PolicyKind::Fifo, 1).run();
    assert_eq!(report.ended, Ended::Done);
    report
}

#[test]
fn a_fault_alone_takes_the_way_there_and_back_and_the_work_on_it() {
    let report = readers(1, 100, |config| {
        config.costs =
            Costs { trap_ns: 1_000, serve_ns: 700, fill_ns: 300, unmap_ns: 1 << 40, wake_ns: 1 << 40 };
    });
    let one = 1_000 + (HEADER_BYTES + 20_000) + 700 + (HEADER_BYTES + PAGE_BYTES + 20_000) + 300;
    assert_eq!(report.latencies.count(), 100);
    assert_eq!(report.latencies.max(), one);
    assert_eq!(report.at.as_ns(), 100 * one);
    assert_eq!((report.total().requests, report.total().resends), (100, 0));
}

#[test]
fn a_page_that_has_come_is_read_in_no_time() {
    let report = readers(1, 10, |config| (config.touches, config.think_ns) = (50, 0));
    let one = 2 * (HEADER_BYTES + 20_000) + PAGE_BYTES;
    assert_eq!((report.at.as_ns(), report.total().touches, report.total().faults), (10 * one, 50, 10));
}

#[test]
fn what_a_victim_costs_is_paid_by_who_needs_the_slot() {
    let with_slots = |slots| {
        readers(1, 100, |config| {
            config.slots = slots;
            config.costs = Costs { unmap_ns: 5_000, wake_ns: 1 << 40, ..Costs::NONE };
        })
    };
    let (few, enough) = (with_slots(4), with_slots(100));
    assert_eq!(few.total().evicted_pages, 96);
    assert_eq!(few.at.since(enough.at), 96 * 5_000);
}

#[test]
fn an_owner_asked_by_all_serves_as_fast_as_its_card() {
    let pages = 200;
    let report = readers(32, pages, |_| ());
    let sent = 32 * u64::from(pages) * (HEADER_BYTES + PAGE_BYTES);
    let took = report.at.as_ns();
    assert!(took > sent, "{took} ns for {sent} bytes at a byte a nanosecond");
    assert!(took < sent + sent / 100, "{took} ns for {sent} bytes: the card was idle");
}

#[test]
fn an_owner_that_computes_for_long_serves_as_fast_as_it_can() {
    let report = readers(8, 100, |config| config.costs.serve_ns = us(50));
    let served = 800 * us(50);
    let took = report.at.as_ns();
    assert!(took > served && took < served + served / 100, "{took} {served}");
}

#[test]
fn a_reader_on_a_slow_line_takes_the_time_of_its_line() {
    let slow = |node: dsm_core::id::NodeId| Card::new(if node.0 == 0 { BYTE_A_NS / 100 } else { BYTE_A_NS });
    let report = readers(1, 50, |config| config.network.cards = Cards::Each(slow));
    let one = 100 * HEADER_BYTES + us(20) + us(20) + 100 * (HEADER_BYTES + PAGE_BYTES);
    assert_eq!(report.latencies.max(), one);
    assert!(one < ms(2));
}
