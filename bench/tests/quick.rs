//! Every experiment runs, asserts what it is to assert, and writes what it promises. The figures mean nothing here.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The names in the list that the command prints when it is given none.
fn names() -> Vec<String> {
    let listed = bench(&[]);
    assert!(listed.status.success());
    let text = text(&listed.stdout);
    let lines = text.lines().filter_map(|line| line.strip_prefix("  "));
    lines.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn every_experiment_runs_and_writes_what_it_found() {
    let names = names();
    for expected in [
        "table1",
        "core",
        "sim",
        "scaling",
        "fig5",
        "fig7",
        "table3",
        "balance",
        "replacement",
        "prefetch",
        "step-aside",
        "gather",
        "embree",
        "left-out",
        "triangle-tests",
        "iso-error",
        "iso",
    ] {
        assert!(names.iter().any(|name| name == expected), "{names:?}");
    }
    for name in names {
        let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("quick-{name}"));
        let _ = fs::remove_dir_all(&out);
        let run = bench(&[&name, "--quick", "--out", out.to_str().unwrap()]);
        assert!(run.status.success(), "{name}: {}", text(&run.stderr));
        let record: Value =
            serde_json::from_slice(&fs::read(out.join(format!("{name}.json"))).unwrap()).unwrap();
        check(&record, &name);
        let printed = text(&run.stdout);
        for aim in record["aims"].as_array().unwrap() {
            assert!(printed.contains(aim["what"].as_str().unwrap()), "{name} does not print {aim}");
        }
        let plot = fs::read_to_string(out.join(format!("{name}.svg")));
        assert!(plot.is_ok_and(|plot| plot.starts_with("<svg") && plot.contains("polyline")), "{name}");
    }
}

/// Whether a record has the shape that others rely on.
fn check(record: &Value, name: &str) {
    assert_eq!(record["experiment"], name);
    assert_eq!(record["quick"], true);
    for (text, of) in [
        ("shows", record),
        ("commit", record),
        ("processor", &record["machine"]),
        ("kernel", &record["machine"]),
    ] {
        assert!(of[text].as_str().is_some_and(|text| !text.is_empty()), "{text}: {of}");
    }
    assert!(record["machine"]["cores"].as_u64().is_some_and(|cores| cores > 0));
    assert!(record["command"].as_array().is_some_and(|words| words.iter().any(|word| word == name)));
    let rows = record["rows"].as_array().unwrap();
    assert!(!rows.is_empty() && rows.iter().all(|row| row["table"].is_string()), "{rows:?}");
    let aims = record["aims"].as_array().unwrap();
    assert!(!aims.is_empty());
    for aim in aims {
        let is_whole = aim["what"].is_string() && aim["aim"].is_string() && aim["holds"].is_boolean();
        assert!(is_whole && aim["value"].as_f64().is_some_and(f64::is_finite), "{aim}");
    }
}

/// Runs an experiment where there is no compiler and no interpreter; what it prints, and the programs in its rows.
fn alone(name: &str) -> (String, Vec<String>) {
    let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("quick-{name}-alone"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args([name, "--quick", "--out", out.to_str().unwrap()]);
    let run = command.env("PATH", "").env_remove("EMBREE4_LIB").output().unwrap();
    assert!(run.status.success(), "{}", text(&run.stderr));
    let record = fs::read(out.join(format!("{name}.json"))).unwrap();
    let record: Value = serde_json::from_slice(&record).unwrap();
    let rows = record["rows"].as_array().unwrap();
    let programs = rows.iter().filter_map(|row| row["program"].as_str()).map(str::to_owned);
    (text(&run.stdout), programs.collect())
}

#[test]
fn without_other_programs_ours_is_measured_alone_and_the_rest_is_said() {
    for (name, missing) in [
        ("embree", ["Embree 3 is not here", "apt-get install", "Embree 4 is not here", "pip install"]),
        ("iso", ["Embree 3 is not here", "Embree 4 is not here", "VTK is not here", "pip install vtk"]),
    ] {
        let (printed, programs) = alone(name);
        for line in missing {
            assert!(printed.contains(line), "{line}: {printed}");
        }
        assert!(!programs.is_empty() && programs.iter().all(|name| name.starts_with("ours")), "{programs:?}");
    }
}

#[test]
fn a_name_that_there_is_not_is_refused_with_the_list() {
    let run = bench(&["table17", "--out", env!("CARGO_TARGET_TMPDIR")]);
    assert!(!run.status.success());
    assert!(text(&run.stderr).contains("table1"), "{}", text(&run.stderr));
}
