//! Plots: lines over an axis, several charts beside each other, as SVG.

use std::path::Path;

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

/// Charts beside each other.
#[derive(Debug)]
pub(crate) struct Plot {
    pub(crate) charts: Vec<Chart>,
}

/// Lines over two axes.
#[derive(Debug)]
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) lines: Vec<Line>,
}

/// An axis, named with its unit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    pub(crate) label: &'static str,
    /// Each step is ten times the one before; values must be above 0.
    pub(crate) is_logarithmic: bool,
}

/// Points joined by a line.
#[derive(Debug)]
pub(crate) struct Line {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// Lines of few points show where these are.
const MARKED_MAX: usize = 16;

const CHART_SIZE: (u32, u32) = (640, 480);

impl Plot {
    pub(crate) fn write(&self, path: &Path) -> Result<()> {
        let count = u32::try_from(self.charts.len())?;
        let root = SVGBackend::new(path, (CHART_SIZE.0 * count, CHART_SIZE.1)).into_drawing_area();
        let drawn = root.fill(&WHITE).map_err(|error| anyhow!("{error}")).and_then(|()| {
            let places = root.split_evenly((1, self.charts.len().max(1)));
            self.charts.iter().zip(&places).try_for_each(|(chart, place)| chart.draw(place))?;
            root.present().map_err(|error| anyhow!("{error}"))
        });
        drawn.map_err(|error| anyhow!("cannot write {}: {error}", path.display()))
    }
}

impl Chart {
    fn draw(&self, place: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<()> {
        let xs = self.range(self.x, |point| point.0);
        let ys = self.range(self.y, |point| point.1);
        let mut chart = ChartBuilder::on(place)
            .caption(&self.title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(44)
            .y_label_area_size(56)
            .build_cartesian_2d(xs, ys)?;
        chart
            .configure_mesh()
            .x_desc(self.x.label)
            .y_desc(self.y.label)
            .x_label_formatter(&|place| self.x.value(*place))
            .y_label_formatter(&|place| self.y.value(*place))
            .light_line_style(WHITE)
            .draw()?;
        for (index, line) in self.lines.iter().enumerate() {
            let colour = Palette99::pick(index).to_rgba();
            let place = |(x, y): &(f64, f64)| (self.x.place(*x), self.y.place(*y));
            let points: Vec<(f64, f64)> = line.points.iter().map(place).collect();
            if points.len() <= MARKED_MAX {
                chart.draw_series(points.iter().map(|point| Circle::new(*point, 3, colour.filled())))?;
            }
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
                .label(&line.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        let mut legend = chart.configure_series_labels();
        legend.position(self.legend_corner()).border_style(BLACK).background_style(WHITE);
        Ok(legend.draw()?)
    }

    /// On the left where that is empty, else where lines that rise leave most room.
    fn legend_corner(&self) -> SeriesLabelPosition {
        let range = self.range(self.x, |point| point.0);
        let middle = f64::midpoint(range.start, range.end);
        let mut points = self.lines.iter().flat_map(|line| &line.points);
        let is_left_empty = points.all(|point| self.x.place(point.0) >= 0.9 * middle);
        if is_left_empty { SeriesLabelPosition::UpperLeft } else { SeriesLabelPosition::LowerRight }
    }

    /// The part of an axis that all points lie on; a linear one begins at 0.
    fn range(&self, axis: Axis, of: fn(&(f64, f64)) -> f64) -> core::ops::Range<f64> {
        let places = self.lines.iter().flat_map(|line| &line.points).map(|point| axis.place(of(point)));
        let (low, high) = places
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), place| (low.min(place), high.max(place)));
        let low = if axis.is_logarithmic { low } else { 0.0 };
        if low < high { low..high + (high - low) * 0.05 } else { 0.0..1.0 }
    }
}

impl Axis {
    /// Where a value lies on the axis.
    fn place(self, value: f64) -> f64 {
        if self.is_logarithmic { value.log10() } else { value }
    }

    /// The label at a place of the axis.
    fn value(self, place: f64) -> String {
        let value = if self.is_logarithmic { 10f64.powf(place) } else { place };
        match value.abs() {
            10.0.. => format!("{value:.0}"),
            ..0.1 if self.is_logarithmic => format!("{value:.0e}"),
            _ => format!("{}", (value * 10.0).round() / 10.0),
        }
    }
}
