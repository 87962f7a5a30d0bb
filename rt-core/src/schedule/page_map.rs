//! A sketch of a set of pages.

/// Which parts of the address space a set of pages lies in: one bit for each of 256 equal parts.
///
/// Pages that are neighbours in address are neighbours in space, and so a set of pages that a node or a tile uses is a
/// few runs of the address space. A part of it is a better thing to compare than a hash of a page: bits stay rare
/// however many pages there are, and a page that is near counts as near.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct PageMap([u64; 4]);

impl PageMap {
    /// No pages.
    pub const EMPTY: Self = Self([0; 4]);

    /// Length of a map in a message.
    pub const BYTES: usize = 32;

    /// The map of these pages of an address space of `page_count`. Pages beyond it are left out.
    pub fn of(pages: impl IntoIterator<Item = u32>, page_count: u32) -> Self {
        let mut map = Self::EMPTY;
        for page in pages.into_iter().filter(|page| *page < page_count) {
            let part = u64::from(page) * u64::from(Self::PARTS) / u64::from(page_count);
            let words = (0..).step_by(64).zip(&mut map.0);
            words
                .filter(|(start, _)| (*start..start + 64).contains(&part))
                .for_each(|(_, word)| *word |= 1 << (part % 64));
        }
        map
    }

    /// What is in either.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        Self([a | e, b | f, c | g, d | h])
    }

    /// How much of this map is in `other`, in sixteenths; none of an empty map is.
    pub const fn share_in(self, other: Self) -> usize {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        let both = Self([a & e, b & f, c & g, d & h]).parts();
        match self.parts() {
            0 => 0,
            parts => (both * Self::SHARES / parts) as usize,
        }
    }

    /// Shares are counted in this many parts of the whole.
    pub const SHARES: u32 = 16;

    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        bytemuck::cast(self.0.map(u64::to_le))
    }

    pub(super) fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytemuck::cast::<_, [u64; 4]>(bytes).map(u64::from_le))
    }

    const PARTS: u32 = 256;

    /// Parts that have a page.
    const fn parts(self) -> u32 {
        let [a, b, c, d] = self.0;
        a.count_ones() + b.count_ones() + c.count_ones() + d.count_ones()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_pages_share_a_part_and_distant_ones_do_not() {
        let near = PageMap::of([5_000, 5_001, 5_002], 10_000);
        assert_eq!(near.parts(), 1);
        assert_eq!(near.share_in(PageMap::of(4_999..5_010, 10_000)), 16);
        assert_eq!(near.share_in(PageMap::of([0, 9_999], 10_000)), 0);
        let half = PageMap::of([0, 5_000], 10_000);
        assert_eq!((half.share_in(near), near.share_in(half)), (8, 16));
    }

    #[test]
    fn small_spaces_have_a_part_for_each_page_and_strays_have_none() {
        let map = PageMap::of(0..100, 100);
        assert_eq!(map.parts(), 100);
        assert_eq!(PageMap::of([100, u32::MAX], 100), PageMap::EMPTY);
        assert_eq!(PageMap::of([0], 0), PageMap::EMPTY);
        assert_eq!(PageMap::EMPTY.share_in(map), 0);
        assert_eq!(PageMap::from_bytes(map.to_bytes()), map);
    }
}
