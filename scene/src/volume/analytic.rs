//! Volumes made by arithmetic: any size, no storage.

use core::f64::consts::{FRAC_PI_2, PI};
use core::fmt;
use core::ops::RangeInclusive;

use rayon::prelude::*;

use super::error::{Trouble, VolumeError};
use super::sample::SampleType;
use super::shape::VolumeShape;
use super::{VolumeSource, run};

/// A volume of `n` samples along each axis whose values follow a formula; the same bits on every machine.
///
/// # Shape and units
/// Sample `i` of an axis is at world coordinate `i`, and at `-1 + 2 i / (n - 1)` in the formula.
#[derive(Debug)]
pub struct Analytic {
    formula: Formula,
    shape: VolumeShape,
    /// What a formula needs of one coordinate, for each sample of an axis.
    axis: Vec<Coordinate>,
    /// Of [`Formula::MarschnerLobb`], what depends on x and y alone; empty until a whole slice is asked for.
    ripples: Vec<f64>,
}

/// A formula for a volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formula {
    /// Schoen's minimal surface with two periods a side, cut off by a ball so that the surface of isovalue 0 is
    /// closed: `g + 0.3 - 0.9 (r / 0.85)^8`, `g = sin kx cos ky + sin ky cos kz + sin kz cos kx`, `k = 4 pi`.
    Gyroid,
    /// Marschner and Lobb's test signal, "An evaluation of reconstruction filters for volume rendering",
    /// Visualization 1994, with flat caps so that the surface of isovalue 0.5 is closed:
    /// `min(m, 0.5 + 2 (0.9 - max(|x|, |y|, |z|)))`,
    /// `m = (1 - sin(pi z / 2) + 0.25 (1 + cos(12 pi cos(pi r / 2)))) / 2.5`, `r = sqrt(x^2 + y^2)`.
    MarschnerLobb,
}

/// A coordinate of the formula with its sine and cosine.
#[derive(Clone, Copy, Debug)]
struct Coordinate {
    /// In -1..=1.
    x: f64,
    sin: f64,
    cos: f64,
}

impl Analytic {
    /// The volume of a formula with `n` samples along each axis.
    ///
    /// # Errors
    /// When `n` is less than 2 or the samples are too many to number.
    pub fn new(formula: Formula, n: u64) -> Result<Self, VolumeError> {
        if !SIZES.contains(&n) {
            let trouble = Trouble::value(n.to_string(), EXPECTED);
            return Err(VolumeError::in_name(formula.name(), trouble));
        }
        let shape = VolumeShape::new([n; 3], SampleType::F32)?;
        let axis = (0..n).into_par_iter().map(|i| formula.coordinate(-1.0 + 2.0 * i as f64 / (n - 1) as f64));
        Ok(Self { formula, shape, axis: axis.collect(), ripples: Vec::new() })
    }

    /// Computes [`ripples`](Self::ripples) when they pay and are no more than a slice of the caller's.
    fn prepare(&mut self, samples: usize) {
        let slice = self.axis.len().saturating_mul(self.axis.len());
        if self.formula == Formula::MarschnerLobb && self.ripples.is_empty() && samples >= slice {
            let rows = self.axis.par_iter();
            let row = |y| self.axis.iter().map(move |x: &Coordinate| ripple(x.x, y));
            self.ripples = rows.flat_map_iter(|y| row(y.x)).collect();
        }
    }

    /// Computes a run of samples that lie in one row.
    fn fill(&self, [x, y, z]: [usize; 3], samples: &mut [f32]) {
        let (row, [y_at, z_at]) = (&self.axis[x..][..samples.len()], [self.axis[y], self.axis[z]]);
        let ripples = (!self.ripples.is_empty()).then(|| &self.ripples[y * self.axis.len() + x..]);
        for (i, (sample, x_at)) in samples.iter_mut().zip(row).enumerate() {
            let value = match self.formula {
                Formula::Gyroid => gyroid([*x_at, y_at, z_at]),
                Formula::MarschnerLobb => {
                    let ripple = ripples.map_or_else(|| ripple(x_at.x, y_at.x), |ripples| ripples[i]);
                    marschner_lobb([*x_at, y_at, z_at], ripple)
                }
            };
            #[expect(clippy::cast_possible_truncation, reason = "rounded once, to the precision of a sample")]
            let single = value as f32;
            *sample = single;
        }
    }
}

impl VolumeSource for Analytic {
    fn shape(&self) -> &VolumeShape {
        &self.shape
    }

    fn read_samples(&mut self, first: u64, samples: &mut [f32]) -> Result<(), VolumeError> {
        run::check(&self.shape, first, samples.len());
        self.prepare(samples.len());
        let n = self.axis.len() as u64;
        // Whole rows where the run begins with one; else its beginning first.
        let head = usize::try_from((n - first % n) % n).unwrap_or(usize::MAX).min(samples.len());
        let (head, rows) = samples.split_at_mut(head);
        let place = |sample: u64| [sample % n, sample / n % n, sample / n / n].map(run::index);
        if !head.is_empty() {
            self.fill(place(first), head);
        }
        let first = first + head.len() as u64;
        rows.par_chunks_mut(self.axis.len()).enumerate().for_each(|(row, samples)| {
            self.fill(place(first + row as u64 * n), samples);
        });
        Ok(())
    }
}

impl Formula {
    /// Name of the formula on a command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gyroid => "gyroid",
            Self::MarschnerLobb => "ml",
        }
    }

    /// The formula of this name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Gyroid, Self::MarschnerLobb].into_iter().find(|formula| formula.name() == name)
    }

    /// The isovalue whose surface is closed.
    pub const fn isovalue(self) -> f64 {
        match self {
            Self::Gyroid => 0.0,
            Self::MarschnerLobb => 0.5,
        }
    }

    fn coordinate(self, x: f64) -> Coordinate {
        let angle = match self {
            Self::Gyroid => 4.0 * PI * x,
            Self::MarschnerLobb => FRAC_PI_2 * x,
        };
        let (sin, cos) = libm::sincos(angle);
        Coordinate { x, sin, cos }
    }
}

impl fmt::Display for Formula {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gyroid => "the built-in gyroid",
            Self::MarschnerLobb => "the built-in signal of Marschner and Lobb",
        })
    }
}

fn gyroid([x, y, z]: [Coordinate; 3]) -> f64 {
    let g = x.sin * y.cos + y.sin * z.cos + z.sin * x.cos;
    let r2 = (x.x * x.x + y.x * y.x + z.x * z.x) / (0.85 * 0.85);
    g + 0.3 - 0.9 * (r2 * r2) * (r2 * r2)
}

fn marschner_lobb([x, y, z]: [Coordinate; 3], ripple: f64) -> f64 {
    let signal = (1.0 - z.sin + ripple) / 2.5;
    signal.min(0.5 + 2.0 * (0.9 - x.x.abs().max(y.x.abs()).max(z.x.abs())))
}

/// What of the signal depends on x and y.
fn ripple(x: f64, y: f64) -> f64 {
    0.25 * (1.0 + libm::cos(12.0 * PI * libm::cos(FRAC_PI_2 * libm::sqrt(x * x + y * y))))
}

/// Most samples along an axis: their cube is the most that a shape takes, at four bytes each.
const SAMPLES_MAX: u64 = 1_321_122;

/// Samples along an axis that a formula can have.
pub(super) const SIZES: RangeInclusive<u64> = 2..=SAMPLES_MAX;

/// What a number of samples should be.
pub(super) const EXPECTED: &str = "a number of samples along an axis from 2 to 1321122";

#[cfg(test)]
mod tests {
    use super::*;

    /// The formulas as they are written in their documentation.
    fn plainly(formula: Formula, [x, y, z]: [f64; 3]) -> f64 {
        match formula {
            Formula::Gyroid => {
                let k = 4.0 * PI;
                let g = libm::sin(k * x) * libm::cos(k * y)
                    + libm::sin(k * y) * libm::cos(k * z)
                    + libm::sin(k * z) * libm::cos(k * x);
                g + 0.3 - 0.9 * libm::pow(libm::sqrt(x * x + y * y + z * z) / 0.85, 8.0)
            }
            Formula::MarschnerLobb => {
                let r = libm::sqrt(x * x + y * y);
                let rho = libm::cos(12.0 * PI * libm::cos(PI * r / 2.0));
                let m = (1.0 - libm::sin(PI * z / 2.0) + 0.25 * (1.0 + rho)) / 2.5;
                f64::min(m, 0.5 + 2.0 * (0.9 - f64::max(x.abs(), f64::max(y.abs(), z.abs()))))
            }
        }
    }

    #[test]
    fn every_sample_is_the_formulas_wherever_a_run_begins() {
        for formula in [Formula::Gyroid, Formula::MarschnerLobb] {
            let n = 17_u64;
            let mut whole = vec![0.0; 17 * 17 * 17];
            let mut source = Analytic::new(formula, n).expect("a size");
            source.read_slices(0, &mut whole).expect("no file");
            for (i, sample) in whole.iter().enumerate() {
                let at = [i % 17, i / 17 % 17, i / 289].map(|i| -1.0 + 2.0 * i as f64 / 16.0);
                let value = plainly(formula, at);
                assert!(
                    (f64::from(*sample) - value).abs() < 1.0e-5 * value.abs().max(1.0),
                    "{formula} {at:?}"
                );
            }
            // Without the slice's own ripples, and from any place.
            let mut source = Analytic::new(formula, n).expect("a size");
            for (first, count) in [(0, 1), (5, 40), (288, 3), (4912, 1), (100, 288), (17, 17), (3, 0)] {
                let mut part = vec![0.0; count];
                source.read_samples(first as u64, &mut part).expect("no file");
                assert_eq!(part, whole[first..][..count], "{formula} {first} {count}");
            }
        }
    }

    #[test]
    fn the_closed_surface_does_not_touch_the_border() {
        for formula in [Formula::Gyroid, Formula::MarschnerLobb] {
            let mut source = Analytic::new(formula, 33).expect("a size");
            let mut samples = vec![0.0_f32; 33 * 33 * 33];
            source.read_slices(0, &mut samples).expect("no file");
            let border = |i: usize| [i % 33, i / 33 % 33, i / 1089].iter().any(|&i| i == 0 || i == 32);
            let above = |sample: f32| f64::from(sample) > formula.isovalue();
            let outside = samples.iter().enumerate().filter(|(i, _)| border(*i));
            assert!(outside.into_iter().all(|(_, sample)| !above(*sample)), "{formula}");
            assert!(samples.iter().any(|sample| above(*sample)), "{formula}");
        }
    }

    #[test]
    fn far_corners_of_a_volume_of_5120_cubed_cost_no_storage() {
        let mut source = Analytic::new(Formula::Gyroid, 5120).expect("a size");
        let mut last = [0.0; 3];
        source.read_samples(source.shape().samples() - 3, &mut last).expect("no file");
        let mut first = [0.0; 1];
        source.read_samples(0, &mut first).expect("no file");
        // Sines and cosines of a multiple of 2 pi are 0 and 1, and r^2 is 3.
        let corner = 0.3 - 0.9 * f64::powi(3.0 / (0.85 * 0.85), 4);
        assert!(
            (f64::from(last[2]) - corner).abs() < 1.0e-4 && (f64::from(first[0]) - corner).abs() < 1.0e-4
        );
    }

    #[test]
    fn sizes_that_make_no_volume_are_refused() {
        for n in [0, 1, SAMPLES_MAX + 1, u64::MAX] {
            let error = Analytic::new(Formula::Gyroid, n).expect_err("no size").to_string();
            assert_eq!(error, format!("gyroid: \"{n}\" is not {EXPECTED}"));
        }
        assert!(VolumeShape::new([SAMPLES_MAX; 3], SampleType::F32).is_ok());
        assert!(VolumeShape::new([SAMPLES_MAX + 1; 3], SampleType::F32).is_err());
    }
}
