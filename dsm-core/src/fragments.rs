//! Which parts of a page have come.

use crate::wire::{FRAGMENTS_MAX, fragment_unit};

/// A bit for each unit of a page: that part has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Fragments([u64; WORDS]);

const WORDS: usize = FRAGMENTS_MAX as usize / 64;

/// What a fragment has added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Added {
    /// Nothing: all of it was here.
    Nothing,
    /// Something, and more is missing.
    Some,
    /// What was missing.
    TheRest,
}

impl Fragments {
    /// Nothing has come.
    pub(crate) const NONE: Self = Self([0; WORDS]);

    /// Whether bytes `offset..offset + bytes` of a page can be a fragment: within the page, not empty, and in whole units.
    pub(crate) fn can_be(page_bytes: u32, offset: u32, bytes: u32) -> bool {
        let unit = fragment_unit(page_bytes);
        let end = offset.checked_add(bytes);
        bytes > 0
            && end.is_some_and(|end| end <= page_bytes)
            && offset.is_multiple_of(unit)
            && bytes.is_multiple_of(unit)
    }

    /// Notes a fragment that [`can_be`](Self::can_be). Parts that had come before are no matter.
    pub(crate) fn add(&mut self, page_bytes: u32, offset: u32, bytes: u32) -> Added {
        let before = *self;
        let unit = fragment_unit(page_bytes);
        for index in offset / unit..(offset + bytes) / unit {
            self.0[index as usize / 64] |= 1 << (index % 64);
        }
        let forgets = crate::mutants::is_on(crate::mutants::Mutant::ForgetFragments);
        match self.missing(page_bytes) {
            _ if *self == before => Added::Nothing,
            None => Added::TheRest,
            Some(_) if forgets => Added::TheRest,
            Some(_) => Added::Some,
        }
    }

    /// The part of the page from the first byte that is missing to the last, as offset and length. What came in between
    /// is asked for again; mostly a few in a row are lost.
    pub(crate) fn missing(&self, page_bytes: u32) -> Option<(u32, u32)> {
        let (unit, units) = (fragment_unit(page_bytes), page_bytes / fragment_unit(page_bytes));
        let is_missing = |index: &u32| self.0[*index as usize / 64] & (1 << (index % 64)) == 0;
        let first = (0..units).find(is_missing)?;
        let last = (0..units).rev().find(is_missing)?;
        Some((first * unit, (last + 1 - first) * unit))
    }

    pub(crate) fn is_empty(&self) -> bool {
        *self == Self::NONE
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::cast_possible_truncation, reason = "small numbers")]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_order_of_fragments_with_overlaps_makes_the_page_exactly_once(
            page_power in 0u32..22, parts in prop::collection::vec((0u32..256, 1u32..256), 0..40),
        ) {
            let page_bytes = 1u32 << page_power;
            let unit = fragment_unit(page_bytes);
            let mut has = [false; FRAGMENTS_MAX as usize];
            let has = &mut has[..(page_bytes / unit) as usize];
            let mut fragments = Fragments::NONE;
            for (start, length) in parts {
                let (offset, bytes) = (start * unit, length * unit);
                let fits = (start + length) as usize <= has.len();
                prop_assert_eq!(Fragments::can_be(page_bytes, offset, bytes), fits);
                if !fits { continue }
                let new = has[start as usize..(start + length) as usize].iter().any(|has| !has);
                has[start as usize..(start + length) as usize].fill(true);
                let expected = match (new, has.iter().all(|has| *has)) {
                    (false, _) => Added::Nothing,
                    (true, false) => Added::Some,
                    (true, true) => Added::TheRest,
                };
                prop_assert_eq!(fragments.add(page_bytes, offset, bytes), expected);
                let first = has.iter().position(|has| !has).map(|index| index as u32 * unit);
                let end = has.iter().rposition(|has| !has).map(|index| (index as u32 + 1) * unit);
                prop_assert_eq!(fragments.missing(page_bytes), first.zip(end).map(|(first, end)| (first, end - first)));
            }
        }
    }

    #[test]
    fn lies_about_fragments_are_known() {
        for (offset, bytes) in [(0, 0), (1, 64), (64, 1), (16384, 64), (u32::MAX - 63, 64), (0, 16448)] {
            assert!(!Fragments::can_be(16384, offset, bytes), "{offset} {bytes}");
        }
    }
}
