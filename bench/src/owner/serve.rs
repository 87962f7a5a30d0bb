//! What an owner does in its own process.

use core::net::Ipv4Addr;
use std::io::{self, Read, Write};
use std::net::UdpSocket;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::process;
use std::sync::Arc;
use std::thread;

use anyhow::{Context, Result, bail};
use transport_shm::{Inbox, Layout, PageFile, Server, now};

use super::{READY, datagram, open, spin_us};
use crate::space::{PAGE_BYTES, PAGE_WORDS, Space, word};

/// Runs an owner of the kind that the arguments name, until its parent lets go of it.
pub(super) fn run(arguments: &[String]) -> Result<()> {
    // Whatever the rest of this process is busy with, it does not outlive its parent.
    thread::spawn(|| {
        let _ = io::stdin().read(&mut [0]);
        process::exit(0);
    });
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["shm", pages, page_file, inbox, channels] => {
            serve_shm(Space { pages: pages.parse()? }, page_file, inbox, channels.parse()?)
        }
        ["udp", pages] => serve_udp(Space { pages: pages.parse()? }),
        _ => bail!("no such owner"),
    }
}

fn serve_shm(space: Space, page_file: &str, inbox: &str, channels: u16) -> Result<()> {
    const LOOK_US: u64 = 1_000_000;
    let pages = PageFile::from(OwnedFd::from(open(page_file)?));
    for page in 0..space.pages {
        pages.file().write_all_at(&bytes_of(page), u64::from(page) * u64::from(PAGE_BYTES))?;
    }
    pages.freeze().context("cannot freeze the pages")?;
    let layout = Layout::new(PAGE_BYTES, channels)?;
    let inbox = Inbox::open(OwnedFd::from(open(inbox)?), layout)?;
    let mut server = Server::new(space.home()?, Arc::new(pages), &inbox, layout, spin_us())?;
    say_ready("")?;
    loop {
        server.serve(now().after(LOOK_US));
    }
}

/// Answers each request with the page, cut into datagrams, each sent by itself as in 2004.
fn serve_udp(space: Space) -> Result<()> {
    let pages: Vec<Vec<u8>> = (0..space.pages).map(bytes_of).collect();
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    say_ready(&socket.local_addr()?.to_string())?;
    let mut message = [0; datagram::BYTES_MAX];
    loop {
        let (length, reader) = socket.recv_from(&mut message)?;
        let Some(request) = datagram::Header::parse(&message[..length]) else { continue };
        let Some(page) = pages.get(request.page as usize) else { continue };
        for (index, piece) in (0..).zip(page.chunks(datagram::PIECE_BYTES)) {
            let header = datagram::Header { index, ..request };
            message[..datagram::HEADER_BYTES].copy_from_slice(&header.emit());
            let end = datagram::HEADER_BYTES + piece.len();
            message[datagram::HEADER_BYTES..end].copy_from_slice(piece);
            socket.send_to(&message[..end], reader)?;
        }
    }
}

fn say_ready(what: &str) -> io::Result<()> {
    let mut output = io::stdout();
    writeln!(output, "{READY}{what}")?;
    output.flush()
}

fn bytes_of(page: u32) -> Vec<u8> {
    let first = page as usize * PAGE_WORDS;
    (first..first + PAGE_WORDS).flat_map(|index| word(index).to_le_bytes()).collect()
}
