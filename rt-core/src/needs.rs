//! What a scene uses, so that nobody pays for the rest.

use core::fmt;

/// Set of the features that a scene image uses; a reader refuses an image with a bit that it does not know, or
/// with a feature that was left out of its build.
///
/// So far there are triangles, spheres and a volume. An image holds no normals: that of a hit follows from what was hit, and
/// is [not computed](crate::SceneView::nearest_place) where it is not wanted. Nor does it take a bit that there are several
/// geometries: their ids are [looked up](crate::SceneView::geometry_id) after the fact, and no kernel reads them.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct SceneNeeds(u32);

impl SceneNeeds {
    /// Nothing at all.
    pub const NONE: Self = Self(0);
    /// Triangles in clusters.
    pub const TRIANGLES: Self = Self(1);
    /// Spheres in clusters.
    pub const SPHERES: Self = Self(1 << 1);
    /// A volume, drawn as isosurfaces.
    pub const VOLUME: Self = Self(1 << 2);

    /// Every feature that this version knows.
    pub const KNOWN: Self = Self::TRIANGLES.with(Self::SPHERES).with(Self::VOLUME);

    /// Every feature that this build can trace, as the features of the crate say.
    pub const BUILT: Self = {
        let triangles = if cfg!(feature = "triangles") { Self::TRIANGLES } else { Self::NONE };
        let spheres = if cfg!(feature = "spheres") { Self::SPHERES } else { Self::NONE };
        let volume = if cfg!(feature = "volumes") { Self::VOLUME } else { Self::NONE };
        triangles.with(spheres).with(volume)
    };

    /// The set with these bits, or `None` when one of them is unknown.
    pub const fn from_bits(bits: u32) -> Option<Self> {
        if bits & !Self::KNOWN.0 == 0 { Some(Self(bits)) } else { None }
    }

    /// The set as written into an image.
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Whether all of `other` is in this set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether there is anything that lies in the grid.
    pub const fn has_primitives(self) -> bool {
        self.0 & (Self::TRIANGLES.0 | Self::SPHERES.0) != 0
    }

    /// Both sets together.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// What is in this set and not in the other.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

impl fmt::Display for SceneNeeds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = [(Self::TRIANGLES, "triangles"), (Self::SPHERES, "spheres"), (Self::VOLUME, "a volume")];
        let mut separator = "";
        for (_, name) in names.into_iter().filter(|(kind, _)| self.contains(*kind)) {
            write!(f, "{separator}{name}")?;
            separator = " and ";
        }
        if separator.is_empty() { f.write_str("nothing") } else { Ok(()) }
    }
}

impl fmt::Debug for SceneNeeds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SceneNeeds({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::SceneNeeds;

    #[test]
    fn an_unknown_bit_is_refused() {
        assert_eq!(SceneNeeds::from_bits(1), Some(SceneNeeds::TRIANGLES));
        assert_eq!(SceneNeeds::from_bits(7), Some(SceneNeeds::KNOWN));
        assert_eq!(std::format!("{}", SceneNeeds::KNOWN), "triangles and spheres and a volume");
        assert_eq!(SceneNeeds::from_bits(1 << 31), None);
        assert!(SceneNeeds::NONE.with(SceneNeeds::TRIANGLES).contains(SceneNeeds::TRIANGLES));
    }

    #[test]
    fn what_is_left_out_is_what_is_needed_and_not_built() {
        let needs = SceneNeeds::KNOWN;
        assert_eq!(needs.without(SceneNeeds::TRIANGLES), SceneNeeds::SPHERES.with(SceneNeeds::VOLUME));
        assert_eq!(needs.without(needs), SceneNeeds::NONE);
    }
}
