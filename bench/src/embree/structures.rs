//! What building takes, and the memory of what is built.

use anyhow::Result;
use scene::{BuildOptions, Model, build};

use super::Amount;
use super::subject::Subject;
use crate::findings::Aim;
use crate::peers::embree::{Built, Edges, Peer, Quality, Structure};
use crate::peers::stopwatch::{self, Elapsed};
use crate::spread::Spread;
use crate::table::{Cell, Table};

/// The structures that were built so far.
#[derive(Debug)]
pub(super) struct Structures {
    builds: usize,
    table: Table,
    aims: Vec<Aim>,
}

/// Bytes of our image, for each triangle.
const BYTES_MAX: f64 = 22.0;

/// The structures of Embree; those of high quality are drawn with.
const OF_EMBREE: [Structure; 4] = [
    Edges::Fast.of(Quality::Medium),
    Edges::Robust.of(Quality::Medium),
    Edges::Fast.of(Quality::High),
    Edges::Robust.of(Quality::High),
];

const PAGE_BYTES: u32 = 16 << 10;

impl Structures {
    pub(super) fn new(Amount { builds, .. }: Amount) -> Self {
        let heads = ["scene", "structure", "build ms", "primitives/s", "bytes/primitive", "with arrays"];
        let title = format!("building with one thread, {builds} times, and the bytes that then are held");
        let mut table = Table::new("structures", title, &heads);
        table.note("build ms: processor time; of ours, to the bytes of the image");
        table.note(
            "with arrays: Embree's structure and the arrays of vertices and indices that it reads; our image holds all",
        );
        Self { builds, table, aims: Vec::new() }
    }

    /// Builds a subject by everybody. Returns our image.
    pub(super) fn build(&mut self, subject: &Subject, peers: &mut [Peer]) -> Result<Vec<u8>> {
        let widest = peers.iter().map(|peer| peer.level).max();
        let (peers, narrower): (Vec<_>, Vec<_>) =
            peers.iter_mut().partition(|peer| Some(peer.level) == widest);
        // Their builders differ little; they only need something to draw.
        for peer in narrower {
            peer.build(Edges::Robust.of(Quality::High))?;
        }
        let (mut ours, mut image) = (Vec::new(), Vec::new());
        let mut theirs: Vec<_> = peers.into_iter().map(|peer| (peer, [const { Vec::new() }; 4])).collect();
        for _ in 0..self.builds {
            let (time, bytes) = prepare(subject)?;
            ours.push(time.cpu_ms);
            image = bytes;
            for (peer, builds) in &mut theirs {
                for (structure, builds) in OF_EMBREE.into_iter().zip(builds) {
                    builds.push(peer.build(structure)?);
                }
            }
        }
        self.add_ours(subject, &ours, &image);
        theirs.iter().for_each(|(peer, builds)| self.add_embree(subject, &peer.name, builds));
        Ok(image)
    }

    fn add_ours(&mut self, subject: &Subject, times_ms: &[f64], image: &[u8]) {
        let bytes = image.len() as f64 / subject.primitives() as f64;
        self.add_row(subject, "ours".to_owned(), times_ms, [bytes; 2]);
        // The few spheres of the flake fill few pages; the rest of these counts for each sphere.
        if subject.model.spheres.is_empty() {
            let what = format!("{}: bytes of our image a triangle", subject.name);
            self.aims.push(Aim::at_most(what, bytes, BYTES_MAX));
        }
    }

    fn add_embree(&mut self, subject: &Subject, name: &str, builds: &[Vec<Built>; 4]) {
        let arrays = subject.model.bytes();
        for (Structure { edges, quality }, builds) in OF_EMBREE.into_iter().zip(builds) {
            let name = format!("{name}, {}, {}", quality.name(), edges.name());
            let times_ms: Vec<f64> = builds.iter().map(|built| built.time.cpu_ms).collect();
            let bytes = builds.last().map_or(0, |built| built.bytes);
            let each = |bytes: u64| bytes as f64 / subject.primitives() as f64;
            self.add_row(subject, name, &times_ms, [each(bytes), each(bytes + arrays)]);
        }
    }

    fn add_row(&mut self, subject: &Subject, name: String, times_ms: &[f64], [bytes, with_arrays]: [f64; 2]) {
        let build_ms = Spread::of(times_ms);
        self.table.push(vec![
            Cell::text(&*subject.name),
            Cell::text(name),
            Cell::Spread(build_ms, 2),
            Cell::Number(subject.primitives() as f64 / build_ms.median * 1e3, 0),
            Cell::Number(bytes, 1),
            Cell::Number(with_arrays, 1),
        ]);
    }

    /// The table and the aims.
    pub(super) fn finish(self) -> (Table, Vec<Aim>) {
        (self.table, self.aims)
    }
}

/// Builds the image of a subject with one thread.
fn prepare(subject: &Subject) -> Result<(Elapsed, Vec<u8>)> {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let model = subject.model.clone();
    let (elapsed, image) = stopwatch::time(|| one.install(|| image_of(model)));
    Ok((elapsed, image?))
}

fn image_of(model: Model) -> Result<Vec<u8>> {
    Ok(build(model, &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?)
}
