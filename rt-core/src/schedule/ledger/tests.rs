use super::*;
use crate::schedule::message::MESSAGE_BYTES_MAX;
use crate::tile::TILE_SIZE;
use std::vec::Vec;

const TILES: u32 = 16;

/// Three nodes of one thread, 4 x 4 tiles.
fn with_ledger(balancer: Balancer, test: impl FnOnce(&mut Ledger<'_>)) {
    with_ledger_on(1, balancer, test);
}

/// The same, with so many render threads on a core.
fn with_ledger_on(threads_per_core: u16, balancer: Balancer, test: impl FnOnce(&mut Ledger<'_>)) {
    let mut tiles = [DealtTile::EMPTY; TILES as usize];
    let mut order = [0; TILES as usize];
    let mut nodes = [DealtNode::EMPTY; 3];
    let config = LedgerConfig {
        epoch: 1,
        nodes: 3,
        threads: 1,
        threads_per_core,
        tiles: Tiles::of(4 * TILE_SIZE, 4 * TILE_SIZE),
        balancer,
        resend_us: 1000,
        confirms: false,
        seed: 1,
    };
    test(&mut Ledger::new(config, LedgerStorage { tiles: &mut tiles, order: &mut order, nodes: &mut nodes }));
}

/// What is dealt to each node; all of it is taken.
fn dealt(ledger: &mut Ledger<'_>) -> [Vec<u32>; 3] {
    let mut dealt = [const { Vec::new() }; 3];
    let mut buffer = [0; MESSAGE_BYTES_MAX];
    while let Output::Transmit { to, length } = ledger.poll(0, &mut buffer) {
        let (message, _) = Message::parse(&buffer[..length]).unwrap();
        let Body::Deal { number, tiles } = message.body else { continue };
        dealt[usize::from(to)].extend(tiles.iter().map(|tile| tile.0));
        let taken = Message { from: to, to: 3, body: Body::Taken { number }, ..message };
        ledger.handle_message(&taken).unwrap();
        ledger.check_invariants();
    }
    dealt
}

fn draw(ledger: &mut Ledger<'_>, frame: u32, node: u16, tiles: &[u32]) {
    for tile in tiles {
        assert_eq!(ledger.handle_drawn(node, frame, TileId(*tile)), Arrival::First);
        ledger.check_invariants();
    }
}

#[test]
fn a_frame_begins_with_the_tiles_that_each_node_drew_in_the_last() {
    with_ledger(Balancer::StealNear, |ledger| {
        ledger.begin(1);
        let first = dealt(ledger);
        assert_eq!(first.iter().map(Vec::len).sum::<usize>(), 16);
        draw(ledger, 1, 0, &first[0]);
        // Node 1 has taken what was node 2's.
        draw(ledger, 1, 1, &[&first[1][..], &first[2]].concat());
        assert_eq!((ledger.missing(), ledger.moved()), (0, u32::try_from(first[2].len()).unwrap()));
        ledger.begin(2);
        let second = dealt(ledger);
        assert_eq!((&second[0], second[1].len(), second[2].len()), (&first[0], 16 - first[0].len(), 0));
    });
}

#[test]
fn where_threads_share_cores_what_was_taken_goes_back_when_the_next_frame_begins() {
    with_ledger_on(2, Balancer::StealNear, |ledger| {
        ledger.begin(1);
        let first = dealt(ledger);
        draw(ledger, 1, 1, &first.concat());
        ledger.begin(2);
        assert_eq!(dealt(ledger), first);
    });
}

#[test]
fn the_first_tiles_of_steal_near_are_pieces_of_the_curve() {
    with_ledger(Balancer::StealNear, |ledger| {
        ledger.begin(1);
        let curve: Vec<u32> = along_curve(ledger.config.tiles, false).map(|tile| tile.0).collect();
        assert_eq!(dealt(ledger).concat(), curve);
    });
}

#[test]
fn what_a_dead_node_had_is_dealt_to_the_living_and_what_comes_twice_is_known() {
    with_ledger(Balancer::Static, |ledger| {
        ledger.begin(1);
        let first = dealt(ledger);
        let (there, missing) = first[2].split_at(1);
        draw(ledger, 1, 2, there);
        assert_eq!(ledger.handle_down(2) as usize, missing.len());
        assert_eq!(ledger.stamp().view, 1);
        let again = dealt(ledger);
        assert!(again[2].is_empty());
        assert_eq!(again.iter().map(Vec::len).sum::<usize>(), 15);
        assert_eq!(ledger.handle_drawn(0, 1, TileId(there[0])), Arrival::Again);
        assert_eq!(ledger.handle_drawn(0, 0, TileId(missing[0])), Arrival::Stale);
        assert_eq!(ledger.handle_drawn(0, 1, TileId(16)), Arrival::Stale);
        assert_eq!(ledger.handle_down(2), 0);
    });
}

#[test]
fn the_central_queue_deals_the_next_tile_when_one_has_come() {
    with_ledger(Balancer::Demand { window: 2 }, |ledger| {
        ledger.begin(1);
        let first = dealt(ledger);
        assert!(first.iter().all(|tiles| tiles.len() == 2));
        draw(ledger, 1, 1, &first[1][..1]);
        let next = dealt(ledger);
        assert_eq!(next.each_ref().map(Vec::len), [0, 1, 0]);
    });
}

#[test]
fn the_slowest_node_gives_one_tile_away_before_the_next_frame() {
    with_ledger(Balancer::Steal, |ledger| {
        ledger.begin(1);
        let first = dealt(ledger);
        for node in [0, 2, 1] {
            draw(ledger, 1, node, &first[usize::from(node)]);
        }
        ledger.begin(2);
        let second = dealt(ledger);
        assert_eq!(second[1].len(), first[1].len() - 1);
        assert_eq!(second.iter().map(Vec::len).sum::<usize>(), 16);
    });
}

#[test]
fn a_node_that_comes_in_the_middle_has_an_empty_deal_and_its_share_from_the_central_queue() {
    for (balancer, count) in [(Balancer::StealNear, 0), (Balancer::Demand { window: 2 }, 2)] {
        with_ledger(balancer, |ledger| {
            ledger.handle_down(1);
            ledger.begin(1);
            assert!(dealt(ledger)[1].is_empty());
            ledger.handle_up(1);
            let mut buffer = [0; MESSAGE_BYTES_MAX];
            let Output::Transmit { to: 1, length } = ledger.poll(0, &mut buffer) else { panic!("no deal") };
            let (message, _) = Message::parse(&buffer[..length]).unwrap();
            assert!(
                matches!(message.body, Body::Deal { number: 0, tiles } if tiles.len() == count),
                "{balancer}"
            );
        });
    }
}

#[test]
fn a_deal_that_is_not_taken_is_sent_again_with_the_same_tiles() {
    with_ledger(Balancer::Static, |ledger| {
        ledger.begin(1);
        let mut buffer = [0; MESSAGE_BYTES_MAX];
        let mut all = |ledger: &mut Ledger<'_>| {
            let mut said = Vec::new();
            while let Output::Transmit { to, length } = ledger.poll(0, &mut buffer) {
                said.push((to, buffer[..length].to_vec()));
            }
            said
        };
        let first = all(ledger);
        ledger.handle_timeout(999);
        assert!(all(ledger).is_empty());
        ledger.handle_timeout(1000);
        assert_eq!(all(ledger), first);
    });
}
