//! Panels side by side in one picture, each with a title above and a legend below.

use std::io::Write;
use std::path::Path;

use anyhow::Result;

use super::letters::{self, ADVANCE, ROWS};
use crate::output::write_whole;

/// Red, green and blue.
pub(super) type Colour = [u8; 3];

/// A picture in colours, row by row from the upper left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Colours {
    width: usize,
    pixels: Vec<Colour>,
}

/// A picture, what it is, and what its colours mean.
#[derive(Debug)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) picture: Colours,
    pub(super) legend: Legend,
}

/// What colours mean.
#[derive(Debug)]
pub(super) enum Legend {
    /// Nothing but themselves.
    Plain,
    /// Each has a name.
    Names(Vec<(Colour, String)>),
    /// They go from the name of the least, over a row of colours, to that of the most.
    Scale(String, Vec<Colour>, String),
}

const PAPER: Colour = [255; 3];
const INK: Colour = [0; 3];

/// Pixels of a letter's point.
const POINT: usize = 2;

/// Height of a line of text with the gap below it, and the gap between panels.
const LINE: usize = ROWS * POINT + 6;
const GAP: usize = 8;

/// Width and height of a colour before its name.
const SWATCH: [usize; 2] = [LINE - GAP / 2, ROWS * POINT];

impl Colours {
    /// A picture of one colour.
    pub(super) fn new(width: usize, height: usize, colour: Colour) -> Self {
        Self { width, pixels: vec![colour; width * height] }
    }

    /// A picture with a colour for each pixel, row by row.
    pub(super) fn of(width: usize, pixels: Vec<Colour>) -> Self {
        Self { width, pixels }
    }

    /// A colour for each pixel, row by row.
    #[cfg(test)]
    pub(super) fn pixels(&self) -> &[Colour] {
        &self.pixels
    }

    fn height(&self) -> usize {
        self.pixels.len() / self.width.max(1)
    }

    /// Fills a rectangle, as far as it lies in the picture.
    fn fill(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], colour: Colour) {
        let end = (x + width).min(self.width);
        for row in self.pixels.chunks_exact_mut(self.width).skip(y).take(height) {
            row.get_mut(x..end).unwrap_or_default().fill(colour);
        }
    }

    fn put(&mut self, [x, y]: [usize; 2], other: &Self) {
        let rows = self.pixels.chunks_exact_mut(self.width).skip(y);
        for (row, other) in rows.zip(other.pixels.chunks_exact(other.width)) {
            row[x..x + other.len()].copy_from_slice(other);
        }
    }

    fn write_text(&mut self, [x, y]: [usize; 2], text: &str) {
        for (place, letter) in text.chars().enumerate() {
            for (down, row) in letters::points(letter).iter().enumerate() {
                for (right, _) in row.bytes().enumerate().filter(|(_, point)| *point == b'#') {
                    let across = (place * ADVANCE + right) * POINT;
                    self.fill([x + across, y + down * POINT], [POINT; 2], INK);
                }
            }
        }
    }

    /// Writes it as PNG. The file is there whole or not at all.
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let mut bytes = Vec::new();
        let (width, height) = (u32::try_from(self.width)?, u32::try_from(self.height())?);
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(self.pixels.as_flattened())?;
        write_whole(path, |file| Ok(file.write_all(&bytes)?))
    }
}

/// Puts panels next to each other.
pub(super) fn side_by_side(panels: &[Panel]) -> Colours {
    let widths: Vec<usize> = panels.iter().map(Panel::width).collect();
    let pictures = panels.iter().map(|panel| panel.picture.height()).max().unwrap_or(0);
    let legends = panels.iter().zip(&widths).map(|(panel, width)| panel.legend.height(*width));
    let height = GAP + LINE + pictures + GAP + legends.max().unwrap_or(0);
    let width = widths.iter().map(|width| width + GAP).sum::<usize>() + GAP;
    let mut sheet = Colours::new(width, height, PAPER);
    let mut left = GAP;
    for (panel, width) in panels.iter().zip(&widths) {
        sheet.write_text([left, GAP], &panel.title);
        sheet.put([left, GAP + LINE], &panel.picture);
        panel.legend.draw(&mut sheet, [left, GAP + LINE + pictures + GAP], *width);
        left += width + GAP;
    }
    sheet
}

fn text_width(text: &str) -> usize {
    letters::width(text) * POINT
}

impl Panel {
    /// As wide as picture and title need, and a legend in one column.
    fn width(&self) -> usize {
        self.picture.width.max(text_width(&self.title)).max(self.legend.width_min())
    }
}

impl Legend {
    /// Width of a swatch, its name and the gap behind it.
    fn entry_width(names: &[(Colour, String)]) -> usize {
        LINE + GAP + names.iter().map(|(_, name)| text_width(name)).max().unwrap_or(0)
    }

    fn columns(names: &[(Colour, String)], width: usize) -> usize {
        ((width + GAP) / (Self::entry_width(names) + GAP)).max(1)
    }

    fn width_min(&self) -> usize {
        match self {
            Self::Plain => 0,
            Self::Names(names) => Self::entry_width(names),
            Self::Scale(least, _, most) => text_width(least) + text_width(most) + 8 * GAP,
        }
    }

    fn height(&self, width: usize) -> usize {
        match self {
            Self::Plain => 0,
            Self::Names(names) => names.len().div_ceil(Self::columns(names, width)) * LINE,
            Self::Scale(..) => LINE,
        }
    }

    fn draw(&self, sheet: &mut Colours, [left, top]: [usize; 2], width: usize) {
        match self {
            Self::Plain => {}
            Self::Names(names) => {
                let (columns, step) = (Self::columns(names, width), Self::entry_width(names) + GAP);
                for (index, (colour, name)) in names.iter().enumerate() {
                    let (x, y) = (left + index % columns * step, top + index / columns * LINE);
                    // White would not show on paper.
                    sheet.fill([x, y], SWATCH, INK);
                    sheet.fill([x + 1, y + 1], SWATCH.map(|side| side - 2), *colour);
                    sheet.write_text([x + LINE, y], name);
                }
            }
            Self::Scale(least, colours, most) => {
                sheet.write_text([left, top], least);
                let start = left + text_width(least) + GAP;
                let end = left + width - text_width(most) - GAP;
                for x in start..end {
                    let colour = colours[(x - start) * colours.len() / (end - start)];
                    sheet.fill([x, top], [1, ROWS * POINT], colour);
                }
                sheet.write_text([end + GAP, top], most);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(width: usize, height: usize, legend: Legend) -> Panel {
        Panel { title: "a".to_owned(), picture: Colours::new(width, height, [9, 8, 7]), legend }
    }

    #[test]
    fn panels_lie_side_by_side_and_keep_their_pixels() {
        let names = (0..5).map(|index| ([index, 0, 0], format!("node {index}"))).collect();
        let scale = Legend::Scale("0".to_owned(), vec![[1; 3], [2; 3]], "99 us".to_owned());
        let panels = [panel(50, 20, Legend::Plain), panel(3, 40, Legend::Names(names)), panel(200, 9, scale)];
        let sheet = side_by_side(&panels);
        let of_pictures = sheet.pixels.iter().filter(|pixel| **pixel == [9, 8, 7]).count();
        assert_eq!(of_pictures, 50 * 20 + 3 * 40 + 200 * 9);
        for index in 0..5 {
            let swatch = sheet.pixels.iter().filter(|pixel| **pixel == [index, 0, 0]).count();
            assert!(swatch >= (SWATCH[0] - 2) * (SWATCH[1] - 2), "{index}: {swatch}");
        }
        assert!(sheet.pixels.contains(&[1; 3]) && sheet.pixels.contains(&[2; 3]));
        assert_eq!(sheet.pixels.len() % sheet.width, 0);
        assert_eq!(sheet.pixels[(GAP + LINE) * sheet.width + GAP], [9, 8, 7]);
    }

    #[test]
    fn text_is_ink_of_the_size_it_says() {
        let mut paper = Colours::new(text_width("18"), ROWS * POINT, PAPER);
        paper.write_text([0, 0], "18");
        let ink = paper.pixels.iter().filter(|pixel| **pixel == INK).count();
        assert_eq!(ink, (8 + 13) * POINT * POINT);
    }
}
