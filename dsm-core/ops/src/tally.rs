//! What a run has come by.

use dsm_core::stats::NodeStats;

/// What a run has come by: to see that it has come by everything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is a count of `NodeStats`, over all nodes")]
pub struct Tally {
    pub faults: u64,
    pub fetched_pages: u64,
    pub evicted_pages: u64,
    pub resends: u64,
    pub failovers: u64,
    pub fragments: u64,
    pub tile_prefetch: u64,
    pub neighbour_prefetch: u64,
    pub prefetch_used: u64,
    pub prefetch_wasted: u64,
    pub adopted_requests: u64,
    pub abandoned_requests: u64,
    pub dead_peers: u64,
    pub late_answers: u64,
    pub refused_messages: u64,
    pub restarts: u64,
}

impl Tally {
    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            faults: self.faults + other.faults,
            fetched_pages: self.fetched_pages + other.fetched_pages,
            evicted_pages: self.evicted_pages + other.evicted_pages,
            resends: self.resends + other.resends,
            failovers: self.failovers + other.failovers,
            fragments: self.fragments + other.fragments,
            tile_prefetch: self.tile_prefetch + other.tile_prefetch,
            neighbour_prefetch: self.neighbour_prefetch + other.neighbour_prefetch,
            prefetch_used: self.prefetch_used + other.prefetch_used,
            prefetch_wasted: self.prefetch_wasted + other.prefetch_wasted,
            adopted_requests: self.adopted_requests + other.adopted_requests,
            abandoned_requests: self.abandoned_requests + other.abandoned_requests,
            dead_peers: self.dead_peers + other.dead_peers,
            late_answers: self.late_answers + other.late_answers,
            refused_messages: self.refused_messages + other.refused_messages,
            restarts: self.restarts + other.restarts,
        }
    }

    /// Each count with its name.
    #[must_use]
    pub const fn named(&self) -> [(&'static str, u64); 16] {
        [
            ("faults", self.faults),
            ("fetched pages", self.fetched_pages),
            ("evicted pages", self.evicted_pages),
            ("resends", self.resends),
            ("failovers", self.failovers),
            ("fragments", self.fragments),
            ("pages asked for before a tile", self.tile_prefetch),
            ("pages asked for along with another", self.neighbour_prefetch),
            ("of these, used", self.prefetch_used),
            ("of these, wasted", self.prefetch_wasted),
            ("faults on pages asked for ahead", self.adopted_requests),
            ("requests made ahead and given up", self.abandoned_requests),
            ("dead peers", self.dead_peers),
            ("late answers", self.late_answers),
            ("refused messages", self.refused_messages),
            ("restarts", self.restarts),
        ]
    }

    pub(crate) fn add(&mut self, stats: NodeStats) {
        self.faults += stats.faults;
        self.fetched_pages += stats.fetched_pages;
        self.evicted_pages += stats.evicted_pages;
        self.resends += stats.resends;
        self.failovers += stats.failovers;
        self.fragments += stats.fragments;
        self.tile_prefetch += stats.tile_prefetch.asked;
        self.neighbour_prefetch += stats.neighbour_prefetch.asked;
        self.prefetch_used += stats.prefetch().used;
        self.prefetch_wasted += stats.prefetch().wasted;
        self.adopted_requests += stats.adopted_requests;
        self.abandoned_requests += stats.abandoned_requests;
        self.dead_peers += stats.dead_peers;
        self.late_answers += stats.late_answers;
        self.refused_messages += stats.refused_messages;
    }
}
