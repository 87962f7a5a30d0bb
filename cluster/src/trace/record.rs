//! Drawing a session and writing down every page that is read.

use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;

use anyhow::{Context, Result, bail};
use kernels::Draw;
use kernels::noted::{Noted, Notes};
use rt_core::schedule::Static;
use rt_core::{Flat, Frame, Kernel, SceneView, Solver, TILE_SIZE, Tiles};

use super::{NodeFrame, Trace};
use crate::isovalue::Surfaces;
use crate::progress::FrameBar;
use crate::run::{Source, Surface};
use crate::session::Session;
use crate::size::PictureSize;

/// What is looked at, from where, and by how many.
#[derive(Clone, Debug)]
pub struct Options {
    /// The scene.
    pub source: Source,
    /// Length of a page; `None` for what the image was prepared for.
    pub page_bytes: Option<u32>,
    /// Nodes that the tiles are dealt to.
    pub nodes: u16,
    /// The kernel, or `None` for the fastest. Beams read other records than rays do.
    pub kernel: Option<Kernel>,
    /// Size of the pictures.
    pub size: PictureSize,
    /// What is looked at; every moment is a frame.
    pub session: Session,
    /// Isosurfaces of a volume, where the session does not say.
    pub isosurfaces: Vec<Surface>,
    /// How their roots are found.
    pub solver: Solver,
    /// No progress bars.
    pub quiet: bool,
}

/// Draws the session on the calling thread, tile by tile as the nodes would, and gives back what was touched.
///
/// # Errors
/// The scene cannot be used, does not fit this process's memory, or cannot be seen from there.
pub fn record(options: &Options) -> Result<Trace> {
    let Options { nodes, size, solver, quiet, .. } = *options;
    if nodes == 0 {
        bail!("a trace needs a node that draws");
    }
    let image = options.source.open(options.page_bytes, quiet)?;
    let shown = Surfaces::new(&options.isosurfaces, &options.session, &options.source, &image)?;
    let resolve = |asked: Option<&[Surface]>| shown.of_moment(asked);
    let frames = options.session.frames(&image.header.view, size, solver, resolve)?;
    let (header, name) = (image.header, image.name.clone());
    let bytes = read(&File::from(OwnedFd::from(image)), header.image_bytes)
        .with_context(|| format!("cannot hold {name} in memory"))?;
    let page_bytes = options.page_bytes.unwrap_or(header.page_bytes);
    let page_count = u32::try_from(header.image_bytes.div_ceil(page_bytes.into()))?;
    let notes = Notes::of_every_touch(page_bytes, header.image_bytes);
    let scene = SceneView::new(Noted::new(Flat::new(&bytes), &notes))?;
    // The header is read once in a session, not in a tile.
    notes.take(|_| ());
    let bar = FrameBar::new(quiet, options.session.count());
    let mut trace =
        Trace { page_bytes, page_count, nodes, size: [size.width, size.height], frames: Vec::new() };
    for frame in &frames {
        trace.frames.push((0..nodes).map(|node| options.node_frame(&scene, &notes, frame, node)).collect());
        bar.set(frame.number + 1);
    }
    Ok(trace)
}

impl Options {
    fn node_frame(
        &self,
        scene: &SceneView<Noted<'_, Flat<'_>>>,
        notes: &Notes,
        frame: &Frame,
        node: u16,
    ) -> NodeFrame {
        let tiles = Tiles::of(frame.width, frame.height);
        let kernel = self.kernel.unwrap_or_else(Kernel::fastest);
        let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
        let mut drawn = NodeFrame::default();
        for id in Static::new(tiles, self.nodes.into()).drawing_order(node.into(), frame.number) {
            let Some(tile) = tiles.get(id) else { continue };
            Draw::render_tile(scene, frame, tile, kernel, &mut pixels[..tile.pixels()]);
            notes.take(|pages| drawn.push(id, &pages.iter().map(|page| page.0).collect::<Vec<_>>()));
        }
        drawn
    }
}

fn read(file: &File, length: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(length)?)?;
    bytes.resize(usize::try_from(length)?, 0);
    file.read_exact_at(&mut bytes, 0)?;
    Ok(bytes)
}
