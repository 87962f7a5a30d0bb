//! The bytes that each holds, to show any isosurface of a volume at once.

use super::Stand;
use super::meshes::STRUCTURES;
use crate::findings::Aim;
use crate::table::{Cell, Table};

/// What was counted so far.
pub(super) struct Memory {
    table: Table,
    aims: Vec<Aim>,
}

const MB: f64 = 1e6;

/// Our image, in what the peer holds at least.
const BYTES_MAX: f64 = 1.0;

impl Memory {
    pub(super) fn new() -> Self {
        let heads = ["volume", "program", "samples MB", "mesh MB", "structure MB", "in all MB"];
        let mut table =
            Table::new("iso_memory", "what is held to show an isosurface, and then another", &heads);
        table.note("samples: of ours the whole image, of the peer the array that meshes are extracted from");
        table.note("structure: as Embree counts it; while it builds it holds more");
        Self { table, aims: Vec::new() }
    }

    pub(super) fn add(&mut self, stand: &Stand<'_>) {
        let name = &stand.subject.name;
        let ours = stand.image.len() as u64;
        self.push(name, "ours".to_owned(), [ours, 0, 0]);
        let Some(meshes) = &stand.meshes else { return };
        let mut least = u64::MAX;
        for (embree, built) in meshes.embrees.iter().zip(&meshes.built) {
            for (structure, built) in STRUCTURES.into_iter().zip(built) {
                let parts = [meshes.edges.volume_bytes, meshes.extracted.bytes(), built.bytes];
                least = least.min(parts.iter().sum());
                self.push(name, format!("{}, {}, {structure}", meshes.edges.name(), embree.name), parts);
            }
        }
        let what = format!("{name}: bytes that ours holds, in the least of the peer");
        self.aims.push(Aim::at_most(what, ours as f64 / least as f64, BYTES_MAX));
    }

    pub(super) fn finish(self) -> (Table, Vec<Aim>) {
        (self.table, self.aims)
    }

    fn push(&mut self, subject: &str, program: String, parts: [u64; 3]) {
        let [samples, mesh, structure] = parts.map(|bytes| Cell::Number(bytes as f64 / MB, 1));
        let all = Cell::Number(parts.iter().sum::<u64>() as f64 / MB, 1);
        self.table.push(vec![Cell::text(subject), Cell::text(program), samples, mesh, structure, all]);
    }
}
