//! What a volume is, in words and bars.

use rt_core::volume::{Volume, bricks_along};
use scene::volume::Histogram;

use crate::report::thousands;

/// Facts about a volume: what, and how much.
pub(crate) fn describe_volume(volume: &Volume) -> [(&'static str, String); 4] {
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
