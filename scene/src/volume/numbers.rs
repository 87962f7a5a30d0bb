//! Numbers in the text of headers.

use core::str::FromStr;

/// Three numbers with a separator between them.
pub(super) fn triple<T: FromStr>(text: &str, separator: char) -> Option<[T; 3]> {
    list(text.split(separator))?.try_into().ok()
}

/// The number of every word; `None` when a word is no number.
pub(super) fn list<'t, T: FromStr>(words: impl IntoIterator<Item = &'t str>) -> Option<Vec<T>> {
    words.into_iter().map(|word| word.trim().parse().ok()).collect()
}
