//! What nodes send each other: the bytes of messages, kept in one place.

use core::cell::RefCell;
use std::rc::Rc;

use rt_core::schedule::Message;

/// A message under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Letter {
    /// The bytes with this number, of all that were ever sent.
    Bytes(u32),
    /// The parcel of tiles with this number.
    Parcel(u32),
    /// From a display: "I have taken so many bytes of yours since the beginning".
    Credit { display: u16, bytes: u64 },
    /// "I have started, for the how manieth time": to the display, until it deals.
    Hello {
        /// Starts so far.
        life: u16,
    },
}

/// What somebody sets itself to do later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Task {
    /// A thread has drawn a tile.
    Drawn { thread: u16, frame: u32, tile: u32, cost_us: u32 },
    /// A message of so many bytes leaves.
    Send { to: u16, bytes: u32, letter: Letter },
    /// A display has put the tiles of a parcel in place.
    Placed(u32),
    /// The supervisor has read a message.
    Read(Letter),
    /// Something may have to be said again.
    Look,
}

/// The bytes of all messages, and all parcels.
#[derive(Clone, Debug, Default)]
pub(super) struct Letters {
    messages: Rc<RefCell<Vec<Box<[u8]>>>>,
    parcels: Rc<RefCell<Vec<Parcel>>>,
}

/// Tiles of one frame, on their way to one display.
#[derive(Clone, Debug, Default)]
pub(super) struct Parcel {
    pub(super) from: u16,
    pub(super) display: u16,
    pub(super) frame: u32,
    pub(super) tiles: Vec<u32>,
    pub(super) bytes: u32,
}

/// Length of a [`Letter::Hello`].
pub(super) const HELLO_BYTES: u32 = 16;

/// Length of what a frame is, which travels with its first deal.
pub(super) const FRAME_BYTES: u32 = 136;

/// Length of a [`Letter::Credit`].
pub(super) const CREDIT_BYTES: u32 = 8;

impl Letters {
    pub(super) fn add(&self, bytes: &[u8]) -> Letter {
        let mut all = self.messages.borrow_mut();
        all.push(bytes.into());
        Letter::Bytes(u32::try_from(all.len() - 1).unwrap_or(u32::MAX))
    }

    /// The message of a letter; `None` for what is none.
    pub(super) fn read(&self, letter: Letter) -> Option<Message> {
        let Letter::Bytes(number) = letter else { return None };
        let all = self.messages.borrow();
        let (message, _) = Message::parse(all.get(number as usize)?).expect("what was sent parses");
        Some(message)
    }

    pub(super) fn add_parcel(&self, parcel: Parcel) -> u32 {
        let mut all = self.parcels.borrow_mut();
        all.push(parcel);
        u32::try_from(all.len() - 1).unwrap_or(u32::MAX)
    }

    /// Takes a parcel: it travels where nothing is doubled.
    pub(super) fn take_parcel(&self, number: u32) -> Parcel {
        self.parcels.borrow_mut().get_mut(number as usize).map(core::mem::take).unwrap_or_default()
    }

    /// A parcel's display, tiles and bytes.
    pub(super) fn size_of(&self, number: u32) -> (u16, usize, u32) {
        let all = self.parcels.borrow();
        all.get(number as usize)
            .map_or((0, 0, 0), |parcel| (parcel.display, parcel.tiles.len(), parcel.bytes))
    }
}
