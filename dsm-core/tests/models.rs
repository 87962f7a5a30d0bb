//! Every state that three nodes can reach: two that own both pages, one that reads them through a single slot, while the
//! network loses, doubles and delays a message, and an owner dies and may come back.
//!
//! The model adds nothing to the protocol: its transitions are those of [`World`], which drives `Node` and `Home` as they
//! are. Time is abstract: any timer may go off, in any order; when nothing is left that could arrive in its stead as
//! often as it likes, else once, early.

mod model;

use model::{Budget, Cluster, explore};

#[test]
fn every_state_of_three_nodes_with_two_copies_is_safe_and_loses_no_page() {
    let explored = explore(Cluster { replicas: 2, fragments: 1, budget: Budget::ONE_OF_EACH });
    println!("two copies: {} states, {} transitions", explored.unique, explored.generated);
    assert_eq!(explored.broken, None);
    assert_eq!(explored.unreached, Vec::<&str>::new());
    assert_eq!(explored.unique, 0);
}
