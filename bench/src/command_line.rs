//! Names and flags.

use core::fmt::Write as _;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Parser;

use crate::experiment::{ALL, Effort, Experiment};
use crate::findings::Record;

/// Runs an experiment: prints its tables, writes DIR/NAME.json and, where one helps, DIR/NAME.svg.
///
/// Without a name, lists the experiments.
#[derive(Debug, Parser)]
#[command(
    name = "bench",
    version,
    after_help = "\
Examples:
  cargo run --release -p bench
  cargo run --release -p bench -- table1
  cargo run --release -p bench -- scaling --out results
  MEMSAVVY_DATA=data cargo run --release -p bench -- scaling
  cargo run --release -p bench -- all --quick

With MEMSAVVY_DATA naming a folder that holds meshes/bunny.ply and meshes/dragon.ply, experiments use these too."
)]
struct CommandLine {
    /// The experiment, or `all`
    name: Option<String>,
    /// Where results go
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Do little work: goes through all of the code, and the figures mean nothing
    #[arg(long)]
    quick: bool,
}

/// Runs the command line of this process. What goes wrong is told in one line.
pub(crate) fn main() -> ExitCode {
    match CommandLine::parse().run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

impl CommandLine {
    fn run(self) -> Result<()> {
        let Some(name) = &self.name else {
            return print(&list());
        };
        let chosen: Vec<&Experiment> =
            ALL.iter().filter(|experiment| name == "all" || experiment.name == name).collect();
        if chosen.is_empty() {
            bail!("there is no experiment {name:?}\n{}", list());
        }
        fs::create_dir_all(&self.out).with_context(|| format!("cannot write to {}", self.out.display()))?;
        let effort = if self.quick { Effort::Quick } else { Effort::Full };
        for experiment in chosen {
            run(experiment, effort, &self.out).with_context(|| experiment.name)?;
        }
        Ok(())
    }
}

fn run(experiment: &Experiment, effort: Effort, out: &Path) -> Result<()> {
    effort.say(&format!("{}: {}", experiment.name, experiment.shows));
    let findings = (experiment.run)(effort)?;
    let file = |extension: &str| out.join(format!("{}.{extension}", experiment.name));
    if let Some(plot) = &findings.plot {
        plot.write(&file("svg"))?;
    }
    let record = Record::of(experiment, effort, &findings);
    let path = file("json");
    let json = serde_json::to_string_pretty(&record)?;
    fs::write(&path, json + "\n").with_context(|| format!("cannot write {}", path.display()))?;
    print(&format!("{findings}\nwritten: {}\n\n", path.display()))
}

/// Prints to standard output. That nobody reads it any more, as with `| head`, is no error.
fn print(text: &str) -> Result<()> {
    match io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

fn list() -> String {
    let mut text = String::from("experiments:\n");
    for experiment in ALL {
        let _ = writeln!(text, "  {:14} {}", experiment.name, experiment.shows);
    }
    text.push_str("run one with: bench NAME [--out DIR] [--quick]\n");
    text
}
