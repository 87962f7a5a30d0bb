//! All that happened in a run, folded into one number.

use core::hash::{Hash, Hasher};

use crate::chance::mix;

/// Folds events into a number that is the same exactly when all of them were, and in the same order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Trace(u64);

impl Trace {
    pub(crate) fn record(&mut self, event: &impl Hash) {
        event.hash(self);
    }

    fn fold(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(5) ^ word).wrapping_mul(0x517C_C1B7_2722_0A95);
    }
}

impl Hasher for Trace {
    fn write(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        words.iter().for_each(|word| self.fold(u64::from_le_bytes(*word)));
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.fold(u64::from_le_bytes(last));
    }

    fn write_u8(&mut self, word: u8) {
        self.fold(word.into());
    }

    fn write_u16(&mut self, word: u16) {
        self.fold(word.into());
    }

    fn write_u32(&mut self, word: u32) {
        self.fold(word.into());
    }

    fn write_u64(&mut self, word: u64) {
        self.fold(word);
    }

    fn write_usize(&mut self, word: usize) {
        self.fold(word as u64);
    }

    #[expect(clippy::cast_sign_loss, reason = "the bits are what counts; enums number their variants so")]
    fn write_isize(&mut self, word: isize) {
        self.fold(word as u64);
    }

    fn finish(&self) -> u64 {
        mix(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_and_content_count() {
        let trace = |events: &[(u64, u8)]| {
            let mut trace = Trace::default();
            events.iter().for_each(|event| trace.record(event));
            trace.finish()
        };
        assert_eq!(trace(&[(1, 2), (3, 4)]), trace(&[(1, 2), (3, 4)]));
        assert_ne!(trace(&[(1, 2), (3, 4)]), trace(&[(3, 4), (1, 2)]));
        assert_ne!(trace(&[(1, 2)]), trace(&[(1, 3)]));
        assert_ne!(trace(&[(1, 2)]), trace(&[]));
    }
}
