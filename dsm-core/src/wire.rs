//! The messages between nodes: little-endian, fixed headers, nothing trusted before it is checked.
//!
//! ```text
//!  0        2     3     4                    12         16        18        20         24         28        32
//!  | magic  | ver | kind| cluster            | epoch    | from    | to      | page     | request  | detail  |
//!  32         36        38        40          44
//!  | offset   | from's  | to's    | stamp     |   the incarnations of sender and receiver; when it was asked for
//! ```
//!
//! A request asks for `detail` bytes of the page from `offset` on, or with 0 for all there are. A grant says that
//! `detail` bytes of the page, from `offset` on, follow: the whole page, or a fragment of it. A refusal gives its reason
//! in `detail` and 0 in `offset`.

use core::fmt;

use crate::id::{ClusterId, Epoch, Incarnation, NodeId, PageId};

/// Bytes of every message's header. A grant's page bytes travel behind it, in whatever way a transport has.
pub const HEADER_BYTES: usize = 44;

/// The protocol's version. Another version is another language.
pub const VERSION: u8 = 3;

/// A message: who to whom, in which cluster and epoch, and what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// The run it belongs to.
    pub cluster: ClusterId,
    /// The epoch in which it was sent.
    pub epoch: Epoch,
    /// Its sender.
    pub from: NodeId,
    /// Its receiver.
    pub to: NodeId,
    /// The sender's incarnation.
    pub from_incarnation: Incarnation,
    /// The incarnation for which an answer is meant: that of the request. A request is for whoever has the number, and
    /// has 0 here.
    pub to_incarnation: Incarnation,
    /// The page it is about.
    pub page: PageId,
    /// The sender's number for the request, returned with the answer. A late answer is known by it.
    pub request: u32,
    /// When this request was sent, by its sender's clock, in microseconds that wrap; returned with the answer. So the round
    /// trip is known whichever of several sendings was answered.
    pub stamp_us: u32,
    /// What it says.
    pub body: Body,
}

/// What a message says about its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// "I need this page", or a part of it.
    Request {
        /// The first byte of the page that is needed.
        offset: u32,
        /// Bytes that are needed; 0 for all from there on.
        bytes: u32,
    },
    /// "Here are bytes of it": they follow the header.
    Grant {
        /// The place in the page of the first byte that follows.
        offset: u32,
        /// Bytes that follow.
        bytes: u32,
    },
    /// "You will not get it from me."
    Refusal(Refusal),
}

/// Why an owner does not grant a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It holds no copy of the page.
    NotOwner,
    /// The owner could not read its own memory.
    Unreadable,
}

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParseError {
    /// Fewer bytes than a header has.
    Truncated {
        /// Bytes there are.
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
    /// A refusal for a reason that there is not, or with an offset.
    Detail {
        /// The detail it gives.
        got: u32,
    },
}

impl Message {
    /// Reads the header at the start of `bytes`; what follows it is left alone.
    ///
    /// A message that parses is well formed, not yet believable: its receiver still checks who sent it.
    ///
    /// # Errors
    /// The bytes are no message; the error says which part is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, ParseError> {
        let Some((header, _)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
            return Err(ParseError::Truncated { got: bytes.len() });
        };
        if header[field::MAGIC..field::VERSION] != MAGIC {
            return Err(ParseError::Magic);
        }
        if header[field::VERSION] != VERSION {
            return Err(ParseError::Version { got: header[field::VERSION] });
        }
        Ok(Self {
            cluster: ClusterId(u64::from_le_bytes(at(header, field::CLUSTER))),
            epoch: Epoch(u32::from_le_bytes(at(header, field::EPOCH))),
            from: NodeId(u16::from_le_bytes(at(header, field::FROM))),
            to: NodeId(u16::from_le_bytes(at(header, field::TO))),
            from_incarnation: Incarnation(u16::from_le_bytes(at(header, field::FROM_INCARNATION))),
            to_incarnation: Incarnation(u16::from_le_bytes(at(header, field::TO_INCARNATION))),
            page: PageId(u32::from_le_bytes(at(header, field::PAGE))),
            request: u32::from_le_bytes(at(header, field::REQUEST)),
            stamp_us: u32::from_le_bytes(at(header, field::STAMP)),
            body: Body::parse(
                header[field::KIND],
                u32::from_le_bytes(at(header, field::DETAIL)),
                u32::from_le_bytes(at(header, field::OFFSET)),
            )?,
        })
    }

    /// Writes the header to the start of `bytes` and returns its length, [`HEADER_BYTES`].
    ///
    /// # Panics
    /// When `bytes` is shorter than that.
    pub fn emit(&self, bytes: &mut [u8]) -> usize {
        let (kind, detail, offset) = self.body.emit();
        let mut put = |start: usize, value: &[u8]| bytes[start..start + value.len()].copy_from_slice(value);
        put(field::MAGIC, &MAGIC);
        put(field::VERSION, &[VERSION, kind]);
        put(field::CLUSTER, &self.cluster.0.to_le_bytes());
        put(field::EPOCH, &self.epoch.0.to_le_bytes());
        put(field::FROM, &self.from.0.to_le_bytes());
        put(field::TO, &self.to.0.to_le_bytes());
        put(field::PAGE, &self.page.0.to_le_bytes());
        put(field::REQUEST, &self.request.to_le_bytes());
        put(field::DETAIL, &detail.to_le_bytes());
        put(field::OFFSET, &offset.to_le_bytes());
        put(field::FROM_INCARNATION, &self.from_incarnation.0.to_le_bytes());
        put(field::TO_INCARNATION, &self.to_incarnation.0.to_le_bytes());
        put(field::STAMP, &self.stamp_us.to_le_bytes());
        HEADER_BYTES
    }

    /// The grant of the whole page, of `page_bytes`, with which `owner`, in its first incarnation, answers this request.
    #[must_use]
    pub const fn grant(&self, owner: NodeId, page_bytes: u32) -> Self {
        self.answer(owner, Incarnation(0), Body::Grant { offset: 0, bytes: page_bytes })
    }

    /// The refusal with which `owner`, in its first incarnation, answers this request.
    #[must_use]
    pub const fn refusal(&self, owner: NodeId, why: Refusal) -> Self {
        self.answer(owner, Incarnation(0), Body::Refusal(why))
    }

    /// What `owner` answers to this request.
    #[must_use]
    pub const fn answer(&self, owner: NodeId, incarnation: Incarnation, body: Body) -> Self {
        Self {
            from: owner,
            to: self.from,
            from_incarnation: incarnation,
            to_incarnation: self.from_incarnation,
            body,
            ..*self
        }
    }

    /// Cuts this grant into grants of at most `fragment_bytes` each, for a transport that cannot carry the whole. What is
    /// no grant stays whole. `fragment_bytes` is best had from [`fragment_bytes`].
    pub fn fragments(self, fragment_bytes: u32) -> impl Iterator<Item = Self> + use<> {
        let fragment_bytes = fragment_bytes.max(1);
        let (offset, bytes) = match self.body {
            Body::Grant { offset, bytes } => (offset, bytes),
            Body::Request { .. } | Body::Refusal(_) => (0, 1),
        };
        (0..bytes.div_ceil(fragment_bytes)).map(move |number| {
            let start = number * fragment_bytes;
            let part = Body::Grant { offset: offset + start, bytes: fragment_bytes.min(bytes - start) };
            let is_grant = matches!(self.body, Body::Grant { .. });
            Self { body: if is_grant { part } else { self.body }, ..self }
        })
    }
}

/// Fragments that a page can come in at most. They start and end at multiples of the page's length over this.
pub const FRAGMENTS_MAX: u32 = 256;

/// The unit at whose multiples the fragments of a page start and end: a 256th of it, or a byte.
#[must_use]
pub const fn fragment_unit(page_bytes: u32) -> u32 {
    if page_bytes < FRAGMENTS_MAX { 1 } else { page_bytes / FRAGMENTS_MAX }
}

/// The longest fragment of a page that fits into `room` bytes, or `None` when not even the shortest does.
///
/// Room for 1,400 bytes carries pages of up to 256 KB (units of 1 KB), room for 8,900 pages of 2 MB.
#[must_use]
pub const fn fragment_bytes(page_bytes: u32, room: u32) -> Option<u32> {
    let unit = fragment_unit(page_bytes);
    match room / unit {
        0 => None,
        _ if room >= page_bytes => Some(page_bytes),
        units => Some(units * unit),
    }
}

impl Body {
    /// "I need the whole page."
    pub const REQUEST: Self = Self::Request { offset: 0, bytes: 0 };

    const fn parse(kind: u8, detail: u32, offset: u32) -> Result<Self, ParseError> {
        match (kind, detail, offset) {
            (1, bytes, offset) => Ok(Self::Request { offset, bytes }),
            (2, bytes, offset) => Ok(Self::Grant { offset, bytes }),
            (3, 1, 0) => Ok(Self::Refusal(Refusal::NotOwner)),
            (3, 2, 0) => Ok(Self::Refusal(Refusal::Unreadable)),
            (3, got, _) => Err(ParseError::Detail { got }),
            (got, _, _) => Err(ParseError::Kind { got }),
        }
    }

    /// Kind, detail and offset.
    const fn emit(self) -> (u8, u32, u32) {
        match self {
            Self::Request { offset, bytes } => (1, bytes, offset),
            Self::Grant { offset, bytes } => (2, bytes, offset),
            Self::Refusal(Refusal::NotOwner) => (3, 1, 0),
            Self::Refusal(Refusal::Unreadable) => (3, 2, 0),
        }
    }
}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { got } => write!(f, "{got} bytes are fewer than the {HEADER_BYTES} of a header"),
            Self::Magic => write!(f, "not a message of this protocol"),
            Self::Version { got } => write!(f, "protocol version {got}, and this is version {VERSION}"),
            Self::Kind { got } => write!(f, "no message has kind {got}"),
            Self::Detail { got } => write!(f, "detail {got} does not go with the kind of message"),
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotOwner => "it holds no copy of the page",
            Self::Unreadable => "it could not read its own memory",
        })
    }
}

impl core::error::Error for ParseError {}

/// Copies a field out of a header. In bounds: all fields end at or before [`HEADER_BYTES`].
fn at<const N: usize>(header: &[u8; HEADER_BYTES], start: usize) -> [u8; N] {
    let mut value = [0; N];
    value.copy_from_slice(&header[start..start + N]);
    value
}

const MAGIC: [u8; 2] = *b"MS";

/// Where each field starts.
mod field {
    pub(super) const MAGIC: usize = 0;
    pub(super) const VERSION: usize = 2;
    pub(super) const KIND: usize = 3;
    pub(super) const CLUSTER: usize = 4;
    pub(super) const EPOCH: usize = 12;
    pub(super) const FROM: usize = 16;
    pub(super) const TO: usize = 18;
    pub(super) const PAGE: usize = 20;
    pub(super) const REQUEST: usize = 24;
    pub(super) const DETAIL: usize = 28;
    pub(super) const OFFSET: usize = 32;
    pub(super) const FROM_INCARNATION: usize = 36;
    pub(super) const TO_INCARNATION: usize = 38;
    pub(super) const STAMP: usize = 40;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_message() -> impl Strategy<Value = Message> {
        let body = prop_oneof![
            any::<(u32, u32)>().prop_map(|(offset, bytes)| Body::Request { offset, bytes }),
            any::<(u32, u32)>().prop_map(|(offset, bytes)| Body::Grant { offset, bytes }),
            Just(Body::Refusal(Refusal::NotOwner)),
            Just(Body::Refusal(Refusal::Unreadable)),
        ];
        (any::<u64>(), any::<[u16; 4]>(), any::<[u32; 4]>(), body).prop_map(
            |(
                cluster,
                [from, to, from_incarnation, to_incarnation],
                [epoch, page, request, stamp_us],
                body,
            )| Message {
                cluster: ClusterId(cluster),
                epoch: Epoch(epoch),
                from: NodeId(from),
                to: NodeId(to),
                from_incarnation: Incarnation(from_incarnation),
                to_incarnation: Incarnation(to_incarnation),
                page: PageId(page),
                request,
                stamp_us,
                body,
            },
        )
    }

    proptest! {
        #[test]
        fn what_is_emitted_parses_to_the_same(message in any_message()) {
            let mut bytes = [0xAA; HEADER_BYTES];
            prop_assert_eq!(message.emit(&mut bytes), HEADER_BYTES);
            prop_assert_eq!(Message::parse(&bytes), Ok(message));
        }

        #[test]
        fn what_parses_emits_to_the_same_bytes(
            mut bytes in prop::array::uniform::<_, HEADER_BYTES>(any::<u8>()), kind in 0u8..5, detail in 0u8..4, offset in 0u8..2,
        ) {
            bytes[..4].copy_from_slice(&[b'M', b'S', VERSION, kind]);
            bytes[field::DETAIL..field::OFFSET].copy_from_slice(&u32::from(detail).to_le_bytes());
            bytes[field::OFFSET..field::FROM_INCARNATION].copy_from_slice(&u32::from(offset).to_le_bytes());
            if let Ok(message) = Message::parse(&bytes) {
                let mut again = [0; HEADER_BYTES];
                message.emit(&mut again);
                prop_assert_eq!(again, bytes);
            }
        }
    }

    #[test]
    fn each_wrong_part_has_its_error() {
        let mut good = [0; HEADER_BYTES];
        good[..4].copy_from_slice(&[b'M', b'S', VERSION, 1]);
        let with = |index: usize, value: u8| {
            let mut bytes = good;
            bytes[index] = value;
            Message::parse(&bytes)
        };
        assert!(Message::parse(&good).is_ok());
        assert_eq!(Message::parse(&good[..43]), Err(ParseError::Truncated { got: 43 }));
        assert_eq!(with(0, b'X'), Err(ParseError::Magic));
        assert_eq!(with(2, 9), Err(ParseError::Version { got: 9 }));
        assert_eq!(with(3, 0), Err(ParseError::Kind { got: 0 }));
        good[3] = 3;
        assert_eq!(Message::parse(&good), Err(ParseError::Detail { got: 0 }));
        good[field::DETAIL] = 2;
        assert!(Message::parse(&good).is_ok());
        good[field::OFFSET] = 1;
        assert_eq!(Message::parse(&good), Err(ParseError::Detail { got: 2 }));
    }

    proptest! {
        #[test]
        fn fragments_cover_a_grant_once_and_in_order(page_power in 0u32..22, room in 1u32..70_000, skip in 0u32..4) {
            let page_bytes = 1 << page_power;
            let Some(fragment) = fragment_bytes(page_bytes, room) else { return Ok(()) };
            prop_assert!(fragment <= room || fragment == page_bytes);
            let start = (skip * fragment_unit(page_bytes)).min(page_bytes);
            let body = Body::Grant { offset: start, bytes: page_bytes - start };
            let mut next = start;
            for part in (Message { body, ..GOOD }).fragments(fragment) {
                let Body::Grant { offset, bytes } = part.body else { panic!("{part:?}") };
                prop_assert_eq!(offset, next);
                prop_assert_eq!((offset % fragment_unit(page_bytes), bytes % fragment_unit(page_bytes)), (0, 0));
                next += bytes;
            }
            prop_assert_eq!(next, page_bytes);
        }
    }

    #[test]
    fn what_is_no_grant_is_not_cut() {
        let mut parts = GOOD.fragments(1);
        assert_eq!((parts.next(), parts.next()), (Some(GOOD), None));
        assert_eq!(fragment_bytes(2 << 20, 8191), None);
        assert_eq!(fragment_bytes(2 << 20, 8900), Some(8192));
        assert_eq!(fragment_bytes(16384, 1400), Some(1344));
        assert_eq!(fragment_bytes(64, 1400), Some(64));
    }

    const GOOD: Message = Message {
        cluster: ClusterId(0),
        epoch: Epoch(0),
        from: NodeId(0),
        to: NodeId(0),
        from_incarnation: Incarnation(0),
        to_incarnation: Incarnation(0),
        page: PageId(0),
        request: 0,
        stamp_us: 0,
        body: Body::REQUEST,
    };
}
