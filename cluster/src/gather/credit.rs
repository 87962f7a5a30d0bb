//! Credit: how many bytes a node may have under way to a display.
//!
//! A display is never flooded: of each node at most [`WINDOW_BYTES`] wait for it or are on their way, whatever it is busy
//! with. Both sides count all bytes since the beginning, so credit is never lost and never counted twice.

use anyhow::{Result, bail};

/// Bytes that a node may have under way to one display.
pub(crate) const WINDOW_BYTES: u64 = 128 << 10;

/// Bytes after which a display gives credit again: four such messages at most wait to be read by a node, which so never
/// keeps a display from sending one.
const STEP_BYTES: u64 = WINDOW_BYTES / 4;

/// A node's side.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Window {
    sent: u64,
    taken: u64,
}

/// A display's side, for one node.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Meter {
    taken: u64,
    told: u64,
}

impl Window {
    /// Whether so many bytes more may be sent now.
    pub(crate) const fn has_room(&self, bytes: usize) -> bool {
        self.sent + bytes as u64 - self.taken <= WINDOW_BYTES
    }

    pub(crate) const fn send(&mut self, bytes: usize) {
        self.sent += bytes as u64;
    }

    /// The display says that it has taken so many bytes since the beginning.
    pub(crate) fn credit(&mut self, taken: u64) -> Result<()> {
        if !(self.taken..=self.sent).contains(&taken) {
            bail!("a display took {taken} bytes of {} after {}", self.sent, self.taken);
        }
        self.taken = taken;
        Ok(())
    }
}

impl Meter {
    /// A packet of so many bytes was taken. Gives back what to tell the node, if it is time.
    pub(crate) const fn take(&mut self, bytes: usize) -> Option<u64> {
        self.taken += bytes as u64;
        if self.taken - self.told < STEP_BYTES {
            return None;
        }
        self.told = self.taken;
        Some(self.taken)
    }
}

#[cfg(test)]
mod tests {
    use super::super::parcel::PARCEL_BYTES_MAX;
    use super::*;
    use std::collections::VecDeque;

    #[test]
    fn a_node_is_never_stuck_and_a_display_never_flooded() {
        for bytes in [1, 100, 20_000, PARCEL_BYTES_MAX] {
            let (mut window, mut meter) = (Window::default(), Meter::default());
            let (mut under_way, mut credits) = (VecDeque::new(), VecDeque::new());
            for _ in 0..20 {
                // The node sends all it may, reading credit only where it has to.
                while window.has_room(bytes) {
                    window.send(bytes);
                    under_way.push_back(bytes);
                }
                assert!(under_way.iter().sum::<usize>() as u64 <= WINDOW_BYTES);
                while let Some(bytes) = under_way.pop_front() {
                    credits.extend(meter.take(bytes));
                }
                assert!(!credits.is_empty() && credits.len() <= 4, "{bytes}: {}", credits.len());
                credits.drain(..).for_each(|taken| window.credit(taken).unwrap());
                assert!(window.has_room(bytes));
            }
        }
    }

    #[test]
    fn credit_for_what_was_not_sent_is_refused() {
        let mut window = Window::default();
        window.send(10);
        assert!(window.credit(11).is_err());
        window.credit(10).unwrap();
        assert!(window.credit(9).is_err());
    }
}
