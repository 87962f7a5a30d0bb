//! What must hold after each operation, beside what a node checks of itself.

use dsm_core::id::NodeId;
use dsm_core::page_state::PageState;

use super::World;
use crate::member::{Thread, Wait};

impl World {
    pub(super) fn check(&mut self) {
        for member in self.members.iter_mut().filter(|member| member.is_alive) {
            let mut slots: Vec<u32> = member.visible.values().copied().collect();
            slots.sort_unstable();
            let shares = slots.windows(2).any(|pair| pair[0] == pair[1]);
            assert!(!shares, "SLOT_HOLDS_ONE_PAGE: two visible pages share a slot");
            let waits: Vec<Thread> =
                member.threads.iter().filter(|thread| **thread != Thread::Running).copied().collect();
            let is_filling: Vec<bool> = waits
                .iter()
                .map(|thread| thread.wait().is_some_and(|wait| member.is_filling(wait.page)))
                .collect();
            member.with_node(|node| {
                for (thread, is_filling) in waits.iter().zip(is_filling) {
                    match thread {
                        Thread::WaitingForPage(wait) => {
                            let state = node.table().state(wait.page);
                            let is_coming = matches!(
                                state,
                                Some(
                                    PageState::Requested
                                        | PageState::Filling
                                        | PageState::Leaving
                                        | PageState::Hiding
                                )
                            );
                            assert!(is_coming, "NO_LOST_WAITER: for {}, which is {state:?}", wait.page);
                        }
                        Thread::WaitingForSlot(_) => {
                            let is_full = node.table().free_count() == 0
                                || node.request_count() == usize::from(self.setup.requests);
                            assert!(is_full, "NO_LOST_WAITER: for a slot, and one is free");
                        }
                        Thread::Fetching(wait) => {
                            let is_asked = node.table().state(wait.page) == Some(PageState::Requested);
                            assert!(is_asked || is_filling, "NO_LOST_WAITER: nobody fetches {}", wait.page);
                        }
                        Thread::Running => {}
                    }
                }
            });
        }
    }

    pub(super) fn check_deadline(&self, node: usize, thread: usize) {
        let member = &self.members[node];
        if let Thread::Fetching(wait) = member.threads[thread] {
            let waited = self.now.since(wait.world_since);
            let in_us = self.setup.patience_us(&wait);
            let is_late = waited > in_us + member.slack_us && !member.is_filling(wait.page);
            assert!(!is_late, "NO_LOST_WAITER: {} is asked for {waited} us after its fault", wait.page);
        }
    }

    /// What was asked of a dead node is due. `DEAD_ARE_LEFT`.
    pub(super) fn check_left(&mut self, node: usize, dead: NodeId) {
        let now = self.now;
        let member = &mut self.members[node];
        for thread in member.waiting(|thread| matches!(thread, Thread::Fetching(_))) {
            let Some(wait) = member.threads[thread].wait() else { continue };
            let last_to = member.oracle.asked.get(&wait.page.0).map(|asked| asked.last_to);
            let is_requested =
                member.with_node(|node| node.table().state(wait.page)) == Some(PageState::Requested);
            if last_to == Some(dead) && is_requested {
                let next = member.next_timer(thread);
                assert!(
                    next.is_some_and(|next| next <= now),
                    "DEAD_ARE_LEFT: {} is waited for until {next:?}",
                    wait.page
                );
            }
        }
    }

    /// A thread has missed a page that `fetcher` has asked for ahead: its request has all the sendings before it that one of
    /// its own would have, and all the time. `ADOPTION_RESTARTS`.
    pub(super) fn check_adopted(&mut self, node: usize, fetcher: usize, wait: Wait) {
        // With neighbours, or a clock that jumped, when a request is due cannot be known from the outside.
        let member = &mut self.members[node];
        let is_asked = member.with_node(|node| node.table().state(wait.page)) == Some(PageState::Requested);
        if !is_asked || self.setup.neighbours > 0 || member.slack_us > 0 {
            return;
        }
        let left_us = self.setup.deadline_us().saturating_sub(self.now.since(wait.world_since));
        let share_us = left_us / (u64::from(self.setup.replicas) * u64::from(self.setup.tries) + 1);
        let next = member.next_timer(fetcher);
        assert!(
            next.is_some_and(|next| next <= self.now.after(share_us)),
            "ADOPTION_RESTARTS: {} is asked for again at {next:?}, and has {share_us} us of {left_us}",
            wait.page
        );
    }
}
