//! What a run prints, and what it writes as JSON.

use core::fmt::{self, Display, Write as _};

use serde::{Deserialize, Serialize};

use crate::loss::Loss;
use crate::size::Bytes;

/// Everything a run has to tell; the shape of `run.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunReport {
    /// The command line, as it was given.
    pub command: Vec<String>,
    /// The scene.
    pub scene: SceneReport,
    /// What was looked at: how the session was made, or the file it came from.
    #[serde(default)]
    pub session: String,
    /// Which of its moments were drawn: `frames` for all, `time` for those whose time had come.
    #[serde(default)]
    pub replay: String,
    /// The picture's width and height in pixels.
    pub size: [u32; 2],
    /// How pages travel: `shm` or `shm-ring`.
    pub transport: String,
    /// How tiles came to nodes: `static`, `demand:2`, `steal` or `steal-near`.
    #[serde(default)]
    pub balance: String,
    /// Threads that put the pictures together.
    #[serde(default = "one_display")]
    pub displays: u16,
    /// One entry for each frame, in order.
    pub frames: Vec<FrameReport>,
    /// One entry for each process that saw the end, in order of its number.
    pub nodes: Vec<ProcessReport>,
    /// Copies of each page.
    #[serde(default = "one")]
    pub replicas: u8,
    /// Processes that died while the others went on; they are missing among `nodes`.
    #[serde(default)]
    pub losses: Vec<Loss>,
    /// Sums over the run.
    pub totals: Totals,
}

/// The scene of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneReport {
    /// Where it came from.
    pub name: String,
    /// Triangles of the model.
    pub triangles: u64,
    /// Spheres of the model.
    #[serde(default)]
    pub spheres: u64,
    /// Length of the scene image.
    pub image_bytes: u64,
    /// Pages of the run; they may be larger than those the image was made for.
    pub pages: u32,
    /// Length of a page.
    pub page_bytes: u32,
    /// What it uses, by name.
    pub needs: String,
    /// Samples of its volume along each axis, if it has one.
    #[serde(default)]
    pub volume: Option<[u32; 3]>,
    /// Values of the isosurfaces shown in the first frame.
    #[serde(default)]
    pub isovalues: Vec<f32>,
    /// What was not taken as it stands in a volume's file.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// One frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameReport {
    /// Its number.
    pub frame: u32,
    /// The moment of the session that it shows, counted from 0.
    #[serde(default)]
    pub moment: u32,
    /// That moment's time in seconds, as the session has it.
    #[serde(default)]
    pub time: f64,
    /// Values of the isosurfaces shown.
    #[serde(default)]
    pub isovalues: Vec<f32>,
    /// From sending the camera until the last tile was in place, in milliseconds.
    pub ms: f64,
    /// Hash of its pixels: XXH3, 64 bits, in hexadecimal.
    pub image_hash: String,
    /// Rays from the eye.
    pub primary_rays: u64,
    /// Rays from the eye that met a surface.
    pub hits: u64,
    /// Rays towards the light.
    pub shadow_rays: u64,
    /// Rays towards the light that reached it.
    pub lit: u64,
    /// Pixels whose ray met records that contradict the image's header.
    pub damaged_pixels: u64,
    /// Tiles that another node drew than the one they were dealt to.
    #[serde(default)]
    pub moved_tiles: u32,
    /// Time that the displays spent in communication: taking tiles and putting them in place, in milliseconds, summed
    /// over the displays.
    #[serde(default)]
    pub gather_ms: f64,
    /// Parcels in which the tiles came.
    #[serde(default)]
    pub gather_parcels: u64,
    /// Bytes in which the tiles came.
    #[serde(default)]
    pub gather_bytes: u64,
    /// Tiles that were not as in the frame before.
    #[serde(default)]
    pub changed_tiles: u64,
}

/// One process.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ProcessReport {
    /// Its number.
    pub node: u16,
    /// `node` renders, `store` only holds pages.
    pub role: String,
    /// Threads that render.
    pub threads: u16,
    /// What it may hold: pages of its own, slots and the tables for both.
    pub budget_bytes: u64,
    /// Pages of its own: those it is home to, and replicas.
    pub home_pages: u32,
    /// Pages of others it can hold at once.
    pub slots: u32,
    /// Slots asked for that the backend cannot manage on this system.
    pub slots_withheld: u32,
    /// What home pages, slots and tables take when all are in use.
    pub held_bytes_max: u64,
    /// Most memory that was ever resident, measured by the system (`VmHWM`).
    pub peak_resident_bytes: u64,
    /// Of these, what is mapped from files (`RssFile`): the program and its libraries, which all processes share. A
    /// node maps no file of the scene.
    pub program_bytes: u64,
    /// The backend in use: `uffd`, `segv`, `soft` or `replicated`; empty for a store.
    pub backend: String,
    /// Backends that the system refused, and why.
    pub backends_declined: Vec<String>,
    /// The kernel in use: `rays`, or beams with `portable`, `avx2` or `avx512` lanes; empty for a store.
    pub kernel: String,
    /// The replacement policy in use; empty where nothing is replaced.
    pub policy: String,
    /// How the policy learned which pages are used: `none`, `hints` or `soft-faults`.
    #[serde(default)]
    pub reference: String,
    /// Loads that met an absent page.
    pub faults: u64,
    /// Of those, the ones that found another thread fetching the page.
    pub merged_faults: u64,
    /// Pages fetched from other processes.
    pub fetched_pages: u64,
    /// Bytes of those pages.
    pub received_bytes: u64,
    /// Pages that had to leave for them.
    pub evictions: u64,
    /// Faults that found the page hidden and sent no message.
    #[serde(default)]
    pub soft_faults: u64,
    /// Pages asked for before anybody touched them.
    #[serde(default)]
    pub prefetched: u64,
    /// Of those, pages that were used.
    #[serde(default)]
    pub prefetch_used: u64,
    /// Of those, pages that left unused.
    #[serde(default)]
    pub prefetch_wasted: u64,
    /// Of the pages asked for, those that came along with one that they follow; the others were expected of a tile.
    #[serde(default)]
    pub neighbours: u64,
    /// Of those, pages that were used.
    #[serde(default)]
    pub neighbours_used: u64,
    /// Of those, pages that left unused.
    #[serde(default)]
    pub neighbours_wasted: u64,
    /// Requests sent again.
    pub resends: u64,
    /// Median time of a miss, from the fault to the page's presence, in microseconds.
    pub miss_p50_us: f64,
    /// The time that 99 of 100 misses stay below, in microseconds.
    pub miss_p99_us: f64,
    /// Pages granted to others, where a server thread does that.
    pub granted_pages: u64,
    /// Tiles drawn.
    #[serde(default)]
    pub tiles_drawn: u64,
    /// Tiles taken from other nodes.
    #[serde(default)]
    pub tiles_taken: u64,
    /// Tiles given to other nodes.
    #[serde(default)]
    pub tiles_given: u64,
    /// Time spent drawing, over all threads and frames, in milliseconds.
    #[serde(default)]
    pub busy_ms: f64,
    /// Time in which threads had nothing to draw since the first tile, over all threads and frames, in milliseconds.
    #[serde(default)]
    pub idle_ms: f64,
}

/// Sums over all frames and nodes.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Totals {
    /// Wall time of all frames, in milliseconds.
    pub frames_ms: f64,
    /// Frames per second.
    pub frames_per_second: f64,
    /// Rays of both kinds.
    pub rays: u64,
    /// Millions of rays per second.
    pub mrays_per_second: f64,
    /// Time that the displays spent in communication, in milliseconds.
    #[serde(default)]
    pub gather_ms: f64,
    /// Bytes in which the tiles came.
    #[serde(default)]
    pub gather_bytes: u64,
    /// Pages fetched.
    pub fetched_pages: u64,
    /// Bytes of those pages.
    pub received_bytes: u64,
    /// Pages that had to leave.
    pub evictions: u64,
    /// Most memory resident beyond what was planned to be held and the program, over all processes.
    pub overhead_bytes_max: u64,
}

impl ProcessReport {
    /// Memory resident beyond home pages, slots, tables and the program: stacks, buffers, the allocator's own.
    #[must_use]
    pub const fn overhead_bytes(&self) -> u64 {
        self.peak_resident_bytes.saturating_sub(self.held_bytes_max).saturating_sub(self.program_bytes)
    }
}

impl Totals {
    /// Adds up frames and processes.
    #[must_use]
    pub fn of(frames: &[FrameReport], nodes: &[ProcessReport]) -> Self {
        let frames_ms: f64 = frames.iter().map(|frame| frame.ms).sum();
        let rays = frames.iter().map(|frame| frame.primary_rays + frame.shadow_rays).sum();
        let per_second = |count: f64| if frames_ms > 0.0 { count / (frames_ms / 1000.0) } else { 0.0 };
        let sum = |count: fn(&ProcessReport) -> u64| nodes.iter().map(count).sum();
        Self {
            frames_ms,
            frames_per_second: per_second(frames.len() as f64),
            rays,
            mrays_per_second: per_second(rays as f64) / 1e6,
            gather_ms: frames.iter().map(|frame| frame.gather_ms).sum(),
            gather_bytes: frames.iter().map(|frame| frame.gather_bytes).sum(),
            fetched_pages: sum(|node| node.fetched_pages),
            received_bytes: sum(|node| node.received_bytes),
            evictions: sum(|node| node.evictions),
            overhead_bytes_max: nodes.iter().map(ProcessReport::overhead_bytes).max().unwrap_or(0),
        }
    }
}

/// The report as people read it in a terminal.
impl Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scene, totals, .. } = self;
        writeln!(
            f,
            "{}: {}, image of {} in {} pages of {}",
            scene.name,
            counted(scene.triangles, scene.spheres, scene.volume),
            Bytes(scene.image_bytes),
            thousands(scene.pages.into()),
            Bytes(scene.page_bytes.into()),
        )?;
        if let Some(last) = self.frames.last().filter(|last| !last.isovalues.is_empty()) {
            let isovalues = |values: &[f32]| values.iter().map(f32::to_string).collect::<Vec<_>>().join(", ");
            write!(f, "isovalues {}", isovalues(&scene.isovalues))?;
            if last.isovalues != scene.isovalues {
                write!(f, "; in the last frame {}", isovalues(&last.isovalues))?;
            }
            writeln!(f)?;
        }
        scene.notes.iter().try_for_each(|note| writeln!(f, "note: {note}"))?;
        writeln!(f)?;
        writeln!(f, "frame        ms   hits   shadow rays   image")?;
        for frame in &self.frames {
            let share = |count: u64| 100.0 * count as f64 / frame.primary_rays.max(1) as f64;
            writeln!(
                f,
                "{:5} {:9.1} {:5.1}% {:12.1}%   {}",
                frame.frame,
                frame.ms,
                share(frame.hits),
                share(frame.shadow_rays),
                frame.image_hash
            )?;
        }
        writeln!(f)?;
        writeln!(f, "{}", table(&self.nodes))?;
        self.write_balance(f)?;
        write!(
            f,
            "{:.1} frames/s, {:.2} Mrays/s; fetched {} pages ({}), evicted {}; at most {} resident beyond what is held and the program",
            totals.frames_per_second,
            totals.mrays_per_second,
            thousands(totals.fetched_pages),
            Bytes(totals.received_bytes),
            thousands(totals.evictions),
            Bytes(totals.overhead_bytes_max),
        )?;
        let of_frames = |sum: f64| sum / self.frames.len().max(1) as f64;
        let pixels = u64::from(self.size[0]) * u64::from(self.size[1]);
        let sent = totals.gather_bytes as f64 / (pixels * self.frames.len().max(1) as u64) as f64;
        write!(
            f,
            "\ngathered by {}: {:.3} ms in communication a frame, {:.1} % of the pixels' bytes",
            if self.displays == 1 { "1 display".to_owned() } else { format!("{} displays", self.displays) },
            of_frames(totals.gather_ms),
            100.0 * sent,
        )?;
        let declined: Vec<&String> = self.nodes.iter().flat_map(|node| &node.backends_declined).collect();
        if let Some(first) = declined.first() {
            write!(f, "\nbackends refused by the system: {first}")?;
        }
        let withheld: u32 = self.nodes.iter().map(|node| node.slots_withheld).sum();
        if withheld > 0 {
            write!(
                f,
                "\n{} slots are not used: segv needs a mapping for each page, and the system allows no more (vm.max_map_count)",
                thousands(withheld.into())
            )?;
        }
        for loss in &self.losses {
            write!(f, "\nwarning: {loss}")?;
        }
        let damaged: u64 = self.frames.iter().map(|frame| frame.damaged_pixels).sum();
        if damaged > 0 {
            write!(
                f,
                "\nwarning: {} pixels met records that contradict the image; prepare it anew",
                thousands(damaged)
            )?;
        }
        Ok(())
    }
}

/// The copies of each page in a report that does not say.
const fn one() -> u8 {
    1
}

/// The displays of a report that does not say.
const fn one_display() -> u16 {
    1
}

/// One row for each process, its columns as wide as they need to be.
impl RunReport {
    /// Who drew how much, and how many tiles changed hands, if there is more than one node.
    fn write_balance(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let nodes: Vec<&ProcessReport> = self.nodes.iter().filter(|node| node.role == "node").collect();
        if nodes.len() < 2 {
            return Ok(());
        }
        let frames = self.frames.len().max(1) as f64;
        let list = |of: &dyn Fn(&ProcessReport) -> String| -> String {
            nodes.iter().map(|node| of(node)).collect::<Vec<_>>().join(" ")
        };
        let per_thread = |node: &ProcessReport, ms: f64| ms / frames / f64::from(node.threads.max(1));
        let moved: u32 = self.frames.iter().map(|frame| frame.moved_tiles).sum();
        writeln!(
            f,
            "{}: tiles drawn {}, taken from others {}; idle {} ms a frame and thread; {:.1} tiles moved a frame",
            self.balance,
            list(&|node| thousands(node.tiles_drawn)),
            list(&|node| thousands(node.tiles_taken)),
            list(&|node| format!("{:.1}", per_thread(node, node.idle_ms))),
            f64::from(moved) / frames,
        )
    }
}

fn table(nodes: &[ProcessReport]) -> String {
    let heads = [
        "",
        "may hold",
        "home",
        "slots",
        "peak",
        "faults",
        "fetched",
        "received",
        "evicted",
        "merged",
        "ahead/used/wasted",
        "miss p50/p99",
        "paging",
    ];
    let mut rows = vec![heads.map(String::from)];
    rows.extend(nodes.iter().map(|node| {
        [
            format!("{} {}", node.role, node.node),
            Bytes(node.budget_bytes).to_string(),
            thousands(node.home_pages.into()),
            thousands(node.slots.into()),
            Bytes(node.peak_resident_bytes).to_string(),
            thousands(node.faults),
            thousands(node.fetched_pages),
            Bytes(node.received_bytes).to_string(),
            thousands(node.evictions),
            thousands(node.merged_faults),
            ahead(node),
            format!("{:.1} / {:.1} us", node.miss_p50_us, node.miss_p99_us),
            format!("{} {} {}", node.backend, node.policy, node.reference).trim().to_owned(),
        ]
    }));
    let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..heads.len()).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        for (cell, width) in row.iter().zip(&widths) {
            let _ = write!(text, "{cell:>width$}  ");
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}

/// Pages asked for before they were touched, and what became of them: the rest are still there. A dash for none.
fn ahead(node: &ProcessReport) -> String {
    if node.prefetched == 0 {
        return "-".to_owned();
    }
    [node.prefetched, node.prefetch_used, node.prefetch_wasted].map(thousands).join(" / ")
}

/// How many triangles, spheres and samples, of what there are.
pub(crate) fn counted(triangles: u64, spheres: u64, volume: Option<[u32; 3]>) -> String {
    let of = |count: u64, what: &str| (count > 0).then(|| format!("{} {what}", thousands(count)));
    let samples = volume.map(|[x, y, z]| format!("a volume of {x}x{y}x{z} samples"));
    let parts = [of(triangles, "triangles"), of(spheres, "spheres"), samples];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" and ")
}

/// A count with a gap after every three digits: `1 234 567`.
pub(crate) fn thousands(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_gaps() {
        let printed = [0, 999, 1000, 1_234_567].map(thousands);
        assert_eq!(printed, ["0", "999", "1 000", "1 234 567"]);
    }

    #[test]
    fn totals_add_up() {
        let frame = FrameReport {
            frame: 0,
            moment: 0,
            time: 0.0,
            isovalues: Vec::new(),
            ms: 500.0,
            image_hash: String::new(),
            primary_rays: 600_000,
            hits: 1,
            shadow_rays: 400_000,
            lit: 1,
            damaged_pixels: 0,
            moved_tiles: 0,
            gather_ms: 0.5,
            gather_parcels: 1,
            gather_bytes: 7,
            changed_tiles: 1,
        };
        let node = ProcessReport {
            fetched_pages: 3,
            held_bytes_max: 10,
            peak_resident_bytes: 17,
            program_bytes: 5,
            ..ProcessReport::default()
        };
        let totals = Totals::of(&[frame.clone(), frame], &[node.clone(), node]);
        assert_eq!((totals.frames_per_second, totals.mrays_per_second), (2.0, 2.0));
        assert_eq!((totals.gather_ms, totals.gather_bytes), (1.0, 14));
        assert_eq!((totals.fetched_pages, totals.overhead_bytes_max), (6, 2));
    }
}
