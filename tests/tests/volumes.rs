//! Volumes in a cluster: what an isovalue outside the range costs, and one inside.

use memsavvy::report::RunReport;
use tests::{Folder, render, run_well};

/// Draws an isosurface of a volume on a node that has none of it: all lies in a store.
fn draw(folder: &Folder, image: &str, isovalue: &str) -> RunReport {
    let cluster = ["--nodes", "1", "--stores", "1", "--memory", "30%", "--threads", "1"];
    let view = ["--size", "96x96", "--frames", "3", "--radius", "0.75", "--iso", isovalue];
    render(folder, &[&[image][..], &cluster, &view].concat())
}

#[test]
fn an_isovalue_outside_the_range_shows_nothing_and_fetches_nothing() {
    let folder = Folder::new("iso-outside");
    let image = folder.file("gyroid.msv");
    run_well(&["prepare", "gyroid:64", "-o", &image, "--quiet"]);
    for isovalue in ["1000", "-1e30", "3.4e38"] {
        let report = draw(&folder, &image, isovalue);
        assert!(report.frames.iter().all(|frame| frame.hits == 0 && frame.primary_rays == 96 * 96));
        // The page of the header may be looked at; nothing says anything of a value that no sample reaches.
        assert!(report.totals.fetched_pages <= 1, "{isovalue}: {:?}", report.totals);
    }
    let report = draw(&folder, &image, "0");
    assert!(report.frames.iter().all(|frame| frame.hits > 2000), "{:?}", report.frames);
    assert!(report.totals.fetched_pages > 20, "{:?}", report.totals);
}
