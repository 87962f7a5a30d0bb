//! What a session, a trace, a scene image and a volume are, in words and bars.

use rt_core::volume::{Volume, bricks_along};
use scene::Info;
use scene::volume::Histogram;

use crate::report::thousands;
use crate::session::{Moment, Session};
use crate::size::Bytes;
use crate::trace::Trace;

/// What is in a session, one fact a line.
pub(crate) fn describe_session(session: &Session) -> String {
    let moments = session.moments();
    let times: Vec<f64> = moments.iter().map(|moment| moment.time).collect();
    let span = times[times.len() - 1] - times[0];
    let shown = |moment: &Moment| match &moment.isosurfaces {
        Some(surfaces) => surfaces.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        None => "as asked with --iso".to_owned(),
    };
    let [first, last] = [&moments[0], &moments[moments.len() - 1]];
    let lines = [
        ("moments", thousands(moments.len() as u64)),
        ("seconds", format!("{span:.3}")),
        ("eye", format!("{:.3?} to {:.3?} diagonals from the centre", first.aim.eye, last.aim.eye)),
        ("isovalues", format!("{} to {}", shown(first), shown(last))),
    ];
    one_a_line(&lines)
}

/// What is in a trace, one fact a line.
pub(crate) fn describe_trace(trace: &Trace) -> String {
    let [width, height] = trace.size;
    let lines = [
        ("frames", format!("{} of {width}x{height}", trace.frames.len())),
        ("nodes", trace.nodes.to_string()),
        ("pages", format!("{} of {}", thousands(trace.page_count.into()), Bytes(trace.page_bytes.into()))),
        ("touched", format!("{} pages", thousands(trace.distinct_pages()))),
        ("a frame", format!("{:.1} pages of a node", trace.pages_per_node_frame())),
        ("a tile", format!("{:.1} pages", trace.pages_per_tile())),
        ("touches", thousands(trace.touch_count())),
    ];
    one_a_line(&lines)
}

/// What is in a scene image, one fact a line.
pub(crate) fn describe(info: &Info) -> String {
    let percent = |part: u64| 100.0 * part as f64 / info.image_bytes.max(1) as f64;
    let mut lines = vec![("uses", info.needs.to_string())];
    if info.triangles + info.spheres > 0 {
        lines.extend(describe_primitives(info));
    }
    if let Some(volume) = &info.volume {
        lines.extend(describe_volume(volume));
    }
    lines.extend([
        ("view", format!("{} to {}", info.view.low, info.view.high)),
        ("image", Bytes(info.image_bytes).to_string()),
        ("pages", format!("{} of {}", thousands(info.pages), Bytes(info.page_bytes.into()))),
    ]);
    lines.extend(info.segments.map(|(kind, bytes)| {
        ("", format!("{:8} {:>9} {:5.1} %", kind.to_string(), Bytes(bytes).to_string(), percent(bytes)))
    }));
    one_a_line(&lines)
}

/// Facts about triangles and spheres, and the grid they lie in.
fn describe_primitives(info: &Info) -> [(&'static str, String); 11] {
    let of_primitives =
        format!("{} of {:.1} primitives", thousands(info.clusters.into()), info.primitives_per_cluster);
    [
        ("triangles", thousands(info.triangles)),
        ("spheres", thousands(info.spheres)),
        ("never hit", format!("{} with two corners in one point or no radius", thousands(info.collapsed))),
        ("vertices", thousands(info.vertices)),
        ("bounds", format!("{} to {}", info.bounds.low, info.bounds.high)),
        ("typical edge", format!("{}", info.typical_edge)),
        ("a primitive", format!("{:.2} bytes of the image", info.bytes_per_primitive)),
        ("copies", format!("{:.3} stored for each primitive", info.duplication)),
        ("levels", info.levels.to_string()),
        (
            "branches",
            format!("{} and {} leaves", thousands(info.branches.into()), thousands(info.leaves.into())),
        ),
        ("clusters", of_primitives),
    ]
}

/// Facts about a volume: what, and how much.
fn describe_volume(volume: &Volume) -> [(&'static str, String); 4] {
    let [x, y, z] = volume.dims;
    let values = [volume.low, volume.high].map(|sample| volume.value(sample));
    let bricks = volume.dims.map(|count| u64::from(bricks_along(count))).into_iter().product();
    [
        ("volume", format!("{x}x{y}x{z} samples stored as {:?}, {:?} apart", volume.sample, volume.spacing)),
        ("values", format!("{} to {}", values[0].min(values[1]), values[0].max(values[1]))),
        ("bricks", format!("{} stored of {}", thousands(volume.bricks), thousands(bricks))),
        ("ranges", format!("{} on {} levels", thousands(volume.branches), volume.levels)),
    ]
}

fn one_a_line(facts: &[(&str, String)]) -> String {
    facts.iter().map(|(what, value)| format!("{what:>12}  {value}")).collect::<Vec<_>>().join("\n")
}

/// The histogram as bars, and the isovalue that it suggests.
pub(crate) fn describe_histogram(histogram: &Histogram) -> String {
    let per_line = histogram.counts().len().div_ceil(LINES).max(1);
    let counts: Vec<u64> = histogram.counts().chunks(per_line).map(|bins| bins.iter().sum()).collect();
    let most = counts.iter().copied().max().unwrap_or(0);
    let mut lines: Vec<String> = (0..)
        .step_by(per_line)
        .zip(counts)
        .map(|(bin, count)| {
            format!("{:>12.5}  {} {}", histogram.bin(bin)[0], bar(count, most), thousands(count))
        })
        .collect();
    if histogram.absent() > 0 {
        lines.push(format!("{:>12}  {}", "absent", thousands(histogram.absent())));
    }
    let suggested = histogram.auto_isovalue().map_or("none".to_owned(), |value| format!("{value}"));
    lines.push(format!("{:>12}  {suggested}", "--iso auto"));
    lines.join("\n")
}

/// A bar as long as the square root of a count, so that what is rare shows beside air.
fn bar(count: u64, most: u64) -> String {
    let full = (count as f64 / most.max(1) as f64).sqrt() * (WIDTH * EIGHTHS.len()) as f64;
    let lit =
        |cell: usize| (0..EIGHTHS.len()).filter(|part| ((cell * EIGHTHS.len() + part) as f64) < full).count();
    (0..WIDTH).map(|cell| lit(cell).checked_sub(1).map_or(' ', |last| EIGHTHS[last])).collect()
}

/// A character from one eighth to all of its width.
const EIGHTHS: [char; 8] = ['▏', '▎', '▍', '▌', '▋', '▊', '▉', '█'];

/// Bars at most.
const LINES: usize = 32;

/// Characters of the longest bar.
const WIDTH: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_go_from_nothing_to_their_whole_width() {
        assert_eq!(bar(0, 10), " ".repeat(WIDTH));
        assert_eq!(bar(10, 10), "█".repeat(WIDTH));
        assert_eq!(bar(1, 4), format!("{}{}", "█".repeat(20), " ".repeat(20)));
        assert_eq!(bar(1, 1_000_000), format!("▏{}", " ".repeat(39)));
        assert_eq!(bar(0, 0), " ".repeat(WIDTH));
    }
}
