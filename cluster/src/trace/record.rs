//! Drawing a path of cameras and writing down every page that is read.

use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use rt_core::camera::OrbitPlace;
use rt_core::schedule::Static;
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TILE_SIZE, Tiles, render_tile};

use super::{NodeFrame, Trace};
use crate::noted::{Noted, Notes};
use crate::progress::FrameBar;
use crate::run::Source;
use crate::size::PictureSize;

/// What is looked at, from where, and by how many.
#[derive(Clone, Debug)]
pub struct Session {
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
    /// The way that the eye goes.
    pub path: Path,
    /// Frames to draw.
    pub frames: u32,
    /// Frames that a full circle would take.
    pub circle: u32,
    /// Distance of the eye from the middle at first, in diagonals of the scene.
    pub radius: f32,
    /// Height of the eye, in degrees above the horizon.
    pub elevation: f64,
    /// No progress bars.
    pub quiet: bool,
}

/// The way that the eye goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Path {
    /// Around the scene at one distance.
    Orbit,
    /// Around the scene and ever closer, in the last frame to a third of the distance.
    Walk,
}

/// Draws the session on the calling thread, tile by tile as the nodes would, and gives back what was touched.
///
/// # Errors
/// The scene cannot be used, does not fit this process's memory, or cannot be seen from there.
pub fn record(session: &Session) -> Result<Trace> {
    let Session { nodes, size, frames, quiet, .. } = *session;
    if nodes == 0 || frames == 0 || session.circle == 0 {
        bail!("a trace needs a node, a frame, and a frame in a circle");
    }
    let image = session.source.open(session.page_bytes, quiet)?;
    let (header, name) = (image.header, image.name.clone());
    let bytes = read(&File::from(OwnedFd::from(image)), header.image_bytes)
        .with_context(|| format!("cannot hold {name} in memory"))?;
    let page_bytes = session.page_bytes.unwrap_or(header.page_bytes);
    let page_count = u32::try_from(header.image_bytes.div_ceil(page_bytes.into()))?;
    let notes = Notes::of_every_touch(page_bytes);
    let scene = SceneView::new(Noted::new(Flat::new(&bytes), &notes))?;
    // The header is read once in a session, not in a tile.
    notes.take(|_| ());
    let orbit = Orbit::around(&header.view);
    let bar = FrameBar::new(quiet, frames);
    let mut trace =
        Trace { page_bytes, page_count, nodes, size: [size.width, size.height], frames: Vec::new() };
    for number in 0..frames {
        let frame = session.frame(&orbit, number)?;
        trace.frames.push((0..nodes).map(|node| session.node_frame(&scene, &notes, &frame, node)).collect());
        bar.advance();
    }
    Ok(trace)
}

impl Session {
    fn frame(&self, orbit: &Orbit, number: u32) -> Result<Frame> {
        let part = number as f32 / self.frames as f32;
        let radius = match self.path {
            Path::Orbit => self.radius,
            Path::Walk => self.radius * (1.0 - part * 2.0 / 3.0),
        };
        let place = OrbitPlace { radius, elevation: self.elevation, frame: number, frames: self.circle };
        Frame::on_orbit(orbit, &place, self.size.width, self.size.height)
            .with_context(|| format!("no camera at radius {radius} of this scene"))
    }

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
            render_tile(scene, frame, tile, kernel, &mut pixels[..tile.pixels()], &mut ());
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
