//! What nodes send each other: the bytes of messages, kept in one place.

use core::cell::RefCell;
use std::rc::Rc;

use rt_core::schedule::Message;

/// A message under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Letter {
    /// The bytes with this number, of all that were ever sent.
    Bytes(u32),
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
    Drawn { frame: u32, tile: u32, cost_us: u32 },
    /// Something may have to be said again.
    Look,
}

/// The bytes of all messages.
#[derive(Clone, Debug, Default)]
pub(super) struct Letters(Rc<RefCell<Vec<Box<[u8]>>>>);

/// Length of a [`Letter::Hello`].
pub(super) const HELLO_BYTES: u32 = 16;

impl Letters {
    pub(super) fn add(&self, bytes: &[u8]) -> Letter {
        let mut all = self.0.borrow_mut();
        all.push(bytes.into());
        Letter::Bytes(u32::try_from(all.len() - 1).unwrap_or(u32::MAX))
    }

    /// The message of a letter; `None` for a hello.
    pub(super) fn read(&self, letter: Letter) -> Option<Message> {
        let Letter::Bytes(number) = letter else { return None };
        let all = self.0.borrow();
        let (message, _) = Message::parse(all.get(number as usize)?).expect("what was sent parses");
        Some(message)
    }
}
