//! From what was asked for to what each process may hold. Pure arithmetic: no process, no file.

use core::fmt;

use dsm_core::id::NodeId;
use dsm_core::placement::{PlacementError, Stripes};
use dsm_core::storage::{PageEntry, SlotEntry};
use serde::{Deserialize, Serialize};

use crate::size::{Bytes, Memory};

/// What was asked for, as far as memory is concerned.
#[derive(Clone, Copy, Debug)]
pub struct Demand {
    /// Processes that render.
    pub nodes: u16,
    /// Processes that hold pages and render nothing. 0: the nodes hold them.
    pub stores: u16,
    /// What one node may hold; `None` for its home share and 15 % of the image besides, or a few pages if that is more.
    pub memory: Option<Memory>,
    /// Length of the scene image.
    pub image_bytes: u64,
    /// Length of a page.
    pub page_bytes: u32,
    /// Every node holds the whole image.
    pub replicated: bool,
    /// Copies of each page, on as many owners.
    pub replicas: u8,
}

/// Who holds what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Which process is home to which page.
    pub placement: Stripes,
    /// Processes that render; numbered from 0, before the stores.
    pub nodes: u16,
    /// Processes that only hold pages.
    pub stores: u16,
    /// Length of a page.
    pub page_bytes: u32,
    /// What one node may hold.
    pub budget_bytes: u64,
    /// Pages of others that a node may hold at once. The same for all, so that they are alike.
    pub slots: u32,
}

/// Numbers from which a process computes the placement; what is sent to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlacementNumbers {
    page_count: u32,
    stripe_pages: u32,
    first_owner: u16,
    owner_count: u16,
    replicas: u8,
}

/// Why a demand cannot be met. Says what to change.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum PlanError {
    /// A node may hold less than its home pages and replicas.
    BelowHomeShare {
        /// What a node may hold.
        budget_bytes: u64,
        /// What its home pages and replicas take.
        home_bytes: u64,
        /// The whole image.
        image_bytes: u64,
        /// Nodes among which the image is dealt.
        nodes: u16,
        /// Copies of each page.
        replicas: u8,
    },
    /// A node may hold its home pages and not one page besides.
    NoSlot {
        /// What a node may hold.
        budget_bytes: u64,
        /// What one more page would make it.
        needed_bytes: u64,
    },
    /// Every node is to hold the whole image, and may not.
    ReplicatedBelowImage {
        /// What a node may hold.
        budget_bytes: u64,
        /// The whole image.
        image_bytes: u64,
    },
    /// More processes than one machine's run can have.
    TooManyProcesses {
        /// Processes asked for.
        got: u32,
    },
    /// No process is to render.
    NoNodes,
    /// The pages cannot be dealt.
    Placement(PlacementError),
}

/// Processes that one run can have on one machine: what one message can carry descriptors for.
pub const PROCESSES_MAX: u16 = 64;

/// What a node may hold besides its home share when nobody says.
const EXTRA_SHARE: f64 = 0.15;

/// And at least room for so many pages of others, so that a scene of a few pages renders too.
const EXTRA_SLOTS_MIN: u64 = 4;

impl Plan {
    /// Deals the pages and counts the slots.
    ///
    /// # Errors
    /// See [`PlanError`].
    pub fn new(demand: &Demand) -> Result<Self, PlanError> {
        let Demand { nodes, stores, page_bytes, image_bytes, .. } = *demand;
        let processes = u32::from(nodes) + u32::from(stores);
        if nodes == 0 {
            return Err(PlanError::NoNodes);
        }
        if processes > u32::from(PROCESSES_MAX) {
            return Err(PlanError::TooManyProcesses { got: processes });
        }
        let (first_owner, owners) = if stores > 0 { (nodes, stores) } else { (0, nodes) };
        let page_count = image_bytes.div_ceil(u64::from(page_bytes));
        let page_count =
            u32::try_from(page_count).map_err(|_| PlanError::Placement(PlacementError::TooManyPages))?;
        let stripe_pages = stripe_pages(page_count, owners);
        let placement = Stripes::new(page_count, stripe_pages, NodeId(first_owner), owners)
            .and_then(|stripes| stripes.with_replicas(demand.replicas))
            .map_err(PlanError::Placement)?;
        let unfilled = Self { placement, nodes, stores, page_bytes, budget_bytes: 0, slots: 0 };
        if demand.replicated { unfilled.replicated(demand) } else { unfilled.paged(demand) }
    }

    fn replicated(self, demand: &Demand) -> Result<Self, PlanError> {
        let image_bytes = demand.image_bytes;
        let budget_bytes = demand.memory.map_or(image_bytes, |memory| memory.of(image_bytes));
        if budget_bytes < image_bytes {
            return Err(PlanError::ReplicatedBelowImage { budget_bytes, image_bytes });
        }
        Ok(Self { budget_bytes, ..self })
    }

    fn paged(self, demand: &Demand) -> Result<Self, PlanError> {
        let home_bytes = self.own_bytes_max();
        // Shares are of whole pages: half a page cannot be held.
        let image_bytes = u64::from(self.placement.page_count()) * u64::from(self.page_bytes);
        let per_slot = u64::from(self.page_bytes) + PER_SLOT_BYTES;
        let extra = Memory::Share(EXTRA_SHARE).of(image_bytes).max(EXTRA_SLOTS_MIN * per_slot);
        let unsaid = extra + home_bytes + self.bookkeeping_bytes(0);
        let budget_bytes = demand.memory.map_or(unsaid, |memory| memory.of(image_bytes));
        let others = self.placement.page_count() - self.fewest_own();
        if others == 0 {
            return Ok(Self { budget_bytes: budget_bytes.max(home_bytes), ..self });
        }
        let fixed_bytes = home_bytes + self.bookkeeping_bytes(0);
        let rest = budget_bytes.checked_sub(home_bytes).ok_or(PlanError::BelowHomeShare {
            budget_bytes,
            home_bytes,
            image_bytes,
            nodes: self.nodes,
            replicas: self.placement.replicas(),
        })?;
        let slots = rest.saturating_sub(self.bookkeeping_bytes(0)) / per_slot;
        // All of the image is there: what the tables need on top of 100 % is not held against it.
        let whole_image = budget_bytes >= image_bytes;
        let slots = if whole_image { others } else { u32::try_from(slots).unwrap_or(others).min(others) };
        if slots == 0 {
            return Err(PlanError::NoSlot { budget_bytes, needed_bytes: fixed_bytes + per_slot });
        }
        Ok(Self { budget_bytes, slots, ..self })
    }

    /// What the tables take that a node keeps.
    fn bookkeeping_bytes(&self, slots: u32) -> u64 {
        bookkeeping_bytes(self.placement.page_count(), slots)
    }

    /// Pages that lie in a process's own memory: it is their home, or holds a replica.
    #[must_use]
    pub fn own_pages(&self, node: NodeId) -> u32 {
        self.placement.held_pages(node)
    }

    /// The numbers to send to a process.
    #[must_use]
    pub fn placement_numbers(&self) -> PlacementNumbers {
        let (first_owner, owner_count) =
            if self.stores > 0 { (self.nodes, self.stores) } else { (0, self.nodes) };
        PlacementNumbers {
            page_count: self.placement.page_count(),
            stripe_pages: self.placement.stripe_pages(),
            first_owner,
            owner_count,
            replicas: self.placement.replicas(),
        }
    }

    /// Bytes of its own of the rendering node that has most.
    fn own_bytes_max(&self) -> u64 {
        let pages = if self.stores > 0 { 0 } else { self.placement.held_pages_max() };
        u64::from(pages) * u64::from(self.page_bytes)
    }

    /// Pages of its own of the rendering node that has fewest.
    fn fewest_own(&self) -> u32 {
        (0..self.nodes).map(|node| self.own_pages(NodeId(node))).min().unwrap_or(0)
    }
}

impl PlacementNumbers {
    /// The placement itself.
    ///
    /// # Errors
    /// The numbers were not made by a [`Plan`].
    pub fn placement(&self) -> Result<Stripes, PlacementError> {
        Stripes::new(self.page_count, self.stripe_pages, NodeId(self.first_owner), self.owner_count)?
            .with_replicas(self.replicas)
    }
}

/// What the tables take that a node keeps for every page of the image and for its slots, with the greediest backend.
#[must_use]
pub fn bookkeeping_bytes(page_count: u32, slots: u32) -> u64 {
    u64::from(page_count) * PER_PAGE_BYTES + u64::from(slots) * PER_SLOT_BYTES
}

/// The state of a page, its entry in the table of `soft`, and its next use where hints foretell it.
const PER_PAGE_BYTES: u64 = size_of::<PageEntry>() as u64 + 4 + 4;

/// The state of a slot, and its pins and mark with `soft`.
const PER_SLOT_BYTES: u64 = size_of::<SlotEntry>() as u64 + 5;

/// How many pages a stripe has: enough stripes that all owners get alike, few enough that each is worth a mapping.
fn stripe_pages(page_count: u32, owners: u16) -> u32 {
    const STRIPES_WANTED: u32 = 64;
    const STRIPE_PAGES_MAX: u32 = 64;
    let pages = page_count / (u32::from(owners) * STRIPES_WANTED);
    (pages + 1).next_power_of_two().div_euclid(2).clamp(1, STRIPE_PAGES_MAX)
}

impl fmt::Display for PlanError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        match self {
            Self::BelowHomeShare { budget_bytes, home_bytes, image_bytes, nodes, replicas } => write!(
                f,
                "--memory allows a node {} ({:.1} % of the image's {}), and its home pages{} alone, dealt to {nodes} nodes, \
                 take {} ({:.1} %); allow more, use more --nodes{}, or let others hold the pages with --stores M",
                Bytes(*budget_bytes),
                percent(*budget_bytes, *image_bytes),
                Bytes(*image_bytes),
                if *replicas > 1 { " and replicas" } else { "" },
                Bytes(*home_bytes),
                percent(*home_bytes, *image_bytes),
                if *replicas > 1 { ", fewer --replicas" } else { "" },
            ),
            Self::NoSlot { budget_bytes, needed_bytes } => write!(
                f,
                "--memory allows a node {}, and its home pages, its tables and a single page of others take {}; allow \
                 more, choose a smaller --page, or let others hold the pages with --stores M",
                Bytes(*budget_bytes),
                Bytes(*needed_bytes),
            ),
            Self::ReplicatedBelowImage { budget_bytes, image_bytes } => write!(
                f,
                "--backend replicated holds the whole image, {}, in every node, and --memory allows {}",
                Bytes(*image_bytes),
                Bytes(*budget_bytes),
            ),
            Self::TooManyProcesses { got } => {
                write!(f, "{got} nodes and stores are more than the {PROCESSES_MAX} that one machine can run")
            }
            Self::NoNodes => write!(f, "--nodes 0 leaves nobody to render"),
            Self::Placement(error) => write!(f, "{error}"),
        }
    }
}

impl core::error::Error for PlanError {}

#[cfg(test)]
mod tests {
    use super::*;

    const MEGABYTE: u64 = 1 << 20;

    fn demand() -> Demand {
        Demand {
            nodes: 4,
            stores: 0,
            memory: Some(Memory::Share(0.4)),
            image_bytes: 64 * MEGABYTE,
            page_bytes: 16384,
            replicated: false,
            replicas: 1,
        }
    }

    #[test]
    fn forty_percent_are_a_quarter_at_home_and_the_rest_in_slots() {
        let plan = Plan::new(&demand()).unwrap();
        assert_eq!(plan.placement.page_count(), 4096);
        assert_eq!(plan.own_pages(NodeId(0)), 1024);
        // 15 % of 4096 pages, less what the tables take.
        assert!((600..=614).contains(&plan.slots), "{}", plan.slots);
        let held = u64::from(1024 + plan.slots) * 16384 + plan.bookkeeping_bytes(plan.slots);
        assert!(held <= plan.budget_bytes && plan.budget_bytes == 64 * MEGABYTE * 4 / 10);
    }

    #[test]
    fn saying_nothing_is_saying_home_share_and_fifteen_percent() {
        let said = Plan::new(&demand()).unwrap();
        let unsaid = Plan::new(&Demand { memory: None, ..demand() }).unwrap();
        assert!(unsaid.slots >= said.slots && unsaid.slots <= said.slots + 4);
        let alone = Plan::new(&Demand { nodes: 1, memory: None, ..demand() }).unwrap();
        assert_eq!((alone.slots, alone.own_pages(NodeId(0))), (0, 4096));
    }

    #[test]
    fn less_than_the_home_share_is_refused_with_the_figures_and_the_way_out() {
        let error = Plan::new(&Demand { memory: Some(Memory::Share(0.16)), ..demand() }).unwrap_err();
        let text = error.to_string();
        for words in ["10.2 MB", "16.0 %", "64 MB", "16 MB", "25.0 %", "--stores"] {
            assert!(text.contains(words), "{words:?} is not in {text:?}");
        }
    }

    #[test]
    fn replicas_count_as_memory_and_too_little_for_them_is_refused_with_the_way_out() {
        let twice = Demand { replicas: 2, ..demand() };
        let error = Plan::new(&twice).unwrap_err().to_string();
        for words in ["and replicas", "32 MB", "50.0 %", "fewer --replicas"] {
            assert!(error.contains(words), "{words:?} is not in {error:?}");
        }
        let plan = Plan::new(&Demand { memory: Some(Memory::Share(0.6)), ..twice }).unwrap();
        assert_eq!(plan.own_pages(NodeId(0)), 2048);
        let held = u64::from(2048 + plan.slots) * 16384 + plan.bookkeeping_bytes(plan.slots);
        assert!(plan.slots > 390 && held <= plan.budget_bytes, "{} slots", plan.slots);
        assert_eq!(plan.placement_numbers().placement().unwrap(), plan.placement);
        let error = Plan::new(&Demand { stores: 1, ..twice }).unwrap_err();
        assert!(matches!(error, PlanError::Placement(PlacementError::Replicas { got: 2, owners: 1 })));
    }

    #[test]
    fn with_stores_the_whole_budget_is_slots() {
        let demand = Demand { stores: 2, memory: Some(Memory::Share(0.16)), ..demand() };
        let plan = Plan::new(&demand).unwrap();
        assert_eq!(plan.own_pages(NodeId(0)), 0);
        assert_eq!(plan.own_pages(NodeId(4)) + plan.own_pages(NodeId(5)), 4096);
        assert!((640..=655).contains(&plan.slots), "{}", plan.slots);
    }

    #[test]
    fn the_whole_image_fits_in_the_whole_image() {
        let plan = Plan::new(&Demand { memory: Some(Memory::Share(1.0)), ..demand() }).unwrap();
        assert_eq!(plan.slots, 3072);
    }

    #[test]
    fn a_budget_without_room_for_one_page_is_refused() {
        let small = Demand { stores: 1, image_bytes: MEGABYTE, page_bytes: 2 << 20, ..demand() };
        assert!(matches!(Plan::new(&small), Err(PlanError::NoSlot { .. })));
    }

    #[test]
    fn a_scene_of_a_few_pages_needs_no_words_about_memory() {
        for pages in 1..30 {
            for nodes in 1..=8 {
                let demand = Demand { nodes, memory: None, image_bytes: pages * 16384, ..demand() };
                let plan = Plan::new(&demand).unwrap();
                assert!(plan.slots > 0 || nodes == 1, "{pages} pages on {nodes} nodes");
            }
        }
    }

    #[test]
    fn replication_needs_the_whole_image_in_each_node() {
        let demand = Demand { replicated: true, ..demand() };
        assert!(matches!(Plan::new(&demand), Err(PlanError::ReplicatedBelowImage { .. })));
        assert_eq!(Plan::new(&Demand { memory: None, ..demand }).unwrap().slots, 0);
    }

    #[test]
    fn owners_get_alike_at_every_size() {
        for image_bytes in [1, 16384, 90 * 16384, 1000 * 16384, 100_000 * 16384] {
            for nodes in 1..=8 {
                let demand = Demand { nodes, memory: Some(Memory::Share(1.0)), image_bytes, ..demand() };
                let plan = Plan::new(&demand).unwrap();
                let most = plan.placement.home_pages_max();
                let fair = plan.placement.page_count().div_ceil(u32::from(nodes));
                assert!(
                    most <= fair + fair / 16 + 1,
                    "{image_bytes} bytes on {nodes}: {most} against {fair}"
                );
            }
        }
    }

    #[test]
    fn too_many_processes_and_none_are_refused() {
        assert!(matches!(Plan::new(&Demand { nodes: 0, ..demand() }), Err(PlanError::NoNodes)));
        assert!(matches!(
            Plan::new(&Demand { nodes: 65, ..demand() }),
            Err(PlanError::TooManyProcesses { got: 65 })
        ));
    }
}
