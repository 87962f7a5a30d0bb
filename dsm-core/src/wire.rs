//! The messages between nodes: little-endian, fixed headers, nothing trusted before it is checked.
//!
//! ```text
//!  0        2     3     4                    12         16        18        20         24         28        32
//!  | magic  | ver | kind| cluster            | epoch    | from    | to      | page     | request  | detail  |
//! ```
//!
//! `detail` is the number of page bytes that follow a grant, or the reason of a refusal. A request has 0 there.

use core::fmt;

use crate::id::{ClusterId, Epoch, NodeId, PageId};

/// Bytes of every message's header. A grant's page bytes travel behind it, in whatever way a transport has.
pub const HEADER_BYTES: usize = 32;

/// The protocol's version. Another version is another language.
pub const VERSION: u8 = 1;

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
    /// The page it is about.
    pub page: PageId,
    /// The sender's number for the request, returned with the answer. A late answer is known by it.
    pub request: u32,
    /// What it says.
    pub body: Body,
}

/// What a message says about its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// "I need this page."
    Request,
    /// "Here are its bytes": that many of them follow the header.
    Grant {
        /// Length of the page in bytes.
        page_bytes: u32,
    },
    /// "You will not get it from me."
    Refusal(Refusal),
}

/// Why an owner does not grant a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The page has another home.
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
    /// A refusal for a reason that there is not, or a request with a detail.
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
            page: PageId(u32::from_le_bytes(at(header, field::PAGE))),
            request: u32::from_le_bytes(at(header, field::REQUEST)),
            body: Body::parse(header[field::KIND], u32::from_le_bytes(at(header, field::DETAIL)))?,
        })
    }

    /// Writes the header to the start of `bytes` and returns its length, [`HEADER_BYTES`].
    ///
    /// # Panics
    /// When `bytes` is shorter than that.
    pub fn emit(&self, bytes: &mut [u8]) -> usize {
        let (kind, detail) = self.body.emit();
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
        HEADER_BYTES
    }

    /// The grant with which `owner` answers this request.
    #[must_use]
    pub const fn grant(&self, owner: NodeId, page_bytes: u32) -> Self {
        Self { from: owner, to: self.from, body: Body::Grant { page_bytes }, ..*self }
    }

    /// The refusal with which `owner` answers this request.
    #[must_use]
    pub const fn refusal(&self, owner: NodeId, why: Refusal) -> Self {
        Self { from: owner, to: self.from, body: Body::Refusal(why), ..*self }
    }
}

impl Body {
    fn parse(kind: u8, detail: u32) -> Result<Self, ParseError> {
        match (kind, detail) {
            (1, 0) => Ok(Self::Request),
            (2, page_bytes) => Ok(Self::Grant { page_bytes }),
            (3, 1) => Ok(Self::Refusal(Refusal::NotOwner)),
            (3, 2) => Ok(Self::Refusal(Refusal::Unreadable)),
            (1 | 3, got) => Err(ParseError::Detail { got }),
            (got, _) => Err(ParseError::Kind { got }),
        }
    }

    const fn emit(self) -> (u8, u32) {
        match self {
            Self::Request => (1, 0),
            Self::Grant { page_bytes } => (2, page_bytes),
            Self::Refusal(Refusal::NotOwner) => (3, 1),
            Self::Refusal(Refusal::Unreadable) => (3, 2),
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
            Self::NotOwner => "it is not the page's home",
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_message() -> impl Strategy<Value = Message> {
        let body = prop_oneof![
            Just(Body::Request),
            any::<u32>().prop_map(|page_bytes| Body::Grant { page_bytes }),
            Just(Body::Refusal(Refusal::NotOwner)),
            Just(Body::Refusal(Refusal::Unreadable)),
        ];
        (any::<u64>(), any::<u32>(), any::<u16>(), any::<u16>(), any::<u32>(), any::<u32>(), body).prop_map(
            |(cluster, epoch, from, to, page, request, body)| Message {
                cluster: ClusterId(cluster),
                epoch: Epoch(epoch),
                from: NodeId(from),
                to: NodeId(to),
                page: PageId(page),
                request,
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
        fn what_parses_emits_to_the_same_bytes(mut bytes in any::<[u8; HEADER_BYTES]>(), kind in 0u8..5, detail in 0u8..4) {
            bytes[..4].copy_from_slice(&[b'M', b'S', VERSION, kind]);
            bytes[field::DETAIL..].copy_from_slice(&u32::from(detail).to_le_bytes());
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
        assert_eq!(Message::parse(&good[..31]), Err(ParseError::Truncated { got: 31 }));
        assert_eq!(with(0, b'X'), Err(ParseError::Magic));
        assert_eq!(with(2, 9), Err(ParseError::Version { got: 9 }));
        assert_eq!(with(3, 0), Err(ParseError::Kind { got: 0 }));
        assert_eq!(with(28, 7), Err(ParseError::Detail { got: 7 }));
    }
}
