//! A table: printed in columns, and written as rows of JSON, from one description.

use core::fmt;

use serde_json::{Map, Value, json};

use crate::spread::Spread;

/// A table of one experiment.
#[derive(Debug)]
pub(crate) struct Table {
    /// Names its rows in the JSON.
    name: &'static str,
    title: String,
    heads: Vec<&'static str>,
    rows: Vec<Vec<Cell>>,
    /// What a reader must know to read it, a line each.
    notes: Vec<String>,
}

/// One entry of a table.
#[derive(Clone, Debug)]
pub(crate) enum Cell {
    /// Words.
    Text(String),
    /// A count.
    Count(u64),
    /// A number, shown with so many digits after the point.
    Number(f64, usize),
    /// A median with its quarters, shown with so many digits after the point.
    Spread(Spread, usize),
}

impl Table {
    pub(crate) fn new(name: &'static str, title: impl Into<String>, heads: &[&'static str]) -> Self {
        let (title, heads) = (title.into(), heads.to_vec());
        Self { name, title, heads, rows: Vec::new(), notes: Vec::new() }
    }

    /// Adds a row with a cell for each head.
    pub(crate) fn push(&mut self, row: Vec<Cell>) {
        assert_eq!(row.len(), self.heads.len(), "a cell for each head of {}", self.name);
        self.rows.push(row);
    }

    pub(crate) fn note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    /// Whether there are no rows.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The rows, each an object whose keys are made of the heads.
    pub(crate) fn to_json(&self) -> Vec<Map<String, Value>> {
        let row = |cells: &Vec<Cell>| {
            let table = ("table".to_owned(), Value::from(self.name));
            let cells = self.heads.iter().zip(cells).map(|(head, cell)| (key(head), cell.to_json()));
            core::iter::once(table).chain(cells).collect()
        };
        self.rows.iter().map(row).collect()
    }
}

impl Cell {
    pub(crate) fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    fn to_json(&self) -> Value {
        match self {
            Self::Text(text) => json!(text),
            Self::Count(count) => json!(count),
            Self::Number(value, _) => json!(value),
            Self::Spread(Spread { median, low, high }, _) => {
                json!({ "median": median, "low": low, "high": high })
            }
        }
    }
}

/// A head as a key: `p50 us` becomes `p50_us`.
fn key(head: &str) -> String {
    let head = head.replace('%', "percent").replace('/', " per ");
    let words = head.split(|letter: char| !letter.is_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_")
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let heads = self.heads.iter().map(ToString::to_string).collect();
        let rows = self.rows.iter().map(|row| row.iter().map(ToString::to_string).collect());
        let lines: Vec<Vec<String>> = core::iter::once(heads).chain(rows).collect();
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.heads.len()).map(width).collect();
        writeln!(f, "{}", self.title)?;
        for line in &lines {
            let mut text = format!("  {:<1$}", line[0], widths[0]);
            for (cell, width) in line.iter().zip(&widths).skip(1) {
                text += &format!("  {cell:>width$}");
            }
            writeln!(f, "{}", text.trim_end())?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "  * {note}"))
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Count(count) => write!(f, "{count}"),
            Self::Number(value, digits) => write!(f, "{value:.digits$}"),
            Self::Spread(Spread { median, low, high }, digits) => {
                write!(f, "{median:.digits$} ({low:.digits$}-{high:.digits$})")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_become_keys() {
        assert_eq!(
            ["p50 us", "misses/s", "16 % memory"].map(key),
            ["p50_us", "misses_per_s", "16_percent_memory"]
        );
    }

    #[test]
    fn columns_are_as_wide_as_they_need_to_be() {
        let mut table = Table::new("t", "Title", &["what", "n"]);
        table.push(vec![Cell::text("a"), Cell::Number(1.25, 1)]);
        table.push(vec![Cell::text("longer"), Cell::Count(7)]);
        table.note("a note");
        assert_eq!(table.to_string(), "Title\n  what      n\n  a       1.2\n  longer    7\n  * a note\n");
        assert_eq!(table.to_json()[0]["n"], 1.25);
    }
}
