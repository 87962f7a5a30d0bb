//! Gathering between processes: parcels, credit, several displays, and what their work takes.

use std::collections::VecDeque;

use rt_core::Tiles;

use super::letters::{Letters, Parcel};

/// How tiles come to the displays, over links that lose nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gather {
    /// Threads that put the picture together, each a band of rows of tiles.
    pub displays: u16,
    /// Bytes of a parcel at most.
    pub parcel_bytes: u32,
    /// Tiles of a parcel at most.
    pub parcel_tiles: u32,
    /// Bytes that a node may have under way to a display.
    pub window_bytes: u64,
    /// What the work takes.
    pub costs: Costs,
}

/// What communication takes of the processors, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Costs {
    /// A node: to make a tile ready for its parcel, and to take the next one in hand.
    pub tile_out: u64,
    /// A node: to send a parcel.
    pub parcel_out: u64,
    /// A display: to receive a parcel.
    pub parcel_in: u64,
    /// A display: to put a tile in place.
    pub tile_in: u64,
    /// The supervisor: to send a message.
    pub message_out: u64,
    /// The supervisor: to receive one.
    pub message_in: u64,
}

/// Time spent on communication in one frame, in nanoseconds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Talk {
    /// By each display.
    pub displays: Vec<u64>,
    /// By the supervisor's own thread.
    pub supervisor: u64,
    /// Parcels that came.
    pub parcels: u64,
    /// Bytes of them.
    pub bytes: u64,
}

/// A node's way to the displays.
#[derive(Debug)]
pub(super) struct Outlet {
    gather: Gather,
    tiles: Tiles,
    me: u16,
    /// What each thread has for each display.
    parcels: Vec<Vec<Parcel>>,
    /// What waits for credit, by display.
    waiting: Vec<VecDeque<u32>>,
    sent: Vec<u64>,
    taken: Vec<u64>,
}

/// Bytes before those of a tile's pixels, about, and before the first tile.
const HEAD_BYTES: u32 = 8;
const FRAME_BYTES: u32 = 4;

impl Gather {
    /// One display, and the parcels and credit of the program.
    #[must_use]
    pub const fn new(costs: Costs) -> Self {
        Self { displays: 1, parcel_bytes: 32 << 10, parcel_tiles: u32::MAX, window_bytes: 128 << 10, costs }
    }

    /// Credit is given again after so many bytes.
    pub(super) const fn step_bytes(&self) -> u64 {
        self.window_bytes / 4
    }
}

impl Talk {
    pub(super) fn of(displays: u16) -> Self {
        Self { displays: vec![0; displays.into()], ..Self::default() }
    }

    /// Of all threads together.
    #[must_use]
    pub fn sum(&self) -> u64 {
        self.supervisor + self.displays.iter().sum::<u64>()
    }

    /// Of the thread that had most.
    #[must_use]
    pub fn most(&self) -> u64 {
        self.displays.iter().copied().max().unwrap_or(0).max(self.supervisor)
    }
}

impl Outlet {
    pub(super) fn new(gather: Gather, tiles: Tiles, me: u16, threads: u16) -> Self {
        let displays = usize::from(gather.displays);
        Self {
            gather,
            tiles,
            me,
            parcels: vec![vec![Parcel::default(); displays]; threads.into()],
            waiting: vec![VecDeque::new(); displays],
            sent: vec![0; displays],
            taken: vec![0; displays],
        }
    }

    /// Adds a tile whose pixels take so many bytes, and puts aside what is full.
    pub(super) fn push(&mut self, letters: &Letters, thread: u16, frame: u32, tile: u32, bytes: u32) {
        let row = tile / self.tiles.columns().max(1);
        let display = row * u32::from(self.gather.displays) / self.tiles.rows().max(1);
        let display = u16::try_from(display).unwrap_or(0);
        let bytes = HEAD_BYTES + bytes;
        let me = self.me;
        let has = &mut self.parcels[usize::from(thread)][usize::from(display)];
        let is_full = has.bytes + bytes > self.gather.parcel_bytes
            || has.tiles.len() >= self.gather.parcel_tiles as usize;
        if !has.tiles.is_empty() && (is_full || has.frame != frame) {
            let number = letters.add_parcel(core::mem::take(has));
            self.waiting[usize::from(display)].push_back(number);
        }
        if has.tiles.is_empty() {
            *has = Parcel { from: me, display, frame, tiles: Vec::new(), bytes: FRAME_BYTES };
        }
        has.tiles.push(tile);
        has.bytes += bytes;
        if has.tiles.len() >= self.gather.parcel_tiles as usize {
            let number = letters.add_parcel(core::mem::take(has));
            self.waiting[usize::from(display)].push_back(number);
        }
    }

    /// A thread has nothing to draw: what it has goes off.
    pub(super) fn flush(&mut self, letters: &Letters, thread: u16) {
        for (display, parcel) in self.parcels[usize::from(thread)].iter_mut().enumerate() {
            if !parcel.tiles.is_empty() {
                self.waiting[display].push_back(letters.add_parcel(core::mem::take(parcel)));
            }
        }
    }

    /// A display has taken so many bytes since the beginning.
    pub(super) fn credit(&mut self, display: u16, bytes: u64) {
        let taken = &mut self.taken[usize::from(display)];
        *taken = bytes.max(*taken);
    }

    /// The next parcel that there is credit for, and its bytes.
    pub(super) fn next(&mut self, letters: &Letters) -> Option<(u32, u32)> {
        for display in 0..self.waiting.len() {
            let Some(number) = self.waiting[display].front().copied() else { continue };
            let (_, _, bytes) = letters.size_of(number);
            if self.sent[display] + u64::from(bytes) - self.taken[display] <= self.gather.window_bytes {
                self.sent[display] += u64::from(bytes);
                self.waiting[display].pop_front();
                return Some((number, bytes));
            }
        }
        None
    }
}
