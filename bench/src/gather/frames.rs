//! The frames of a camera, cut into tiles.

use anyhow::Result;
use kernels::Draw;
use memsavvy::session::{Path, Session, Way};
use rt_core::{Flat, Frame, Kernel, Orbit, SceneView, TILE_SIZE, Tiles};
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
}

const PAGE_BYTES: u32 = 16 << 10;

/// Bytes of a tile's number, counts and length.
pub(crate) const HEAD_BYTES: u64 = 16;

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
    pub(crate) fn draw(scene: &Scene, camera: Camera, amount: Amount) -> Result<Self> {
        let view = SceneView::new(Flat::new(&scene.image))?;
        let orbit = Orbit::around(&view.header().view);
        let session = camera.session(amount.frames, scene.radius)?;
        let draw = |(number, moment): (u32, &memsavvy::session::Moment)| {
            let size = [amount.size, amount.size];
            let frame = Frame::aimed(number, &orbit, &moment.aim, moment.light, size)?;
            Ok(draw(&view, &frame))
        };
        let pictures = (0..).zip(session.moments()).map(draw).collect::<Result<_>>()?;
        Ok(Self { name: scene.name.clone(), camera, size: amount.size as usize, pictures })
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

    /// Bytes of a frame whose tiles travel as they are.
    pub(crate) fn raw_bytes(&self, edge: usize) -> u64 {
        (self.size * self.size) as u64 + HEAD_BYTES * self.tiles(edge).count() as u64
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

fn draw(scene: &SceneView<Flat<'_>>, frame: &Frame) -> Vec<u8> {
    let (tiles, kernel) = (Tiles::of(frame.width, frame.height), Kernel::fastest());
    let row = frame.width as usize;
    let mut picture = vec![0; row * frame.height as usize];
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let pixels = &mut pixels[..tile.pixels()];
        Draw::render_tile(scene, frame, tile, kernel, pixels);
        for (y, line) in (tile.y as usize..).zip(pixels.chunks_exact(tile.width as usize)) {
            let start = y * row + tile.x as usize;
            picture[start..start + line.len()].copy_from_slice(line);
        }
    }
    picture
}
