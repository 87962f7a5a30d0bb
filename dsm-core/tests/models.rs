//! Every state that three nodes can reach: two that own both pages or one each, readers with a single slot, while the
//! network loses, doubles and delays messages and an owner dies and may come back.
//!
//! The model adds nothing to the protocol: its transitions are those of [`World`](dsm_ops::World), which drives `Node` and
//! `Home` as they are. Time is abstract: any timer may go off in any order, as often as it likes where nothing is left
//! that could arrive in its stead, else early, as often as the budget allows. Copies of messages that are for somebody
//! else arrive at any time. The numbers of states are asserted: a change of the protocol shows here.

mod model;

use model::{Budget, Cluster, explore};

/// Explores all, prints how much it was, and checks that nothing breaks and that what is named here is not reached.
fn assert_holds(cluster: Cluster, states: usize, unreached: &[&str]) {
    let explored = explore(cluster, false);
    println!("{cluster:?}: {} states, {} transitions", explored.states, explored.transitions);
    assert_eq!(explored.broken, None);
    assert_eq!(explored.unreached, unreached);
    assert_eq!(explored.states, states, "the protocol reaches other states than those that were reviewed");
}

#[test]
fn two_threads_lose_no_page_to_a_lost_message_and_a_death() {
    assert_holds(
        Cluster::TWO_THREADS,
        46_069,
        &[model::RETURN, model::LATE, model::ADOPTION, model::ABANDONMENT],
    );
}

#[test]
fn pages_that_are_asked_for_ahead_keep_nobody_waiting() {
    assert_holds(Cluster::AHEAD, 73_633, &[model::RETURN, model::LATE, model::ABANDONMENT]);
}

#[test]
fn without_a_second_copy_what_was_asked_for_ahead_is_given_up() {
    assert_holds(
        Cluster::AHEAD_ONE_COPY,
        3_154,
        &[model::FAILOVER, model::RETURN, model::LATE, model::ADOPTION],
    );
}

#[test]
fn a_node_that_comes_back_is_a_new_node() {
    assert_holds(Cluster::RETURN, 17_219, &[model::ADOPTION, model::ABANDONMENT]);
}

#[test]
fn fragments_that_are_lost_are_asked_for_again() {
    assert_holds(
        Cluster::FRAGMENTS,
        9_743,
        &[model::RETURN, model::LATE, model::ADOPTION, model::ABANDONMENT],
    );
}

#[test]
fn messages_that_come_late_and_twice_do_no_harm() {
    let budget = Budget { duplicates: 1, early_timers: 1, ..Budget::NONE };
    assert_holds(
        Cluster { threads: 1, budget, ..Cluster::TWO_THREADS },
        1_843,
        &[model::DEATH, model::RETURN, model::ADOPTION, model::ABANDONMENT],
    );
}

#[test]
fn without_a_second_copy_a_fault_ends_by_its_deadline() {
    assert_holds(
        Cluster::ONE_COPY,
        1_639,
        &[model::FAILOVER, model::RETURN, model::LATE, model::ADOPTION, model::ABANDONMENT],
    );
}
