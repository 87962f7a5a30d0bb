//! The datagrams of the paper's reconstruction: a request, and a page in pieces that fit an Ethernet frame.

use crate::space::PAGE_BYTES;

/// What stands before every piece; alone, it is a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) page: u32,
    /// The reader's number for the request, so that a late piece is known as such.
    pub(crate) request: u32,
    /// Which piece.
    pub(crate) index: u32,
}

/// What one frame of Ethernet carries over UDP.
pub(crate) const BYTES_MAX: usize = 1472;
pub(crate) const HEADER_BYTES: usize = 12;
pub(crate) const PIECE_BYTES: usize = BYTES_MAX - HEADER_BYTES;

/// Datagrams that a page takes.
pub(crate) const PIECES: usize = (PAGE_BYTES as usize).div_ceil(PIECE_BYTES);

impl Header {
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        let word = |index: usize| Some(u32::from_le_bytes(*bytes.get(index * 4..)?.first_chunk()?));
        Some(Self { page: word(0)?, request: word(1)?, index: word(2)? })
    }

    pub(crate) fn emit(self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        for (place, word) in bytes.chunks_exact_mut(4).zip([self.page, self.request, self.index]) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }
}
