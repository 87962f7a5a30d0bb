//! What whole-system tests share: starting the command, finding data, looking at processes.

use core::time::Duration;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Instant;

use memsavvy::report::RunReport;

/// The command under test. Built by cargo beside the test that is running.
#[must_use]
pub fn program() -> PathBuf {
    // A test runs in `target/PROFILE/deps`; programs are one folder up.
    let test = std::env::current_exe().expect("a test knows where it is");
    let folder = test.parent().and_then(Path::parent).expect("tests lie in target/PROFILE/deps");
    folder.join("memsavvy-under-test")
}

/// A file of the data folder that `MEMSAVVY_DATA` names, or `None`, having said so, when the variable is not set.
///
/// # Panics
/// When the variable is set and the file is not there.
#[must_use]
pub fn data(name: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("MEMSAVVY_DATA") else {
        eprintln!("skipped: MEMSAVVY_DATA does not name the data folder, so there is no {name}");
        return None;
    };
    let path = Path::new(&folder).join(name);
    assert!(path.exists(), "MEMSAVVY_DATA is set and there is no {}", path.display());
    Some(path)
}

/// An empty folder that is this test's alone, removed when dropped.
#[derive(Debug)]
pub struct Folder(PathBuf);

impl Folder {
    /// A fresh folder; `test` tells people whose it was.
    ///
    /// # Panics
    /// When the system gives none.
    #[must_use]
    pub fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("memsavvy-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    /// A file in it, as a command-line argument.
    #[must_use]
    pub fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().expect("temporary folders have plain names").to_owned()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Runs the command to its end.
///
/// # Panics
/// When it cannot be started.
pub fn run<S: AsRef<str>>(arguments: &[S]) -> Output {
    let arguments = arguments.iter().map(AsRef::as_ref);
    Command::new(program()).args(arguments).stdin(Stdio::null()).output().expect("the command starts")
}

/// Runs the command, which must end well.
///
/// # Panics
/// When it does not; shows what it said.
pub fn run_well<S: AsRef<str>>(arguments: &[S]) -> String {
    let output = run(arguments);
    let words: Vec<&str> = arguments.iter().map(AsRef::as_ref).collect();
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Runs `render` with these arguments and gives back its report.
///
/// # Panics
/// When it does not end well, or its report is not one.
#[must_use]
pub fn render<S: AsRef<str>>(folder: &Folder, arguments: &[S]) -> RunReport {
    let report = folder.file("run.json");
    let mut all = vec!["render"];
    all.extend(arguments.iter().map(AsRef::as_ref));
    all.extend(["--report", &report, "--quiet"]);
    run_well(&all);
    serde_json::from_slice(&fs::read(&report).expect("a report")).expect("a report that parses")
}

/// The one line in which a failed run says what went wrong.
///
/// # Panics
/// When it ended well, or said anything else.
#[must_use]
pub fn error_line(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{:?}: {said}", output.status);
    let lines: Vec<&str> = said.lines().collect();
    assert!(lines.len() == 1 && lines[0].starts_with("error: "), "not one clear line: {said}");
    lines[0].to_owned()
}

/// A run that is under way. Killed when dropped, and its processes with it.
#[derive(Debug)]
pub struct Running {
    child: Child,
}

impl Running {
    /// Starts the command and waits until `processes` processes of its cluster run, each with a thread of this name.
    ///
    /// # Panics
    /// When they do not within a minute.
    #[must_use]
    pub fn start<S: AsRef<str>>(arguments: &[S], processes: usize, thread: &str) -> Self {
        let running = Self::spawn(arguments);
        wait_until("the cluster runs", || {
            let started = running.processes();
            started.len() == processes && started.iter().all(|process| has_thread(*process, thread))
        });
        running
    }

    /// Starts the command.
    ///
    /// # Panics
    /// When it does not start.
    #[must_use]
    pub fn spawn<S: AsRef<str>>(arguments: &[S]) -> Self {
        let arguments = arguments.iter().map(AsRef::as_ref);
        let mut command = Command::new(program());
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        Self { child: command.spawn().expect("the command starts") }
    }

    /// The number of the command's own process.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// The numbers of the cluster's processes, nodes before stores.
    #[must_use]
    pub fn processes(&self) -> Vec<u32> {
        children_of(self.child.id())
    }

    /// Waits for the end.
    ///
    /// # Panics
    /// When it does not come within a minute.
    #[must_use]
    pub fn end(mut self) -> Output {
        let mut status = None;
        wait_until("the command ends", || {
            status = self.child.try_wait().expect("our own child");
            status.is_some()
        });
        let mut stderr = Vec::new();
        if let Some(mut pipe) = self.child.stderr.take() {
            std::io::Read::read_to_end(&mut pipe, &mut stderr).expect("what it said");
        }
        Output { status: status.expect("waited for"), stdout: Vec::new(), stderr }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Looks again and again until something is so.
///
/// # Panics
/// After a minute.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < Duration::from_secs(60), "waited a minute until {what}");
        std::thread::yield_now();
    }
}

/// Whether a process exists, be it one that has ended and that nobody has waited for.
#[must_use]
pub fn exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

fn children_of(process: u32) -> Vec<u32> {
    let list = fs::read_to_string(format!("/proc/{process}/task/{process}/children")).unwrap_or_default();
    list.split_whitespace().filter_map(|child| child.parse().ok()).collect()
}

/// Whether a process has a thread of this name.
#[must_use]
pub fn has_thread(process: u32, name: &str) -> bool {
    let Ok(tasks) = fs::read_dir(format!("/proc/{process}/task")) else { return false };
    let names = tasks.flatten().filter_map(|task| fs::read_to_string(task.path().join("comm")).ok());
    names.into_iter().any(|comm| comm.trim_end() == name)
}
