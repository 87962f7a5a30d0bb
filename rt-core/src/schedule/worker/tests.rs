use super::*;
use crate::schedule::message::TILES_MAX;
use crate::tile::TILE_SIZE;
use std::vec::Vec;

const TILES: u32 = 16;
const DISPLAY: u16 = 3;

/// Node 1 of 3, one thread, 4 x 4 tiles.
fn with_worker(balancer: Balancer, test: impl FnOnce(&mut Worker<'_>)) {
    with_worker_on(1, balancer, test);
}

/// The same, with so many render threads on a core.
fn with_worker_on(threads_per_core: u16, balancer: Balancer, test: impl FnOnce(&mut Worker<'_>)) {
    let mut tiles = [TileEntry::EMPTY; TILES as usize];
    let mut order = [0; TILES as usize];
    let mut peers = [PeerEntry::EMPTY; 4];
    let config = WorkerConfig {
        epoch: 1,
        me: 1,
        nodes: 3,
        threads: 1,
        threads_per_core,
        tiles: Tiles::of(4 * TILE_SIZE, 4 * TILE_SIZE),
        balancer,
        resend_us: 1000,
        is_display_reliable: true,
        seed: 1,
    };
    let storage = WorkerStorage { tiles: &mut tiles, order: &mut order, peers: &mut peers };
    test(&mut Worker::new(config, storage));
}

fn message(frame: u32, from: u16, body: Body) -> Message {
    Message { epoch: 1, stamp: Stamp { frame, view: 0 }, from, to: 1, body }
}

fn deal(worker: &mut Worker<'_>, frame: u32, tiles: impl IntoIterator<Item = u32>) {
    let tiles: heapless::Vec<TileId, TILES_MAX> = tiles.into_iter().map(TileId).collect();
    worker.handle_message(0, &message(frame, DISPLAY, Body::Deal { number: 0, tiles })).unwrap();
    worker.check_invariants();
}

/// Draws all that is queued; tile `t` takes `cost(t)` and uses page `t`.
fn draw_all(worker: &mut Worker<'_>, frame: u32, cost_us: impl Fn(u32) -> u32) -> Vec<u32> {
    let mut drawn = Vec::new();
    while let Some(tile) = worker.take(0) {
        let map = PageMap::of([tile.0], TILES);
        assert!(worker.handle_drawn(0, frame, tile, cost_us(tile.0), map));
        drawn.push(tile.0);
    }
    drawn
}

/// All that the worker has to say.
fn said(worker: &mut Worker<'_>) -> Vec<(u16, Body)> {
    let mut buffer = [0; crate::schedule::message::MESSAGE_BYTES_MAX];
    let mut said = Vec::new();
    while let Output::Transmit { to, length } = worker.poll(0, &mut buffer) {
        said.push((to, Message::parse(&buffer[..length]).unwrap().0.body));
    }
    said
}

fn ask(worker: &mut Worker<'_>, frame: u32, number: u32, pages: core::ops::Range<u32>) -> Vec<u32> {
    let map = PageMap::of(pages, TILES);
    worker.handle_message(0, &message(frame, 2, Body::Ask { number, map, waits: false })).unwrap();
    worker.check_invariants();
    let given = said(worker).into_iter().find_map(|(to, body)| match body {
        Body::Give { gifts, .. } if to == 2 => Some(gifts.iter().map(|gift| gift.tile.0).collect()),
        _ => None,
    });
    given.unwrap_or_default()
}

#[test]
fn a_thief_gets_half_of_the_work_and_first_what_lies_on_its_pages() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        draw_all(worker, 1, |_| 1000);
        deal(worker, 2, 0..TILES);
        let mut given = ask(worker, 2, 1, 4..9);
        given.sort_unstable();
        assert_eq!(given.len(), 8);
        assert!((4..9).all(|tile| given.contains(&tile)), "{given:?}");
    });
}

#[test]
fn half_is_measured_in_time_not_in_tiles() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        draw_all(worker, 1, |tile| if tile < 4 { 7000 } else { 1000 });
        deal(worker, 2, 0..TILES);
        // 28 ms lie on the first four tiles, 12 ms on the others: half is 20 ms.
        let given = ask(worker, 2, 1, 0..4);
        let cost: u32 = given.iter().map(|tile| if *tile < 4 { 7 } else { 1 }).sum();
        // A third dear one would be more than that.
        assert_eq!((given.len(), cost), (2, 14), "{given:?}");
    });
}

#[test]
fn what_is_less_than_the_margin_is_kept() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        draw_all(worker, 1, |_| 10);
        deal(worker, 2, 0..TILES);
        // 160 us in all; 200 us is the least that is shared.
        assert!(ask(worker, 2, 1, 0..16).is_empty());
        assert!(said(worker).is_empty());
    });
}

#[test]
fn the_papers_donor_gives_one_tile_and_that_is_the_last() {
    with_worker(Balancer::Steal, |worker| {
        deal(worker, 2, 0..TILES);
        let last = worker.queued_tiles().last().unwrap().0;
        assert_eq!(ask(worker, 2, 1, 0..16), [last]);
    });
}

#[test]
fn a_question_that_comes_twice_is_answered_once() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        assert_eq!(ask(worker, 1, 1, 0..0).len(), 8);
        let body = Body::Ask { number: 1, map: PageMap::EMPTY, waits: false };
        assert_eq!(worker.handle_message(0, &message(1, 2, body)), Err(Refused::OutOfTurn));
        assert!(said(worker).is_empty());
    });
}

#[test]
fn a_gift_is_sent_again_until_it_is_taken_and_nothing_else_is_given_to_that_peer_before() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        let given = ask(worker, 1, 1, 0..0);
        assert!(ask(worker, 1, 2, 0..0).is_empty());
        worker.handle_timeout(1000);
        let again = said(worker);
        assert!(
            matches!(&again[..], [(2, Body::Give { number: 1, gifts, .. })] if gifts.len() == given.len())
        );
        worker.handle_message(0, &message(1, 2, Body::Taken { number: 1 })).unwrap();
        worker.check_invariants();
        worker.handle_timeout(100_000);
        assert!(said(worker).is_empty());
        assert_eq!(ask(worker, 1, 3, 0..0).len(), 4);
    });
}

#[test]
fn a_dear_tile_is_drawn_first() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, 0..TILES);
        draw_all(worker, 1, |tile| if tile == 9 { 90_000 } else { 1000 });
        deal(worker, 2, 0..TILES);
        assert_eq!(worker.take(0), Some(TileId(9)));
    });
}

#[test]
fn who_finds_nothing_leaves_word_and_rests_and_is_woken_by_a_gift() {
    with_worker(Balancer::StealNear, |worker| {
        deal(worker, 1, [3]);
        assert_eq!(worker.take(0), Some(TileId(3)));
        assert!(worker.handle_drawn(0, 1, TileId(3), 1000, PageMap::EMPTY));
        assert_eq!(worker.take(0), None);
        let mut asked = Vec::new();
        for _ in 0..10 {
            for (to, body) in said(worker) {
                let Body::Ask { number, waits, .. } = body else { continue };
                asked.push((to, waits));
                let nothing = Body::Nothing { number, left_us: 0, map: PageMap::EMPTY, busiest: None };
                worker.handle_message(0, &message(1, to, nothing)).unwrap();
            }
        }
        asked.sort_unstable();
        assert_eq!(asked, [(0, false), (0, true), (2, false), (2, true)]);
        assert!(worker.is_resting());
        let gift = Gift { tile: TileId(5), cost_us: 700, map: PageMap::EMPTY };
        let give = Body::Give { number: 1, left_us: 0, gifts: [gift].into_iter().collect() };
        worker.handle_message(0, &message(1, 2, give)).unwrap();
        assert!(!worker.is_resting());
        assert_eq!((worker.take(0), worker.cost_us(TileId(5))), (Some(TileId(5)), 700));
    });
}

#[test]
fn odd_frames_are_drawn_backwards_and_another_frame_voids_the_last() {
    with_worker(Balancer::Static, |worker| {
        deal(worker, 2, 0..TILES);
        let mut forwards = draw_all(worker, 2, |_| 1000);
        deal(worker, 3, 0..TILES);
        assert!(!worker.handle_drawn(0, 2, TileId(0), 1, PageMap::EMPTY), "frame 2 is over");
        forwards.reverse();
        assert_eq!(draw_all(worker, 3, |_| 1000), forwards);
    });
}

#[test]
fn where_threads_share_a_core_an_idle_one_leaves_it_to_the_other_before_it_asks() {
    let asks = |worker: &mut Worker<'_>| {
        said(worker).iter().filter(|(_, body)| matches!(body, Body::Ask { .. })).count()
    };
    for (threads_per_core, waits_us) in [(1, 0), (2, 16_000 + 16_000 + TURN_US)] {
        with_worker_on(threads_per_core, Balancer::StealNear, |worker| {
            deal(worker, 1, 0..TILES);
            draw_all(worker, 1, |_| 1000);
            assert_eq!(asks(worker), usize::from(waits_us == 0));
            if waits_us > 0 {
                // Time stands still here: the 16 ms of its tiles have yet to pass, too.
                let mut buffer = [0; crate::schedule::message::MESSAGE_BYTES_MAX];
                assert_eq!(worker.poll(0, &mut buffer), Output::Idle(Some(waits_us)));
                worker.handle_timeout(waits_us - 1);
                assert_eq!(asks(worker), 0);
                worker.handle_timeout(waits_us);
                assert_eq!(asks(worker), 1);
            }
        });
    }
}
