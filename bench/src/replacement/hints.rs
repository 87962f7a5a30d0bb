//! What hints cost: the same tiles drawn with and without noting which pages they use.

use anyhow::{Result, ensure};
use dsm_core::id::PageId;
use dsm_core::page_sets::{PageSetStorage, PageSets, SetEntry, TileEntry};
use dsm_core::replacement::{Policy, PolicyKind, Replay};
use dsm_core::storage::SlotEntry;
use kernels::Draw;
use kernels::noted::{Noted, Notes};
use rt_core::camera::OrbitPlace;
use rt_core::schedule::Static;
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TILE_SIZE, TileId, Tiles};
use rustix::time::{ClockId, clock_gettime};
use scene::{BuildOptions, Mesh, build, builtin, read_mesh};

use crate::data;
use crate::experiment::Effort;
use crate::findings::Aim;
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// What hints may cost of a frame, in per cent.
const COST_MAX: f64 = 1.0;

const PAGE_BYTES: u32 = 16 << 10;

/// Times one frame of each scene with and without hints, in turns, by the processor time of this thread.
pub(super) fn measure(effort: Effort) -> Result<(Table, Vec<Aim>)> {
    let heads = ["scene", "pages of a tile", "ms a frame", "of it noting pages, %", "cost of hints, %"];
    let mut table = Table::new("hints", "What it costs to tell the policy which pages tiles use", &heads);
    let mut aims = Vec::new();
    for (name, mesh) in meshes(effort)? {
        let bytes = build(mesh, &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?;
        let Cost { plain_ms, noting, cost, pages } = compare(&bytes, effort)?;
        aims.push(Aim::at_most(format!("{name}: cost of hints, in % of a frame"), cost.median, COST_MAX));
        table.push(vec![
            Cell::text(name),
            Cell::Number(pages, 1),
            Cell::Spread(plain_ms, 1),
            Cell::Spread(noting, 2),
            Cell::Spread(cost, 2),
        ]);
    }
    table.note("noting pages, telling recall, and keeping the page sets; one thread, all pages resident");
    Ok((table, aims))
}

fn meshes(effort: Effort) -> Result<Vec<(&'static str, Mesh)>> {
    let mut meshes = vec![("knot", builtin::knot(effort.pick(600_000, 60_000)))];
    if let Some(path) = data::mesh_file("dragon", effort) {
        meshes.push(("dragon", read_mesh(&path)?));
    }
    Ok(meshes)
}

/// What hints cost of one scene.
struct Cost {
    /// Milliseconds of a plain frame.
    plain_ms: Spread,
    /// What noting pages adds to it, in per cent, when nobody wants to know them.
    noting: Spread,
    /// What hints add to it.
    cost: Spread,
    /// Pages of a tile.
    pages: f64,
}

fn compare(bytes: &[u8], effort: Effort) -> Result<Cost> {
    // So that the kernel reads the same with and without.
    let notes = Notes::new(PAGE_BYTES, bytes.len() as u64).with_misses(false);
    let plain = SceneView::new(Flat::new(bytes))?;
    let noted = SceneView::new(Noted::new(Flat::new(bytes), &notes))?;
    let size = effort.pick(512, 96);
    let place = OrbitPlace { radius: 0.75, elevation: 0.0, frame: 1, frames: 180 };
    let frame = Frame::on_orbit(&Orbit::around(&plain.header().view), &place, size, size)?;
    let mut listener = Listener::new(bytes.len().div_ceil(PAGE_BYTES as usize));
    let (mut plain_ms, mut noting, mut costs) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..effort.pick(31, 2) {
        let without = draw(&plain, &frame, |_| {});
        let only_noted = draw(&noted, &frame, |_| notes.take(|_| {}));
        let start = processor_ms();
        listener.begin(&frame);
        let begin_ms = processor_ms() - start;
        let with = draw(&noted, &frame, |tile| notes.take(|pages| listener.end_tile(tile, pages)));
        ensure!(without.picture == with.picture, "SAME_IMAGE: hints change the picture");
        plain_ms.push(without.ms);
        noting.push(100.0 * (only_noted.ms / without.ms - 1.0));
        costs.push(100.0 * ((begin_ms + with.ms) / without.ms - 1.0));
    }
    let tiles = f64::from(Tiles::of(size, size).count() * effort.pick(31, 2));
    let pages = listener.heard as f64 / tiles;
    Ok(Cost { plain_ms: Spread::of(&plain_ms), noting: Spread::of(&noting), cost: Spread::of(&costs), pages })
}

/// A frame that was drawn, and the processor time it took.
struct Drawn {
    picture: Vec<u8>,
    ms: f64,
}

fn draw<M: Draw>(scene: &SceneView<M>, frame: &Frame, mut after: impl FnMut(TileId)) -> Drawn {
    let tiles = Tiles::of(frame.width, frame.height);
    let mut picture = Vec::with_capacity(frame.width as usize * frame.height as usize);
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    let kernel = Kernel::fastest();
    let start = processor_ms();
    for id in Static::new(tiles, 1).drawing_order(0, frame.number) {
        let Some(tile) = tiles.get(id) else { continue };
        Draw::render_tile(scene, frame, tile, kernel, &mut pixels[..tile.pixels()]);
        picture.extend_from_slice(&pixels[..tile.pixels()]);
        after(id);
    }
    Drawn { picture, ms: processor_ms() - start }
}

fn processor_ms() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

/// What a node does with hints.
struct Listener {
    cache: Replay<'static, Policy>,
    sets: PageSets<'static>,
    heard: u64,
}

impl Listener {
    /// With a slot for each page. Leaked: there are two of them in the life of this process.
    fn new(pages: usize) -> Self {
        const ENTRIES: usize = 128 << 10;
        const TILES: usize = 1024;
        let storage = PageSetStorage {
            entries: vec![SetEntry::EMPTY; ENTRIES].leak(),
            tiles: vec![TileEntry::EMPTY; TILES].leak(),
            next_uses: vec![0; pages].leak(),
        };
        let slots = vec![SlotEntry::EMPTY; pages].leak();
        let mut cache = Replay::new(vec![0; pages].leak(), slots, Policy::new(PolicyKind::Recall, 1), 0);
        for page in (0..).map(PageId).take(pages) {
            let _ = cache.touch(page);
        }
        Self { cache, sets: PageSets::new(storage), heard: 0 }
    }

    fn begin(&mut self, frame: &Frame) {
        let tiles = Tiles::of(frame.width, frame.height);
        let order: Vec<u32> =
            Static::new(tiles, 1).drawing_order(0, frame.number).map(|tile| tile.0).collect();
        self.sets.begin_frame(&order, |page, when| self.cache.forecast(page, when));
    }

    fn end_tile(&mut self, tile: TileId, pages: &[PageId]) {
        self.heard += pages.len() as u64;
        self.cache.clock(self.sets.place_of(tile.0), self.sets.frame_end());
        pages.iter().for_each(|page| self.cache.hint(*page));
        self.sets.finish_tile(tile.0, pages, |page, when| self.cache.forecast(page, when));
    }
}
