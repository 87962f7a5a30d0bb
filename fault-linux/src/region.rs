//! An address range in which a scene lies, and everything that all its threads share.

use core::fmt;
use core::slice;
use core::sync::atomic::{AtomicU64, Ordering};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::Arc;

use dsm_core::id::{NodeId, PageId, PortId};
use dsm_core::node;
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use dsm_core::stats::NodeStats;

use crate::area::Area;
use crate::backend::{Backend, BackendKind, Record};
use crate::failure::PageFailure;
use crate::paging::Paging;
use crate::probe::{Choice, Demand, Probed, probe};
use crate::signal::{self, Listed};
use crate::sys::{self, Errno};

/// A scene's address range on this node: home pages mapped, pages of others coming and going through slots.
///
/// Shared by all its threads. Each of them [attaches](Region::attach) with a transport of its own.
#[derive(Debug)]
pub struct Region {
    kind: Kind,
    choice: Choice,
    holds_all: bool,
    /// A bit for each port in use.
    ports: [AtomicU64; PORTS / 64],
    pid: u32,
    _listed: Listed,
}

#[derive(Debug)]
enum Kind {
    Paged(Box<Paging>),
    Replicated(Area),
}

/// What a region is made from.
#[derive(Debug)]
pub struct Setup {
    /// The state machine's numbers. How many pages leave at a time, and how early, is set by the region.
    pub node: node::Config,
    /// Which page leaves when a slot is needed.
    pub policy: PolicyKind,
    /// How it learns which pages are used.
    pub reference: ReferenceSource,
    /// How many per cent of the slots hold hidden pages, where soft faults are the source.
    pub hidden_per_cent: u32,
    /// With hints: bring the pages that a tile touched in the last frame before it starts. Whether a missed page brings
    /// others along stands in `node`.
    pub prefetch: bool,
    /// Makes what is random repeatable.
    pub seed: u64,
    /// Pages of other nodes that may be resident at once.
    pub slot_count: u32,
    /// The file with this node's own pages, those it is home to and replicas, in the order of their held index, unless it
    /// owns none.
    pub home: Option<OwnedFd>,
    /// The backend, or `None` for the best that the system does not refuse.
    pub backend: Option<BackendKind>,
}

/// Why there is no region.
#[derive(Debug)]
#[non_exhaustive]
pub enum RegionError {
    /// No backend can be used; the text says what each of them was refused.
    NoBackend(String),
    /// The state machine does not accept its configuration.
    Config(node::ConfigError),
    /// A system call failed.
    System {
        /// What was being done.
        doing: &'static str,
        /// What the system said.
        why: Errno,
    },
    /// The process has as many regions as it can have.
    TooMany,
}

/// Threads that can be attached to a region at once.
const PORTS: usize = 256;

impl Region {
    /// Reserves the range, maps the home pages and gets ready to serve faults.
    ///
    /// # Errors
    /// See [`RegionError`].
    ///
    /// # Safety
    /// For as long as the region lives, and any slice got from it is used: nobody writes the home file, nobody cuts
    /// it short, and whatever transports deliver as the bytes of a page is the same each time.
    pub unsafe fn new(setup: Setup) -> Result<Arc<Self>, RegionError> {
        let failed = |doing| move |why| RegionError::System { doing, why };
        signal::install().map_err(failed("installing the fault handler"))?;
        let demand = Demand::of(&setup);
        let Probed { area, backend, slot_count, choice } =
            probe(setup.backend, demand).map_err(|declined| RegionError::NoBackend(declined.to_string()))?;
        let home = match &setup.home {
            Some(file) => {
                let mapped = map_home(&area, &backend, file.as_fd(), &setup.node);
                mapped.map_err(failed("mapping the home pages"))?
            }
            None => None,
        };
        let placement = &setup.node.placement;
        let holds_all = slot_count >= placement.page_count() - placement.held_pages(setup.node.me);
        let (policy, reference) = ((setup.policy, setup.seed), backend.reference(setup.reference));
        let hidden_max = backend.hidden_max(reference, slot_count, setup.hidden_per_cent);
        let node = node::Config { hidden_max, ..setup.node };
        let paging = Paging::new(area, backend, home, node, slot_count, policy, (reference, setup.prefetch));
        Self::assemble(Kind::Paged(Box::new(paging.map_err(RegionError::Config)?)), choice, holds_all)
    }

    /// Maps a whole image: the replicated baseline. Nothing faults, and no node has to be asked.
    ///
    /// # Errors
    /// See [`RegionError`].
    ///
    /// # Safety
    /// For as long as the region lives, and any slice got from it is used: nobody writes the file or cuts it short.
    pub unsafe fn replicated(
        image: BorrowedFd<'_>,
        page_count: u32,
        page_bytes: usize,
    ) -> Result<Arc<Self>, RegionError> {
        let failed = |why| RegionError::System { doing: "mapping the whole image", why };
        let area = Area::reserve(page_count, page_bytes, libc::PROT_READ).map_err(failed)?;
        // SAFETY: the area was just made; the caller vouches for the file.
        unsafe { sys::map_file_over(area.start(), area.bytes(), image.as_raw_fd(), 0) }.map_err(failed)?;
        let choice = Choice { used: BackendKind::Replicated, declined: Vec::new(), slots_withheld: 0 };
        Self::assemble(Kind::Replicated(area), choice, true)
    }

    fn assemble(kind: Kind, choice: Choice, holds_all: bool) -> Result<Arc<Self>, RegionError> {
        let area = kind.area();
        let start = area.start().addr();
        let listed = Listed::new(start, start + area.bytes()).ok_or(RegionError::TooMany)?;
        let ports = [const { AtomicU64::new(0) }; PORTS / 64];
        Ok(Arc::new(Self { kind, choice, holds_all, ports, pid: sys::pid(), _listed: listed }))
    }

    /// The backend in use, and why not others.
    #[must_use]
    pub const fn choice(&self) -> &Choice {
        &self.choice
    }

    /// What the state machine has counted; all zero when everything is mapped.
    #[must_use]
    pub fn stats(&self) -> NodeStats {
        self.paging().map(Paging::stats).unwrap_or_default()
    }

    /// Whether every page has a place here, so that none is missed twice.
    #[must_use]
    pub const fn holds_all(&self) -> bool {
        self.holds_all
    }

    /// Slots there are, after what the backend withholds; 0 when everything is mapped.
    #[must_use]
    pub fn slot_count(&self) -> u32 {
        self.paging().map_or(0, Paging::slot_count)
    }

    /// How the policy learns which pages are used: what was asked for, or what comes closest with this backend.
    #[must_use]
    pub fn reference(&self) -> ReferenceSource {
        self.paging().map_or(ReferenceSource::Nothing, Paging::reference)
    }

    /// A frame begins, and this node draws these tiles, in this order. For hints; see
    /// [`Attached::begin_tile`](crate::Attached::begin_tile).
    pub fn begin_frame(&self, order: &[u32]) {
        if let Some(paging) = self.paging() {
            paging.begin_frame(order);
        }
    }

    /// A tile comes to this node after the frame has begun, from one where it touched these pages in the last frame; they
    /// are brought before it starts. Without pages, what it touched here before stands.
    pub fn adopt_tile(&self, tile: u32, pages: &[PageId]) {
        if let Some(paging) = self.paging() {
            paging.adopt_tile(tile, pages);
        }
    }

    /// The pages that a tile touched here in the last frame, as far as hints have told; none otherwise.
    #[must_use]
    pub fn pages_of(&self, tile: u32) -> Vec<PageId> {
        self.paging().map_or(Vec::new(), |paging| paging.pages_of(tile))
    }

    /// Length of a page in bytes.
    #[must_use]
    pub fn page_bytes(&self) -> usize {
        self.kind.area().page_bytes()
    }

    /// Tells whether every byte read so far was the scene's.
    ///
    /// # Errors
    /// The first page that could not be had, and why.
    pub fn check(&self) -> Result<(), PageFailure> {
        self.paging().map_or(Ok(()), Paging::check)
    }

    /// Tells that another node is dead: it is asked for nothing any more, where there are copies elsewhere.
    pub fn handle_peer_down(&self, peer: NodeId) {
        if let Some(paging) = self.paging() {
            paging.handle_peer_down(peer);
        }
    }

    pub(crate) fn paging(&self) -> Option<&Paging> {
        match &self.kind {
            Kind::Paged(paging) => Some(paging),
            Kind::Replicated(_) => None,
        }
    }

    /// A child made by fork has no region; what it has is the parent's userfaultfd, and must not use it.
    pub(crate) fn is_copy_made_by_fork(&self) -> bool {
        sys::pid() != self.pid
    }

    /// All bytes, for an attached thread to slice.
    pub(crate) fn bytes(&self) -> &[u8] {
        assert_ne!(self.choice.used, BackendKind::Soft, "the bytes of `soft` are reached by records");
        let area = self.kind.area();
        // SAFETY: the area is readable for as long as `self` lives: what is absent appears when it is read. Its bytes
        // do not change; see the crate's safety contract.
        unsafe { slice::from_raw_parts(area.start(), area.bytes()) }
    }

    /// The record at `offset`, or `Ok(None)` when there is no such record, or the page that has to come first.
    pub(crate) fn record(&self, offset: u64, length: usize) -> Result<Option<Record<'_>>, PageId> {
        let Some((page, start)) = self.locate(offset, length) else { return Ok(None) };
        match (&self.kind, self.choice.used) {
            (Kind::Paged(paging), BackendKind::Soft) => paging.record(page, start, length).map(Some),
            _ => {
                let start = page.index() * self.page_bytes() + start;
                Ok(Some(Record::of_home(&self.bytes()[start..start + length])))
            }
        }
    }

    /// The page of a record and where the record starts in it; `None` when it lies outside, or in more than one.
    fn locate(&self, offset: u64, length: usize) -> Option<(PageId, usize)> {
        let (area, offset) = (self.kind.area(), usize::try_from(offset).ok()?);
        let start = offset % area.page_bytes();
        let page = area.page_at(area.start().addr().checked_add(offset)?)?;
        (start.checked_add(length)? <= area.page_bytes()).then_some((page, start))
    }

    /// A port that no other thread uses.
    pub(crate) fn take_port(&self) -> Option<PortId> {
        (0..=u8::MAX).map(PortId).find(|port| {
            let (word, bit) = self.port_bit(*port);
            word.fetch_or(bit, Ordering::Relaxed) & bit == 0
        })
    }

    pub(crate) fn return_port(&self, port: PortId) {
        let (word, bit) = self.port_bit(port);
        word.fetch_and(!bit, Ordering::Relaxed);
    }

    fn port_bit(&self, port: PortId) -> (&AtomicU64, u64) {
        (&self.ports[usize::from(port.0) / 64], 1 << (port.0 % 64))
    }
}

impl Kind {
    fn area(&self) -> &Area {
        match self {
            Self::Paged(paging) => paging.area(),
            Self::Replicated(area) => area,
        }
    }
}

impl Demand {
    fn of(setup: &Setup) -> Self {
        let placement = &setup.node.placement;
        Self {
            page_count: placement.page_count(),
            page_bytes: setup.node.page_bytes as usize,
            slot_count: setup.slot_count,
            home_stripes: placement.held_stripes_of(setup.node.me).count(),
            watches_touches: setup.reference == ReferenceSource::SoftFaults,
        }
    }
}

/// Puts the home pages in place: stripe by stripe into the area, or, for `soft`, all of them into one of their own.
fn map_home(
    area: &Area,
    backend: &Backend,
    file: BorrowedFd<'_>,
    config: &node::Config,
) -> Result<Option<Area>, Errno> {
    let (placement, file) = (&config.placement, file.as_raw_fd());
    if let Backend::Soft(_) = backend {
        let home = Area::reserve(placement.held_pages(config.me), area.page_bytes(), libc::PROT_READ)?;
        // SAFETY: the area was just made; the caller of `Region::new` vouches for the file.
        unsafe { sys::map_file_over(home.start(), home.bytes(), file, 0) }?;
        return Ok(Some(home));
    }
    let mut offset = 0;
    for stripe in placement.held_stripes_of(config.me) {
        let (start, bytes) = area.span(&stripe);
        // SAFETY: the stripe lies in our area, and nobody reads it yet. The caller of `Region::new` vouches for the
        // file.
        unsafe { sys::map_file_over(start, bytes, file, offset) }?;
        offset += bytes as u64;
    }
    Ok(None)
}

impl fmt::Display for RegionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBackend(declined) => f.write_str(declined),
            Self::Config(error) => write!(f, "{error}"),
            Self::System { doing, why } => write!(f, "{doing}: {why}"),
            Self::TooMany => write!(f, "a process can have {} regions at once", signal::REGIONS_MAX),
        }
    }
}

impl core::error::Error for RegionError {}
