//! Files that a run writes: where they go, and whole or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

/// Writes a file under another name and renames it, so that nobody finds half of it.
pub(crate) fn write_whole<T>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<T>,
) -> Result<T> {
    let name = path.file_name().with_context(|| format!("{} names no file", path.display()))?;
    let mut partial = name.to_owned();
    partial.push(format!(".{}.partial", std::process::id()));
    let partial = path.with_file_name(partial);
    let written = write_partial(&partial, write).and_then(|value| {
        fs::rename(&partial, path)?;
        Ok(value)
    });
    if written.is_err() {
        let _ = fs::remove_file(&partial);
    }
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// Says before a long run what would keep a file from being written after it.
pub(crate) fn check_folder_of(path: &Path) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let found = fs::metadata(folder).with_context(|| format!("cannot write {}", path.display()))?;
    if !found.is_dir() || path.is_dir() {
        bail!("cannot write {}: it would have to be a file in a folder", path.display());
    }
    Ok(())
}

fn write_partial<T>(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> Result<T>) -> Result<T> {
    let opened = OpenOptions::new().read(true).write(true).create(true).truncate(true).open(path)?;
    let mut file = BufWriter::with_capacity(1 << 20, opened);
    let value = write(&mut file)?;
    file.flush()?;
    Ok(value)
}

/// Where pictures go: one file for the last frame, or a pattern like `out-%03d.png` for each.
#[derive(Clone, Debug)]
pub(crate) struct Destination {
    pattern: String,
    /// The pattern's parts before and after the number, and the number's width.
    number: Option<(String, usize, String)>,
}

impl Destination {
    /// Understands `%d` and `%03d`.
    pub(crate) fn parse(pattern: &str) -> Result<Self> {
        let number = match pattern.split_once('%') {
            None => None,
            Some((before, rest)) => {
                let Some((width, after)) = rest.split_once('d') else {
                    bail!("{pattern:?} has a % that no d follows; write frames as in out-%03d.png");
                };
                let width = if width.is_empty() { Ok(0) } else { width.parse() };
                let width = width.ok().filter(|width| *width <= 9);
                let width = width.with_context(|| format!("{pattern:?} has no number between % and d"))?;
                if after.contains('%') {
                    bail!("{pattern:?} has more than one %");
                }
                Some((before.to_owned(), width, after.to_owned()))
            }
        };
        Ok(Self { pattern: pattern.to_owned(), number })
    }

    /// Where frame `frame` of `frames` goes, if it is written.
    pub(crate) fn path(&self, frame: u32, frames: u32) -> Option<PathBuf> {
        match &self.number {
            Some((before, width, after)) => Some(format!("{before}{frame:0width$}{after}").into()),
            None => (frame + 1 == frames).then(|| self.pattern.clone().into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn destinations_number_frames_or_keep_the_last() {
        let path = |pattern: &str, frame| Destination::parse(pattern).unwrap().path(frame, 3);
        assert_eq!(path("out.png", 1), None);
        assert_eq!(path("out.png", 2), Some("out.png".into()));
        assert_eq!(path("out-%03d.png", 1), Some("out-001.png".into()));
        assert_eq!(path("%d.png", 2), Some("2.png".into()));
        for pattern in ["a%.png", "a%xd.png", "%d%d.png", "%99d"] {
            assert!(Destination::parse(pattern).is_err(), "{pattern}");
        }
    }
}
