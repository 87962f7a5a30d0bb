//! Every state that a few nodes can reach that draw a frame of a few tiles, while the network loses or doubles a message or
//! a node dies: each tile is displayed once, and the frame ends.
//!
//! The model adds nothing to the protocol: its transitions are those of [`World`](balance_ops::World). Time passes when
//! nothing is under way, to the moment at which somebody has something to look after. Numbers of questions and gifts count
//! only as far as they compare with those under way, so states come back and there are finitely many. Their numbers are
//! asserted: a change of the protocol shows here.

mod model;

use model::{Cluster, explore};

/// Explores all, prints how much it was, and checks that nothing breaks and that all is reached but what is named here.
fn assert_holds(cluster: Cluster, states: usize, unreached: &[&str]) {
    let explored = explore(cluster, false);
    println!("{cluster:?}: {} states, {} transitions", explored.states, explored.transitions);
    assert_eq!(explored.broken, None);
    let is_expected = |name: &&str| unreached.contains(name);
    assert!(explored.unreached.iter().all(is_expected), "not reached: {:?}", explored.unreached);
    assert_eq!(explored.states, states, "the protocol reaches other states than those that were reviewed");
}

#[test]
fn two_nodes_that_take_from_each_other_end_their_frame() {
    assert_holds(Cluster::CALM, 36_356, &[model::REDRAWN]);
}

#[test]
fn what_a_dead_node_owed_is_drawn_by_the_other() {
    assert_holds(Cluster::DEATH, 306_683, &[]);
}

#[test]
fn a_lost_message_loses_no_tile() {
    assert_holds(Cluster::LOSS, 250_866, &[model::REDRAWN]);
}

#[test]
fn a_doubled_message_doubles_no_tile() {
    assert_holds(Cluster::DOUBLE, 403_074, &[model::REDRAWN]);
}

#[test]
fn a_tile_that_is_lost_is_sent_again() {
    assert_holds(Cluster::TILE_LOSS, 43_883, &[model::STOLEN, model::REDRAWN]);
}

#[test]
fn a_tile_on_its_way_from_a_dead_node_counts_if_it_comes() {
    assert_holds(Cluster::TILE_DEATH, 57_101, &[model::STOLEN]);
}

#[test]
fn the_central_queue_survives_a_loss_and_a_death() {
    assert_holds(Cluster::DEMAND, 53_370, &[model::STOLEN, model::REFUSED]);
}

#[test]
fn what_comes_late_from_the_last_frame_changes_nothing() {
    assert_holds(Cluster::TWO_FRAMES, 296_976, &[model::STOLEN, model::REDRAWN]);
}

#[test]
fn nodes_that_share_cores_wait_and_end_their_frame() {
    assert_holds(Cluster::SHARED_CORES, 121_483, &[model::REFUSED]);
}
