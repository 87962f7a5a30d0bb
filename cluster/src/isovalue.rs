//! Which isosurfaces of a volume are shown.

use core::cell::OnceCell;
use core::fmt;
use core::str::FromStr;

use anyhow::{Context, Error, Result, bail};
use rt_core::shade::ALBEDO;
use rt_core::{ISOVALUES_MAX, Isosurface};

use crate::scene_source::{Image, Source};
use crate::session::Session;

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

impl fmt::Display for Surface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.isovalue {
            Isovalue::Value(value) => write!(f, "{value}@{}", self.albedo),
            Isovalue::Auto => write!(f, "auto@{}", self.albedo),
        }
    }
}

/// The isosurfaces of an image that a run shows.
pub(crate) struct Surfaces<'a> {
    /// What was asked for all moments that do not say themselves.
    asked: &'a [Surface],
    source: &'a Source,
    image: &'a Image,
    /// What `auto` is, once somebody has wanted to know.
    auto: OnceCell<f32>,
}

impl<'a> Surfaces<'a> {
    /// What `--iso` asks for, of an image that a session is replayed on.
    pub(crate) fn new(
        asked: &'a [Surface],
        session: &Session,
        source: &'a Source,
        image: &'a Image,
    ) -> Result<Self> {
        let name = &image.name;
        match (image.header.volume, asked.len(), session.has_isosurfaces()) {
            (None, 1.., _) => bail!("--iso is for volumes, and {name} has none"),
            (None, _, true) => bail!("the session has isovalues, which are for volumes, and {name} has none"),
            (Some(_), 1.., true) => bail!("the session says which isovalues are shown; leave --iso out"),
            (Some(_), got, _) if got > ISOVALUES_MAX => {
                bail!("--iso takes at most {ISOVALUES_MAX} values; got {got}")
            }
            _ => Ok(Self { asked, source, image, auto: OnceCell::new() }),
        }
    }

    /// The isosurfaces of a moment that asks for these; none when there is no volume.
    pub(crate) fn of_moment(&self, asked: Option<&[Surface]>) -> Result<Vec<Isosurface>> {
        if self.image.header.volume.is_none() {
            return Ok(Vec::new());
        }
        let default = [Surface { isovalue: Isovalue::Auto, albedo: ALBEDO }];
        let of_all = if self.asked.is_empty() { &default } else { self.asked };
        let isosurface = |surface: &Surface| {
            Ok(Isosurface { value: self.value(surface.isovalue)?, albedo: surface.albedo })
        };
        asked.unwrap_or(of_all).iter().map(isosurface).collect()
    }

    fn value(&self, isovalue: Isovalue) -> Result<f32> {
        if let Isovalue::Value(value) = isovalue {
            return Ok(value);
        }
        if let Some(value) = self.auto.get() {
            return Ok(*value);
        }
        let known = self.source.isovalue();
        // All samples the same: no value shows anything.
        let value = if known.is_some() { known } else { self.image.auto_isovalue()? }.unwrap_or(0.0);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a value between samples, which are single precision"
        )]
        let single = value as f32;
        Ok(*self.auto.get_or_init(|| single))
    }
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
        let printed = ["80.5@0.8", "-1000@0.25", "auto@1"].map(|text| surface(text).unwrap().to_string());
        assert_eq!(printed, ["80.5@0.8", "-1000@0.25", "auto@1"]);
        assert_eq!(surface("auto@1"), Some(Surface { isovalue: Isovalue::Auto, albedo: 1.0 }));
        for wrong in ["", "x", "nan", "inf", "3@", "3@2", "3@-1", "@0.5", "3@nan"] {
            assert_eq!(surface(wrong), None, "{wrong}");
        }
    }
}
