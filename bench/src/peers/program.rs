//! Compiling `peers/embree.cpp` against the Embrees that are here.

use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use super::folder::Folder;
use super::level::Level;
use crate::experiment::Effort;

/// The programs that could be compiled, one for each Embree.
#[derive(Debug)]
pub(crate) struct Programs {
    programs: Vec<PathBuf>,
    /// What is not here, and how it is installed.
    pub(crate) notes: Vec<String>,
}

const SOURCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/peers/embree.cpp");

/// Vectorised as well as the compiler can; not-a-number must stay what it is.
const FLAGS: [&str; 8] = [
    "-std=c++17",
    "-O3",
    "-march=native",
    "-mprefer-vector-width=512",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-Wall",
    "-Wextra",
];

/// What the compiler says when Embree 3 is not installed, in the language that it is asked to speak.
const NO_EMBREE_3: &str = "embree3/rtcore.h: No such file";

const INSTALL_3: &str = "apt-get install g++ libembree-dev";
const INSTALL_4: &str =
    "pip install --target embree4 embreex && export EMBREE4_LIB=$(ls embree4/embreex.libs/libembree4*)";

impl Programs {
    /// Compiles what can be compiled.
    ///
    /// # Errors
    /// When our program does not compile although all it needs is here.
    pub(crate) fn compile(folder: &Folder, effort: Effort) -> Result<Self> {
        let mut these = Self { programs: Vec::new(), notes: Vec::new() };
        let compiled =
            compile(&folder.path("embree3"), &["-DEMBREE=3".into(), SOURCE.into(), "-lembree3".into()])?;
        these.add(compiled, "Embree 3", INSTALL_3);
        let compiled = match std::env::var_os("EMBREE4_LIB") {
            Some(library) => compile(&folder.path("embree4"), &arguments_4(Path::new(&library))?)?,
            None => None,
        };
        these.add(compiled, "Embree 4", INSTALL_4);
        these.notes.iter().for_each(|note| effort.say(note));
        Ok(these)
    }

    fn add(&mut self, compiled: Option<PathBuf>, name: &str, install: &str) {
        match compiled {
            Some(program) => self.programs.push(program),
            None => self.notes.push(format!("{name} is not here and not measured; to install it: {install}")),
        }
    }

    /// Every program at every level.
    pub(crate) fn at_levels(&self, levels: &[Level]) -> impl Iterator<Item = (Level, &Path)> {
        levels.iter().flat_map(|&level| self.programs.iter().map(move |program| (level, program.as_path())))
    }
}

/// Embree 4 is linked by the name of its file; wheels give it odd ones.
fn arguments_4(library: &Path) -> Result<[OsString; 5]> {
    let library = library.canonicalize().with_context(|| format!("EMBREE4_LIB is {}", library.display()))?;
    let folder = library.parent().context("EMBREE4_LIB names no file")?;
    let mut search = OsString::from("-Wl,-rpath,");
    search.push(folder);
    let unresolved = "-Wl,--allow-shlib-undefined".into();
    Ok(["-DEMBREE=4".into(), SOURCE.into(), library.into(), search, unresolved])
}

/// Runs the compiler; `None` when it is not installed, or Embree 3 is not.
fn compile(program: &Path, arguments: &[OsString]) -> Result<Option<PathBuf>> {
    let mut compiler = Command::new("g++");
    compiler.args(FLAGS).args(arguments).arg("-o").arg(program).env("LC_ALL", "C");
    let output = match compiler.output() {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        output => output.context("cannot run g++")?,
    };
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains(NO_EMBREE_3) {
        return Ok(None);
    }
    if !output.status.success() {
        bail!("{compiler:?} failed:\n{said}");
    }
    ensure!(said.is_empty(), "{compiler:?} warns:\n{said}");
    Ok(Some(program.to_owned()))
}
