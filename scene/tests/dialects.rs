//! Mesh files of many exporters: counts and bounds as measured by others, and no panic however a file is cut.
//!
//! Needs the folder that `MEMSAVVY_DATA` names; skips, and says so, when it is not set.

use std::fs;
use std::path::{Path, PathBuf};

use scene::read::Format;
use scene::{ReadError, parse_mesh, read_mesh};

fn data_folder() -> Option<PathBuf> {
    let folder = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: MEMSAVVY_DATA does not name the data folder");
    }
    folder
}

/// A row of the tables in the data folder's README.
struct Row {
    path: PathBuf,
    vertices: usize,
    triangles: usize,
    /// Lowest and highest corner, in that order; none for a file without vertices.
    bounds: Option<[f32; 6]>,
}

fn rows(data: &Path) -> Vec<Row> {
    let readme = fs::read_to_string(data.join("README.md")).expect("the data folder has a README");
    let number = |cell: &str| cell.replace(',', "").parse().expect("a count");
    let is_mesh = |name: &str| {
        Path::new(name).extension().is_some_and(|extension| extension == "ply" || extension == "obj")
    };
    let cells = readme.lines().map(|line| line.split('|').map(str::trim).collect::<Vec<_>>());
    cells
        .filter(|cells| cells.len() > 6 && is_mesh(cells[1]))
        .map(|cells| {
            let folders = ["meshes", "meshes-dialects"].map(|folder| data.join(folder).join(cells[1]));
            let numbers = cells[5].split(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c)));
            let bounds: Vec<f32> = numbers.filter_map(|number| number.parse().ok()).collect();
            Row {
                path: folders.into_iter().find(|path| path.exists()).expect("the file of a row"),
                vertices: number(cells[3]),
                triangles: number(cells[4]),
                bounds: bounds.try_into().ok(),
            }
        })
        .collect()
}

#[test]
fn every_file_reads_as_the_table_says() {
    let Some(data) = data_folder() else { return };
    let rows = rows(&data);
    assert!(rows.len() >= 30, "only {} rows in the README's tables", rows.len());
    for Row { path, vertices, triangles, bounds } in rows {
        let mesh = read_mesh(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let counts = (mesh.positions.len(), mesh.triangles.len());
        assert_eq!(counts, (vertices, triangles), "{}", path.display());
        let ours = mesh.bounds().map(|bounds| [bounds.low.to_array(), bounds.high.to_array()].concat());
        assert_eq!(ours.is_some(), bounds.is_some(), "{}", path.display());
        for (ours, theirs) in ours.unwrap_or_default().into_iter().zip(bounds.unwrap_or_default()) {
            assert!(
                (ours - theirs).abs() <= 1.0e-5 * theirs.abs(),
                "{}: {ours} for {theirs}",
                path.display()
            );
        }
    }
}

#[test]
fn every_file_that_has_triangles_builds() {
    let Some(data) = data_folder() else { return };
    for Row { path, triangles, .. } in rows(&data).into_iter().filter(|row| row.triangles < 200_000) {
        let mesh = read_mesh(&path).expect("as the other test shows");
        let built = scene::build(mesh, &scene::BuildOptions::default(), &|_| {});
        assert_eq!(built.is_ok(), triangles > 0, "{}: {:?}", path.display(), built.err());
    }
}

/// The files of the folder of dialects, with their formats.
fn dialects(data: &Path) -> impl Iterator<Item = (Vec<u8>, Format)> {
    let folder = fs::read_dir(data.join("meshes-dialects")).expect("the folder of dialects");
    folder.map(|entry| {
        let path = entry.expect("a readable folder").path();
        let format = Format::recognise(b"", Some(&path)).unwrap_or(Format::Ply);
        (fs::read(&path).expect("a readable file"), format)
    })
}

#[test]
fn a_file_cut_anywhere_is_a_mesh_or_an_error() {
    let Some(data) = data_folder() else { return };
    let mut refused = 0;
    for (bytes, format) in dialects(&data) {
        // Every length in the header and the start of the body, then ever larger steps.
        let mut length = 0;
        while length < bytes.len() {
            match parse_mesh(&bytes[..length], Some(format)) {
                Ok(mesh) => {
                    let corners = mesh.triangles.iter().flatten();
                    assert!(corners.into_iter().all(|&vertex| (vertex as usize) < mesh.positions.len()));
                }
                Err(error) => {
                    refused += 1;
                    assert_is_one_line(&error);
                }
            }
            length += 1 + length / 400;
        }
    }
    assert!(refused > 1000);
}

#[test]
fn bytes_changed_anywhere_do_no_harm() {
    let Some(data) = data_folder() else { return };
    let mut seed = 1_u32;
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as usize
    };
    for (bytes, format) in dialects(&data) {
        for _ in 0..60 {
            let mut bytes = bytes.clone();
            // Mostly in the header, where a byte does the most.
            for _ in 0..1 + next() % 4 {
                let span = if next() % 3 > 0 { bytes.len().min(400) } else { bytes.len() };
                bytes[next() % span] = u8::try_from(next() % 256).expect("a byte");
            }
            if let Err(error) = parse_mesh(&bytes, Some(format)) {
                assert_is_one_line(&error);
            }
        }
    }
}

fn assert_is_one_line(error: &ReadError) {
    let text = error.to_string();
    assert!(!text.contains('\n') && text.len() < 250, "{text:?}");
}
