//! A world: a configuration, a seed, and all that follows from the two.

use core::panic::AssertUnwindSafe;
use std::panic::catch_unwind;
use std::rc::Rc;

use dsm_core::id::NodeId;
use dsm_core::node::Node;
use dsm_core::replacement::{Policy, PolicyKind, Replacement};
use dsm_core::stats::Histogram;
use dsm_core::storage::{PageEntry, PeerEntry, RequestEntry, SlotEntry, Storage};

use super::config::{Config, ConfigError};
use super::member::{MakePolicy, Member, Shared};
use super::packet::{Packet, Task};
use super::report::{NodeReport, Report};
use super::workload::Pattern;
use crate::chance::mix;
use crate::cluster::{Cluster, Ended, Setup, Step};
use crate::verify::message_of;

/// The memory in which the nodes of a world work, and what they share. Can be lent to one world after the other.
#[derive(Debug)]
pub struct Memory {
    shared: Shared,
    pages: Vec<PageEntry>,
    slots: Vec<SlotEntry>,
    peers: Vec<PeerEntry>,
    requests: Vec<RequestEntry>,
}

/// A paging cluster in virtual time.
///
/// The same configuration and seed give the same run, event for event, on any machine.
pub struct World<'s, R: Replacement = Policy> {
    cluster: Cluster<Member<'s, R>>,
    config: &'s Config,
    seed: u64,
}

impl Memory {
    /// Memory for worlds of this configuration.
    ///
    /// # Errors
    /// The parts of the configuration do not fit together.
    pub fn new(config: Config) -> Result<Self, ConfigError> {
        config.check()?;
        let page_count = config.node.placement.page_count();
        let threads = u32::from(config.renderers) * u32::from(config.threads);
        let nodes = usize::from(config.nodes);
        let mut memory = Self {
            pages: vec![PageEntry::EMPTY; nodes * page_count as usize],
            slots: vec![SlotEntry::EMPTY; nodes * config.slots as usize],
            peers: vec![PeerEntry::EMPTY; nodes * usize::from(config.node.placement.owner_count())],
            requests: vec![RequestEntry::EMPTY; nodes * config.requests()],
            shared: Shared {
                pattern: Pattern::new(config.workload.clone(), page_count, threads),
                fragment_bytes: config.fragment_bytes()?,
                config,
            },
        };
        memory.try_every_node()?;
        Ok(memory)
    }

    /// Makes each node once, so that a world need not fear that one cannot be made.
    fn try_every_node(&mut self) -> Result<(), ConfigError> {
        let (shared, storages) = self.lend();
        for (me, storage) in storages {
            let config = dsm_core::node::Config { me, ..shared.config.node };
            Node::new(config, storage, Policy::new(PolicyKind::Fifo, 0)).map_err(ConfigError::Node)?;
        }
        Ok(())
    }

    /// What nodes share, and for each its own part.
    fn lend(&mut self) -> (&Shared, impl Iterator<Item = (NodeId, Storage<'_>)>) {
        let config = &self.shared.config;
        let placement = &config.node.placement;
        let (page_count, slot_count) = (placement.page_count() as usize, config.slots as usize);
        let (peer_count, request_count) = (usize::from(placement.owner_count()), config.requests());
        let (mut pages, mut slots) = (&mut self.pages[..], &mut self.slots[..]);
        let (mut peers, mut requests) = (&mut self.peers[..], &mut self.requests[..]);
        let storages = (0..config.nodes).map(NodeId).map(move |node| {
            let storage = Storage {
                pages: pages.split_off_mut(..page_count).unwrap_or_default(),
                slots: slots.split_off_mut(..slot_count).unwrap_or_default(),
                peers: peers.split_off_mut(..peer_count).unwrap_or_default(),
                requests: requests.split_off_mut(..request_count).unwrap_or_default(),
            };
            (node, storage)
        });
        (&self.shared, storages)
    }
}

impl<'s> World<'s> {
    /// A world whose nodes replace pages by this policy.
    pub fn new(memory: &'s mut Memory, policy: PolicyKind, seed: u64) -> Self {
        World::with_policy(memory, seed, move |_, seed| Policy::new(policy, seed))
    }
}

impl<'s, R: Replacement> World<'s, R> {
    /// A world whose nodes replace pages by a policy of your own; `make` is given the node and a seed.
    pub fn with_policy(memory: &'s mut Memory, seed: u64, make: impl Fn(NodeId, u64) -> R + 's) -> Self {
        let make: Rc<MakePolicy<'s, R>> = Rc::new(make);
        let (shared, storages) = memory.lend();
        let policy_seed = |node: NodeId| mix(seed ^ mix(u64::from(node.0)));
        let members = storages
            .map(|(me, storage)| Member::new(shared, me, seed, policy_seed(me), storage, make.clone()));
        let config = &shared.config;
        let setup = Setup {
            network: config.network.clone(),
            faults: config.faults.clone(),
            checks: config.checks,
            seed,
        };
        Self { cluster: Cluster::new(setup, members.collect()), config, seed }
    }

    /// Lets things happen until all threads are done or time is over, and checks every node at the end.
    ///
    /// # Panics
    /// When an invariant does not hold. The message begins with its name and ends with the seed and the event.
    pub fn run(&mut self) -> Report {
        let cluster = &mut self.cluster;
        let until = self.config.until;
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            let ended = cluster.run(until);
            assert!(
                ended != Ended::Stuck,
                "NO_LOST_WAITER: nothing will ever happen again, and threads wait"
            );
            cluster.check_invariants();
            ended
        }));
        match outcome {
            Ok(ended) => self.report(ended),
            Err(panic) => {
                let (steps, at) = (self.cluster.steps(), self.cluster.now());
                let what = message_of(&*panic);
                panic!("{what}; in seed {} at event {steps}, after {at}", self.seed)
            }
        }
    }

    /// Lets the next thing happen, or returns `None` when all threads are done.
    ///
    /// # Panics
    /// When an invariant does not hold.
    pub fn step(&mut self) -> Option<Step<Packet, Task>> {
        if self.cluster.is_done() { None } else { self.cluster.step() }
    }

    /// The nodes.
    pub fn members(&self) -> &[Member<'s, R>] {
        self.cluster.actors()
    }

    /// What has been counted so far.
    pub fn report(&self, ended: Ended) -> Report {
        let mut latencies = Histogram::EMPTY;
        self.members().iter().for_each(|member| latencies.merge(member.latencies()));
        let node = |member: &Member<'s, R>| NodeReport {
            node: member.me(),
            is_up: self.cluster.is_up(member.me()),
            starts: self.cluster.starts(member.me()),
            counts: member.counts(),
            traffic: self.cluster.traffic(member.me()),
        };
        Report {
            seed: self.seed,
            ended,
            at: self.cluster.now(),
            steps: self.cluster.steps(),
            trace: self.cluster.trace(),
            nodes: self.members().iter().map(node).collect(),
            latencies,
        }
    }
}

impl<R: Replacement> core::fmt::Debug for World<'_, R> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("World")
            .field("seed", &self.seed)
            .field("cluster", &self.cluster)
            .finish_non_exhaustive()
    }
}
