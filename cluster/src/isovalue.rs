//! Which isosurfaces of a volume are shown.

use core::str::FromStr;

use anyhow::{Context, Error, Result, bail};
use rt_core::shade::ALBEDO;
use rt_core::{ISOVALUES_MAX, Isosurface};

use crate::scene_source::{Image, Source};

/// An isosurface to show, as in `80.5`, `auto` or `80.5@0.4`: a value and how bright the surface is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Which isovalue.
    pub isovalue: Isovalue,
    /// Grey when fully lit, from 0 to 1.
    pub albedo: f32,
}

/// An isovalue, given or to be found out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Isovalue {
    /// This one.
    Value(f32),
    /// The one a built-in volume is made for, or one that the histogram suggests.
    Auto,
}

impl FromStr for Surface {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (value, grey) = text.split_once('@').map_or((text, None), |(value, grey)| (value, Some(grey)));
        let number = |text: &str| text.parse().ok().filter(|number: &f32| number.is_finite());
        let isovalue = match value {
            "auto" => Isovalue::Auto,
            value => {
                Isovalue::Value(number(value).context("expected auto or a number, as in 80.5 or 80.5@0.4")?)
            }
        };
        let albedo = grey.map_or(Some(ALBEDO), number).filter(|grey| (0.0..=1.0).contains(grey));
        Ok(Self { isovalue, albedo: albedo.context("the grey behind @ is a number from 0 to 1")? })
    }
}

/// The isosurfaces to show of an image; none when it has no volume.
pub(crate) fn resolve(asked: &[Surface], source: &Source, image: &Image) -> Result<Vec<Isosurface>> {
    if image.header.volume.is_none() {
        if !asked.is_empty() {
            bail!("--iso is for volumes, and {} has none", image.name);
        }
        return Ok(Vec::new());
    }
    if asked.len() > ISOVALUES_MAX {
        bail!("--iso takes at most {ISOVALUES_MAX} values; got {}", asked.len());
    }
    let default = [Surface { isovalue: Isovalue::Auto, albedo: ALBEDO }];
    let asked = if asked.is_empty() { &default } else { asked };
    asked
        .iter()
        .map(|surface| {
            Ok(Isosurface { value: value(surface.isovalue, source, image)?, albedo: surface.albedo })
        })
        .collect()
}

fn value(isovalue: Isovalue, source: &Source, image: &Image) -> Result<f32> {
    if let Isovalue::Value(value) = isovalue {
        return Ok(value);
    }
    let known = source.isovalue();
    // All samples the same: no value shows anything.
    let value = if known.is_some() { known } else { image.auto_isovalue()? }.unwrap_or(0.0);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a value between samples, which are single precision"
    )]
    let single = value as f32;
    Ok(single)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_read_and_nonsense_refused() {
        let surface = |text: &str| text.parse::<Surface>().ok();
        let value = |value| Isovalue::Value(value);
        assert_eq!(surface("80.5"), Some(Surface { isovalue: value(80.5), albedo: ALBEDO }));
        assert_eq!(surface("-1e3@0.25"), Some(Surface { isovalue: value(-1000.0), albedo: 0.25 }));
        assert_eq!(surface("auto@1"), Some(Surface { isovalue: Isovalue::Auto, albedo: 1.0 }));
        for wrong in ["", "x", "nan", "inf", "3@", "3@2", "3@-1", "@0.5", "3@nan"] {
            assert_eq!(surface(wrong), None, "{wrong}");
        }
    }
}
