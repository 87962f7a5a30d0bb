//! Memory that notes which pages are touched.

use core::cell::RefCell;

use rt_core::{Flat, SceneMemory};

/// An image in one slice, and the pages of it that were read.
#[derive(Debug)]
pub(super) struct Touched<'a> {
    image: Flat<'a>,
    page_bytes: u64,
    pages: RefCell<Vec<bool>>,
}

impl<'a> Touched<'a> {
    pub(super) fn new(image: &'a [u8], page_bytes: u32) -> Self {
        let pages = image.len().div_ceil(page_bytes as usize);
        Self {
            image: Flat::new(image),
            page_bytes: page_bytes.into(),
            pages: RefCell::new(vec![false; pages]),
        }
    }

    /// How many pages were read, that of the header included.
    pub(super) fn count(&self) -> u64 {
        self.pages.borrow().iter().map(|&touched| u64::from(touched)).sum()
    }
}

impl SceneMemory for Touched<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        let page = usize::try_from(offset / self.page_bytes).ok()?;
        if let Some(touched) = self.pages.borrow_mut().get_mut(page) {
            *touched = true;
        }
        self.image.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.image.length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_counts_once() {
        let image = [0; 64];
        let touched = Touched::new(&image, 16);
        for offset in [0, 3, 33, 40, 1000] {
            assert_eq!(touched.record(offset, 2).is_some(), offset < 64);
        }
        assert_eq!(touched.count(), 2);
    }
}
