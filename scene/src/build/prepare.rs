//! Checks a model, scales it to unit size, and lays the cube of the grid around it.

use glam::Vec3;
use rayon::prelude::*;
use rt_core::Bounds;
use rt_core::grid::{GridShape, LEVELS_MAX};
use rt_core::image::SCALE_EXPONENT_MAX;
use rt_core::scale::{Scale, exponent_of, power_of_two};
use rt_core::sphere::Sphere;
use rt_core::surface::Surface;

use super::crowd::uncrowded;
use super::surfaces::is_collapsed;
use super::{BuildError, BuildOptions};
use crate::mesh::Mesh;
use crate::model::Model;

/// A model in grid units, and where its grid lies.
pub(super) struct Prepared {
    pub(super) model: Model,
    pub(super) bounds: Bounds,
    /// `levels` is the most that make sense here; the grid may need fewer.
    pub(super) grid: GridShape,
    pub(super) typical_edge: f32,
    pub(super) scale_exponent: i32,
}

pub(super) fn prepare(mut model: Model, options: &BuildOptions) -> Result<Prepared, BuildError> {
    check(&model)?;
    let bounds = model.bounds().ok_or(BuildError::NoTriangles)?;
    let largest = bounds.low.abs().max(bounds.high.abs()).max_element();
    let scale_exponent = -exponent_of(largest);
    let scale = Scale::new(scale_exponent);
    scale_model(&mut model, scale);
    if ids(&model).all(|id| is_collapsed(&model.surface(id))) {
        let (triangles, spheres) = (model.mesh.triangles.len(), model.spheres.len());
        return Err(BuildError::AllCollapsed { triangles, spheres });
    }
    if scale_exponent.abs() > SCALE_EXPONENT_MAX {
        return Err(BuildError::OutOfRange { largest });
    }
    let typical_edge = typical_edge(&model);
    let mut grid =
        cube_around(&Bounds { low: scale.apply_to(bounds.low), high: scale.apply_to(bounds.high) });
    grid.slack = uncrowded(&model, &grid, (options.slack.max(0.0) * typical_edge).min(grid.size));
    Ok(Prepared { model, bounds, grid, typical_edge, scale_exponent })
}

/// The numbers of all triangles and spheres.
pub(super) fn ids(model: &Model) -> impl IndexedParallelIterator<Item = u32> + use<> {
    (0..u32::try_from(model.count()).unwrap_or(u32::MAX)).into_par_iter()
}

fn scale_model(model: &mut Model, scale: Scale) {
    // Adding 0 makes -0 and 0 one number, so that equal points have equal bits.
    let positions = &mut model.mesh.positions;
    positions.par_iter_mut().for_each(|position| *position = position.map(|x| scale.apply(x) + 0.0));
    model.spheres.par_iter_mut().for_each(|sphere| {
        let Sphere { centre, radius } = *sphere;
        *sphere = Sphere { centre: scale.apply_to(centre) + 0.0, radius: scale.apply(radius) + 0.0 };
    });
}

fn check(model: &Model) -> Result<(), BuildError> {
    if model.count() == 0 {
        return Err(BuildError::NoTriangles);
    }
    if model.count() > PRIMITIVES_MAX {
        return Err(BuildError::TooManyTriangles { count: model.count() as u64 });
    }
    if model.view.is_some_and(|view| !view.is_proper()) {
        return Err(BuildError::View);
    }
    check_mesh(&model.mesh)?;
    check_spheres(&model.spheres)
}

fn check_spheres(spheres: &[Sphere]) -> Result<(), BuildError> {
    // Far enough below the largest number that a centre and a radius can be added.
    let is_usable = |x: f32| x.abs() < f32::MAX * 0.25;
    let unusable =
        |sphere: &Sphere| !sphere.centre.to_array().into_iter().all(is_usable) || !is_usable(sphere.radius);
    if let Some(sphere) = spheres.par_iter().position_first(unusable) {
        return Err(BuildError::SphereNotFinite { sphere });
    }
    match spheres.par_iter().position_first(|sphere| sphere.radius < 0.0) {
        Some(sphere) => Err(BuildError::NegativeRadius { sphere, radius: spheres[sphere].radius }),
        None => Ok(()),
    }
}

fn check_mesh(mesh: &Mesh) -> Result<(), BuildError> {
    if let Some(vertex) = mesh.positions.par_iter().position_first(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(BuildError::NotFinite { vertex });
    }
    let vertices = mesh.positions.len();
    let names_none = |triangle: &[u32; 3]| triangle.iter().any(|&vertex| vertex as usize >= vertices);
    if let Some(triangle) = mesh.triangles.par_iter().position_first(names_none) {
        let [a, b, c] = mesh.triangles[triangle];
        return Err(BuildError::NoSuchVertex { triangle, vertex: a.max(b).max(c), vertices });
    }
    Ok(())
}

/// Length of a typical edge, a sphere's being its diameter: within 6 % of the geometric mean.
///
/// The bits of a float, as an integer, are roughly its logarithm; their mean is exact and does not depend on
/// the order of summation, so neither on threads. The geometric mean keeps a few huge triangles from deciding
/// for millions of small ones.
fn typical_edge(model: &Model) -> f32 {
    let edges = ids(model).flat_map_iter(|id| match model.surface(id) {
        Surface::Triangle([a, b, c]) => [b - a, c - b, a - c].map(|edge| edge.length()),
        Surface::Sphere(sphere) => [sphere.radius * 2.0, 0.0, 0.0],
    });
    let (sum, count) = edges
        .filter(|length| *length > 0.0)
        .fold(|| (0_u64, 0_u64), |(sum, count), length| (sum + u64::from(length.to_bits()), count + 1))
        .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    let mean = sum.checked_div(count).unwrap_or(0);
    f32::from_bits(u32::try_from(mean).unwrap_or(0))
}

/// The smallest cube around `bounds` whose edge is a power of two and whose finest cells have corners that
/// `f32` can hold.
fn cube_around(bounds: &Bounds) -> GridShape {
    let (low, high) = (bounds.low.to_array().map(f64::from), bounds.high.to_array().map(f64::from));
    let extent = (0..3).fold(0.0, |extent: f64, axis| extent.max(high[axis] - low[axis]));
    let smallest = (SIZE_EXPONENT_MIN..).find(|&exponent| f64::from(power_of_two(exponent)) >= extent);
    (smallest.unwrap_or(SIZE_EXPONENT_MIN)..)
        .find_map(|exponent| cube_of_size(low, high, exponent))
        .unwrap_or_else(|| {
            unreachable!(
                "a cube twice as large as the bounds contains them wherever its corner is rounded to"
            )
        })
}

/// The cube with edge `2^exponent` around the middle of the bounds, unless rounding its corner leaves a bound
/// outside.
fn cube_of_size(low: [f64; 3], high: [f64; 3], exponent: i32) -> Option<GridShape> {
    let levels = ((exponent - CORNER_EXPONENT) / 2).clamp(1, i32::try_from(LEVELS_MAX).unwrap_or(i32::MAX));
    let size = f64::from(power_of_two(exponent));
    let unit = f64::from(power_of_two(exponent - 2 * levels.min(3)));
    let origin = [0, 1, 2].map(|axis| (((low[axis] + high[axis] - size) * 0.5) / unit).floor() * unit);
    let contains = (0..3).all(|axis| origin[axis] <= low[axis] && high[axis] <= origin[axis] + size);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the corner is a short multiple of a power of two: exact in f32"
    )]
    let shape = GridShape {
        origin: Vec3::from(origin.map(|x| x as f32)),
        size: size as f32,
        slack: 0.0,
        levels: levels.unsigned_abs(),
    };
    contains.then_some(shape)
}

/// Cells are at least `2^CORNER_EXPONENT` wide: coordinates are below 4, so their corners are exact in `f32`.
const CORNER_EXPONENT: i32 = -22;

/// A mesh smaller than this, compared with its largest coordinate, gets one level of cells.
const SIZE_EXPONENT_MIN: i32 = -20;

/// Triangles and spheres are numbered with 31 bits, which leaves room for copies.
const PRIMITIVES_MAX: usize = 1 << 31;
