//! Which pages a tile uses, noted for next to nothing.

use core::cell::{Cell, RefCell};

use dsm_core::id::PageId;
use rt_core::SceneMemory;

/// The pages that a thread has used since it last took them.
#[derive(Debug)]
pub struct Notes {
    page_shift: u32,
    /// A bit for each page that is in `pages` and need not be noted again.
    seen: Vec<Cell<u64>>,
    is_once: bool,
    /// Where every touch is noted, the page of the last record; `u64::MAX` before the first.
    last: Cell<u64>,
    /// Pages that are not in `pages` may have to be fetched.
    may_miss: bool,
    pages: RefCell<Vec<PageId>>,
}

/// A scene's memory, and notes of which pages of it are used.
///
/// A record of a page that is noted costs a look at its bit. Whether it is the page of the record before is not asked: it is so
/// half of the time, and a branch that nobody can foretell costs more than the bit.
#[derive(Clone, Copy, Debug)]
pub struct Noted<'a, M> {
    memory: M,
    notes: &'a Notes,
}

impl Notes {
    /// Nothing noted of an image yet.
    #[must_use]
    pub fn new(page_bytes: u32, image_bytes: u64) -> Self {
        let pages = image_bytes.div_ceil(page_bytes.into());
        let words = usize::try_from(pages.div_ceil(64)).unwrap_or(0);
        Self {
            page_shift: page_bytes.trailing_zeros(),
            seen: vec![Cell::new(0); words],
            is_once: true,
            last: Cell::new(u64::MAX),
            may_miss: true,
            pages: RefCell::new(Vec::new()),
        }
    }

    /// Notes every touch: a page is there again each time it is used after another.
    #[must_use]
    pub fn of_every_touch(page_bytes: u32, image_bytes: u64) -> Self {
        Self { is_once: false, ..Self::new(page_bytes, image_bytes) }
    }

    /// Says whether pages may have to be fetched; otherwise kernels need not look twice whether they have to read.
    #[must_use]
    pub fn with_misses(self, may_miss: bool) -> Self {
        Self { may_miss, ..self }
    }

    /// Gives the pages that were used since the last call to `use_pages`, in the order of their (first) use.
    pub fn take(&self, use_pages: impl FnOnce(&[PageId])) {
        let mut pages = self.pages.borrow_mut();
        use_pages(&pages);
        for page in pages.drain(..) {
            if let Some(word) = self.seen.get(page.index() / 64) {
                word.set(0);
            }
        }
        self.last.set(u64::MAX);
    }

    #[inline]
    fn record(&self, offset: u64) {
        let page = offset >> self.page_shift;
        if !self.is_noted(page) {
            self.note(page);
        }
    }

    /// Whether a page is in `pages`.
    #[inline]
    fn is_noted(&self, page: u64) -> bool {
        let word = usize::try_from(page / 64).ok().and_then(|word| self.seen.get(word));
        word.is_some_and(|word| word.get() >> (page % 64) & 1 != 0)
    }

    /// Whether the page at `offset` is here: one of its records has been used since the pages were taken.
    #[inline]
    fn holds(&self, offset: u64) -> bool {
        !self.may_miss || self.is_noted(offset >> self.page_shift)
    }

    #[cold]
    #[inline(never)]
    fn note(&self, page: u64) {
        let Ok(number) = u32::try_from(page) else { return };
        let Some(word) = self.seen.get(PageId(number).index() / 64) else { return };
        if self.is_once {
            word.set(word.get() | 1 << (page % 64));
        } else if self.last.replace(page) == page {
            return;
        }
        self.pages.borrow_mut().push(PageId(number));
    }
}

impl<'a, M> Noted<'a, M> {
    /// Notes what is read of `memory`.
    pub const fn new(memory: M, notes: &'a Notes) -> Self {
        Self { memory, notes }
    }
}

impl<M: SceneMemory> SceneMemory for Noted<'_, M> {
    type Record<'b>
        = M::Record<'b>
    where
        Self: 'b;

    const HOLDS_NOTHING: bool = M::HOLDS_NOTHING;

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<Self::Record<'_>> {
        self.notes.record(offset);
        self.memory.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.memory.length()
    }

    /// The first record of a page may cost a miss, and the page a slot. Others of the same tile do not.
    #[inline]
    fn is_at_hand(&self, offset: u64, _length: usize) -> bool {
        self.notes.holds(offset)
    }

    #[inline]
    fn is_all_at_hand(&self) -> bool {
        !self.notes.may_miss
    }

    #[inline]
    fn prefetch(&self, offset: u64, length: usize) {
        self.memory.prefetch(offset, length);
    }
}

#[cfg(test)]
mod tests {
    use rt_core::Flat;

    use super::*;

    #[test]
    fn each_page_is_noted_once_and_anew_after_it_was_taken() {
        let bytes = vec![0; 70 * 4096];
        let notes = Notes::new(4096, 70 * 4096);
        let memory = Noted::new(Flat::new(&bytes), &notes);
        let taken = || {
            let mut taken = Vec::new();
            notes.take(|pages| taken.extend(pages.iter().map(|page| page.0)));
            taken
        };
        for page in [3, 3, 69, 3, 68, 69, 0] {
            assert!(memory.record(page * 4096 + 8, 16).is_some());
        }
        assert_eq!(memory.record(u64::MAX, 1), None);
        assert_eq!(taken(), [3, 69, 68, 0]);
        assert!(memory.record(0, 16).is_some());
        assert_eq!(taken(), [0]);
        assert!(taken().is_empty());
    }

    #[test]
    fn a_page_is_at_hand_once_it_was_used_or_where_none_is_missed() {
        let bytes = vec![0; 8 * 4096];
        for may_miss in [true, false] {
            let notes = Notes::new(4096, 8 * 4096).with_misses(may_miss);
            let memory = Noted::new(Flat::new(&bytes), &notes);
            assert_eq!(memory.is_at_hand(5 * 4096, 16), !may_miss);
            assert!(memory.record(5 * 4096 + 64, 16).is_some());
            assert!(memory.is_at_hand(5 * 4096, 16));
            notes.take(|_| ());
            assert_eq!([5, 9].map(|page| memory.is_at_hand(page * 4096, 16)), [!may_miss; 2]);
        }
    }

    #[test]
    fn every_touch_is_noted_where_every_one_counts() {
        let bytes = vec![0; 8 * 4096];
        let notes = Notes::of_every_touch(4096, 8 * 4096);
        let memory = Noted::new(Flat::new(&bytes), &notes);
        for page in [3, 3, 5, 3] {
            assert!(memory.record(page * 4096, 16).is_some());
        }
        let mut taken = Vec::new();
        notes.take(|pages| taken.extend(pages.iter().map(|page| page.0)));
        assert_eq!(taken, [3, 5, 3]);
    }
}
