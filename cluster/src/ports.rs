//! A render thread's way to the owners, whichever transport was asked for.

use std::os::fd::OwnedFd;
use std::sync::Arc;

use anyhow::{Context, Result};
use dsm_core::home::Home;
use dsm_core::id::{ClusterId, Epoch, NodeId};
use dsm_core::placement::Stripes;
use dsm_core::time::Instant;
use dsm_core::transport::{Lossy, Received, SendError, Transport};
use transport_shm::{ChannelId, DirectPort, Inbox, Layout, PageFile, RingPort};

use crate::control::{SetUp, TransportKind};

/// The ways to all owners that the threads of one process share; each thread gets a [`Port`] of its own.
#[derive(Debug)]
pub(crate) struct Routes {
    set_up: SetUp,
    placement: Stripes,
    owners: Vec<Owner>,
}

/// What is known of one owner.
#[derive(Debug)]
struct Owner {
    id: NodeId,
    pages: Arc<PageFile>,
    inbox: Option<Inbox>,
}

/// One thread's port. It loses messages when that was asked for.
pub(crate) type Port = Lossy<AnyPort>;

/// A port of either kind.
#[derive(Debug)]
pub(crate) enum AnyPort {
    Direct(DirectPort),
    Ring(RingPort),
}

/// The epoch of a run; scenes do not change yet.
pub(crate) const EPOCH: Epoch = Epoch(1);

impl Routes {
    pub(crate) fn new(
        set_up: &SetUp,
        placement: Stripes,
        pages: Vec<OwnedFd>,
        inboxes: Vec<OwnedFd>,
    ) -> Result<Self> {
        let layout = layout(set_up)?;
        let mut inboxes = inboxes.into_iter();
        let owners = placement.owner_ids().zip(pages).map(|(id, pages)| {
            let inbox = inboxes.next().map(|file| Inbox::open(file, layout)).transpose();
            Ok(Owner { id, pages: Arc::new(PageFile::from(pages)), inbox: inbox.context("an inbox")? })
        });
        Ok(Self { set_up: set_up.clone(), placement, owners: owners.collect::<Result<_>>()? })
    }

    /// The port of render thread `thread` of this process.
    pub(crate) fn port(&self, thread: u16) -> Result<Port> {
        let SetUp { transport, page_bytes, lose_per_mille, node, .. } = self.set_up;
        let port = match transport {
            TransportKind::Shm => {
                let mut port = DirectPort::new(page_bytes);
                for owner in &self.owners {
                    port.connect(owner.id, self.home(owner.id), owner.pages.clone());
                }
                AnyPort::Direct(port)
            }
            TransportKind::ShmRing => AnyPort::Ring(self.ring_port(thread)?),
        };
        let seed = self.set_up.seed ^ (u64::from(node) << 32) ^ u64::from(thread);
        Ok(Lossy::new(port, lose_per_mille, seed))
    }

    /// Plays the part of an owner.
    pub(crate) fn home(&self, owner: NodeId) -> Home {
        Home::new(owner, ClusterId(self.set_up.cluster), EPOCH, self.placement, self.set_up.page_bytes)
    }

    /// The pages and the inbox of this process itself, if it owns pages.
    pub(crate) fn own(&self) -> Option<(&Arc<PageFile>, Option<&Inbox>)> {
        let own = self.owners.iter().find(|owner| owner.id.0 == self.set_up.node)?;
        Some((&own.pages, own.inbox.as_ref()))
    }

    fn ring_port(&self, thread: u16) -> Result<RingPort> {
        let (layout, channel) =
            (layout(&self.set_up)?, ChannelId(self.set_up.node * self.set_up.threads + thread));
        let mut port = RingPort::new(self.set_up.spin_us);
        for owner in &self.owners {
            let inbox = owner.inbox.as_ref().context("an owner without an inbox")?;
            port.connect(owner.id, inbox, layout, channel)
                .with_context(|| format!("the ring to {}", owner.id))?;
        }
        Ok(port)
    }
}

impl Transport for AnyPort {
    fn send(&mut self, to: NodeId, message: &[u8]) -> Result<(), SendError> {
        match self {
            Self::Direct(port) => port.send(to, message),
            Self::Ring(port) => port.send(to, message),
        }
    }

    fn receive(&mut self, deadline: Instant) -> Option<Received<'_>> {
        match self {
            Self::Direct(port) => port.receive(deadline),
            Self::Ring(port) => port.receive(deadline),
        }
    }
}

/// The layout of every inbox of a run: a channel for each render thread.
pub(crate) fn layout(set_up: &SetUp) -> Result<Layout> {
    let channels =
        set_up.nodes.checked_mul(set_up.threads).context("more render threads than rings can have")?;
    Ok(Layout::new(set_up.page_bytes, channels)?)
}
