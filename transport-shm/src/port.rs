//! One thread's rings to all owners, as a transport.

use std::collections::VecDeque;
use std::io;

use dsm_core::id::NodeId;
use dsm_core::time::Instant;
use dsm_core::transport::{Received, SendError, Transport};
use dsm_core::wire::HEADER_BYTES;

use crate::bell::Bell;
use crate::channel::ClientEnd;
use crate::clock::now;
use crate::inbox::{ChannelId, Inbox, Layout, at};
use crate::mapping::Mapping;

/// One thread's way to the owners: a channel in the inbox of each.
///
/// Answers are looked for where the last request went. An answer that comes later, from an owner that was given up,
/// stays in its ring and is found, and known as late, when that owner is next asked.
#[derive(Debug)]
pub struct RingPort {
    routes: Vec<Option<Route>>,
    /// The owners of the last requests that no answer came to, the oldest first. Never grows: it is used in signal
    /// handlers.
    asked: VecDeque<usize>,
    /// The owner asked last: where to look when an answer that came late was taken for a later one.
    last: usize,
    spin_us: u64,
}

#[derive(Debug)]
struct Route {
    channel: ClientEnd,
    /// The first page of the inbox, where the server's bell is.
    front: Mapping,
}

/// Requests that are remembered until they are answered.
const ASKED_MAX: usize = 16;

/// A sleep is never longer than this, whatever the deadline.
const SLEEP_US_MAX: u64 = 10_000;

/// Nor than this while others than the one who rings may answer.
const LOOK_US: u64 = 1_000;

impl RingPort {
    /// A port without routes. It looks for an answer for `spin_us` before it sleeps: about 100 where every thread has
    /// a core, 0 where owner and reader share one.
    #[must_use]
    pub fn new(spin_us: u64) -> Self {
        Self { routes: Vec::new(), asked: VecDeque::with_capacity(ASKED_MAX), last: 0, spin_us }
    }

    /// Opens the way to `owner` through its inbox. `channel` is this thread's alone.
    ///
    /// # Errors
    /// There is no such channel, or it cannot be mapped.
    pub fn connect(
        &mut self,
        owner: NodeId,
        inbox: &Inbox,
        layout: Layout,
        channel: ChannelId,
    ) -> io::Result<()> {
        use std::os::fd::AsFd;
        let route = Route {
            channel: ClientEnd::open(inbox.as_fd(), layout, channel)?,
            front: Mapping::new(inbox.as_fd(), 0, at::UNIT)?,
        };
        if self.routes.len() <= owner.index() {
            self.routes.resize_with(owner.index() + 1, || None);
        }
        self.routes[owner.index()] = Some(route);
        Ok(())
    }

    fn route(&mut self, owner: usize) -> Option<&mut Route> {
        self.routes.get_mut(owner)?.as_mut()
    }
}

impl Transport for RingPort {
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError> {
        let header: &[u8; HEADER_BYTES] = message.try_into().map_err(|_| SendError::Full)?;
        if self.asked.len() == ASKED_MAX {
            self.asked.pop_front();
        }
        self.asked.push_back(to.index());
        self.last = to.index();
        let route = self.route(to.index()).ok_or(SendError::NoRoute(to))?;
        route.channel.release();
        route.channel.ask(header).map_err(|_| SendError::Full)?;
        route.front.shared::<Bell>(0).ring();
        Ok(())
    }

    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        self.routes.iter_mut().flatten().for_each(|route| route.channel.release());
        let has_answer = |owner: &usize| {
            self.routes.get(*owner).and_then(Option::as_ref).is_some_and(|route| route.channel.has_answer())
        };
        let is_ready = || has_answer(&self.last) || self.asked.iter().any(has_answer);
        // Whoever was asked last rings; the others are looked at meanwhile. One of them may be dead and never ring.
        let last = &self.routes.get(self.last)?.as_ref()?.channel;
        let sleep_us_max = if self.asked.len() > 1 { LOOK_US } else { SLEEP_US_MAX };
        wait_for(deadline, self.spin_us, is_ready, |timeout_us| last.sleep(timeout_us.min(sleep_us_max)));
        let Some(place) = self.asked.iter().position(has_answer) else {
            // Overdue: whoever was asked longest ago is not looked at any more, until it is asked again.
            self.asked.pop_front();
            let (header, body) = self.route(self.last)?.channel.answer()?;
            return Some(Received { header, body });
        };
        let owner = self.asked.remove(place)?;
        let (header, body) = self.route(owner)?.channel.answer()?;
        Some(Received { header, body })
    }
}

/// Looks for `spin_us`, then sleeps in short stretches, until `is_ready` or the deadline.
pub(crate) fn wait_for(deadline: Instant, spin_us: u64, is_ready: impl Fn() -> bool, sleep: impl Fn(u64)) {
    if is_ready() {
        return;
    }
    let start = now();
    loop {
        let time = now();
        if is_ready() || time >= deadline {
            return;
        }
        if time.since(start) < spin_us {
            core::hint::spin_loop();
        } else {
            sleep(deadline.since(time).min(SLEEP_US_MAX));
        }
    }
}
