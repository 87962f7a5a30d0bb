//! A surface under fire: rays aimed at its edges and vertices, and what became of them.

use glam::Vec3;
use rt_core::{Flat, Ray, SceneView};

use super::pass::{Pass, judge};
use super::surface::{Side, Surface};
use super::{Dice, image};

/// A surface under fire.
pub struct Target {
    pub name: String,
    pub surface: Surface,
    size: f32,
    image: Vec<u8>,
    pub dice: Dice,
    pub tally: Tally,
}

/// What became of the rays.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub rays: u32,
    /// Rays that the exact ray takes past the surface.
    pub meet_nothing: u32,
    /// Rays for which rounding decides.
    pub at_silhouette: u32,
    /// Rays with a hit as near as it must be, though behind the point they were aimed at.
    pub hit_behind_aim: u32,
}

impl Tally {
    /// Asserts that of a surface with fat triangles nearly every ray was stopped, so that the excuses that
    /// the judge accepts are not what passes the test.
    pub fn assert_few_excused(&self, name: &str) {
        let excused = self.meet_nothing + self.at_silhouette + self.hit_behind_aim;
        assert!(excused * 100 <= self.rays + 99, "{name}: {self:?}");
    }
}

impl core::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.rays += other.rays;
        self.meet_nothing += other.meet_nothing;
        self.at_silhouette += other.at_silhouette;
        self.hit_behind_aim += other.hit_behind_aim;
    }
}

impl Target {
    pub fn new(name: String, surface: Surface, seed: u64) -> Self {
        let image = image(&surface.mesh, 0.5, 4096);
        let name = format!("{name}, seed {seed}");
        Self { name, size: surface.size(), surface, image, dice: Dice(seed), tally: Tally::default() }
    }

    /// Aims rays from eyes in all directions, `distance` sizes away, at what can be seen from there. A ray with
    /// a hit at most `behind` sizes behind its aim is not judged.
    pub fn shoot_from(&mut self, distance: f32, behind: f32, rays: u32) {
        for _ in 0..rays {
            let aimed_at = self.aim();
            let towards_eye = self.dice.direction();
            let origin = aimed_at.point + towards_eye * (distance * self.size);
            let ray = Ray { origin, direction: aimed_at.point - origin, t_max: f32::INFINITY };
            self.shoot(&aimed_at, &ray, (distance + behind) / distance);
        }
    }

    /// Aims parallel rays that start `distance` sizes away, at a surface that has no back.
    pub fn shoot_along(&mut self, direction: Vec3, distance: f32, rays: u32) {
        for _ in 0..rays {
            let aimed_at = self.aim();
            let origin = aimed_at.point - direction * (distance * self.size);
            self.shoot(&aimed_at, &Ray { origin, direction, t_max: f32::INFINITY }, f32::MAX);
        }
    }

    /// A random point of an edge, or a vertex.
    pub fn aim(&mut self) -> Aim {
        let triangle = self.dice.below(self.surface.mesh.triangles.len());
        let side = Side { triangle: u32::try_from(triangle).expect("a mesh"), corner: self.dice.below(3) };
        let [a, b] = self.surface.ends(side);
        if self.dice.unit() < 0.25 {
            Aim { point: a, around: self.surface.fan(side) }
        } else {
            let around = self.surface.across(side).map(|across| vec![side.triangle, across]);
            Aim { point: a + (b - a) * self.dice.unit(), around }
        }
    }

    fn shoot(&mut self, Aim { point, around }: &Aim, ray: &Ray, t_of_aim: f32) {
        let Some(around) = around else { return };
        if !self.surface.all_turned_alike(around, ray) {
            return;
        }
        self.tally.rays += 1;
        let scene = SceneView::new(Flat::new(&self.image)).expect("a valid image");
        let hit = scene.nearest(ray, &mut ()).expect("a sound image").map_or(f32::INFINITY, |hit| hit.t);
        if hit <= t_of_aim {
            return;
        }
        match judge(&self.surface, ray, hit) {
            Pass::Leak { triangle, t } => {
                panic!("{}: {ray:?}, aimed at {point}, passes triangle {triangle} at {t}", self.name)
            }
            Pass::MeetsNothing => self.tally.meet_nothing += 1,
            Pass::AtSilhouette => self.tally.at_silhouette += 1,
            Pass::HitBehindAim => self.tally.hit_behind_aim += 1,
        }
    }
}

/// A point of a surface, and the triangles that meet there when the surface goes on in every direction.
pub struct Aim {
    pub point: Vec3,
    pub around: Option<Vec<u32>>,
}
