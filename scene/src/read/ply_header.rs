//! Brings PLY headers of all dialects into one form.

use std::collections::HashSet;
use std::io::BufRead;

use super::{ReadError, Trouble};

/// A PLY header in the form that every reader takes: one space between words, lines ended by LF, no comments.
pub(super) struct CleanHeader {
    pub(super) text: String,
}

/// Reads a header up to the first byte of the body.
///
/// Lines may end in LF, CR LF or CR. The end of the last is ambiguous: in `end_header CR LF` the LF may be
/// the first byte of binary data. It is when all other lines end in CR alone.
pub(super) fn read(reader: &mut impl BufRead) -> Result<CleanHeader, ReadError> {
    let mut scan = Scan { reader, line: Vec::new(), lines: 0, bytes: 0, only_cr: true };
    let mut text = String::new();
    let mut names = Names::default();
    loop {
        let end = scan.next_line()?;
        let line = String::from_utf8_lossy(&scan.line).into_owned();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if scan.lines == 1 && words != ["ply"] {
            return Err(ReadError::at_line(1, Trouble::HeaderLine(shortened(&line))));
        }
        if words == ["end_header"] {
            if end == LineEnd::Cr && !scan.only_cr {
                scan.skip_lf()?;
            }
            text.push_str("end_header\n");
            return Ok(CleanHeader { text });
        }
        scan.finish_line(end)?;
        if !matches!(words.first(), None | Some(&("comment" | "obj_info"))) {
            names.check(&words).map_err(|trouble| ReadError::at_line(scan.lines, trouble))?;
            text.push_str(&words.join(" "));
            text.push('\n');
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum LineEnd {
    Lf,
    /// CR; whether LF follows has not been looked at.
    Cr,
}

struct Scan<'r, R> {
    reader: &'r mut R,
    line: Vec<u8>,
    lines: u64,
    bytes: usize,
    only_cr: bool,
}

impl<R: BufRead> Scan<'_, R> {
    /// Reads a line and the first byte of its end.
    fn next_line(&mut self) -> Result<LineEnd, ReadError> {
        self.line.clear();
        self.lines += 1;
        loop {
            let mut byte = [0];
            self.bytes += 1;
            if self.bytes > HEADER_BYTES_MAX || self.reader.read(&mut byte)? == 0 {
                return Err(ReadError::at_line(self.lines, Trouble::EndlessHeader));
            }
            match byte[0] {
                b'\n' => return Ok(LineEnd::Lf),
                b'\r' => return Ok(LineEnd::Cr),
                other => self.line.push(other),
            }
        }
    }

    /// Takes the LF of a CR LF, and notes how the line ended.
    fn finish_line(&mut self, end: LineEnd) -> Result<(), ReadError> {
        let has_lf = end == LineEnd::Lf || self.skip_lf()?;
        self.only_cr &= !has_lf;
        Ok(())
    }

    fn skip_lf(&mut self) -> Result<bool, ReadError> {
        let is_lf = self.reader.fill_buf()?.first() == Some(&b'\n');
        if is_lf {
            self.reader.consume(1);
        }
        Ok(is_lf)
    }
}

/// Names declared so far, to find what is declared twice; the layout of the body would be in doubt.
#[derive(Default)]
struct Names {
    format: bool,
    elements: HashSet<String>,
    properties: HashSet<String>,
}

impl Names {
    fn check(&mut self, words: &[&str]) -> Result<(), Trouble> {
        let is_new = match *words {
            ["format", ..] => !core::mem::replace(&mut self.format, true),
            ["element", name, ..] => {
                self.properties.clear();
                self.elements.insert(name.to_owned())
            }
            ["property", .., name] => self.properties.insert(name.to_owned()),
            _ => true,
        };
        if is_new { Ok(()) } else { Err(Trouble::Twice(shortened(&words.join(" ")))) }
    }
}

/// The beginning of a line, for a message.
pub(super) fn shortened(line: &str) -> String {
    line.chars().take(60).collect()
}

/// Longest header that is read; ours have under 1 KB.
const HEADER_BYTES_MAX: usize = 1 << 20;
