//! What stands before the bytes of a tile in a parcel: five to nine bytes, mostly.
//!
//! # Layout
//! Numbers below are `varint`s; those that may be negative are folded.
//! 1. The tile, less the one before it in the parcel.
//! 2. A byte: the coding in the two lowest bits; then whether there are as many primary rays as in the tile before, and
//!    whether any ray was damaged.
//! 3. The primary rays, unless they are as many. Then how many fewer hits there are than those, how many fewer shadow rays
//!    than hits, and how many fewer lit points than shadow rays. Then the damaged rays, if there are any.
//! 4. The length of the tile's bytes, unless it has none because it is the same as in the last frame.

use anyhow::{Context, Result};
use rt_core::{TileCounts, TileId};

use super::codec::Coding;
use crate::varint::{fold, put, take, unfold};

/// The heads of the tiles of a parcel, in their order: each builds on the one before it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Heads {
    tile: u32,
    primary: u16,
}

/// What is said of a tile. Its `t_sum` does not travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// The tile.
    pub id: TileId,
    /// What was counted while it was drawn; numbers of at most 16 bits.
    pub counts: TileCounts,
    /// How its pixels are written.
    pub coding: Coding,
    /// In how many bytes; 0 where they are those of the last frame.
    pub length: u16,
}

/// Bits of the byte that says what follows.
const CODING: u8 = 0b11;
const SAME_PRIMARY: u8 = 0b100;
const DAMAGED: u8 = 0b1000;

impl Heads {
    /// Adds the head of the next tile to `out`.
    pub fn write(&mut self, head: &Head, out: &mut Vec<u8>) {
        let TileCounts { primary, hits, shadow, lit, damaged, .. } = head.counts;
        // A tile has 1024 pixels, and each has a ray or two.
        let [primary, hits, shadow, lit, damaged] =
            [primary, hits, shadow, lit, damaged].map(|count| u16::try_from(count).unwrap_or(u16::MAX));
        put(out, fold(i64::from(head.id.0) - i64::from(self.tile)));
        let is_same = if primary == self.primary { SAME_PRIMARY } else { 0 };
        out.push(head.coding as u8 | is_same | if damaged == 0 { 0 } else { DAMAGED });
        if is_same == 0 {
            put(out, primary.into());
        }
        for (more, fewer) in [(primary, hits), (hits, shadow), (shadow, lit)] {
            put(out, fold(i64::from(more) - i64::from(fewer)));
        }
        if damaged != 0 {
            put(out, damaged.into());
        }
        if head.coding != Coding::Same {
            put(out, head.length.into());
        }
        (self.tile, self.primary) = (head.id.0, primary);
    }

    /// Takes the head of the next tile off `bytes`.
    ///
    /// # Errors
    /// The bytes end too early, or are none that a head is written in.
    pub fn read(&mut self, bytes: &mut &[u8]) -> Result<Head> {
        let step = unfold(take(bytes).context("half a tile's number")?);
        let id = i64::from(self.tile).checked_add(step).and_then(|id| u32::try_from(id).ok());
        let id = id.with_context(|| format!("tile {} and {step} more", self.tile))?;
        let (flags, rest) = bytes.split_first().context("half a tile's head")?;
        *bytes = rest;
        let primary = if flags & SAME_PRIMARY == 0 { small(bytes)? } else { self.primary };
        let mut below = |more: u16| {
            let fewer = unfold(take(bytes).context("half a tile's counts")?);
            let count = i64::from(more).checked_sub(fewer).and_then(|count| u16::try_from(count).ok());
            count.with_context(|| format!("tile {id}: a count of {more} less {fewer}"))
        };
        let hits = below(primary)?;
        let shadow = below(hits)?;
        let lit = below(shadow)?;
        let damaged = if flags & DAMAGED == 0 { 0 } else { small(bytes)? };
        let coding = match flags & CODING {
            0 => Coding::Same,
            1 => Coding::Raw,
            2 => Coding::Spatial,
            _ => Coding::Temporal,
        };
        let length = if coding == Coding::Same { 0 } else { small(bytes)? };
        (self.tile, self.primary) = (id, primary);
        let [primary, hits, shadow, lit, damaged] = [primary, hits, shadow, lit, damaged].map(u64::from);
        let counts = TileCounts { primary, hits, shadow, lit, damaged, t_sum: 0.0 };
        Ok(Head { id: TileId(id), counts, coding, length })
    }
}

/// A number of at most 16 bits.
fn small(bytes: &mut &[u8]) -> Result<u16> {
    let number = take(bytes).context("half a number in a tile's head")?;
    u16::try_from(number).with_context(|| format!("{number} in a tile's head"))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn any_head() -> impl Strategy<Value = Head> {
        let coding = prop::sample::select(vec![Coding::Same, Coding::Raw, Coding::Spatial, Coding::Temporal]);
        let count = || prop_oneof![0..=1024_u64, Just(0), Just(1024), Just(u64::from(u16::MAX))];
        let counts = (count(), count(), count(), count(), count());
        (prop_oneof![0..4096_u32, any::<u32>()], counts, coding, any::<u16>()).prop_map(
            |(id, (primary, hits, shadow, lit, damaged), coding, length)| Head {
                id: TileId(id),
                counts: TileCounts { primary, hits, shadow, lit, damaged, t_sum: 0.0 },
                coding,
                length: if coding == Coding::Same { 0 } else { length },
            },
        )
    }

    proptest! {
        #[test]
        fn heads_come_back_as_they_were(heads in prop::collection::vec(any_head(), 0..20)) {
            let (mut bytes, mut writer) = (Vec::new(), Heads::default());
            heads.iter().for_each(|head| writer.write(head, &mut bytes));
            let (mut rest, mut reader) = (&bytes[..], Heads::default());
            for head in &heads {
                prop_assert_eq!(reader.read(&mut rest).unwrap(), *head);
            }
            prop_assert!(rest.is_empty());
        }

        #[test]
        fn any_bytes_are_heads_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let (mut rest, mut reader) = (&bytes[..], Heads::default());
            while !rest.is_empty() && reader.read(&mut rest).is_ok() {}
        }
    }

    #[test]
    fn a_tile_that_is_as_it_was_takes_five_bytes_and_more_where_half_of_it_is_hit() {
        let counts =
            |hits, shadow, lit| TileCounts { primary: 1024, hits, shadow, lit, damaged: 0, t_sum: 0.0 };
        let mut heads = Heads { tile: 6, primary: 1024 };
        for (counts, length) in
            [(counts(1024, 1000, 950), 5), (counts(0, 0, 0), 6), (counts(500, 400, 100), 8)]
        {
            let mut bytes = Vec::new();
            heads.write(&Head { id: TileId(7), counts, coding: Coding::Same, length: 0 }, &mut bytes);
            assert_eq!(bytes.len(), length, "{counts:?}");
        }
    }
}
