//! One thread's rings to all owners, as a transport.

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
    /// The owner asked last.
    asked: usize,
    spin_us: u64,
}

#[derive(Debug)]
struct Route {
    channel: ClientEnd,
    /// The first page of the inbox, where the server's bell is.
    front: Mapping,
}

/// A sleep is never longer than this, whatever the deadline.
const SLEEP_US_MAX: u64 = 10_000;

impl RingPort {
    /// A port without routes. It looks for an answer for `spin_us` before it sleeps: about 100 where every thread has
    /// a core, 0 where owner and reader share one.
    #[must_use]
    pub const fn new(spin_us: u64) -> Self {
        Self { routes: Vec::new(), asked: 0, spin_us }
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
        self.asked = to.index();
        let route = self.route(to.index()).ok_or(SendError::NoRoute(to))?;
        route.channel.release();
        route.channel.ask(header).map_err(|_| SendError::Full)?;
        route.front.shared::<Bell>(0).ring();
        Ok(())
    }

    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        let spin_us = self.spin_us;
        let channel = &mut self.route(self.asked)?.channel;
        channel.release();
        wait_for(deadline, spin_us, || channel.has_answer(), |timeout_us| channel.sleep(timeout_us));
        let (header, body) = channel.answer()?;
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
