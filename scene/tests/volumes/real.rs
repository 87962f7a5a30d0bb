//! Real scans: samples against a reading of the raw files that shares nothing with ours, counts against those of
//! others.
//!
//! Needs the folder that `MEMSAVVY_DATA` names; skips, and says so, when it is not set.

use std::io::Read;

use flate2::read::GzDecoder;
use scene::volume::Histogram;
use serde_json::Value;

use super::*;

/// The scans' descriptions with their paths.
fn scans() -> Vec<(PathBuf, Value)> {
    let Some(data) = std::env::var_os("MEMSAVVY_DATA").map(PathBuf::from) else {
        eprintln!("skipped: MEMSAVVY_DATA does not name the data folder");
        return Vec::new();
    };
    let folder = fs::read_dir(data.join("volumes")).expect("the folder of volumes");
    let paths = folder.map(|entry| entry.expect("a readable folder").path());
    let jsons = paths.filter(|path| path.extension().is_some_and(|extension| extension == "json"));
    let scans: Vec<_> = jsons
        .map(|path| {
            let json = fs::read(&path).expect("a readable file");
            let json = serde_json::from_slice(&json).expect("a description");
            (path, json)
        })
        .collect();
    assert!(scans.len() >= 3, "{} scans", scans.len());
    scans
}

/// Every sample of a scan, u8 or little-endian f32.
fn plainly(path: &Path, json: &Value) -> Vec<f32> {
    let file = fs::File::open(path.with_file_name(json["file"].as_str().expect("a name"))).expect("its file");
    let mut bytes = Vec::new();
    match json["compression"].as_str() {
        Some("gzip") => GzDecoder::new(file).read_to_end(&mut bytes),
        _ => { file }.read_to_end(&mut bytes),
    }
    .expect("readable");
    match json["dtype"].as_str() {
        Some("u8") => bytes.into_iter().map(f32::from).collect(),
        _ => bytes.chunks(4).map(|word| f32::from_le_bytes(word.try_into().expect("four bytes"))).collect(),
    }
}

#[test]
fn every_sample_is_the_files() {
    for (path, json) in scans() {
        let samples = plainly(&path, &json);
        let mut volume = open_file(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let dims = volume.shape().dims;
        assert_eq!(serde_json::to_value(dims).ok(), Some(json["dims"].clone()), "{}", path.display());
        assert_eq!(volume.shape().samples(), samples.len() as u64, "{}", path.display());
        let slice = usize::try_from(volume.shape().slice_samples()).expect("small");
        // Nine slices at a time with one in common, as a layout of bricks asks for them.
        let mut slab = vec![0.0; 9 * slice];
        for z in (0..dims[2] - 1).step_by(8) {
            let first = usize::try_from(z).expect("small") * slice;
            let count = (samples.len() - first).min(slab.len());
            volume
                .read_slices(z, &mut slab[..count])
                .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            assert!(same(&slab[..count], &samples[first..][..count]), "{}: slice {z}", path.display());
        }
    }
}

#[test]
fn histograms_agree_with_counts_of_others_and_isovalues_are_of_a_surface() {
    for (path, json) in scans() {
        let samples = plainly(&path, &json);
        let mut volume = open_file(&path).expect("as the other test shows");
        let histogram = Histogram::of(&mut volume, 256).expect("as the other test shows");
        assert_eq!(histogram.counts().iter().sum::<u64>(), samples.len() as u64);
        let ends = [&json["min"], &json["max"]].map(|end| end.as_f64().expect("a number"));
        // A number in JSON may be read with an error far below that of a sample.
        #[expect(clippy::cast_possible_truncation, reason = "both are samples of single precision")]
        let single = |ends: [f64; 2]| ends.map(|end| end as f32);
        assert_eq!(histogram.values().map(single), Some(single(ends)), "{}", path.display());
        let mean = samples.iter().copied().map(f64::from).sum::<f64>() / samples.len() as f64;
        let ours = histogram.mean().expect("finite samples");
        assert!((ours - mean).abs() <= 1.0e-12 * mean, "{}: mean {ours} for {mean}", path.display());
        for known in json["isovalues"].as_array().into_iter().flatten().filter(|_| json["dtype"] == "u8") {
            let value = known["value"].as_f64().expect("a number");
            let above = (0..256).filter(|bin| histogram.bin(*bin)[0] >= value);
            let above: u64 = above.map(|bin| histogram.counts()[bin]).sum();
            assert_eq!(Some(above), known["voxels_above"].as_u64(), "{} {value}", path.display());
        }
        let isovalue = histogram.auto_isovalue().expect("a surface");
        println!("{}: isovalue {isovalue}, suggested {}", path.display(), json["suggested_isovalue"]);
        // Between background and the densest of what was scanned, with a sensible part of the samples inside.
        let inside = samples.iter().filter(|sample| f64::from(**sample) > isovalue).count() as f64;
        let share = inside / samples.len() as f64;
        assert!((0.02..0.3).contains(&share), "{}: {isovalue} has {share} inside", path.display());
    }
}
