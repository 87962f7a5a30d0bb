//! The life of a page in a node's cache, as one table of state and event.

/// Where a page is in its life at one node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PageState {
    /// Not here, and nobody has asked for it.
    Absent = 0,
    /// Asked for; a slot is kept for it.
    Requested = 1,
    /// Its bytes are here and are being put in place; no reader sees them yet.
    Filling = 2,
    /// Mapped: reading it is a plain load that this crate never hears of.
    Resident = 3,
    /// Chosen as a victim and being taken away from its readers.
    Leaving = 4,
    /// Could not be had within its deadline. It stays so until the epoch ends.
    Failed = 5,
    /// This node is its home: always mapped, never evicted.
    Home = 6,
    /// Being taken from its readers' sight; its bytes stay in their slot.
    Hiding = 7,
    /// Out of its readers' sight, with its bytes in their slot: a touch brings it back without a message.
    Hidden = 8,
}

/// What can happen to a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PageEvent {
    /// A thread touched it while it was not mapped, and a slot is there for it.
    Fault,
    /// An owner's bytes arrived.
    Grant,
    /// The driver has put the bytes in place: the whole page is visible.
    Filled,
    /// The deadline passed, or the owner refused.
    Expire,
    /// The same, while nobody waited for it: it was asked for ahead.
    Abandon,
    /// Replacement chose it as a victim.
    Evict,
    /// The driver has taken it away from its readers; its slot is free.
    Unmapped,
    /// Replacement wants to know whether it is still used.
    Hide,
    /// The driver has taken it from its readers' sight.
    Covered,
}

/// What the node has to do on a transition, and what the thread that faulted is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Nothing. On a fault this cannot be; else the event came late or twice.
    None,
    /// Ask the home node for it; the faulting thread fetches.
    SendRequest,
    /// The faulting thread waits until the page's state changes.
    Wait,
    /// The faulting thread goes on: the page came meanwhile.
    Ready,
    /// The faulting thread is told that the page cannot be had.
    Refuse,
    /// Put the bytes into the slot and make the page visible.
    Map,
    /// Count it as resident and wake who waits for it.
    Wake,
    /// Take it away from its readers.
    Unmap,
    /// Take it from its readers' sight and keep its bytes.
    Hide,
    /// Count it as hidden and wake who waits for it.
    Keep,
    /// Make the bytes that are in its slot visible again; the faulting thread does it.
    Show,
    /// Free its slot and wake who waits, for it or for a slot.
    Release,
    /// Free its slot, remember why, and wake who waits.
    Fail,
    /// Free its slot and wake who waits for one.
    Forget,
}

impl PageState {
    /// All states, in the order of their numbers.
    pub const ALL: [Self; 9] = [
        Self::Absent,
        Self::Requested,
        Self::Filling,
        Self::Resident,
        Self::Leaving,
        Self::Failed,
        Self::Home,
        Self::Hiding,
        Self::Hidden,
    ];

    /// The transition table: the next state, and what follows from getting there.
    ///
    /// There is no `_` arm: a new state or event does not compile until each of its cells is thought about.
    /// The drawing of it is in ARCHITECTURE.md; `tests/page_state.rs` prints every cell.
    #[must_use]
    pub const fn on(self, event: PageEvent) -> (Self, Effect) {
        use PageEvent::{Abandon, Covered, Evict, Expire, Fault, Filled, Grant, Hide, Unmapped};
        use PageState::{Absent, Failed, Filling, Hidden, Hiding, Home, Leaving, Requested, Resident};
        match (self, event) {
            (Absent, Fault) => (Requested, Effect::SendRequest),
            (Absent, Grant | Filled | Expire | Abandon | Evict | Unmapped | Hide | Covered) => {
                (Absent, Effect::None)
            } // late or twice

            (Requested, Fault) => (Requested, Effect::Wait), // one request is enough
            (Requested, Grant) => (Filling, Effect::Map),
            (Requested, Expire) => (Failed, Effect::Fail),
            (Requested, Abandon) => (Absent, Effect::Forget), // whoever touches it later asks anew
            (Requested, Filled | Evict | Unmapped | Hide | Covered) => (Requested, Effect::None), // holds a slot, but no page

            (Filling, Fault) => (Filling, Effect::Wait),
            (Filling, Filled) => (Resident, Effect::Wake),
            (Filling, Grant | Expire | Abandon) => (Filling, Effect::None), // the bytes are here already
            (Filling, Evict | Unmapped | Hide | Covered) => (Filling, Effect::None), // its slot is being written

            (Resident, Fault) => (Resident, Effect::Ready), // two threads raced to it
            (Resident, Evict) => (Leaving, Effect::Unmap),
            (Resident, Hide) => (Hiding, Effect::Hide),
            (Resident, Grant | Filled | Expire | Abandon | Unmapped | Covered) => (Resident, Effect::None),

            (Leaving, Fault) => (Leaving, Effect::Wait), // it must be gone before it can come again
            (Leaving, Unmapped) => (Absent, Effect::Release),
            (Leaving, Grant | Filled | Expire | Abandon | Evict | Hide | Covered) => (Leaving, Effect::None),

            (Failed, Fault) => (Failed, Effect::Refuse),
            (Failed, Grant | Filled | Expire | Abandon | Evict | Unmapped | Hide | Covered) => {
                (Failed, Effect::None)
            } // too late

            (Home, Fault) => (Home, Effect::Ready), // mapped since before the first thread started
            (Home, Grant | Filled | Expire | Abandon | Evict | Unmapped | Hide | Covered) => {
                (Home, Effect::None)
            }

            (Hiding, Fault) => (Hiding, Effect::Wait), // it must be out of sight before it can be shown
            (Hiding, Covered) => (Hidden, Effect::Keep),
            (Hiding, Grant | Filled | Expire | Abandon | Evict | Unmapped | Hide) => (Hiding, Effect::None),

            (Hidden, Fault) => (Filling, Effect::Show), // a soft fault
            (Hidden, Evict) => (Leaving, Effect::Unmap),
            (Hidden, Grant | Filled | Expire | Abandon | Unmapped | Hide | Covered) => (Hidden, Effect::None),
        }
    }

    /// The state with this number. Numbers beyond the last state are never stored and read as the last one.
    pub(crate) const fn from_bits(bits: u32) -> Self {
        match bits {
            0 => Self::Absent,
            1 => Self::Requested,
            2 => Self::Filling,
            3 => Self::Resident,
            4 => Self::Leaving,
            5 => Self::Failed,
            6 => Self::Home,
            7 => Self::Hiding,
            _ => Self::Hidden,
        }
    }

    /// Whether a page in this state has a slot.
    #[must_use]
    pub const fn holds_slot(self) -> bool {
        match self {
            Self::Requested
            | Self::Filling
            | Self::Resident
            | Self::Leaving
            | Self::Hiding
            | Self::Hidden => true,
            Self::Absent | Self::Failed | Self::Home => false,
        }
    }
}

impl PageEvent {
    /// All events, in the order of the table's columns.
    pub const ALL: [Self; 9] = [
        Self::Fault,
        Self::Grant,
        Self::Filled,
        Self::Expire,
        Self::Abandon,
        Self::Evict,
        Self::Unmapped,
        Self::Hide,
        Self::Covered,
    ];
}
