//! `NO_LOST_WAITER`: every fault ends, with the page or by its deadline with a named error. Nothing hangs, whoever
//! dies; and nothing is left behind.

use core::time::Duration;
use std::process::Output;
use std::time::Instant;

use rustix::process::{Pid, Signal, kill_process};
use tests::{Folder, Running, error_line, exists, run_well, wait_until};

/// Long enough for a busy machine, short enough to wait for fifty times.
const DEADLINE_S: &str = "0.4";

/// More than any deadline, and short of a hang.
const PATIENCE: Duration = Duration::from_secs(20);

const TIMES: usize = 50;

fn send(process: u32, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(process).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

fn scene(folder: &Folder) -> String {
    let image = folder.file("knot.msv");
    run_well(&["prepare", "--builtin", "100000", "-o", &image, "--quiet"]);
    image
}

/// A run of two nodes over two stores that misses all the time and would go on for hours.
fn start(image: &str, transport: &str) -> Running {
    let cluster =
        ["--nodes", "2", "--stores", "2", "--memory", "10%", "--threads", "2", "--transport", transport];
    let view = ["--size", "256x256", "--frames", "100000", "--deadline", DEADLINE_S];
    let arguments = [&["render", image][..], &cluster, &view].concat();
    let running = Running::start(&arguments, 4, "alive");
    wait_until("both nodes draw", || {
        running.processes()[..2].iter().all(|node| tests::has_thread(*node, "render 1"))
    });
    running
}

/// Does something to process `victim` of a run and gives back how the run ended, and the line it said.
fn hit(image: &str, transport: &str, victim: usize, signal: Signal) -> (Output, String) {
    let running = start(image, transport);
    let processes = running.processes();
    let begin = Instant::now();
    send(processes[victim], signal);
    let output = running.end();
    let line = error_line(&output);
    assert!(begin.elapsed() < PATIENCE, "{:?}: {line}", begin.elapsed());
    for process in processes {
        assert!(!exists(process), "process {process} was left behind: {line}");
    }
    (output, line)
}

#[test]
fn a_killed_owner_ends_the_run_every_time() {
    let folder = Folder::new("killed");
    let image = scene(&folder);
    for time in 0..TIMES {
        let (victim, transport) = (time % 4, ["shm", "shm-ring"][time / 4 % 2]);
        let (_, line) = hit(&image, transport, victim, Signal::KILL);
        let name = ["node 0", "node 1", "store 2", "store 3"][victim];
        assert!(line.contains(&format!("{name} was killed by SIGKILL")), "{line}");
    }
}

#[test]
fn a_stopped_owner_ends_the_run_every_time() {
    let folder = Folder::new("stopped");
    let image = scene(&folder);
    for time in 0..TIMES {
        let (victim, transport) = (time % 4, ["shm", "shm-ring"][time / 4 % 2]);
        let (_, line) = hit(&image, transport, victim, Signal::STOP);
        let name = ["node 0", "node 1", "store 2", "store 3"][victim];
        assert!(line.contains(&format!("{name} was stopped")), "{line}");
    }
}

#[test]
fn the_end_of_the_supervisor_is_the_end_of_its_processes() {
    let folder = Folder::new("supervisor");
    let image = scene(&folder);
    for signal in [Signal::KILL, Signal::INT, Signal::TERM] {
        let running = start(&image, "shm-ring");
        let processes = running.processes();
        send(running.id(), signal);
        let output = running.end();
        assert!(!output.status.success());
        wait_until("its processes have ended", || processes.iter().all(|process| !exists(*process)));
    }
}

/// Memory files and sockets have no names, so there is nothing that could be left behind.
#[test]
fn a_run_leaves_no_name_behind() {
    let names = || {
        let list = |folder: &str| {
            std::fs::read_dir(folder).map_or(0, |entries| {
                entries
                    .flatten()
                    .filter(|entry| entry.file_name().to_string_lossy().contains("memsavvy-inbox"))
                    .count()
            })
        };
        list("/dev/shm") + list("/tmp")
    };
    let folder = Folder::new("names");
    let image = scene(&folder);
    let before = names();
    let running = start(&image, "shm-ring");
    let sockets = std::fs::read_to_string("/proc/net/unix").unwrap();
    assert!(!sockets.contains("memsavvy"), "{sockets}");
    assert_eq!(names(), before);
    drop(running);
}
