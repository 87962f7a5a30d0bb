//! Which pages a tile uses, noted for next to nothing.

use core::cell::{Cell, RefCell};

use dsm_core::id::PageId;
use rt_core::SceneMemory;

/// The pages that a thread has used since it last took them.
#[derive(Debug)]
pub struct Notes {
    page_shift: u32,
    /// A bit for each page that is in `pages`.
    seen: Vec<Cell<u64>>,
    pages: RefCell<Vec<PageId>>,
}

/// A scene's memory, and notes of which pages of it are used.
///
/// A record of a page that was used before costs a look at its bit, and a branch that is nearly always the same: to compare
/// with the page of the last record costs three times as much, because nobody can predict the outcome.
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
            pages: RefCell::new(Vec::new()),
        }
    }

    /// Gives the pages that were used since the last call to `use_pages`, each once, in the order of their first use.
    pub fn take(&self, use_pages: impl FnOnce(&[PageId])) {
        let mut pages = self.pages.borrow_mut();
        use_pages(&pages);
        for page in pages.drain(..) {
            self.seen[page.index() / 64].set(0);
        }
    }

    #[inline]
    fn record(&self, offset: u64) {
        let page = offset >> self.page_shift;
        let word = usize::try_from(page / 64).ok().and_then(|word| self.seen.get(word));
        if let Some(word) = word
            && word.get() & bit_of(page) == 0
        {
            self.note(page, word);
        }
    }

    #[cold]
    fn note(&self, page: u64, word: &Cell<u64>) {
        word.set(word.get() | bit_of(page));
        // There is a bit for it, so its number fits.
        self.pages.borrow_mut().extend(u32::try_from(page).map(PageId));
    }
}

const fn bit_of(page: u64) -> u64 {
    1 << (page % 64)
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

    #[inline]
    fn record(&self, offset: u64, length: usize) -> Option<Self::Record<'_>> {
        self.notes.record(offset);
        self.memory.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.memory.length()
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
}
