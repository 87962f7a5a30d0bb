//! A program that obeys lines: a child that is sent requests and answers each with a line of JSON.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result};
use serde::de::DeserializeOwned;

/// A running program.
#[derive(Debug)]
pub(crate) struct Obedient {
    /// Who it is, in errors.
    pub(crate) name: String,
    child: Child,
    /// `None` once the child was told to end.
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Obedient {
    /// Starts a program, and waits for nothing.
    pub(crate) fn start(name: &str, command: &mut Command) -> Result<Self> {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {name}"))?;
        let requests = child.stdin.take();
        let answers = BufReader::new(child.stdout.take().context("the program has no output")?);
        Ok(Self { name: name.to_owned(), child, requests, answers })
    }

    /// Sends a line, and reads what is answered.
    pub(crate) fn ask<T: DeserializeOwned>(&mut self, request: &str) -> Result<T> {
        let requests = self.requests.as_mut().context("the program was told to end")?;
        writeln!(requests, "{request}").with_context(|| format!("{} has ended", self.name))?;
        self.answer()
    }

    /// Reads a line.
    pub(crate) fn answer<T: DeserializeOwned>(&mut self) -> Result<T> {
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        serde_json::from_str(&line).with_context(|| format!("{} answers {line:?}", self.name))
    }

    /// Ends the program, and gives the status that it ends with.
    pub(crate) fn end(&mut self) -> Result<Option<i32>> {
        // The end of its input ends the program.
        self.requests = None;
        Ok(self.child.wait()?.code())
    }
}

impl Drop for Obedient {
    fn drop(&mut self) {
        // What it ends with does not matter any more.
        let _ = self.end();
    }
}
