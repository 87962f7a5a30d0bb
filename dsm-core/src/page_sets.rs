//! Which pages each tile touched in the last frame: what foretells the next one.

use crate::id::PageId;

/// Memory lent to [`PageSets`].
#[derive(Debug)]
pub struct PageSetStorage<'s> {
    /// Room for the pages of all tiles of two frames; half of it is for each.
    pub entries: &'s mut [SetEntry],
    /// One entry per tile of the picture.
    pub tiles: &'s mut [TileEntry],
    /// One number per page of the address space.
    pub next_uses: &'s mut [u32],
}

/// A page that a tile touched, in 8 bytes. Opaque; start with [`SetEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SetEntry {
    page: u32,
    /// The next tile of this frame that touched the page in the last one, in the count of all tiles, or that tile
    /// itself when there is none.
    next_use: u32,
}

/// Where the pages of a tile are, in 20 bytes. Opaque; start with [`TileEntry::EMPTY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileEntry {
    /// Its place in this frame's order, in the count of all tiles.
    place: u32,
    sets: [Set; 2],
}

/// The pages of one tile in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Set {
    start: u32,
    count: u32,
}

/// The pages that each tile touched in the last frame and has touched so far in this one.
///
/// Time is counted in tiles, over all frames, and wraps: tile `i` of a frame's order has the *place* `start of the frame +
/// i`. Between frames the pages of a tile change little, so the last frame says what a tile is about to touch
/// ([`pages_of`](Self::pages_of)), and when a page will be touched next.
///
/// # Edge cases
/// Tiles beyond the storage, and tiles for which no entries are left, have no pages. Nothing is wrong then, less is
/// foretold.
#[derive(Debug)]
pub struct PageSets<'s> {
    storage: PageSetStorage<'s>,
    /// The half of the entries that this frame is recorded in.
    half: usize,
    /// Entries in use of either half.
    used: [u32; 2],
    frame_start: u32,
    frame_end: u32,
    unrecorded: u64,
}

impl<'s> PageSets<'s> {
    /// Knows of no frame yet.
    #[must_use]
    pub fn new(storage: PageSetStorage<'s>) -> Self {
        storage.tiles.fill(TileEntry::EMPTY);
        Self { storage, half: 0, used: [0; 2], frame_start: 0, frame_end: 0, unrecorded: 0 }
    }

    /// A frame begins whose tiles will be drawn in this order. What was recorded becomes the last frame.
    ///
    /// Calls `forecast` with pages and the places of tiles that will touch them; for a page that is given several
    /// times, the last call has the first use.
    pub fn begin_frame(&mut self, order: &[u32], mut forecast: impl FnMut(PageId, u32)) {
        self.half ^= 1;
        self.used[self.half] = 0;
        self.frame_start = self.frame_end;
        self.frame_end = self.frame_start.wrapping_add(u32::try_from(order.len()).unwrap_or(u32::MAX));
        let half = self.half;
        self.storage.tiles.iter_mut().for_each(|tile| tile.sets[half] = Set::EMPTY);
        let mut place = self.frame_end;
        for tile in order.iter().rev() {
            place = place.wrapping_sub(1);
            self.foretell(*tile, place, &mut forecast);
        }
    }

    /// A tile was drawn and touched these pages, each given once.
    ///
    /// Calls `forecast` with each page that it touched in the last frame, and the place of the tile that will touch it
    /// next in this one, if there is one.
    pub fn finish_tile(&mut self, tile: u32, pages: &[PageId], mut forecast: impl FnMut(PageId, u32)) {
        self.record_in(self.half, tile, pages);
        let Some(entry) = self.storage.tiles.get(tile as usize) else { return };
        for set in self.entries(entry.sets[self.half ^ 1], self.half ^ 1) {
            if set.next_use != entry.place {
                forecast(PageId(set.page), set.next_use);
            }
        }
    }

    /// A tile comes to this node after the frame has begun, from one where it touched these pages in the last frame. With no
    /// pages, what it touched here stands. It is taken to be drawn after all others.
    ///
    /// Calls `forecast` with those of its pages that nothing was foretold of in this frame.
    pub fn adopt_tile(&mut self, tile: u32, pages: &[PageId], mut forecast: impl FnMut(PageId, u32)) {
        let place = self.frame_end;
        self.frame_end = place.wrapping_add(1);
        let half = self.half ^ 1;
        if !pages.is_empty() {
            self.record_in(half, tile, pages);
        }
        let Some(entry) = self.storage.tiles.get_mut(tile as usize) else { return };
        entry.place = place;
        let range = self.range(self.storage.tiles[tile as usize].sets[half], half);
        let frame = place.wrapping_sub(self.frame_start);
        for entry in &mut self.storage.entries[range] {
            entry.next_use = place;
            let Some(next_use) = self.storage.next_uses.get_mut(entry.page as usize) else { continue };
            if next_use.wrapping_sub(self.frame_start) >= frame {
                *next_use = place;
                forecast(PageId(entry.page), place);
            }
        }
    }

    /// Whether `tile` has a place in this frame.
    #[must_use]
    pub fn is_placed(&self, tile: u32) -> bool {
        self.place_of(tile).wrapping_sub(self.frame_start) < self.frame_end.wrapping_sub(self.frame_start)
    }

    /// The pages that `tile` touched in the last frame.
    pub fn pages_of(&self, tile: u32) -> impl Iterator<Item = PageId> {
        let set = self.storage.tiles.get(tile as usize).map_or(Set::EMPTY, |tile| tile.sets[self.half ^ 1]);
        self.entries(set, self.half ^ 1).iter().map(|entry| PageId(entry.page))
    }

    /// The place of `tile` in this frame.
    #[must_use]
    pub fn place_of(&self, tile: u32) -> u32 {
        self.storage.tiles.get(tile as usize).map_or(self.frame_start, |tile| tile.place)
    }

    /// The place of the first tile of the next frame.
    #[must_use]
    pub const fn frame_end(&self) -> u32 {
        self.frame_end
    }

    /// Tiles for which no entries were left.
    #[must_use]
    pub const fn unrecorded(&self) -> u64 {
        self.unrecorded
    }

    /// Notes when the pages of a tile of the last frame are touched next; called from the last tile to the first.
    fn foretell(&mut self, tile: u32, place: u32, forecast: &mut impl FnMut(PageId, u32)) {
        let Some(entry) = self.storage.tiles.get_mut(tile as usize) else { return };
        entry.place = place;
        let range = self.range(self.storage.tiles[tile as usize].sets[self.half ^ 1], self.half ^ 1);
        let to_end = self.frame_end.wrapping_sub(place);
        for entry in &mut self.storage.entries[range] {
            entry.next_use = place;
            let Some(next_use) = self.storage.next_uses.get_mut(entry.page as usize) else { continue };
            // What an earlier frame has left there lies before this place.
            if (1..to_end).contains(&next_use.wrapping_sub(place)) {
                entry.next_use = *next_use;
            }
            *next_use = place;
            forecast(PageId(entry.page), place);
        }
    }

    /// Notes what a tile touched in one of the two frames.
    fn record_in(&mut self, half: usize, tile: u32, pages: &[PageId]) {
        let start = self.used[half];
        let room = self.half_length() - start as usize;
        let Some(entry) = self.storage.tiles.get_mut(tile as usize) else { return };
        let count = match u32::try_from(pages.len()) {
            Ok(count) if pages.len() <= room => count,
            _ => {
                self.unrecorded += 1;
                return;
            }
        };
        entry.sets[half] = Set { start, count };
        let range = self.range(Set { start, count }, half);
        for (entry, page) in self.storage.entries[range].iter_mut().zip(pages) {
            *entry = SetEntry { page: page.0, next_use: 0 };
        }
        self.used[half] += count;
    }

    fn entries(&self, set: Set, half: usize) -> &[SetEntry] {
        &self.storage.entries[self.range(set, half)]
    }

    fn range(&self, set: Set, half: usize) -> core::ops::Range<usize> {
        let start = half * self.half_length() + set.start as usize;
        start..start + set.count as usize
    }

    const fn half_length(&self) -> usize {
        self.storage.entries.len() / 2
    }
}

impl SetEntry {
    /// Room for a page.
    pub const EMPTY: Self = Self { page: 0, next_use: 0 };
}

impl TileEntry {
    /// A tile without pages.
    pub const EMPTY: Self = Self { place: 0, sets: [Set::EMPTY; 2] };
}

impl Set {
    const EMPTY: Self = Self { start: 0, count: 0 };
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGES: usize = 10;

    fn with_sets(test: impl FnOnce(&mut PageSets<'_>)) {
        let mut entries = [SetEntry::EMPTY; 12];
        let mut tiles = [TileEntry::EMPTY; 3];
        let mut next_uses = [0; PAGES];
        let storage = PageSetStorage { entries: &mut entries, tiles: &mut tiles, next_uses: &mut next_uses };
        test(&mut PageSets::new(storage));
    }

    /// Draws a frame; gives back what was foretold at its start and at the end of each tile.
    fn draw(
        sets: &mut PageSets<'_>,
        order: &[u32],
        touched: &[&[u32]],
    ) -> heapless::Vec<(u32, u32, u32), 64> {
        let mut told = heapless::Vec::new();
        sets.begin_frame(order, |page, when| told.push((99, page.0, when)).unwrap());
        for (tile, pages) in order.iter().zip(touched) {
            let pages: heapless::Vec<PageId, 8> = pages.iter().map(|page| PageId(*page)).collect();
            sets.finish_tile(*tile, &pages, |page, when| told.push((*tile, page.0, when)).unwrap());
        }
        told
    }

    #[test]
    fn the_first_frame_foretells_the_second_in_whatever_order_it_comes() {
        with_sets(|sets| {
            let touched: [&[u32]; 3] = [&[1, 2], &[2, 3], &[1, 4]];
            assert!(draw(sets, &[0, 1, 2], &touched).is_empty());
            let told = draw(sets, &[0, 1, 2], &touched);
            let at_start = [(99, 1, 5), (99, 4, 5), (99, 2, 4), (99, 3, 4), (99, 1, 3), (99, 2, 3)];
            assert_eq!(told, [&at_start[..], &[(0, 1, 5), (0, 2, 4)]].concat_vec());
            // Backwards: tile 2 is at place 6, tile 0 at place 8.
            let told = draw(sets, &[2, 1, 0], &[touched[2], touched[1], touched[0]]);
            let at_start = [(99, 1, 8), (99, 2, 8), (99, 2, 7), (99, 3, 7), (99, 1, 6), (99, 4, 6)];
            assert_eq!(told, [&at_start[..], &[(2, 1, 8), (1, 2, 8)]].concat_vec());
        });
    }

    #[test]
    fn what_an_older_frame_touched_is_not_foretold() {
        with_sets(|sets| {
            draw(sets, &[0, 1], &[&[1], &[1]]);
            draw(sets, &[0, 1], &[&[5], &[6]]);
            let told = draw(sets, &[0, 1], &[&[5], &[6]]);
            assert_eq!(told, [(99, 6, 5), (99, 5, 4)]);
            assert_eq!(sets.pages_of(0).map(|page| page.0).collect::<heapless::Vec<_, 4>>(), [5]);
        });
    }

    #[test]
    fn what_has_no_room_is_left_out_and_counted() {
        with_sets(|sets| {
            draw(sets, &[0, 1, 7], &[&[1, 2, 3, 4], &[5, 6, 7], &[8]]);
            assert_eq!(sets.unrecorded(), 1);
            let told = draw(sets, &[0, 1, 7], &[&[], &[], &[]]);
            assert_eq!(told.iter().map(|told| told.1).collect::<heapless::Vec<_, 8>>(), [1, 2, 3, 4]);
        });
    }

    #[test]
    fn a_tile_that_comes_late_brings_what_it_touched_elsewhere() {
        with_sets(|sets| {
            draw(sets, &[0, 1], &[&[1, 2], &[3]]);
            sets.begin_frame(&[0], |_, _| {});
            let mut told = heapless::Vec::<_, 8>::new();
            sets.adopt_tile(2, &[PageId(2), PageId(7)], |page, when| told.push((page.0, when)).unwrap());
            // Page 2 is foretold for tile 0 already, at place 2.
            assert_eq!(told, [(7, 3)]);
            assert_eq!(sets.pages_of(2).map(|page| page.0).collect::<heapless::Vec<_, 4>>(), [2, 7]);
            // Tile 1 was drawn here before; who gives it back knows no more.
            sets.adopt_tile(1, &[], |page, when| told.push((page.0, when)).unwrap());
            assert_eq!(told, [(7, 3), (3, 4)]);
            assert!(sets.is_placed(0) && sets.is_placed(1) && sets.is_placed(2) && sets.frame_end() == 5);
            sets.begin_frame(&[0], |_, _| {});
            assert!(sets.is_placed(0) && !sets.is_placed(1));
        });
    }

    trait ConcatVec {
        fn concat_vec(self) -> heapless::Vec<(u32, u32, u32), 64>;
    }

    impl ConcatVec for [&[(u32, u32, u32)]; 2] {
        fn concat_vec(self) -> heapless::Vec<(u32, u32, u32), 64> {
            self.into_iter().flatten().copied().collect()
        }
    }
}
