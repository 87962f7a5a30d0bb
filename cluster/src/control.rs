//! What the supervisor and its processes say to each other.
//!
//! A packet is one letter and what belongs to it: JSON where people may want to look, bytes where there are many.

use anyhow::{Context, Result, bail};
use rt_core::{Frame, TileCounts};
use serde::{Deserialize, Serialize};

use crate::diagnostic::{FactBatch, Wants};
use crate::plan::PlacementNumbers;
use crate::report::ProcessReport;

/// From the supervisor to a process.
#[derive(Debug)]
pub(crate) enum Order {
    /// Who you are. Comes first, with the files listed in [`Files`].
    SetUp(Box<SetUp>),
    /// Every page is in place; you may fetch from others.
    Go,
    /// A frame begins, and this is the display's first deal of its tiles.
    Draw(Frame, Vec<u8>),
    /// The display's part of the balance: which tiles are whose.
    Balance(Vec<u8>),
    /// The process of this number is dead; ask it for nothing.
    Down(u16),
    /// Finish the tiles under way, and take no more.
    Halt,
    /// Report and end.
    Stop,
}

/// From a process to the supervisor.
#[derive(Debug)]
pub(crate) enum News {
    /// Home pages are filled.
    Ready,
    /// Nothing has happened, and I am here.
    Alive,
    /// What is known of some tiles of a frame, where somebody wants to know.
    Facts(FactBatch),
    /// A node's part of the balance, for the display.
    Balance(Vec<u8>),
    /// I draw no more, and need no more pages.
    Halted,
    /// I have to give up.
    Failed(String),
    /// What I have counted; the last packet.
    Report(Box<ProcessReport>),
}

/// What a process must know before it starts.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SetUp {
    pub(crate) node: u16,
    pub(crate) nodes: u16,
    pub(crate) processes: u16,
    pub(crate) cluster: u64,
    pub(crate) placement: PlacementNumbers,
    pub(crate) page_bytes: u32,
    pub(crate) image_bytes: u64,
    pub(crate) budget_bytes: u64,
    pub(crate) slots: u32,
    pub(crate) threads: u16,
    /// Render threads, of all nodes, for each core.
    pub(crate) threads_per_core: u16,
    /// Each render thread keeps to a core of its own.
    pub(crate) binds_to_cores: bool,
    pub(crate) backend: String,
    pub(crate) policy: String,
    /// A source of reference bits by name.
    pub(crate) reference: String,
    pub(crate) hidden_per_cent: u32,
    pub(crate) prefetch: Prefetch,
    pub(crate) kernel: String,
    pub(crate) transport: TransportKind,
    pub(crate) spin_us: u64,
    pub(crate) deadline_us: u64,
    /// Messages lost on purpose, in a thousand, and the seed of which.
    pub(crate) lose_per_mille: u32,
    pub(crate) seed: u64,
    /// Mailboxes that come with the plan: one for each node, where they take tiles from each other, else none.
    pub(crate) mailboxes: u16,
    /// How tiles come to nodes, by name.
    pub(crate) balance: String,
    /// The picture.
    pub(crate) size: [u32; 2],
    /// Displays that the tiles go to.
    pub(crate) displays: u16,
    /// Tiles sent at a time at most; fewer than a parcel holds for tests that count them, and where each is waited for.
    pub(crate) batch_tiles: u16,
    /// What is to be found out of each tile.
    pub(crate) wants: Wants,
}

/// Which pages come before they are touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
pub enum Prefetch {
    /// None.
    None,
    /// Those that follow a missed page in address order, as many as are used.
    Neighbours,
    /// Those that a tile touched in the last frame, before it starts, where hints are the source.
    Tiles,
    /// Both.
    Both,
}

/// How pages travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum TransportKind {
    /// Shared memory, read straight out of the owner's; no server has to answer.
    Shm,
    /// Shared memory, through rings and the owner's server thread, as between machines.
    ShmRing,
}

/// Where render threads run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum BindTo {
    /// Each on a core of its own.
    Core,
    /// Wherever the system puts them.
    None,
}

/// The order of the files that come with [`Order::SetUp`]: the image, the pages of each owner, the inboxes of each, the
/// mailboxes of the nodes, and for a node that renders its links to the displays. A node's own letters come last.
#[derive(Debug)]
pub(crate) struct Files<T> {
    pub(crate) image: T,
    pub(crate) pages: Vec<T>,
    pub(crate) inboxes: Vec<T>,
    pub(crate) mailboxes: Vec<T>,
    pub(crate) displays: Vec<T>,
}

/// What was counted while tiles of a frame were drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Drawn {
    pub(crate) frame: u32,
    pub(crate) primary_rays: u64,
    pub(crate) hits: u64,
    pub(crate) shadow_rays: u64,
    pub(crate) lit: u64,
    pub(crate) damaged: u64,
}

impl Order {
    pub(crate) fn to_packet(&self) -> Result<Vec<u8>> {
        Ok(match self {
            Self::SetUp(set_up) => with_json(b'S', set_up)?,
            Self::Go => vec![b'G'],
            Self::Draw(frame, deal) => [b"D", frame.as_bytes(), deal].concat(),
            Self::Balance(message) => [&b"B"[..], message].concat(),
            Self::Down(process) => [&b"N"[..], &process.to_le_bytes()].concat(),
            Self::Halt => vec![b'H'],
            Self::Stop => vec![b'X'],
        })
    }

    pub(crate) fn from_packet(packet: &[u8]) -> Result<Self> {
        match packet {
            [b'S', json @ ..] => Ok(Self::SetUp(serde_json::from_slice(json)?)),
            [b'G'] => Ok(Self::Go),
            [b'D', rest @ ..] => {
                let (frame, deal) = rest.split_at_checked(size_of::<Frame>()).context("half a frame")?;
                Ok(Self::Draw(Frame::read(frame)?, deal.to_vec()))
            }
            [b'B', message @ ..] => Ok(Self::Balance(message.to_vec())),
            [b'N', low, high] => Ok(Self::Down(u16::from_le_bytes([*low, *high]))),
            [b'H'] => Ok(Self::Halt),
            [b'X'] => Ok(Self::Stop),
            _ => bail!("an order of {} bytes that is none", packet.len()),
        }
    }
}

impl News {
    pub(crate) fn to_packet(&self) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Ready => vec![b'R'],
            Self::Alive => vec![b'A'],
            Self::Halted => vec![b'H'],
            Self::Facts(batch) => batch.to_packet(b'I'),
            Self::Balance(message) => [&b"B"[..], message].concat(),
            Self::Failed(why) => [b"F", why.as_bytes()].concat(),
            Self::Report(report) => with_json(b'P', report)?,
        })
    }

    pub(crate) fn from_packet(packet: &[u8]) -> Result<Self> {
        match packet {
            [b'R'] => Ok(Self::Ready),
            [b'A'] => Ok(Self::Alive),
            [b'H'] => Ok(Self::Halted),
            [b'I', rest @ ..] => Ok(Self::Facts(FactBatch::from_bytes(rest)?)),
            [b'B', message @ ..] => Ok(Self::Balance(message.to_vec())),
            [b'F', why @ ..] => Ok(Self::Failed(String::from_utf8_lossy(why).into_owned())),
            [b'P', json @ ..] => Ok(Self::Report(serde_json::from_slice(json)?)),
            _ => bail!("news of {} bytes that is none", packet.len()),
        }
    }
}

impl<T> Files<T> {
    /// All of them, in the order in which they travel.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &T> {
        let shared = core::iter::once(&self.image).chain(&self.pages).chain(&self.inboxes);
        shared.chain(&self.mailboxes).chain(&self.displays)
    }

    /// Sorts what came with the plan into its places.
    pub(crate) fn from_list(list: Vec<T>, owners: usize, set_up: &SetUp) -> Result<Self> {
        let inboxes = if set_up.transport == TransportKind::ShmRing { owners } else { 0 };
        let displays = if set_up.node < set_up.nodes { set_up.displays.into() } else { 0 };
        let got = list.len();
        let mut list = list.into_iter();
        let image = list.next().context("the image did not come with the plan")?;
        let pages: Vec<T> = list.by_ref().take(owners).collect();
        let inboxes: Vec<T> = list.by_ref().take(inboxes).collect();
        let mailboxes: Vec<T> = list.by_ref().take(set_up.mailboxes.into()).collect();
        let displays: Vec<T> = list.by_ref().take(displays).collect();
        if pages.len() != owners || list.next().is_some() {
            bail!("{got} files came with a plan for {owners} owners");
        }
        Ok(Self { image, pages, inboxes, mailboxes, displays })
    }
}

impl Drawn {
    /// Adds what was counted for other tiles of the frame.
    pub(crate) const fn merge(&mut self, other: &Self) {
        self.primary_rays += other.primary_rays;
        self.hits += other.hits;
        self.shadow_rays += other.shadow_rays;
        self.lit += other.lit;
        self.damaged += other.damaged;
    }

    /// Adds what was counted for one.
    pub(crate) const fn add(&mut self, counts: &TileCounts) {
        self.primary_rays += counts.primary;
        self.hits += counts.hits;
        self.shadow_rays += counts.shadow;
        self.lit += counts.lit;
        self.damaged += counts.damaged;
    }
}

fn with_json(letter: u8, value: &impl Serialize) -> Result<Vec<u8>> {
    let mut packet = vec![letter];
    serde_json::to_writer(&mut packet, value)?;
    Ok(packet)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_that_are_none_are_errors() {
        for packet in [&b""[..], b"Z", b"S{", b"Dxx", b"GG", b"Txx", b"N", b"N123"] {
            assert!(Order::from_packet(packet).is_err());
        }
        for packet in [&b""[..], b"T12", b"P[]", b"RR", b"I12", b"D123"] {
            assert!(News::from_packet(packet).is_err());
        }
    }
}
