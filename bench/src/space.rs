//! A shared space to read: one owner holds every page, one reader holds none.

use std::sync::Arc;

use anyhow::{Context, Result};
use dsm_core::home::Home;
use dsm_core::id::{ClusterId, Epoch, NodeId};
use dsm_core::node::Config;
use dsm_core::placement::Stripes;
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use dsm_core::time::Instant;
use dsm_core::transport::{Received, SendError, Transport};
use fault_linux::{BackendKind, Region, Setup};
use transport_shm::{DirectPort, PageFile};

/// A shared space of so many pages, whose every word is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Space {
    pub(crate) pages: u32,
}

/// Length of a page: the paper's 16 KB.
pub(crate) const PAGE_BYTES: u32 = 16 << 10;

/// Words of a page.
pub(crate) const PAGE_WORDS: usize = PAGE_BYTES as usize / size_of::<u64>();

/// The node that owns all pages.
pub(crate) const OWNER: NodeId = NodeId(1);

const READER: NodeId = NodeId(0);
const CLUSTER: ClusterId = ClusterId(0x2004);
const EPOCH: Epoch = Epoch(1);

impl Space {
    pub(crate) fn bytes(self) -> usize {
        self.pages as usize * PAGE_BYTES as usize
    }

    pub(crate) fn words(self) -> usize {
        self.pages as usize * PAGE_WORDS
    }

    /// The owner's part in answering requests.
    pub(crate) fn home(self) -> Result<Home> {
        Ok(Home::new(OWNER, CLUSTER, EPOCH, self.placement()?, PAGE_BYTES))
    }

    /// A region in which `slots` pages can be resident at once, replaced at random.
    pub(crate) fn region(self, backend: BackendKind, slots: u32, seed: u64) -> Result<Arc<Region>> {
        let node =
            Config { cluster: CLUSTER, epoch: EPOCH, ..Config::new(READER, self.placement()?, PAGE_BYTES) };
        let policy = PolicyKind::Random;
        let setup = Setup {
            node,
            policy,
            reference: ReferenceSource::Nothing,
            hidden_per_cent: 0,
            prefetch: false,
            seed,
            slot_count: slots,
            home: None,
            backend: Some(backend),
        };
        // SAFETY: there is no home file, and every port of this program leads to an owner that has filled and frozen
        // its pages, with the same words for the same space, before it says that it is ready.
        let region = unsafe { Region::new(setup) };
        let region = region.with_context(|| format!("a region by {backend}"))?;
        anyhow::ensure!(region.slot_count() == slots, "{backend} withholds slots: {}", region.choice());
        Ok(region)
    }

    /// A way to the owner that reads its memory file.
    pub(crate) fn direct_port(self, pages: &Arc<PageFile>) -> Result<DirectPort> {
        let mut port = DirectPort::new(PAGE_BYTES);
        port.connect(OWNER, self.home()?, pages.clone());
        Ok(port)
    }

    fn placement(self) -> Result<Stripes> {
        Ok(Stripes::new(self.pages, self.pages, OWNER, 1)?)
    }
}

/// The word at `index` of the whole space, counted in words; as good as random.
#[inline]
pub(crate) fn word(index: usize) -> u64 {
    let mixed = (index as u64 ^ 0x2545_F491_4F6C_DD1D).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) ^ (mixed >> 32)
}

/// Numbers that repeat for a seed, cheap enough to stand between two loads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers(u64);

impl Numbers {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x1234_5678_9ABC_DEF1)
    }

    /// The next number in `0..bound`, where `bound` is below 2^32.
    ///
    /// # Source
    /// Knuth's MMIX multiplier; the upper half of the state is used, the lower is not random enough.
    #[inline]
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((self.0 >> 32) * bound as u64) >> 32) as usize
    }

    /// Makes the numbers to come depend on `value`.
    #[inline]
    pub(crate) fn stir(&mut self, value: u64) {
        self.0 ^= value;
    }
}

/// A transport that is lent to a region for a while and goes on afterwards.
#[derive(Debug)]
pub(crate) struct Lent<'a, T>(pub(crate) &'a mut T);

impl<T: Transport> Transport for Lent<'_, T> {
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError> {
        self.0.send(to, message)
    }

    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        self.0.receive(deadline)
    }
}
