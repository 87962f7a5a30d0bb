//! Processes that own pages: this program, started as its own child.
//!
//! An owner opens the memory files of the reader through `/proc`, fills its pages and says so. It ends when it is
//! told to, and also when its parent is gone: then its standard input ends.

pub(crate) mod datagram;
mod serve;

use core::net::{Ipv4Addr, SocketAddr};
use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::net::UdpSocket;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use transport_shm::{ChannelId, Inbox, Layout, PageFile, RingPort};

use crate::machine;
use crate::space::{OWNER, PAGE_BYTES, Space};

/// An owner whose pages are read straight out of its memory, or asked for over rings.
#[derive(Debug)]
pub(crate) struct ShmOwner {
    _process: Process,
    pages: Arc<PageFile>,
    inbox: Inbox,
    layout: Layout,
}

/// An owner that answers datagrams.
#[derive(Debug)]
pub(crate) struct UdpOwner {
    _process: Process,
    address: SocketAddr,
}

/// A child process, ended on drop.
#[derive(Debug)]
struct Process {
    child: Child,
    /// What it said when it was ready.
    said: String,
}

/// The hidden subcommand under which an owner is started.
const OWNER_COMMAND: &str = "owner";

/// What an owner says first when it is ready.
const READY: &str = "ready ";

/// Runs an owner if that is what this process was started as.
pub(crate) fn run_as_owner_if_asked() -> Option<ExitCode> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (command, arguments) = arguments.split_first()?;
    if command != OWNER_COMMAND {
        return None;
    }
    match serve::run(arguments) {
        Ok(()) => Some(ExitCode::SUCCESS),
        Err(error) => {
            eprintln!("owner: {error:#}");
            Some(ExitCode::FAILURE)
        }
    }
}

impl ShmOwner {
    /// Starts an owner of all pages of `space`, with as many channels to ask over.
    pub(crate) fn start(space: Space, channels: u16) -> Result<Self> {
        let pages = PageFile::create(space.bytes() as u64)?;
        let layout = Layout::new(PAGE_BYTES, channels)?;
        let inbox = Inbox::create(layout)?;
        let arguments = [
            "shm".to_owned(),
            space.pages.to_string(),
            path_of(pages.as_fd()),
            path_of(inbox.as_fd()),
            channels.to_string(),
        ];
        let process = Process::start(&arguments)?;
        Ok(Self { _process: process, pages: Arc::new(pages), inbox, layout })
    }

    /// The memory file that holds the pages.
    pub(crate) const fn pages(&self) -> &Arc<PageFile> {
        &self.pages
    }

    /// A way to the owner over a channel that nobody else uses.
    pub(crate) fn ring_port(&self, channel: u16) -> Result<RingPort> {
        let mut port = RingPort::new(spin_us());
        port.connect(OWNER, &self.inbox, self.layout, ChannelId(channel))?;
        Ok(port)
    }
}

impl UdpOwner {
    /// Starts an owner of all pages of `space`.
    pub(crate) fn start(space: Space) -> Result<Self> {
        let process = Process::start(&["udp".to_owned(), space.pages.to_string()])?;
        let address = process.said.parse().context("the owner's address")?;
        Ok(Self { _process: process, address })
    }

    /// A socket that speaks with the owner alone.
    pub(crate) fn socket(&self) -> io::Result<UdpSocket> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.connect(self.address)?;
        Ok(socket)
    }
}

impl Process {
    fn start(arguments: &[String]) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg(OWNER_COMMAND).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        let child = command.spawn().context("cannot start an owner")?;
        let mut process = Self { child, said: String::new() };
        let mut line = String::new();
        let output = process.child.stdout.take().context("the owner's output")?;
        BufReader::new(output).read_line(&mut line)?;
        match line.strip_prefix(READY) {
            Some(said) => said.trim().clone_into(&mut process.said),
            None => bail!("the owner did not get ready"),
        }
        Ok(process)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nobody to end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// How long both ends of a ring look before they sleep: not at all where they share a core.
fn spin_us() -> u64 {
    if machine::cores() > 1 { 100 } else { 0 }
}

/// Where another process of this user finds a file that this one holds open.
fn path_of(file: BorrowedFd<'_>) -> String {
    format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd())
}

fn open(path: &str) -> Result<File> {
    File::options().read(true).write(true).open(path).with_context(|| format!("cannot open {path}"))
}
