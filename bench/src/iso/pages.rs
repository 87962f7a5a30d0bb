//! Pages that a frame touches, and the pages of what it shows.
//!
//! A brick that a ray ends in has to be read. Whatever else is touched was looked at for nothing: bricks that the
//! isovalue lies in and the ray passes by the surface, and bricks on its way that it did not have to look at.

use core::cell::Cell as Place;
use std::collections::BTreeSet;

use anyhow::{Context, Result, ensure};
use kernels::Draw;
use kernels::noted::{Noted, Notes};
use rt_core::{Flat, Frame, Kernel, Ray, SceneMemory, SceneView, TILE_SIZE, TileCounts, Tiles};

use super::{Amount, RADIUS, Stand};
use crate::findings::Aim;
use crate::table::{Cell, Table};

/// What was counted so far.
pub(super) struct Pages {
    table: Table,
    aims: Vec<Aim>,
}

/// Pages of bricks that are touched, in those that rays end in.
const TOUCHED_MAX: f64 = 1.3;

impl Pages {
    pub(super) fn new(Amount { size, .. }: Amount) -> Self {
        let title =
            format!("pages touched by a frame without shadows: {size}x{size}, from {RADIUS} diagonals");
        let heads =
            ["volume", "program", "pages", "of the tree", "of bricks", "of bricks that rays end in", "ratio"];
        let table = Table::new("iso_pages", title, &heads);
        Self { table, aims: Vec::new() }
    }

    pub(super) fn count(&mut self, stand: &Stand<'_>) -> Result<()> {
        let frame = stand.frames(stand.subject.isovalue)?[0];
        let frame = Frame { flags: frame.flags | Frame::NO_SHADOWS, ..frame };
        let header = stand.scene.header();
        let ends = ends(stand.image, header.page_bytes, &frame)?;
        for kernel in [Kernel::fastest(), Kernel::rays()] {
            let touched = touched(stand.image, header.page_bytes, &frame, kernel)?;
            self.add(stand, kernel, &touched, &ends)?;
        }
        Ok(())
    }

    fn add(
        &mut self,
        stand: &Stand<'_>,
        kernel: Kernel,
        touched: &BTreeSet<u64>,
        ends: &BTreeSet<u64>,
    ) -> Result<()> {
        let header = stand.scene.header();
        let first_of_bricks = header.segments.bricks.offset / u64::from(header.page_bytes);
        ensure!(ends.is_subset(touched), "a ray ends in a page that no tile has touched");
        let bricks = touched.range(first_of_bricks..).count();
        let ratio = bricks as f64 / ends.len().max(1) as f64;
        let name = &stand.subject.name;
        let all = header.image_bytes / u64::from(header.page_bytes);
        let counts = [all, (touched.len() - bricks) as u64, bricks as u64, ends.len() as u64];
        let names = vec![Cell::text(&**name), Cell::text(format!("ours, {kernel}"))];
        self.table.push([names, counts.map(Cell::Count).into(), vec![Cell::Number(ratio, 2)]].concat());
        let what = format!("{name}, {kernel}: pages of bricks touched, in those that rays end in");
        self.aims.push(Aim::at_most(what, ratio, TOUCHED_MAX));
        Ok(())
    }

    pub(super) fn finish(self) -> (Table, Vec<Aim>) {
        (self.table, self.aims)
    }
}

/// The pages that drawing a frame touches.
fn touched(image: &[u8], page_bytes: u32, frame: &Frame, kernel: Kernel) -> Result<BTreeSet<u64>> {
    let notes = Notes::new(page_bytes, image.len() as u64);
    let scene = SceneView::new(Noted::new(Flat::new(image), &notes))?;
    let tiles = Tiles::of(frame.width, frame.height);
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    let mut counts = TileCounts::default();
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        counts += Draw::render_tile(&scene, frame, tile, kernel, &mut pixels[..tile.pixels()]);
    }
    ensure!(counts.damaged == 0 && counts.hits > 0, "{counts:?}");
    let mut touched = BTreeSet::new();
    notes.take(|pages| touched.extend(pages.iter().map(|page| u64::from(page.0))));
    Ok(touched)
}

/// The pages of the bricks that rays of a frame end in.
fn ends(image: &[u8], page_bytes: u32, frame: &Frame) -> Result<BTreeSet<u64>> {
    let scene = SceneView::new(Latest { memory: Flat::new(image), offset: Place::new(0) })?;
    let values: Vec<f32> = frame.isosurfaces().iter().map(|surface| surface.value).collect();
    let surfaces =
        scene.isosurfaces(&values, frame.solver())?.context("nothing of this value in the volume")?;
    let mut pages = BTreeSet::new();
    for y in 0..frame.height {
        let row = frame.camera.row(y);
        for x in 0..frame.width {
            let direction = frame.camera.direction(row, x);
            let ray = Ray { origin: frame.camera.eye, direction, t_max: f32::INFINITY };
            if surfaces.nearest(&ray, &mut ())?.is_some() {
                // The last record that a ray reads is the brick that it ends in.
                pages.insert(scene.memory().offset.get() / u64::from(page_bytes));
            }
        }
    }
    Ok(pages)
}

/// A memory that knows which record was read last.
#[derive(Debug)]
struct Latest<'a> {
    memory: Flat<'a>,
    offset: Place<u64>,
}

impl SceneMemory for Latest<'_> {
    type Record<'b>
        = &'b [u8]
    where
        Self: 'b;

    fn record(&self, offset: u64, length: usize) -> Option<&[u8]> {
        self.offset.set(offset);
        self.memory.record(offset, length)
    }

    fn length(&self) -> u64 {
        self.memory.length()
    }
}
