//! Rays a second: tables, aims and charts of all races.

use super::Amount;
use super::race::{Entrant, Lap, Race, Standing, Way};
use super::subject::Subject;
use crate::findings::Aim;
use crate::peers::embree::Mode;
use crate::peers::level::Level;
use crate::plot::{Axis, Chart, Line};
use crate::table::{Cell, Table};

/// What the races so far have shown.
#[derive(Debug)]
pub(super) struct Rates {
    all: Table,
    ratios: Table,
    aims: Vec<Aim>,
    charts: Vec<Chart>,
}

/// With vectors no wider than AVX2, ours is to be so many times as fast as Embree on every mesh.
const AVX2_RATIO_MIN: f64 = 1.2;

/// Our ray kernel is to be so many times as fast as Embree's single ray.
const RAY_RATIO_MIN: f64 = 0.8;

impl Rates {
    pub(super) fn new(Amount { size, frames, .. }: Amount) -> Self {
        let title = format!("rays a second of one thread: {size}x{size}, {frames} frames around the scene");
        let heads = [
            "scene",
            "radius",
            "vectors",
            "program",
            "Mrays/s",
            "best Mrays/s",
            "primary",
            "shadow",
            "ms/frame",
            "wall ms/frame",
        ];
        let mut all = Table::new("rates", title, &heads);
        all.note("Mrays/s: all rays over the processor time of the whole frame, in millions a second");
        all.note(
            "primary: the same in pictures without shadow rays; shadow: shadow rays over the time these add",
        );
        all.note(
            "robust: no ray slips through between two triangles, as in ours; structures of high quality",
        );
        let title = "ours against Embree, the better version, robust: rays a second, times Embree's";
        let heads = ["scene", "radius", "what", "ours", "Embree", "ratio", "of the best"];
        let mut ratios = Table::new("ratios", title, &heads);
        ratios.note("best: the fastest of ours and of Embree's modes that use no wider vectors");
        ratios.note("ratio: of laps of the same round; of the best: between the best laps of all rounds");
        Self { all, ratios, aims: Vec::new(), charts: Vec::new() }
    }

    pub(super) fn note(&mut self, note: &str) {
        self.all.note(note);
    }

    /// Adds the races on one subject, each with the distance of the eye.
    pub(super) fn add(&mut self, subject: &Subject, races: &[(f32, Race)]) {
        for (radius, race) in races {
            let view = View { subject, radius: *radius, race };
            race.standings.iter().for_each(|standing| self.all.push(view.row(standing)));
            self.all.note(format!("{} {radius}: {}", subject.name, race.note));
            Level::compared().into_iter().for_each(|level| self.compare_best(&view, level));
            self.compare_rays(&view);
        }
        self.charts.push(chart(subject, races));
    }

    /// Compares the best of both with vectors of this width.
    fn compare_best(&mut self, view: &View<'_>, level: Level) {
        let embree = view.race.best(|entrant| entrant.is_robust_embree() && entrant.level == level);
        let ours = view.race.best(|entrant| entrant.is_ours() && entrant.level <= level);
        let widest_min = view.subject.ratio_min;
        let limit = if level == Level::Avx512 { widest_min } else { widest_min.map(|_| AVX2_RATIO_MIN) };
        self.compare(view, &format!("best, {}", level.name()), [ours, embree], limit);
    }

    /// Compares our ray kernel with Embree's single ray of the better version.
    fn compare_rays(&mut self, view: &View<'_>) {
        let is_ray = |entrant: &Entrant| matches!(entrant.way, Way::Ours(kernel) if kernel.is_ray());
        let is_single = |entrant: &Entrant| {
            entrant.is_robust_embree() && matches!(entrant.way, Way::Embree { mode: Mode::Single, .. })
        };
        let limit = view.subject.ratio_min.map(|_| RAY_RATIO_MIN);
        self.compare(view, "ray by ray", [view.race.best(is_ray), view.race.best(is_single)], limit);
    }

    /// Adds a row, and an aim where a limit is set, if both are there.
    fn compare(
        &mut self,
        view: &View<'_>,
        what: &str,
        [ours, embree]: [Option<&Standing>; 2],
        limit: Option<f64>,
    ) {
        let (Some(ours), Some(embree)) = (ours, embree) else { return };
        let ratio = ours.ratio_to(embree);
        self.ratios.push(vec![
            Cell::text(&*view.subject.name),
            Cell::Number(view.radius.into(), 2),
            Cell::text(what),
            Cell::text(&*ours.entrant.name),
            Cell::text(format!("{}, {}", embree.entrant.name, embree.entrant.level.name())),
            Cell::Spread(ratio, 2),
            Cell::Number(ours.best(Lap::mrays) / embree.best(Lap::mrays), 2),
        ]);
        let what = format!("{} {}: ours against Embree, {what}", view.subject.name, view.radius);
        self.aims.extend(limit.map(|limit| Aim::at_least(what, ratio.median, limit)));
    }

    /// The charts, the tables with anything in them, and the aims.
    pub(super) fn finish(self) -> (Vec<Chart>, Vec<Table>, Vec<Aim>) {
        let tables = [self.all, self.ratios].into_iter().filter(|table| !table.is_empty());
        (self.charts, tables.collect(), self.aims)
    }
}

/// A race and what it was about.
#[derive(Debug)]
struct View<'a> {
    subject: &'a Subject,
    radius: f32,
    race: &'a Race,
}

impl View<'_> {
    fn row(&self, standing: &Standing) -> Vec<Cell> {
        let frames = standing.frames as f64;
        vec![
            Cell::text(&*self.subject.name),
            Cell::Number(self.radius.into(), 2),
            Cell::text(standing.entrant.level.name()),
            Cell::text(&*standing.entrant.name),
            Cell::Spread(standing.spread(Lap::mrays), 2),
            Cell::Number(standing.best(Lap::mrays), 2),
            Cell::Number(standing.spread(Lap::primary_mrays).median, 2),
            Cell::Number(standing.spread(Lap::shadow_mrays).median, 2),
            Cell::Number(standing.spread(|lap| lap.whole.time.cpu_ms).median / frames, 2),
            Cell::Number(standing.spread(|lap| lap.whole.time.wall_ms).median / frames, 2),
        ]
    }
}

/// Rays a second over the distance of the eye: ours, and Embree in all modes with the widest vectors.
fn chart(subject: &Subject, races: &[(f32, Race)]) -> Chart {
    let widest = Level::compared()[0];
    let is_shown =
        |entrant: &Entrant| entrant.is_ours() || entrant.is_robust_embree() && entrant.level == widest;
    let shown = races.first().into_iter().flat_map(|(_, race)| race.standings.iter().enumerate());
    let line = |(index, standing): (usize, &Standing)| {
        let rate = |(radius, race): &(f32, Race)| {
            (f64::from(*radius), race.standings[index].spread(Lap::mrays).median)
        };
        Line { name: standing.entrant.name.clone(), points: races.iter().map(rate).collect() }
    };
    Chart {
        title: subject.name.clone(),
        x: Axis { label: "distance of the eye, in diagonals", is_logarithmic: false },
        y: Axis { label: "Mrays/s, all rays", is_logarithmic: false },
        lines: shown.filter(|(_, standing)| is_shown(&standing.entrant)).map(line).collect(),
    }
}
