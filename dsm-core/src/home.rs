//! The state machine of a node that owns pages: it answers requests.
//!
//! A home keeps no record of who has copies; the scene does not change within an epoch, so nobody needs to know.
//! It is apart from [`Node`](crate::node::Node) so that serving others never waits for this node's own faults.

use core::fmt;

use crate::id::{ClusterId, Epoch, Incarnation, NodeId};
use crate::placement::Stripes;
use crate::stats::HomeStats;
use crate::wire::{Body, Message, ParseError, Refusal};

/// Answers requests for the pages that this node holds, as their home or as a replica.
#[derive(Clone, Debug)]
pub struct Home {
    me: NodeId,
    cluster: ClusterId,
    epoch: Epoch,
    incarnation: Incarnation,
    placement: Stripes,
    page_bytes: u32,
    stats: HomeStats,
}

/// What a home does about a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Send `message`, and behind it the bytes that it names of the page with this index. A transport that cannot carry
    /// so many at once sends [`Message::fragments`] of it instead.
    Grant {
        /// The header to send, to `message.to`.
        message: Message,
        /// Place of the page among the pages that this node holds.
        held_index: u32,
    },
    /// Send `message`, which says no.
    Refuse {
        /// The header to send, to `message.to`.
        message: Message,
    },
}

/// Why a message was dropped without an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum HomeError {
    /// The bytes are no message.
    Parse(ParseError),
    /// It belongs to another run.
    Cluster(ClusterId),
    /// It was sent in another epoch.
    Epoch(Epoch),
    /// It is for another node.
    To(NodeId),
    /// It is no request.
    NotRequest,
    /// It asks for bytes that no page has.
    Range {
        /// Where they would start.
        offset: u32,
        /// How many they would be.
        bytes: u32,
    },
}

impl Home {
    /// A home, in its first incarnation, of the pages that `placement` gives to `me`.
    #[must_use]
    pub const fn new(
        me: NodeId,
        cluster: ClusterId,
        epoch: Epoch,
        placement: Stripes,
        page_bytes: u32,
    ) -> Self {
        let stats = HomeStats { granted_pages: 0, refused_requests: 0, refused_messages: 0 };
        Self { me, cluster, epoch, incarnation: Incarnation(0), placement, page_bytes, stats }
    }

    /// The same home in a later incarnation.
    #[must_use]
    pub const fn in_incarnation(self, incarnation: Incarnation) -> Self {
        Self { incarnation, ..self }
    }

    /// Takes one message and says what to send for it.
    ///
    /// # Errors
    /// The message is none that a home answers; it is counted and has no effect.
    pub fn handle_message(&mut self, bytes: &[u8]) -> Result<Answer, HomeError> {
        let request = self.check(bytes).inspect_err(|_| self.stats.refused_messages += 1)?;
        Ok(self.answer(request))
    }

    /// Says no to a request that was granted, because the page's bytes could not be read after all.
    pub fn handle_unreadable(&mut self, granted: &Message) -> Message {
        self.stats.granted_pages -= 1;
        self.stats.refused_requests += 1;
        Message { body: Body::Refusal(Refusal::Unreadable), ..*granted }
    }

    /// What has been counted so far.
    #[must_use]
    pub const fn stats(&self) -> HomeStats {
        self.stats
    }

    fn check(&self, bytes: &[u8]) -> Result<Message, HomeError> {
        let message = Message::parse(bytes).map_err(HomeError::Parse)?;
        match message {
            Message { cluster, .. } if cluster != self.cluster => Err(HomeError::Cluster(cluster)),
            Message { epoch, .. } if epoch != self.epoch => Err(HomeError::Epoch(epoch)),
            Message { to, .. } if to != self.me => Err(HomeError::To(to)),
            Message { body: Body::Request { offset, bytes }, .. } => match self.range(offset, bytes) {
                Some(_) => Ok(message),
                None => Err(HomeError::Range { offset, bytes }),
            },
            Message { .. } => Err(HomeError::NotRequest),
        }
    }

    fn answer(&mut self, request: Message) -> Answer {
        let range = match request.body {
            Body::Request { offset, bytes } => self.range(offset, bytes),
            Body::Grant { .. } | Body::Refusal(_) => None,
        };
        let held_index = self.placement.held_index(self.me, request.page);
        if let (Some((offset, bytes)), Some(held_index)) = (range, held_index) {
            self.stats.granted_pages += 1;
            let message = request.answer(self.me, self.incarnation, Body::Grant { offset, bytes });
            Answer::Grant { message, held_index }
        } else {
            self.stats.refused_requests += 1;
            let body = Body::Refusal(Refusal::NotOwner);
            Answer::Refuse { message: request.answer(self.me, self.incarnation, body) }
        }
    }

    /// The bytes that a request is for, as offset and length, when a page has them.
    fn range(&self, offset: u32, bytes: u32) -> Option<(u32, u32)> {
        let rest = self.page_bytes.checked_sub(offset).filter(|rest| *rest > 0)?;
        match bytes {
            0 => Some((offset, rest)),
            _ => (bytes <= rest).then_some((offset, bytes)),
        }
    }
}

impl fmt::Display for HomeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parse(error) => write!(f, "{error}"),
            Self::Cluster(cluster) => write!(f, "message of another cluster, {:#x}", cluster.0),
            Self::Epoch(epoch) => write!(f, "message of epoch {}", epoch.0),
            Self::To(to) => write!(f, "message for {to}"),
            Self::NotRequest => write!(f, "message that is no request"),
            Self::Range { offset, bytes } => {
                write!(f, "request for {bytes} bytes from byte {offset} on, which no page has")
            }
        }
    }
}

impl core::error::Error for HomeError {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::PageId;
    use crate::wire::HEADER_BYTES;

    const CLUSTER: ClusterId = ClusterId(5);
    const EPOCH: Epoch = Epoch(2);

    fn home() -> Home {
        let placement = Stripes::new(8, 2, NodeId(0), 2).unwrap();
        Home::new(NodeId(1), CLUSTER, EPOCH, placement, 4096)
    }

    fn request(page: u32) -> Message {
        Message {
            cluster: CLUSTER,
            epoch: EPOCH,
            from: NodeId(0),
            to: NodeId(1),
            from_incarnation: Incarnation(4),
            to_incarnation: Incarnation(0),
            page: PageId(page),
            request: 77,
            stamp_us: 55,
            body: Body::REQUEST,
        }
    }

    fn answer(home: &mut Home, message: Message) -> Result<Answer, HomeError> {
        let mut bytes = [0; HEADER_BYTES];
        message.emit(&mut bytes);
        home.handle_message(&bytes)
    }

    #[test]
    fn own_pages_are_granted_under_the_request_s_number() {
        let message = request(6).grant(NodeId(1), 4096);
        assert_eq!(answer(&mut home(), request(6)), Ok(Answer::Grant { message, held_index: 2 }));
        assert_eq!((message.to, message.to_incarnation), (NodeId(0), Incarnation(4)));
        assert_eq!((message.request, message.stamp_us), (77, 55));
    }

    #[test]
    fn replicas_are_granted_as_home_pages_are_and_say_which_incarnation_holds_them() {
        let placement = Stripes::new(8, 2, NodeId(0), 2).unwrap().with_replicas(2).unwrap();
        let mut home = Home::new(NodeId(1), CLUSTER, EPOCH, placement, 4096).in_incarnation(Incarnation(3));
        let Ok(Answer::Grant { message, held_index }) = answer(&mut home, request(4)) else {
            panic!("not granted")
        };
        assert_eq!((message.from_incarnation, held_index), (Incarnation(3), 6));
    }

    #[test]
    fn a_part_is_granted_when_a_page_has_it() {
        let with = |offset, bytes| Message { body: Body::Request { offset, bytes }, ..request(6) };
        for (offset, bytes, granted) in [(0, 0, 4096), (4000, 0, 96), (16, 64, 64), (4095, 1, 1)] {
            let Ok(Answer::Grant { message, .. }) = answer(&mut home(), with(offset, bytes)) else {
                panic!("{offset}")
            };
            assert_eq!(message.body, Body::Grant { offset, bytes: granted });
        }
        for (offset, bytes) in [(4096, 0), (4095, 2), (0, 4097), (u32::MAX, u32::MAX)] {
            assert_eq!(answer(&mut home(), with(offset, bytes)), Err(HomeError::Range { offset, bytes }));
        }
    }

    #[test]
    fn pages_of_others_and_pages_that_are_none_are_refused() {
        for page in [0, 5, 8, u32::MAX] {
            let message = request(page).refusal(NodeId(1), Refusal::NotOwner);
            assert_eq!(answer(&mut home(), request(page)), Ok(Answer::Refuse { message }));
        }
    }

    #[test]
    fn strangers_get_no_answer() {
        let mut home = home();
        let other = ClusterId(6);
        assert_eq!(
            answer(&mut home, Message { cluster: other, ..request(6) }),
            Err(HomeError::Cluster(other))
        );
        assert_eq!(
            answer(&mut home, Message { epoch: Epoch(1), ..request(6) }),
            Err(HomeError::Epoch(Epoch(1)))
        );
        assert_eq!(answer(&mut home, Message { to: NodeId(3), ..request(6) }), Err(HomeError::To(NodeId(3))));
        let grant = Body::Grant { offset: 0, bytes: 4096 };
        assert_eq!(answer(&mut home, Message { body: grant, ..request(6) }), Err(HomeError::NotRequest));
        assert_eq!(home.handle_message(b"MS"), Err(HomeError::Parse(ParseError::Truncated { got: 2 })));
        assert_eq!(home.stats(), HomeStats { refused_messages: 5, ..HomeStats::default() });
    }

    #[test]
    fn a_page_that_cannot_be_read_is_refused_after_all() {
        let mut home = home();
        let Ok(Answer::Grant { message, .. }) = answer(&mut home, request(6)) else { panic!("not granted") };
        let refusal = home.handle_unreadable(&message);
        assert_eq!(refusal.body, Body::Refusal(Refusal::Unreadable));
        assert_eq!((home.stats().granted_pages, home.stats().refused_requests), (0, 1));
    }
}
