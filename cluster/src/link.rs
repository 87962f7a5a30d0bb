//! The socket between the supervisor and one process: packets, and with some of them open files.
//!
//! A pair of sequenced-packet sockets, one end of which is the process's standard input. Packets arrive whole and in
//! order; the end of either process is the end of the link, which the other sees at once. It has no name anywhere.

use core::mem::MaybeUninit;
use std::io::{self, IoSlice, IoSliceMut};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, ReturnFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, SocketFlags, SocketType, recv, recvmsg, sendmsg, socketpair,
};

/// One end of the socket. Several threads may send; packets do not mix.
#[derive(Debug)]
pub(crate) struct Link {
    socket: OwnedFd,
}

/// What was received.
#[derive(Debug)]
pub(crate) struct Packet {
    pub(crate) bytes: Vec<u8>,
    pub(crate) files: Vec<OwnedFd>,
}

/// Bytes of the largest packet. Well below what a socket holds by default.
pub(crate) const PACKET_BYTES_MAX: usize = 64 << 10;

/// Files that one packet can carry.
pub(crate) const FILES_MAX: usize = 250;

impl Link {
    /// Two ends of one link.
    pub(crate) fn pair() -> io::Result<(Self, Self)> {
        let (one, other) =
            socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?;
        Ok((Self { socket: one }, Self { socket: other }))
    }

    /// An end that was inherited.
    pub(crate) const fn from_socket(socket: OwnedFd) -> Self {
        Self { socket }
    }

    pub(crate) fn into_socket(self) -> OwnedFd {
        self.socket
    }

    /// Sends a packet; waits while the other end is slow.
    pub(crate) fn send(&self, bytes: &[u8]) -> io::Result<()> {
        self.send_with(bytes, &[])
    }

    /// Sends a packet, unless the other end is so slow that there is no room for it.
    pub(crate) fn send_or_drop(&self, bytes: &[u8]) -> io::Result<()> {
        rustix::net::send(&self.socket, bytes, SendFlags::NOSIGNAL | SendFlags::DONTWAIT)?;
        Ok(())
    }

    /// Sends a packet and duplicates of `files`.
    pub(crate) fn send_with(&self, bytes: &[u8], files: &[BorrowedFd<'_>]) -> io::Result<()> {
        if bytes.len() > PACKET_BYTES_MAX || files.len() > FILES_MAX {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let mut space = vec![MaybeUninit::uninit(); SendAncillaryMessage::ScmRights(files).size()];
        let mut ancillary = SendAncillaryBuffer::new(&mut space);
        if !files.is_empty() && !ancillary.push(SendAncillaryMessage::ScmRights(files)) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let sent = sendmsg(&self.socket, &[IoSlice::new(bytes)], &mut ancillary, SendFlags::NOSIGNAL)?;
        if sent == bytes.len() { Ok(()) } else { Err(io::ErrorKind::WriteZero.into()) }
    }

    /// Receives the next packet into `buffer` and gives back its length; `None` when the other end is gone. What does not
    /// fit is lost, and so are files.
    ///
    /// A reset is treated as in [`receive`](Self::receive).
    pub(crate) fn receive_into(&self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let received = match recv(&self.socket, &mut *buffer, RecvFlags::empty()) {
            Err(Errno::CONNRESET) => recv(&self.socket, buffer, RecvFlags::empty()),
            received => received,
        };
        match received {
            Err(Errno::CONNRESET) | Ok((0, _)) => Ok(None),
            Ok((length, _)) => Ok(Some(length)),
            Err(error) => Err(error.into()),
        }
    }

    /// Receives the next packet; `None` when the other end is gone.
    ///
    /// Who ends with packets unread resets the link. The system tells that once, and before what it had sent.
    pub(crate) fn receive(&self) -> io::Result<Option<Packet>> {
        let is_reset = |error: &io::Error| error.kind() == io::ErrorKind::ConnectionReset;
        match self.receive_once() {
            Err(error) if is_reset(&error) => match self.receive_once() {
                Err(error) if is_reset(&error) => Ok(None),
                next => next,
            },
            packet => packet,
        }
    }

    fn receive_once(&self) -> io::Result<Option<Packet>> {
        let mut bytes = vec![0; PACKET_BYTES_MAX];
        let mut space = vec![MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(FILES_MAX))];
        let mut ancillary = RecvAncillaryBuffer::new(&mut space);
        let flags = RecvFlags::CMSG_CLOEXEC;
        let received = recvmsg(&self.socket, &mut [IoSliceMut::new(&mut bytes)], &mut ancillary, flags)?;
        if received.flags.intersects(ReturnFlags::TRUNC | ReturnFlags::CTRUNC) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a packet larger than packets are"));
        }
        let mut files = Vec::new();
        for message in ancillary.drain() {
            if let RecvAncillaryMessage::ScmRights(rights) = message {
                files.extend(rights);
            }
        }
        bytes.truncate(received.bytes);
        // No packet is empty, so an empty one is the end.
        Ok((received.bytes > 0).then_some(Packet { bytes, files }))
    }
}

impl AsFd for Link {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// Waits until one of `files` has something to receive, or its other end is gone; at most `timeout_ms`. Returns which.
pub(crate) fn wait_for_any(files: &[BorrowedFd<'_>], timeout_ms: u32) -> io::Result<Vec<usize>> {
    let mut polled: Vec<PollFd<'_>> =
        files.iter().map(|file| PollFd::from_borrowed_fd(*file, PollFlags::IN)).collect();
    let timeout =
        Timespec { tv_sec: i64::from(timeout_ms / 1000), tv_nsec: i64::from(timeout_ms % 1000) * 1_000_000 };
    match poll(&mut polled, Some(&timeout)) {
        Ok(_) | Err(Errno::INTR) => {}
        Err(error) => return Err(error.into()),
    }
    let ready = |(index, polled): (usize, &PollFd<'_>)| (!polled.revents().is_empty()).then_some(index);
    Ok(polled.iter().enumerate().filter_map(ready).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn packets_arrive_whole_in_order_and_with_their_files() {
        let (one, other) = Link::pair().unwrap();
        let (mut reader, writer) = io::pipe().unwrap();
        one.send(b"first").unwrap();
        one.send_with(b"second", &[writer.as_fd()]).unwrap();
        drop(writer);
        assert_eq!(wait_for_any(&[other.as_fd()], 1000).unwrap(), [0]);
        assert_eq!(other.receive().unwrap().unwrap().bytes, b"first");
        let second = other.receive().unwrap().unwrap();
        assert_eq!((&second.bytes[..], second.files.len()), (&b"second"[..], 1));
        rustix::io::write(&second.files[0], b"through").unwrap();
        drop(second);
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!(text, "through");
    }

    #[test]
    fn what_was_sent_before_the_end_is_received_though_packets_were_left_unread() {
        let (one, other) = Link::pair().unwrap();
        other.send(b"unread").unwrap();
        one.send(b"last words").unwrap();
        drop(one);
        let mut buffer = [0; 64];
        assert_eq!(other.receive_into(&mut buffer).unwrap(), Some(10));
        assert_eq!(&buffer[..10], b"last words");
        assert_eq!(other.receive_into(&mut buffer).unwrap(), None);
    }

    #[test]
    fn the_end_of_one_side_is_seen_by_the_other() {
        let (one, other) = Link::pair().unwrap();
        drop(one);
        assert_eq!(wait_for_any(&[other.as_fd()], 1000).unwrap(), [0]);
        assert!(other.receive().unwrap().is_none());
        assert_eq!(other.send(b"x").unwrap_err().kind(), io::ErrorKind::BrokenPipe);
    }

    #[test]
    fn what_is_too_large_is_refused_before_it_is_sent() {
        let (one, _other) = Link::pair().unwrap();
        one.send(&vec![1; PACKET_BYTES_MAX]).unwrap();
        assert!(one.send(&vec![1; PACKET_BYTES_MAX + 1]).is_err());
    }
}
