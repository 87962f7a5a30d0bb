//! The state machine of a node that owns pages: it answers requests.
//!
//! A home keeps no record of who has copies; the scene does not change within an epoch, so nobody needs to know.
//! It is apart from [`Node`](crate::node::Node) so that serving others never waits for this node's own faults.

use core::fmt;

use crate::id::{ClusterId, Epoch, NodeId, PageId};
use crate::placement::Stripes;
use crate::stats::HomeStats;
use crate::wire::{Body, Message, ParseError, Refusal};

/// Answers requests for the pages that this node is home to.
#[derive(Debug)]
pub struct Home {
    me: NodeId,
    cluster: ClusterId,
    epoch: Epoch,
    placement: Stripes,
    page_bytes: u32,
    stats: HomeStats,
}

/// What a home does about a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Send `message`, and behind it the bytes of the home page with this index.
    Grant {
        /// The header to send, to `message.to`.
        message: Message,
        /// Place of the page among this node's home pages.
        home_index: u32,
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
}

impl Home {
    /// A home of the pages that `placement` gives to `me`.
    #[must_use]
    pub const fn new(
        me: NodeId,
        cluster: ClusterId,
        epoch: Epoch,
        placement: Stripes,
        page_bytes: u32,
    ) -> Self {
        let stats = HomeStats { granted_pages: 0, refused_requests: 0, refused_messages: 0 };
        Self { me, cluster, epoch, placement, page_bytes, stats }
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
            Message { body: Body::Request, .. } => Ok(message),
            Message { .. } => Err(HomeError::NotRequest),
        }
    }

    fn answer(&mut self, request: Message) -> Answer {
        if let Some(home_index) = self.own_index(request.page) {
            self.stats.granted_pages += 1;
            Answer::Grant { message: request.grant(self.me, self.page_bytes), home_index }
        } else {
            self.stats.refused_requests += 1;
            Answer::Refuse { message: request.refusal(self.me, Refusal::NotOwner) }
        }
    }

    fn own_index(&self, page: PageId) -> Option<u32> {
        self.placement.home_index(page).filter(|_| self.placement.home(page) == Some(self.me))
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
        }
    }
}

impl core::error::Error for HomeError {}

#[cfg(test)]
mod tests {
    use super::*;
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
            page: PageId(page),
            request: 77,
            body: Body::Request,
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
        assert_eq!(answer(&mut home(), request(6)), Ok(Answer::Grant { message, home_index: 2 }));
        assert_eq!((message.to, message.request), (NodeId(0), 77));
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
        let grant = Body::Grant { page_bytes: 4096 };
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
