//! What stands beside every figure: processor, cores, kernel, commit.

use core::fmt;
use std::fs;
use std::process::Command;
use std::thread::available_parallelism;

use serde::Serialize;

/// The machine that an experiment ran on.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Machine {
    processor: String,
    cores: usize,
    kernel: String,
    /// The system's setting for transparent huge pages.
    huge_pages: String,
}

impl Machine {
    pub(crate) fn this() -> Self {
        Self {
            processor: field("/proc/cpuinfo", "model name").unwrap_or_else(unknown),
            cores: cores(),
            kernel: line("/proc/sys/kernel/osrelease").unwrap_or_else(unknown),
            huge_pages: line("/sys/kernel/mm/transparent_hugepage/enabled").unwrap_or_else(unknown),
        }
    }
}

/// Cores that this process may use.
pub(crate) fn cores() -> usize {
    available_parallelism().map_or(1, core::num::NonZero::get)
}

/// The commit that is checked out where the command runs, or "unknown".
pub(crate) fn commit() -> String {
    let output = Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output();
    let commit = output.ok().filter(|output| output.status.success());
    let text = commit.and_then(|output| String::from_utf8(output.stdout).ok());
    text.map_or_else(unknown, |text| text.trim().to_owned())
}

fn line(path: &str) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.lines().next()?.trim().to_owned())
}

fn field(path: &str, name: &str) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let (_, value) = text.lines().find(|line| line.starts_with(name))?.split_once(':')?;
    Some(value.trim().to_owned())
}

fn unknown() -> String {
    "unknown".to_owned()
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { processor, cores, kernel, huge_pages } = self;
        write!(f, "{processor}, {cores} cores, Linux {kernel}, huge pages: {huge_pages}")
    }
}
