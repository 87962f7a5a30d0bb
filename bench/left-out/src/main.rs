//! Draws the tiles of a picture and sums their bytes: a whole renderer with nothing around it.
//!
//! `left-out IMAGE FRAME`: a scene image and the bytes of a frame. The experiment of the same name asks how large it
//! is with each set of features.

use std::error::Error;
use std::{env, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let mut files = Vec::new();
    for name in env::args().skip(1).take(2) {
        files.push(fs::read(name)?);
    }
    let [image, frame] = files.as_slice() else { return Err("left-out IMAGE FRAME".into()) };
    println!("{}", draw(image, frame)?);
    Ok(())
}

#[cfg(feature = "draw")]
fn draw(image: &[u8], frame: &[u8]) -> Result<u64, Box<dyn Error>> {
    use rt_core::{Flat, Frame, Kernel, SceneView, TILE_SIZE, Tiles, render_tile};

    let (scene, frame) = (SceneView::new(Flat::new(image))?, Frame::read(frame)?);
    let (tiles, kernel) = (Tiles::of(frame.width, frame.height), Kernel::fastest());
    let mut pixels = [0; (TILE_SIZE * TILE_SIZE) as usize];
    let mut sum = 0;
    for tile in tiles.ids().filter_map(|id| tiles.get(id)) {
        let pixels = &mut pixels[..tile.pixels()];
        render_tile(&scene, &frame, tile, kernel, pixels, &mut ());
        sum += pixels.iter().map(|&grey| u64::from(grey)).sum::<u64>();
    }
    Ok(sum)
}

#[cfg(not(feature = "draw"))]
fn draw(image: &[u8], frame: &[u8]) -> Result<u64, Box<dyn Error>> {
    Ok((image.len() + frame.len()) as u64)
}
