//! The displays of a run: threads of the supervisor, each of which puts a part of the picture together.

use core::time::Duration;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use rt_core::{Frame, TileId};
use rustix::event::{EventfdFlags, eventfd};

use super::credit::Meter;
use super::parcel::PARCEL_BYTES_MAX;
use super::part::{Part, Traffic};
use crate::control::Drawn;
use crate::link::{Link, wait_for_any};
use crate::picture::Picture;
use crate::size::PictureSize;

/// All displays, as the supervisor sees them.
#[derive(Debug)]
pub(crate) struct Displays {
    shared: Vec<Arc<Shared>>,
    /// Rung when a part is whole, when something is wrong, and where somebody waits for tiles at each parcel.
    bell: Arc<OwnedFd>,
    /// Tiles that were put in place, in that order.
    arrivals: Arc<Mutex<Vec<Arrived>>>,
}

/// A tile that was put in place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arrived {
    pub(crate) node: u16,
    pub(crate) frame: u32,
    pub(crate) tile: TileId,
}

/// What a display and the supervisor both look at.
#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    /// Notified when a node has gone.
    gone: Condvar,
}

#[derive(Debug)]
struct State {
    part: Part,
    /// For each node whether all that it had sent is taken, and no more will come.
    is_gone: Vec<bool>,
    /// What a node sent that cannot be.
    wrong: Option<String>,
}

/// A frame put together by all displays.
#[derive(Debug)]
pub(crate) struct Gathered {
    pub(crate) picture: Picture,
    pub(crate) counts: Drawn,
    pub(crate) traffic: Traffic,
}

/// A display's own thread.
struct Display {
    shared: Arc<Shared>,
    bell: Arc<OwnedFd>,
    arrivals: Arc<Mutex<Vec<Arrived>>>,
    /// The link to each node and what was taken from it; `None` once it is gone.
    nodes: Vec<Option<(Link, Meter)>>,
    rings_always: bool,
    buffer: Vec<u8>,
}

/// A display looks up this often though nothing comes, so as to end with the supervisor.
const LOOK_MS: u32 = 500;

impl Displays {
    /// Starts so many displays for `nodes` nodes. Gives back with them the ends for each node, in the order of the
    /// displays. Where somebody waits for tiles, the bell rings at each parcel.
    pub(crate) fn start(
        displays: u16,
        nodes: usize,
        rings_always: bool,
    ) -> Result<(Self, Vec<Vec<OwnedFd>>)> {
        let bell = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK);
        let bell = Arc::new(bell.context("cannot get a bell for the displays")?);
        let mut ends: Vec<Vec<OwnedFd>> = (0..nodes).map(|_| Vec::new()).collect();
        let (mut shared, arrivals) = (Vec::new(), Arc::default());
        for number in 0..usize::from(displays) {
            let mut links = Vec::new();
            for ends in &mut ends {
                let (ours, theirs) = Link::pair().context("cannot get a socket for a display")?;
                links.push(Some((ours, Meter::default())));
                ends.push(theirs.into_socket());
            }
            let part = Part::new(number, displays.into());
            let state = Mutex::new(State { part, is_gone: vec![false; nodes], wrong: None });
            let one = Arc::new(Shared { state, gone: Condvar::new() });
            let display = Display {
                shared: one.clone(),
                bell: bell.clone(),
                arrivals: Arc::clone(&arrivals),
                nodes: links,
                rings_always,
                buffer: vec![0; PARCEL_BYTES_MAX + 1],
            };
            thread::Builder::new().name(format!("display {number}")).spawn(move || display.run())?;
            shared.push(one);
        }
        Ok((Self { shared, bell, arrivals }, ends))
    }

    /// Readable when there may be something new.
    pub(crate) fn bell(&self) -> BorrowedFd<'_> {
        self.bell.as_fd()
    }

    /// Silences the bell, and tells what a node sent that cannot be.
    pub(crate) fn listen(&self) -> Result<()> {
        // Nothing to read: it has not rung.
        let _ = rustix::io::read(&self.bell, &mut [0; 8]);
        match self.states().find_map(|mut state| state.wrong.take()) {
            Some(wrong) => Err(anyhow!(wrong)),
            None => Ok(()),
        }
    }

    /// A frame begins. Nobody may draw it before.
    pub(crate) fn begin(&self, frame: &Frame) {
        self.states().for_each(|mut state| state.part.begin(frame));
    }

    /// The tiles that were put in place since this was last asked.
    pub(crate) fn arrivals(&self) -> Vec<Arrived> {
        core::mem::take(&mut self.arrivals.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Tiles that are in place.
    pub(crate) fn present(&self) -> usize {
        self.states().map(|state| state.part.present()).sum()
    }

    /// The whole frame.
    pub(crate) fn gather(&self, size: PictureSize) -> Gathered {
        let mut picture = Picture::new(size);
        let (mut counts, mut traffic) = (Drawn::default(), Traffic::default());
        for state in self.states() {
            let start = Instant::now();
            state.part.copy_to(&mut picture);
            counts = Drawn { frame: state.part.counts.frame, ..counts };
            counts.merge(&state.part.counts);
            let Traffic { parcels, bytes, changed_tiles, busy_ns } = state.part.traffic;
            traffic.parcels += parcels;
            traffic.bytes += bytes;
            traffic.changed_tiles += changed_tiles;
            traffic.busy_ns += busy_ns + ns_since(start);
        }
        Gathered { picture, counts, traffic }
    }

    /// Waits until all that a dead node had sent is taken: then each of its tiles is there or will never be.
    pub(crate) fn see_gone(&self, node: usize, deadline: Duration) -> Result<()> {
        for shared in &self.shared {
            let is_here = |state: &mut State| state.is_gone.get(node) == Some(&false);
            let state = shared.state();
            let waited = shared.gone.wait_timeout_while(state, deadline, is_here);
            if waited.unwrap_or_else(PoisonError::into_inner).1.timed_out() {
                bail!("node {node} is dead, and somebody holds its link to a display");
            }
        }
        Ok(())
    }

    fn states(&self) -> impl Iterator<Item = MutexGuard<'_, State>> {
        self.shared.iter().map(|shared| shared.state())
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Display {
    /// Takes parcels until all nodes are gone, or the supervisor has dropped its displays.
    fn run(mut self) {
        while self.nodes.iter().any(Option::is_some) && Arc::strong_count(&self.shared) > 1 {
            let open = self.nodes.iter().enumerate().filter(|(_, node)| node.is_some());
            let open: Vec<usize> = open.map(|(index, _)| index).collect();
            let links = self.nodes.iter().flatten().map(|(link, _)| link.as_fd());
            let links: Vec<BorrowedFd<'_>> = links.collect();
            // Poll fails when memory is short; then it is tried again.
            let ready = wait_for_any(&links, LOOK_MS).unwrap_or_default();
            for ready in ready {
                self.take(open[ready]);
            }
        }
    }

    /// Takes one parcel of a node that has sent one, or is gone.
    fn take(&mut self, node: usize) {
        let start = Instant::now();
        let Some((link, meter)) = &mut self.nodes[node] else { return };
        let mut state = self.shared.state();
        let taken = match link.receive_into(&mut self.buffer) {
            Ok(Some(length)) if length > PARCEL_BYTES_MAX => Err(anyhow!("a parcel larger than parcels are")),
            Ok(Some(length)) => state.part.take(&self.buffer[..length]).map(|tiles| {
                note(&self.arrivals, node, state.part.counts.frame, &tiles);
                length
            }),
            Ok(None) | Err(_) => {
                self.nodes[node] = None;
                state.is_gone[node] = true;
                self.shared.gone.notify_all();
                return;
            }
        };
        match taken {
            Ok(length) => {
                // A node that is gone needs no credit; that it is gone is seen at the next look.
                let _ = meter.take(length).map(|taken| link.send(&taken.to_le_bytes()));
            }
            Err(error) => state.wrong = Some(format!("node {node} sent {error:#}")),
        }
        state.part.traffic.busy_ns += ns_since(start);
        if self.rings_always || state.part.is_whole() || state.wrong.is_some() {
            // It fails when it has rung 2^64 times unheard.
            let _ = rustix::io::write(&self.bell, &1_u64.to_ne_bytes());
        }
    }
}

/// Writes down that these tiles of a node are in place.
fn note(arrivals: &Mutex<Vec<Arrived>>, node: usize, frame: u32, tiles: &[TileId]) {
    // There are fewer nodes than 2^16.
    let node = u16::try_from(node).unwrap_or(u16::MAX);
    let arrived = tiles.iter().map(|tile| Arrived { node, frame, tile: *tile });
    arrivals.lock().unwrap_or_else(PoisonError::into_inner).extend(arrived);
}

fn ns_since(start: Instant) -> u64 {
    u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX)
}
