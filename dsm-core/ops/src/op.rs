//! One thing that can happen.

/// One thing that can happen to a cluster.
///
/// Numbers count what there is when it happens, and begin again at its end: every operation means something in every
/// state, or nothing. Made by proptest and the fuzzer, listed by [`World::enabled`](crate::World::enabled).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Op {
    /// A thread reads a page; of the upper quarter of the numbers, it asks for it ahead. Without effect while it waits for
    /// another.
    Read {
        /// Which node.
        node: u8,
        /// Which of its threads.
        thread: u8,
        /// Which page.
        page: u8,
    },
    /// The n-th message under way arrives.
    Deliver(u8),
    /// The n-th message under way is lost.
    Drop(u8),
    /// The n-th message under way arrives and stays under way.
    Duplicate(u8),
    /// The n-th piece of work of a node is finished: a slot filled, a victim unmapped.
    Finish {
        /// Which node.
        node: u8,
        /// Which piece of its work.
        work: u8,
    },
    /// Time passes, and every thread looks after its requests.
    Advance {
        /// How much, in microseconds.
        us: u16,
    },
    /// Time passes to the next moment at which a thread has something to look after, and it does.
    Timer {
        /// Which node.
        node: u8,
        /// Which of its threads.
        thread: u8,
    },
    /// The clock of a node jumps.
    Jump {
        /// Which node.
        node: u8,
        /// By how many milliseconds; back, when negative.
        ms: i8,
    },
    /// A node ends without a word.
    Crash(u8),
    /// A node that ended is started again.
    Restart(u8),
    /// The driver of a node learns that another has ended. Without effect when it has not.
    TellDown {
        /// Who is told.
        node: u8,
        /// Of whom.
        of: u8,
    },
    /// The driver of a node hears from another, otherwise than by a message.
    TellHeard {
        /// Who hears.
        node: u8,
        /// From whom.
        of: u8,
    },
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
    /// It is of another cluster.
    Cluster,
    /// It is of a node that holds no copy of the page.
    From,
    /// It answers another incarnation.
    Incarnation,
}

impl Stray {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Epoch, Self::Cluster, Self::From, Self::Incarnation];
}

impl Op {
    /// Bytes that an operation is made of.
    pub const BYTES: usize = 4;

    /// The operation that these bytes stand for. All bytes stand for one, and frequent ones have many.
    #[must_use]
    pub fn from_bytes([kind, a, b, c]: [u8; Self::BYTES]) -> Self {
        match kind % 64 {
            0..14 => Self::Read { node: a, thread: b, page: c },
            14..28 => Self::Deliver(a),
            28..40 => Self::Finish { node: a, work: b },
            40..44 => Self::Timer { node: a, thread: b },
            44..46 => Self::Drop(a),
            46..48 => Self::Duplicate(a),
            48..51 => Self::Advance { us: u16::from_le_bytes([a, b]) % 3000 },
            51 => Self::Jump { node: a, ms: i8::from_le_bytes([b]) },
            52..54 => Self::Crash(a),
            54 | 55 => Self::Restart(a),
            56 | 57 => Self::TellDown { node: a, of: b },
            58 => Self::TellHeard { node: a, of: b },
            59..62 => Self::Stray { message: a, how: Stray::ALL[usize::from(b) % Stray::ALL.len()] },
            _ => Self::Corrupt { message: a, byte: b, xor: c },
        }
    }

    /// The operations that `bytes` stand for; what is left at their end is none.
    pub fn list_from_bytes(bytes: &[u8]) -> impl Iterator<Item = Self> + '_ {
        bytes.as_chunks::<{ Self::BYTES }>().0.iter().copied().map(Self::from_bytes)
    }
}
