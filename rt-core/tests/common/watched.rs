//! Memory that is watched.

use core::cell::Cell;

use rt_core::{Flat, SceneMemory, SceneView};

/// Memory that notes which pages are read. All tests that look at reads use it, since each kind of memory is a kernel
/// more to compile.
pub struct Watched<'a> {
    bytes: Flat<'a>,
    /// Whether each page has been read.
    pages: Vec<Cell<bool>>,
    /// What has not been read is far away.
    is_far: Cell<bool>,
}

/// Bytes of a page.
pub const PAGE_BYTES: usize = 4096;

/// A scene in memory that is watched. All of it is at hand.
pub fn watched(image: &[u8]) -> SceneView<Watched<'_>> {
    let pages = vec![Cell::new(false); image.len().div_ceil(PAGE_BYTES)];
    let memory = Watched { bytes: Flat::new(image), pages, is_far: Cell::new(false) };
    SceneView::new(memory).expect("the header is sound")
}

impl Watched<'_> {
    /// Nothing has been read so far; from now on, what has not been read may be far away.
    pub fn forget(&self, is_far: bool) {
        self.pages.iter().for_each(|page| page.set(false));
        self.is_far.set(is_far);
    }

    /// How many pages have been read that begin in this range of bytes.
    pub fn read_in(&self, bytes: core::ops::Range<u64>) -> usize {
        let begins = |page: usize| bytes.contains(&((page * PAGE_BYTES) as u64));
        self.pages.iter().enumerate().filter(|(page, read)| read.get() && begins(*page)).count()
    }

    fn page(&self, offset: u64) -> Option<&Cell<bool>> {
        self.pages.get(usize::try_from(offset).ok()? / PAGE_BYTES)
    }

    /// How many pages have been read.
    pub fn read(&self) -> usize {
        self.read_in(0..u64::MAX)
    }
}

impl SceneMemory for Watched<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        let record = self.bytes.record(offset, length)?;
        self.page(offset)?.set(true);
        Some(record)
    }

    fn length(&self) -> u64 {
        self.bytes.length()
    }

    fn is_at_hand(&self, offset: u64, _length: usize) -> bool {
        !self.is_far.get() || self.page(offset).is_some_and(Cell::get)
    }

    fn is_all_at_hand(&self) -> bool {
        !self.is_far.get()
    }
}
