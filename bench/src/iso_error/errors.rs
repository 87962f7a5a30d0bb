//! How far found places are from exact ones.

use crate::spread::quantile;

/// What became of one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Difference {
    /// It meets nothing, and nothing was found.
    Background,
    /// Another surface was found, or one where there is none, or none where there is one.
    Elsewhere,
    /// The surface was found this far from where it is.
    Apart {
        voxels: f64,
        /// Between the normals.
        degrees: f64,
    },
}

/// What became of all rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Errors {
    pub(super) rays: u64,
    /// Rays that meet the surface.
    pub(super) hits: u64,
    /// Rays that found it elsewhere.
    pub(super) elsewhere: u64,
    /// Of the others, in voxels.
    pub(super) distance: Summary,
    /// Between normals, in degrees.
    pub(super) angle: Summary,
}

/// Some numbers of one kind; all 0 when there are none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Summary {
    pub(super) largest: f64,
    /// 999 of 1000 are not above.
    pub(super) p999: f64,
    /// Root of the mean of squares.
    pub(super) rms: f64,
}

/// What is found farther away is another surface.
const VOXELS_MAX: f64 = 1.0;

impl Difference {
    pub(super) fn of(voxels: f64, degrees: f64) -> Self {
        if voxels <= VOXELS_MAX { Self::Apart { voxels, degrees } } else { Self::Elsewhere }
    }
}

impl Errors {
    pub(super) fn of(differences: &[Difference]) -> Self {
        let count = |is: fn(&Difference) -> bool| differences.iter().filter(|one| is(one)).count() as u64;
        let apart = |of: fn(f64, f64) -> f64| {
            let these = differences.iter().filter_map(|one| match one {
                Difference::Apart { voxels, degrees } => Some(of(*voxels, *degrees)),
                _ => None,
            });
            Summary::of(these.collect())
        };
        Self {
            rays: differences.len() as u64,
            hits: count(|one| *one != Difference::Background),
            elsewhere: count(|one| *one == Difference::Elsewhere),
            distance: apart(|voxels, _| voxels),
            angle: apart(|_, degrees| degrees),
        }
    }
}

impl Summary {
    fn of(mut numbers: Vec<f64>) -> Self {
        numbers.sort_by(f64::total_cmp);
        let squares: f64 = numbers.iter().map(|number| number * number).sum();
        let at = |share| quantile(&numbers, share).unwrap_or(0.0);
        Self { largest: at(1.0), p999: at(0.999), rms: (squares / numbers.len().max(1) as f64).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_elsewhere_is_counted_and_not_averaged() {
        let errors = Errors::of(&[
            Difference::Background,
            Difference::of(0.75, 0.0),
            Difference::of(0.25, 2.0),
            Difference::of(1.25, 90.0),
            Difference::Elsewhere,
        ]);
        assert_eq!((errors.rays, errors.hits, errors.elsewhere), (5, 4, 2));
        assert_eq!((errors.distance.largest, errors.angle.largest), (0.75, 2.0));
        assert_eq!(errors.distance.rms, (0.3125_f64).sqrt());
    }

    #[test]
    fn nothing_found_is_no_error() {
        let errors = Errors::of(&[Difference::Background; 3]);
        assert_eq!((errors.hits, errors.distance), (0, Summary { largest: 0.0, p999: 0.0, rms: 0.0 }));
    }
}
