//! What balancers say to each other: little-endian, a fixed header, nothing trusted before it is checked.
//!
//! ```text
//!  0        2     3     4         8         12        16      18      20      22     24        28        32
//!  | magic  | ver | kind| checksum| epoch   | frame   | view  | from  | to    | count| number  | time    | body ...
//! ```
//!
//! The body is `count` entries of the length that the kind has. What follows belongs to the transport: pages of tiles
//! that are given, pixels of a tile that was drawn. The checksum is of all of the header and body behind it.

use core::fmt;

use heapless::Vec;
use xxhash_rust::xxh3::xxh3_64;

use super::page_map::PageMap;
use crate::tile::TileId;

/// Bytes of every message's header.
pub const HEADER_BYTES: usize = 32;

/// Tiles that one [`Body::Deal`] or [`Body::Shown`] can name.
pub const TILES_MAX: usize = 256;

/// Tiles that one [`Body::Give`] can hand over.
pub const GIFTS_MAX: usize = 32;

/// Length of the longest message.
pub const MESSAGE_BYTES_MAX: usize = {
    let (gifts, tiles) = (GIFTS_MAX * Gift::BYTES, TILES_MAX * TILE_BYTES);
    HEADER_BYTES + if gifts > tiles { gifts } else { tiles }
};

/// The protocol's version. Another version is another language.
pub const VERSION: u8 = 1;

/// A frame, and the how manieth deal of it. Later ones are larger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp {
    /// The frame's number.
    pub frame: u32,
    /// Counts up when tiles had to be dealt anew.
    pub view: u16,
}

/// A message: who to whom, in which epoch and view, and what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The run it belongs to.
    pub epoch: u32,
    /// What it is about.
    pub stamp: Stamp,
    /// Its sender. The display has the number after the last node's.
    pub from: u16,
    /// Its receiver.
    pub to: u16,
    /// What it says.
    pub body: Body,
}

/// What a message says.
#[derive(Clone, Debug, PartialEq, Eq)]
#[expect(
    clippy::large_enum_variant,
    reason = "made, sent and dropped at once; without an allocator there is no box"
)]
pub enum Body {
    /// From the display: "these tiles are yours". Number 0 opens the view; what was dealt before is void.
    Deal {
        /// Counts the deals to one node in one view.
        number: u32,
        /// The tiles.
        tiles: Vec<TileId, TILES_MAX>,
    },
    /// From a node: "these tiles are yours now".
    Give {
        /// Counts the gifts to one peer in one view, from 1.
        number: u32,
        /// Work that its sender has left, in microseconds.
        left_us: u32,
        /// The tiles.
        gifts: Vec<Gift, GIFTS_MAX>,
    },
    /// "I have them": answers a deal or a gift.
    Taken {
        /// Which deal or gift.
        number: u32,
    },
    /// "I have nothing to do; what can you spare?"
    Ask {
        /// Counts the sender's questions in one view, from 1.
        number: u32,
        /// The pages that its sender uses.
        map: PageMap,
        /// If the answer is no, remember me.
        waits: bool,
    },
    /// "Nothing": answers an ask.
    Nothing {
        /// Which question.
        number: u32,
        /// Work that its sender has left, in microseconds: too little to share.
        left_us: u32,
        /// The pages that its sender uses.
        map: PageMap,
        /// Ask that one: of all that its sender knows it has most left.
        busiest: Option<u16>,
    },
    /// To the display, with the pixels behind it: "this tile is drawn".
    Drawn {
        /// The tile.
        tile: TileId,
        /// How long it took, in microseconds.
        cost_us: u32,
    },
    /// From the display: "these have come".
    Shown {
        /// The tiles.
        tiles: Vec<TileId, TILES_MAX>,
    },
}

/// A tile that changes hands, and what is known of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gift {
    /// The tile.
    pub tile: TileId,
    /// What it takes to draw it, in microseconds; 0 when nobody knows.
    pub cost_us: u32,
    /// The pages it used when it was drawn last.
    pub map: PageMap,
}

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParseError {
    /// Fewer bytes than the header, or than it says that follow.
    Truncated {
        /// Bytes that there should be.
        needed: usize,
        /// Bytes that there are.
        got: usize,
    },
    /// It does not begin as our messages do.
    Magic,
    /// It speaks another version of the protocol.
    Version {
        /// The version it speaks.
        got: u8,
    },
    /// No message has this kind.
    Kind {
        /// The kind it claims.
        got: u8,
    },
    /// Its bytes are not those that were sent.
    Checksum,
    /// A count, number or time that does not go with the kind.
    Field,
}

impl Message {
    /// Reads the message at the start of `bytes`, and gives back what follows it.
    ///
    /// A message that parses is well formed, not yet believable: its receiver still checks who sent it, and when.
    ///
    /// # Errors
    /// The bytes are no message; the error says which part is wrong.
    pub fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), ParseError> {
        let truncated = |needed| ParseError::Truncated { needed, got: bytes.len() };
        let Some((header, rest)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
            return Err(truncated(HEADER_BYTES));
        };
        if header[..2] != MAGIC {
            return Err(ParseError::Magic);
        }
        if header[2] != VERSION {
            return Err(ParseError::Version { got: header[2] });
        }
        let count = usize::from(u16_at(header, field::COUNT));
        let length = count * entry_bytes(header[3])?;
        let (entries, rest) = rest.split_at_checked(length).ok_or(truncated(HEADER_BYTES + length))?;
        if u32_at(header, field::CHECKSUM) != checksum(&bytes[..HEADER_BYTES + length]) {
            return Err(ParseError::Checksum);
        }
        let stamp = Stamp { frame: u32_at(header, field::FRAME), view: u16_at(header, field::VIEW) };
        let message = Self {
            epoch: u32_at(header, field::EPOCH),
            stamp,
            from: u16_at(header, field::FROM),
            to: u16_at(header, field::TO),
            body: Body::parse(header, count, entries)?,
        };
        Ok((message, rest))
    }

    /// Writes the message to the start of `bytes` and returns its length.
    ///
    /// # Panics
    /// When `bytes` is shorter than that; [`MESSAGE_BYTES_MAX`] always do.
    pub fn emit(&self, bytes: &mut [u8]) -> usize {
        let (kind, count, number, time) = self.body.header();
        let length = HEADER_BYTES + self.body.emit(&mut bytes[HEADER_BYTES..]);
        let mut put = |start: usize, value: &[u8]| bytes[start..start + value.len()].copy_from_slice(value);
        put(0, &[MAGIC[0], MAGIC[1], VERSION, kind]);
        put(field::EPOCH, &self.epoch.to_le_bytes());
        put(field::FRAME, &self.stamp.frame.to_le_bytes());
        put(field::VIEW, &self.stamp.view.to_le_bytes());
        put(field::FROM, &self.from.to_le_bytes());
        put(field::TO, &self.to.to_le_bytes());
        put(field::COUNT, &count.to_le_bytes());
        put(field::NUMBER, &number.to_le_bytes());
        put(field::TIME, &time.to_le_bytes());
        let checksum = checksum(&bytes[..length]);
        bytes[field::CHECKSUM..field::EPOCH].copy_from_slice(&checksum.to_le_bytes());
        length
    }
}

impl Body {
    fn parse(header: &[u8; HEADER_BYTES], count: usize, entries: &[u8]) -> Result<Self, ParseError> {
        let (number, time) = (u32_at(header, field::NUMBER), u32_at(header, field::TIME));
        let tiles = || tiles_of(entries).ok_or(ParseError::Field);
        let one = || <[u8; 40]>::try_from(entries).map_err(|_| ParseError::Field);
        match (header[3], number, time) {
            (kind::DEAL, number, 0) => Ok(Self::Deal { number, tiles: tiles()? }),
            (kind::GIVE, number, left_us) => {
                let gifts = entries.as_chunks().0.iter().map(Gift::from_bytes);
                Ok(Self::Give { number, left_us, gifts: collected(gifts).ok_or(ParseError::Field)? })
            }
            (kind::TAKEN, number, 0) if count == 0 => Ok(Self::Taken { number }),
            (kind::ASK, number, waits @ (0 | 1)) => {
                let map: [u8; PageMap::BYTES] = entries.try_into().map_err(|_| ParseError::Field)?;
                Ok(Self::Ask { number, map: PageMap::from_bytes(map), waits: waits == 1 })
            }
            (kind::NOTHING, number, left_us) => {
                let entry = one()?;
                let (map, busiest) = entry.split_first_chunk().ok_or(ParseError::Field)?;
                let busiest = match busiest {
                    [0, 0, 0, 0, 0, 0, 0, 0] => None,
                    [1, 0, low, high, 0, 0, 0, 0] => Some(u16::from_le_bytes([*low, *high])),
                    _ => return Err(ParseError::Field),
                };
                Ok(Self::Nothing { number, left_us, map: PageMap::from_bytes(*map), busiest })
            }
            (kind::DRAWN, tile, cost_us) if count == 0 => Ok(Self::Drawn { tile: TileId(tile), cost_us }),
            (kind::SHOWN, 0, 0) => Ok(Self::Shown { tiles: tiles()? }),
            _ => Err(ParseError::Field),
        }
    }

    /// Kind, count of entries, number and time.
    fn header(&self) -> (u8, u16, u32, u32) {
        match self {
            Self::Deal { number, tiles } => (kind::DEAL, count(tiles.len()), *number, 0),
            Self::Give { number, left_us, gifts } => (kind::GIVE, count(gifts.len()), *number, *left_us),
            Self::Taken { number } => (kind::TAKEN, 0, *number, 0),
            Self::Ask { number, waits, .. } => (kind::ASK, 1, *number, u32::from(*waits)),
            Self::Nothing { number, left_us, .. } => (kind::NOTHING, 1, *number, *left_us),
            Self::Drawn { tile, cost_us } => (kind::DRAWN, 0, tile.0, *cost_us),
            Self::Shown { tiles } => (kind::SHOWN, count(tiles.len()), 0, 0),
        }
    }

    /// Writes the entries and returns their length.
    fn emit(&self, bytes: &mut [u8]) -> usize {
        match self {
            Self::Deal { tiles, .. } | Self::Shown { tiles } => {
                let places = bytes.chunks_exact_mut(TILE_BYTES);
                places.zip(tiles).for_each(|(place, tile)| place.copy_from_slice(&tile.0.to_le_bytes()));
                tiles.len() * TILE_BYTES
            }
            Self::Give { gifts, .. } => {
                let places = bytes.chunks_exact_mut(Gift::BYTES);
                places.zip(gifts).for_each(|(place, gift)| place.copy_from_slice(&gift.to_bytes()));
                gifts.len() * Gift::BYTES
            }
            Self::Ask { map, .. } => {
                bytes[..PageMap::BYTES].copy_from_slice(&map.to_bytes());
                PageMap::BYTES
            }
            Self::Nothing { map, busiest, .. } => {
                bytes[..PageMap::BYTES].copy_from_slice(&map.to_bytes());
                let [low, high] = busiest.unwrap_or_default().to_le_bytes();
                let busiest = [u8::from(busiest.is_some()), 0, low, high, 0, 0, 0, 0];
                bytes[PageMap::BYTES..NOTHING_BYTES].copy_from_slice(&busiest);
                NOTHING_BYTES
            }
            Self::Taken { .. } | Self::Drawn { .. } => 0,
        }
    }
}

impl Gift {
    const BYTES: usize = 40;

    fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..4].copy_from_slice(&self.tile.0.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.cost_us.to_le_bytes());
        bytes[8..].copy_from_slice(&self.map.to_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let mut map = [0; PageMap::BYTES];
        map.copy_from_slice(&bytes[8..]);
        Self { tile: TileId(u32_at(bytes, 0)), cost_us: u32_at(bytes, 4), map: PageMap::from_bytes(map) }
    }
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { needed, got } => write!(f, "{got} bytes where {needed} are needed"),
            Self::Magic => write!(f, "not a message between balancers"),
            Self::Version { got } => write!(f, "protocol version {got}, and this is version {VERSION}"),
            Self::Kind { got } => write!(f, "no message has kind {got}"),
            Self::Checksum => write!(f, "the bytes are not those that were sent"),
            Self::Field => write!(f, "a count, number or time that does not go with the kind of message"),
        }
    }
}

impl core::error::Error for ParseError {}

/// Length of an entry of each kind.
const fn entry_bytes(kind: u8) -> Result<usize, ParseError> {
    match kind {
        kind::DEAL | kind::SHOWN => Ok(TILE_BYTES),
        kind::GIVE => Ok(Gift::BYTES),
        kind::ASK => Ok(PageMap::BYTES),
        kind::NOTHING => Ok(NOTHING_BYTES),
        kind::TAKEN | kind::DRAWN => Ok(0),
        got => Err(ParseError::Kind { got }),
    }
}

fn tiles_of(entries: &[u8]) -> Option<Vec<TileId, TILES_MAX>> {
    collected(entries.as_chunks().0.iter().map(|tile| TileId(u32::from_le_bytes(*tile))))
}

/// All of them, or `None` when there are more than a message can have.
fn collected<T, const N: usize>(all: impl Iterator<Item = T>) -> Option<Vec<T, N>> {
    let mut list = Vec::new();
    for one in all {
        list.push(one).ok()?;
    }
    Some(list)
}

/// 32 bits of XXH3 over all that follows the checksum, with the kind in front.
fn checksum(bytes: &[u8]) -> u32 {
    let [a, b, c, d, ..] = (xxh3_64(&bytes[field::EPOCH..]) ^ u64::from(bytes[3])).to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}

fn count(length: usize) -> u16 {
    u16::try_from(length).unwrap_or(u16::MAX)
}

fn u16_at(bytes: &[u8], start: usize) -> u16 {
    u16::from_le_bytes([bytes[start], bytes[start + 1]])
}

fn u32_at(bytes: &[u8], start: usize) -> u32 {
    u32::from_le_bytes([bytes[start], bytes[start + 1], bytes[start + 2], bytes[start + 3]])
}

const MAGIC: [u8; 2] = *b"MT";
const TILE_BYTES: usize = 4;
const NOTHING_BYTES: usize = PageMap::BYTES + 8;

/// Where each field starts.
mod field {
    pub(super) const CHECKSUM: usize = 4;
    pub(super) const EPOCH: usize = 8;
    pub(super) const FRAME: usize = 12;
    pub(super) const VIEW: usize = 16;
    pub(super) const FROM: usize = 18;
    pub(super) const TO: usize = 20;
    pub(super) const COUNT: usize = 22;
    pub(super) const NUMBER: usize = 24;
    pub(super) const TIME: usize = 28;
}

mod kind {
    pub(super) const DEAL: u8 = 1;
    pub(super) const GIVE: u8 = 2;
    pub(super) const TAKEN: u8 = 3;
    pub(super) const ASK: u8 = 4;
    pub(super) const NOTHING: u8 = 5;
    pub(super) const DRAWN: u8 = 6;
    pub(super) const SHOWN: u8 = 7;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_map() -> impl Strategy<Value = PageMap> {
        any::<[u8; PageMap::BYTES]>().prop_map(PageMap::from_bytes)
    }

    fn any_body() -> impl Strategy<Value = Body> {
        let tiles = || prop::collection::vec(any::<u32>().prop_map(TileId), 0..=TILES_MAX);
        let gift = (any::<u32>(), any::<u32>(), any_map());
        let gift = gift.prop_map(|(tile, cost_us, map)| Gift { tile: TileId(tile), cost_us, map });
        prop_oneof![
            (any::<u32>(), tiles())
                .prop_map(|(number, tiles)| Body::Deal { number, tiles: tiles.into_iter().collect() }),
            (any::<u32>(), any::<u32>(), prop::collection::vec(gift, 0..=GIFTS_MAX)).prop_map(
                |(number, left_us, gifts)| Body::Give { number, left_us, gifts: gifts.into_iter().collect() }
            ),
            any::<u32>().prop_map(|number| Body::Taken { number }),
            (any::<u32>(), any_map(), any::<bool>()).prop_map(|(number, map, waits)| Body::Ask {
                number,
                map,
                waits
            }),
            (any::<u32>(), any::<u32>(), any_map(), any::<Option<u16>>())
                .prop_map(|(number, left_us, map, busiest)| Body::Nothing { number, left_us, map, busiest }),
            (any::<u32>(), any::<u32>())
                .prop_map(|(tile, cost_us)| Body::Drawn { tile: TileId(tile), cost_us }),
            tiles().prop_map(|tiles| Body::Shown { tiles: tiles.into_iter().collect() }),
        ]
    }

    fn any_message() -> impl Strategy<Value = Message> {
        (any::<u32>(), any::<u32>(), any::<[u16; 3]>(), any_body()).prop_map(
            |(epoch, frame, [view, from, to], body)| Message {
                epoch,
                stamp: Stamp { frame, view },
                from,
                to,
                body,
            },
        )
    }

    proptest! {
        #[test]
        fn what_is_emitted_parses_to_the_same(message in any_message(), rest in any::<[u8; 5]>()) {
            let mut bytes = [0xAA; MESSAGE_BYTES_MAX + 5];
            let length = message.emit(&mut bytes);
            bytes[length..length + 5].copy_from_slice(&rest);
            prop_assert_eq!(Message::parse(&bytes[..length + 5]), Ok((message, &rest[..])));
            prop_assert!(Message::parse(&bytes[..length - 1]).is_err());
        }

        #[test]
        fn a_byte_that_changed_on_the_way_is_noticed(message in any_message(), at in any::<u16>(), xor in 1u8..) {
            let mut bytes = [0; MESSAGE_BYTES_MAX];
            let length = message.emit(&mut bytes);
            bytes[usize::from(at) % length] ^= xor;
            prop_assert!(Message::parse(&bytes).is_err());
        }

        #[test]
        fn what_parses_emits_to_the_same_bytes(
            kind in 0u8..10, count in 0u16..3, time in 0u32..3, tail in prop::collection::vec(0u8..2, 0..120),
        ) {
            let mut bytes = std::vec![0; HEADER_BYTES];
            bytes[..4].copy_from_slice(&[b'M', b'T', VERSION, kind]);
            bytes[field::COUNT..field::NUMBER].copy_from_slice(&count.to_le_bytes());
            bytes[field::TIME..].copy_from_slice(&time.to_le_bytes());
            bytes.extend(tail);
            let length = HEADER_BYTES + usize::from(count) * entry_bytes(kind).unwrap_or(0);
            if length <= bytes.len() {
                let sum = checksum(&bytes[..length]);
                bytes[field::CHECKSUM..field::EPOCH].copy_from_slice(&sum.to_le_bytes());
            }
            if let Ok((message, rest)) = Message::parse(&bytes) {
                let mut again = [0; MESSAGE_BYTES_MAX];
                let length = message.emit(&mut again);
                prop_assert_eq!(&again[..length], &bytes[..bytes.len() - rest.len()]);
            }
        }
    }

    #[test]
    fn each_wrong_part_has_its_error() {
        let good = Message {
            epoch: 1,
            stamp: Stamp { frame: 2, view: 3 },
            from: 4,
            to: 5,
            body: Body::Taken { number: 6 },
        };
        let mut bytes = [0; HEADER_BYTES];
        good.emit(&mut bytes);
        let with = |index: usize, value: u8| {
            let mut bytes = bytes;
            bytes[index] = value;
            Message::parse(&bytes).map(|_| ())
        };
        assert_eq!(with(0, b'X'), Err(ParseError::Magic));
        assert_eq!(with(2, 9), Err(ParseError::Version { got: 9 }));
        assert_eq!(with(3, 9), Err(ParseError::Kind { got: 9 }));
        assert_eq!(with(field::NUMBER, 7), Err(ParseError::Checksum));
        let short = ParseError::Truncated { needed: HEADER_BYTES, got: 31 };
        assert_eq!(Message::parse(&bytes[..31]), Err(short));
    }
}
