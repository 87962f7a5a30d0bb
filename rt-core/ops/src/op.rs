//! One thing that can happen.

/// One thing that can happen to a cluster.
///
/// Numbers count what there is when it happens, and begin again at its end: every operation means something in every
/// state, or nothing. Made by proptest and the fuzzer, listed by [`World::enabled`](crate::World::enabled).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Op {
    /// An idle thread of a node asks for a tile.
    Take(u8),
    /// A thread of a node has drawn its tile.
    Draw {
        /// Which node.
        node: u8,
        /// Which of the tiles that are being drawn.
        tile: u8,
        /// How long it took, in units of 100 microseconds.
        cost: u8,
    },
    /// The n-th message under way arrives.
    Deliver(u8),
    /// The n-th message under way is lost.
    Drop(u8),
    /// The n-th message under way arrives and stays under way.
    Duplicate(u8),
    /// Time passes to the next moment at which somebody has something to look after, and it does. The display comes after
    /// the nodes.
    Timer(u8),
    /// Time passes, and everybody looks.
    Advance {
        /// How much, in microseconds.
        us: u16,
    },
    /// A node ends without a word.
    Crash(u8),
    /// A node that ended is started again, and says so.
    Restart(u8),
    /// All are told that a node has ended. Without effect when it has not.
    TellDown(u8),
    /// The next frame begins, if this one is whole.
    NextFrame,
    /// A copy of the n-th message under way arrives that is for somebody else, in this respect.
    Stray {
        /// Which message.
        message: u8,
        /// In what respect.
        how: Stray,
    },
    /// Bytes that are nearly a message arrive: the n-th message under way with one byte changed.
    Corrupt {
        /// Which message.
        message: u8,
        /// Which of its bytes.
        byte: u8,
        /// With these bits the other way round.
        xor: u8,
    },
}

/// In what respect a message is for somebody else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stray {
    /// It is of another epoch.
    Epoch,
    /// It is of a view that has not begun anywhere.
    View,
    /// It is of the frame before.
    Frame,
    /// It names another receiver.
    To,
}

impl Stray {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Epoch, Self::View, Self::Frame, Self::To];
}

impl Op {
    /// Bytes that an operation is made of.
    pub const BYTES: usize = 4;

    /// The operation that these bytes stand for. All bytes stand for one, and frequent ones have many.
    #[must_use]
    pub fn from_bytes([kind, a, b, c]: [u8; Self::BYTES]) -> Self {
        match kind % 64 {
            0..13 => Self::Take(a),
            13..25 => Self::Draw { node: a, tile: b, cost: c },
            25..43 => Self::Deliver(a),
            43..46 => Self::Drop(a),
            46..49 => Self::Duplicate(a),
            49..52 => Self::Timer(a),
            52 | 53 => Self::Advance { us: u16::from_le_bytes([a, b]) },
            54 => Self::Crash(a),
            55 => Self::Restart(a),
            56 | 57 => Self::TellDown(a),
            58..61 => Self::NextFrame,
            61 => Self::Stray { message: a, how: Stray::ALL[usize::from(b) % Stray::ALL.len()] },
            _ => Self::Corrupt { message: a, byte: b, xor: c },
        }
    }

    /// The operations that `bytes` stand for; what is left at their end is none.
    pub fn list_from_bytes(bytes: &[u8]) -> impl Iterator<Item = Self> + '_ {
        bytes.as_chunks::<{ Self::BYTES }>().0.iter().copied().map(Self::from_bytes)
    }
}
