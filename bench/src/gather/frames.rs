//! The frames of a camera, cut into tiles.

use anyhow::Result;
use kernels::Draw;
use memsavvy::session::{Path, Session, Way};
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TILE_SIZE, Tile, TileCounts};
use scene::{BuildOptions, Model, build, builtin, read_mesh};

use super::Amount;
use crate::data;
use crate::experiment::Effort;

/// How the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Camera {
    /// Not at all.
    Still,
    /// Half a degree a frame, around the scene.
    Slow,
    /// Ten degrees a frame.
    Fast,
}

/// A scene to look at, and from how far.
pub(crate) struct Scene {
    pub(crate) name: String,
    image: Vec<u8>,
    radius: f64,
}

/// Frames of one camera.
#[derive(Debug)]
pub(crate) struct Frames {
    pub(crate) name: String,
    pub(crate) camera: Camera,
    pub(crate) size: usize,
    pub(crate) pictures: Vec<Vec<u8>>,
    /// For each picture and each of some edges, what is counted for each tile.
    counts: Vec<Vec<(usize, Vec<TileCounts>)>>,
}

const PAGE_BYTES: u32 = 16 << 10;

/// Bunny and dragon from near and far where they are, and else a knot.
pub(crate) fn scenes(effort: Effort) -> Result<Vec<Scene>> {
    let mut scenes = Vec::new();
    for name in ["bunny", "dragon"] {
        let Some(path) = data::mesh_file(name, effort).filter(|path| path.exists() && !effort.is_quick())
        else {
            continue;
        };
        effort.say(&format!("{name}: building"));
        let image = image_of(read_mesh(&path)?.into())?;
        for radius in [1.5, 0.75] {
            scenes.push(Scene { name: format!("{name} {radius}"), image: image.clone(), radius });
        }
    }
    if scenes.is_empty() {
        let image = image_of(builtin::knot(effort.pick(600_000, 5_000)).into())?;
        scenes.push(Scene { name: "knot 0.75".to_owned(), image, radius: 0.75 });
    }
    Ok(scenes)
}

fn image_of(model: Model) -> Result<Vec<u8>> {
    Ok(build(model, &BuildOptions::default(), &|_| {})?.to_bytes(PAGE_BYTES)?)
}

impl Camera {
    pub(crate) const ALL: [Self; 3] = [Self::Still, Self::Slow, Self::Fast];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Still => "still",
            Self::Slow => "slow",
            Self::Fast => "fast",
        }
    }

    /// A session of it.
    pub(crate) fn session(self, frames: u32, radius: f64) -> Result<Session> {
        let (way, circle) = match self {
            Self::Still => (Way::Still, None),
            Self::Slow => (Way::Orbit, Some(720)),
            Self::Fast => (Way::Orbit, Some(36)),
        };
        Path { way, circle, frames, radius, ..Path::default() }.session()
    }
}

impl Frames {
    /// Draws them in tiles of each of `edges`, which cover the same pixels.
    pub(crate) fn draw(scene: &Scene, camera: Camera, amount: Amount, edges: &[usize]) -> Result<Self> {
        let view = SceneView::new(Flat::new(&scene.image))?;
        let orbit = Orbit::around(&view.header().view);
        let session = camera.session(amount.frames, scene.radius)?;
        let (size, kernel) = (amount.size as usize, Kernel::fastest());
        let mut frames =
            Self { name: scene.name.clone(), camera, size, pictures: Vec::new(), counts: Vec::new() };
        for (number, moment) in (0..).zip(session.moments()) {
            let frame = Frame::aimed(number, &orbit, &moment.aim, moment.light, [amount.size; 2])?;
            let mut picture = vec![0; size * size];
            let mut of_tiles = |edge: usize| {
                let tiles = frames.tiles(edge);
                (
                    edge,
                    tiles
                        .map(|(at, extent)| draw(&view, &frame, kernel, (at, extent), &mut picture))
                        .collect(),
                )
            };
            frames.counts.push(edges.iter().map(|edge| of_tiles(*edge)).collect());
            frames.pictures.push(picture);
        }
        Ok(frames)
    }

    /// What is counted for each tile of a frame.
    pub(crate) fn counts(&self, frame: usize, edge: usize) -> &[TileCounts] {
        let of_edge = self.counts[frame].iter().find(|(of, _)| *of == edge);
        of_edge.map_or(&[], |(_, counts)| counts)
    }

    /// Where tiles of that edge lie, and how large they are.
    pub(crate) fn tiles(&self, edge: usize) -> impl Iterator<Item = ([usize; 2], [usize; 2])> + use<> {
        let size = self.size;
        let starts = move || (0..size).step_by(edge);
        let length = move |start: usize| edge.min(size - start);
        starts().flat_map(move |y| starts().map(move |x| ([x, y], [length(x), length(y)])))
    }

    /// The pixels of a tile.
    pub(crate) fn cut(
        &self,
        frame: usize,
        [x, y]: [usize; 2],
        [width, height]: [usize; 2],
        to: &mut Vec<u8>,
    ) {
        to.clear();
        for line in y..y + height {
            let start = line * self.size + x;
            to.extend(&self.pictures[frame][start..start + width]);
        }
    }

    /// Share of the tiles that are as in the frame before.
    pub(crate) fn unchanged(&self, edge: usize) -> f64 {
        let (mut same, mut all) = (0_u32, 0_u32);
        let (mut now, mut before) = (Vec::new(), Vec::new());
        for frame in 1..self.pictures.len() {
            for (at, size) in self.tiles(edge) {
                self.cut(frame, at, size, &mut now);
                self.cut(frame - 1, at, size, &mut before);
                same += u32::from(now == before);
                all += 1;
            }
        }
        f64::from(same) / f64::from(all.max(1))
    }
}

/// Draws a tile into a picture of square frames.
fn draw(
    scene: &SceneView<Flat<'_>>,
    frame: &Frame,
    kernel: Kernel,
    (at, extent): ([usize; 2], [usize; 2]),
    picture: &mut [u8],
) -> TileCounts {
    let [x, y, width, height] =
        [at[0], at[1], extent[0], extent[1]].map(|pixels| u32::try_from(pixels).unwrap_or(0));
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    let pixels = &mut pixels[..extent[0] * extent[1]];
    let tile = Tile { x, y, width, height };
    let counts = Draw::render_tile(scene, frame, tile, kernel, pixels);
    for (line, from) in (at[1]..).zip(pixels.chunks_exact(extent[0])) {
        let start = line * frame.width as usize + at[0];
        picture[start..start + from.len()].copy_from_slice(from);
    }
    counts
}
