//! Numbers that are mostly small, in as few bytes as they need: seven bits a byte, the lowest first, and the highest bit set in
//! all bytes but the last.

/// Adds a number to `bytes`.
pub(crate) fn put(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push((number & 0x7F) as u8 | 0x80);
        number >>= 7;
    }
    bytes.push((number & 0x7F) as u8);
}

/// Takes a number off `bytes`; `None` when they end before it does, or it has more than 64 bits.
pub(crate) fn take(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

/// Small numbers of either sign become small ones: 0, -1, 1, -2 .. are 0, 1, 2, 3 ..
pub(crate) const fn fold(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)).cast_unsigned()
}

/// What [`fold`] made a number of.
pub(crate) const fn unfold(number: u64) -> i64 {
    (number >> 1).cast_signed() ^ -(number & 1).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_either_sign_come_back() {
        for number in [0, -1, 1, 63, -64, 64, i64::from(u32::MAX), -i64::from(u32::MAX), i64::MAX, i64::MIN] {
            let mut bytes = Vec::new();
            put(&mut bytes, fold(number));
            let mut rest = &bytes[..];
            assert_eq!(take(&mut rest).map(unfold), Some(number));
            assert!(rest.is_empty());
        }
    }

    #[test]
    fn what_ends_too_early_or_never_is_no_number() {
        assert_eq!(
            (take(&mut &[][..]), take(&mut &[0x80][..]), take(&mut &[0xFF; 11][..])),
            (None, None, None)
        );
    }
}
