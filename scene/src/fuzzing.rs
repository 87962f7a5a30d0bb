//! Entry points for fuzzers: arbitrary bytes in, no panic and no hang out.

use std::io::Cursor;
use std::path::Path;
use std::sync::OnceLock;

use rt_core::image::HEADER_BYTES;
use rt_core::{Flat, Ray, SceneView};
use xxhash_rust::xxh3::xxh3_64;

use crate::bricks::write_volume;
use crate::build::{BuildOptions, build};
use crate::builtin;
use crate::volume::{self, VolumeSource};

/// Takes a good image, writes lies into it, makes its header's checksum right again, and traces some rays through it.
///
/// Half of the time it is one of triangles, else of triangles and spheres, as the length of `lies` says. Every four bytes of `lies` are one: where (three bytes, modulo the image's length) and what. Random bytes hardly ever
/// are an image; this gets past the door.
pub fn lying_image(lies: &[u8]) {
    static GOOD: OnceLock<[Vec<u8>; 3]> = OnceLock::new();
    let good = GOOD.get_or_init(|| {
        let models = [builtin::knot(2000).into(), builtin::sphereflake(2)].map(|model| {
            let scene = build(model, &BuildOptions::default(), &|_| {});
            scene.ok().and_then(|scene| scene.to_bytes(4096).ok()).unwrap_or_default()
        });
        let [triangles, spheres] = models;
        [triangles, spheres, volume_image().unwrap_or_default()]
    });
    let mut bytes = good[lies.len() / 4 % 3].clone();
    for lie in lies.chunks_exact(4) {
        let place = u32::from_le_bytes([lie[0], lie[1], lie[2], 0]) as usize % bytes.len();
        bytes[place] = lie[3];
    }
    // The checksum is the last word of the header, over all that is before it.
    let (header, checksum) = bytes[..HEADER_BYTES].split_at_mut(HEADER_BYTES - size_of::<u64>());
    checksum.copy_from_slice(&xxh3_64(header).to_le_bytes());
    image(&bytes);
}

/// Takes arbitrary bytes as a scene image and traces some rays through it, checksums of segments ignored.
pub fn image(bytes: &[u8]) {
    let Ok(scene) = SceneView::new(Flat::new(bytes)) else { return };
    let bounds = scene.header().bounds;
    let middle = (bounds.low + bounds.high) * 0.5;
    let size = bounds.high - bounds.low;
    #[cfg(feature = "volumes")]
    let surfaces = scene.isosurfaces(&[0.0, 0.4], rt_core::Solver::default()).ok().flatten();
    for ray in 0..16_u16 {
        let towards = |bit: u16| if ray >> bit & 1 == 0 { 1.0 } else { -0.37 };
        let direction = glam::Vec3::new(towards(0), towards(1), towards(2)) * size;
        let origin = if ray >> 3 == 0 { middle - direction * 3.0 } else { middle };
        let ray = Ray { origin, direction, t_max: f32::INFINITY };
        let nearest = scene.nearest(&ray, &mut ());
        let any = scene.any(&ray, &mut ());
        if let (Ok(nearest), Ok(any)) = (nearest, any) {
            // Holds for any bytes: both walks read the same records until something is hit.
            assert!(any || nearest.is_none(), "any hit misses what nearest hit finds");
        }
        #[cfg(feature = "volumes")]
        if let Some(surfaces) = &surfaces {
            let (nearest, any) = (surfaces.nearest(&ray, &mut ()), surfaces.any(&ray, &mut ()));
            assert_eq!(nearest.map(|hit| hit.is_some()), any, "both look for the first root");
        }
        if let Ok(Some(hit)) = nearest {
            let _ = scene.original_id(hit.primitive);
        }
    }
}

/// The image of a small volume.
fn volume_image() -> Option<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    let mut source = volume::Analytic::new(volume::Formula::Gyroid, 24).ok()?;
    write_volume(&mut source, None, None, 4096, &mut out, &|_| {}).ok()?;
    Some(out.into_inner())
}

/// Takes arbitrary bytes as a volume: as a file whose format they tell, as a name, and as a description in JSON. What
/// opens is read to its end, unless it declares far more than there is.
pub fn volume(bytes: &[u8]) {
    if let Ok(mut volume) = volume::parse_volume(bytes) {
        let samples = volume.shape().samples();
        let mut run = vec![0.0; usize::try_from(samples).unwrap_or(usize::MAX).min(1 << 12)];
        for first in (0..samples - run.len() as u64 + 1).step_by(run.len()).take(1 << 8) {
            if volume.read_samples(first, &mut run).is_err() {
                break;
            }
        }
    }
    let _ = volume::RawVolume::from_json(bytes, Path::new(""));
    if let Ok(name) = core::str::from_utf8(bytes) {
        let _ = name.parse::<volume::VolumeName>();
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn any_bytes_behind_the_beginning_of_a_volume_do_no_harm() {
        let beginnings: [&[u8]; 5] = [
            b"NRRD0001\ntype: short\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nendian: little\n\n",
            b"\x5c\x01\0\0",
            b"<VTKFile type='ImageData'><ImageData WholeExtent='0 1 0 1 0 1'><PointData><DataArray type='Int8' format='ascii'>",
            b"raw:a?dims=1x1x1&type=u8",
            b"{\"file\": \"a\", \"dims\": [1, 1, 1], \"dtype\": \"u8\"}",
        ];
        for beginning in beginnings {
            super::volume(&[beginning, b"1 2 3 4 5 6 7 8 9 10 11"].concat());
            for seed in 0..500_u32 {
                let mut bytes = [beginning, &[b'1'; 400]].concat();
                let place = seed.wrapping_mul(2_654_435_761) as usize % bytes.len();
                bytes[place] = seed.to_le_bytes()[0];
                super::volume(&bytes);
            }
        }
    }

    #[test]
    fn an_image_with_wrong_bytes_does_no_harm() {
        let scene = super::build(super::builtin::knot(3000), &Default::default(), &|_| {});
        let whole = scene.ok().and_then(|scene| scene.to_bytes(4096).ok()).expect("a good image");
        super::image(&whole);
        for place in (4096..whole.len()).step_by(977) {
            let mut bytes = whole.clone();
            bytes[place] = bytes[place].wrapping_add(101);
            super::image(&bytes);
        }
        super::image(b"MEMSAVVY");
    }

    #[test]
    fn lies_do_no_harm_and_without_any_the_image_is_good() {
        super::lying_image(&[]);
        // A lie about the header's padding is none.
        super::lying_image(&[0, 8, 0, 0]);
        for seed in 0..2000_u32 {
            let byte = |index: u32| {
                (seed.wrapping_mul(2_654_435_761).wrapping_add(index * 40_503) >> 9).to_le_bytes()[0]
            };
            let lies: Vec<u8> = (0..4 * (1 + seed % 20)).map(|index| byte(index ^ seed)).collect();
            super::lying_image(&lies);
        }
    }
}
