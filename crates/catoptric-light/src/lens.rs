//! Lenses: curved or refracting bodies in which lamps look large from nearly everywhere, as globes around bulbs do.
//!
//! A receiver that looks at such a body finds the lamps in it at once, and their light is as free of noise as that of lamps
//! (`irradiance::lens`); light-side rays, which own all other light over curved and refracting surfaces, would have to be counted. Where lamps are
//! small in a body, or in few views of it, as by the focus of a ball, it is the other way round.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use catoptric_scene::{Rgb, Surface, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::chain::Event;
use catoptric_trace::sequence::{Key, Purpose};

use crate::irradiance::{Lights, Scratch};
use crate::lamp::pieces;
use crate::receiver::Receiver;

/// A body that shows lamps large.
#[derive(Clone, Debug)]
pub struct Lens {
    triangles: Range<u32>,
    /// A ball around it.
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
}

impl Lens {
    /// Whether a triangle is part of it.
    #[inline]
    pub(crate) fn holds(&self, triangle: TriangleId) -> bool {
        self.triangles.contains(&triangle.0)
    }
}

/// The lenses of a scene.
#[derive(Clone, Debug, Default)]
pub struct Lenses(Vec<Lens>);

impl Lenses {
    /// Each of them.
    pub(crate) fn all(&self) -> impl Iterator<Item = &Lens> {
        self.0.iter()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Number of them.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether a triangle is part of one.
    #[inline]
    pub fn hold(&self, triangle: TriangleId) -> bool {
        self.0.iter().any(|lens| lens.holds(triangle))
    }
}

/// Bodies that are looked at, the largest first.
const MAX_BODIES: usize = 16;
/// Each receiver asks every lens: where they are more, light-side rays are quicker.
const MAX_LENSES: usize = 2;
/// Rays from each receiver to each body.
const LOOKS: u32 = 64;
/// Of these so many must meet it for the receiver to have a say.
const MET: usize = 16;
/// Share of the rays that meet a body which find the lamps, as if all found the same: (Σv)²/(nΣv²).
const LARGE: f32 = 0.08;
/// Share of the receivers that see it to whom it shows the lamps large.
const NEARLY_ALL: f32 = 0.75;
/// … and of the first of them, by which most bodies are dismissed.
const SOME: f32 = 0.4;

impl Lights<'_> {
    /// Finds the lenses, as some receivers see them: those that light-side rays leave to [`Lights::through_lenses`].
    pub fn find_lenses(&mut self, receivers: &[Receiver], seed: u32) {
        if !self.params().light_rays || self.emitters().cells().is_empty() {
            return;
        }
        let mut bodies = bodies(self.tracer());
        bodies.sort_by(|a, b| b.radius.total_cmp(&a.radius).then(a.triangles.start.cmp(&b.triangles.start)));
        bodies.truncate(MAX_BODIES);
        let share_of = |body: &Lens, receivers: &[Receiver]| {
            let key = Key::new(seed, Purpose::Lens, u64::from(body.triangles.start));
            let views: Vec<Option<bool>> = receivers
                .par_iter()
                .with_max_len(1)
                .enumerate()
                .map_init(Scratch::default, |scratch, (index, receiver)| {
                    self.shows_lamps(body, receiver, key.child(index as u32), scratch)
                })
                .collect();
            let seen = views.iter().flatten().count();
            let large = views.iter().flatten().filter(|&&large| large).count();
            (seen > 0).then_some(large as f32 / seen as f32)
        };
        let (first, _) = receivers.split_at(receivers.len() / 4);
        let is_lens = |body: &Lens| {
            share_of(body, first).is_none_or(|share| share >= SOME)
                && share_of(body, receivers).is_some_and(|share| share >= NEARLY_ALL)
        };
        bodies.retain(is_lens);
        if bodies.len() <= MAX_LENSES {
            self.lenses = Lenses(bodies);
        }
    }

    /// Whether a body shows the lamps large to a receiver; `None` where it hardly sees the body.
    fn shows_lamps(&self, body: &Lens, receiver: &Receiver, key: Key, scratch: &mut Scratch) -> Option<bool> {
        let mut found: Vec<f32> = Vec::with_capacity(LOOKS as usize);
        self.looks_into(body, receiver, LOOKS, key, scratch, |light: Rgb| found.push(light.element_sum()));
        let sum: f32 = found.iter().sum();
        let squares: f32 = found.iter().map(|v| v * v).sum();
        (found.len() >= MET).then_some(squares > 0.0 && sum * sum >= LARGE * LOOKS as f32 * squares)
    }
}

/// The curved or refracting bodies of a scene: pieces of surfaces that share no corner.
fn bodies(tracer: &Tracer) -> Vec<Lens> {
    let scene = tracer.scene();
    let is_body = |surface: &&Surface| {
        let material = &scene.materials()[surface.material.index()];
        let bends = |t: u32| material.is_solid() || tracer.reflection(TriangleId(t)) == Event::Curved;
        material.may_be_specular() && surface.triangles.clone().any(bends)
    };
    let body = |triangles: Range<u32>| {
        // Lamps are seen straight through sheets of glass.
        if triangles.clone().any(|t| tracer.slab_of(TriangleId(t)).is_some()) {
            return None;
        }
        let corners = || triangles.clone().flat_map(|t| scene.corners(TriangleId(t)));
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let center = 0.5 * (low + high);
        // Not a corner on the border.
        let radius = corners().map(|c| c.distance(center)).fold(0.0, f32::max) * (1.0 + 1e-5);
        (radius > 0.0).then_some(Lens { triangles, center, radius })
    };
    let surfaces = scene.surfaces().par_iter().with_max_len(1).filter(is_body);
    surfaces
        .flat_map_iter(|surface| pieces(scene, surface.triangles.clone()).into_iter().filter_map(body))
        .collect()
}
