//! The S* walk: drivers that take light from one diffuse end to the next over ideal mirrors and glass.
//!
//! *choose* follows one branch by keyed roulette (rows, hemisphere gathers, light-side rays); *follow a chain* checks a
//! given list of mirror planes (images); the eye's *split* driver, which follows every branch, is in [`split`]. All use
//! the one interaction of [`crate::interaction`].

use glam::Vec3;

use catoptric_scene::Rgb;

use crate::chain::{Chain, Event};
use crate::interaction::Interaction;
use crate::ledger::{Ledger, entry};
use crate::medium::MediumStack;
use crate::plane::PlaneId;
use crate::sequence::Key;
use crate::slab::Passage;
use crate::tracer::{Hit, Ray, Tracer};

pub mod split;

/// Limits of a walk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WalkParams {
    /// Events after which a walk is given up (and booked).
    pub max_depth: u32,
    /// Below this throughput roulette decides whether a walk goes on.
    pub roulette_below: f32,
    /// False: the first surface ends every walk, as in radiosity without extended form factors (`--plain`).
    pub extended: bool,
    /// True for walks that start at a light: interpolated normals scatter importance and power differently.
    pub from_light: bool,
}

impl Default for WalkParams {
    /// 1000 events: a duct of perfect mirrors loses 1e-4 at 120, nothing visible at 1000.
    fn default() -> Self {
        Self { max_depth: 1000, roulette_below: 0.1, extended: true, from_light: false }
    }
}

/// Light that reaches a diffuse side, or a surface that emits.
#[derive(Debug)]
pub struct Arrival<'a> {
    /// Where.
    pub hit: &'a Hit,
    /// World position.
    pub position: Vec3,
    /// Direction of travel.
    pub direction: Vec3,
    /// Surface there.
    pub interaction: &'a Interaction,
    /// Power throughput before the surface splits it (without T(θ) of a coat there: `interaction.receives` has it).
    pub throughput: Rgb,
    /// What happened on the way.
    pub chain: &'a Chain,
    /// Media at the end.
    pub media: MediumStack,
    /// Length of the whole path, metres.
    pub distance: f32,
}

/// How a walk ended.
#[derive(Clone, Copy, Debug)]
pub enum End {
    /// On a surface, by roulette or at the depth limit.
    Inside,
    /// Out of the scene.
    Escaped {
        /// Direction.
        direction: Vec3,
        /// Power throughput.
        throughput: Rgb,
        /// What happened on the way.
        chain: Chain,
        /// Medium from which it left.
        media: MediumStack,
    },
}

/// Follows one branch at each event. `arrive` is called at every surface with a diffuse or emitting side.
///
/// Everything that happens to `throughput` is booked in `ledger`, so that its entries sum to what was sent.
pub fn choose(
    tracer: &Tracer,
    ray: Ray,
    media: MediumStack,
    throughput: Rgb,
    key: Key,
    params: &WalkParams,
    ledger: &mut Ledger,
    mut arrive: impl FnMut(&Arrival),
) -> End {
    choose_meeting(tracer, ray, media, throughput, key, params, ledger, |arrival| {
        let interaction = arrival.interaction;
        if interaction.receives > 0.0 || interaction.emission.0.max_element() > 0.0 {
            arrive(arrival);
        }
    })
}

/// [`choose`], but `meet` is called at every surface, mirrors, glass and black backs included.
pub fn choose_meeting(
    tracer: &Tracer,
    ray: Ray,
    media: MediumStack,
    throughput: Rgb,
    key: Key,
    params: &WalkParams,
    ledger: &mut Ledger,
    meet: impl FnMut(&Arrival),
) -> End {
    choose_meeting_after(tracer, ray, media, throughput, Chain::DIRECT, key, params, ledger, meet)
}

/// [`choose_meeting`] for a walk to which `chain` has happened already.
pub fn choose_meeting_after(
    tracer: &Tracer,
    mut ray: Ray,
    mut media: MediumStack,
    mut throughput: Rgb,
    mut chain: Chain,
    key: Key,
    params: &WalkParams,
    ledger: &mut Ledger,
    mut meet: impl FnMut(&Arrival),
) -> End {
    let mut distance = 0.0;
    for depth in 0..params.max_depth {
        let Some(hit) = tracer.nearest(&ray, f32::INFINITY) else {
            ledger.escaped += entry(throughput);
            return End::Escaped { direction: ray.direction, throughput, chain, media };
        };
        distance += hit.t;

        // Beer–Lambert on the way.
        let medium = media.current();
        let passed = throughput * tracer.media().transmittance(medium, hit.t);
        ledger.absorbed += entry(throughput - passed);
        throughput = passed;

        let interaction = tracer.interact(ray.direction, &hit, media);
        let position = ray.origin + ray.direction * hit.t;
        let receives = interaction.receives > 0.0;
        meet(&Arrival {
            hit: &hit,
            position,
            direction: ray.direction,
            interaction: &interaction,
            throughput,
            chain: &chain,
            media,
            distance,
        });

        // What does not go on stays here.
        let passed_on = interaction.passed_on();
        let kept = throughput * (Rgb::ONE - passed_on);
        if receives {
            ledger.arrived += entry(kept);
        } else if hit.back && interaction.branches().iter().all(|b| b.event == Event::Undeviated) {
            // Nothing but alpha lets light go on from behind.
            ledger.black_backs += entry(kept);
        } else {
            ledger.absorbed += entry(kept);
        }
        if !params.extended {
            ledger.cut_off += entry(throughput * passed_on);
            return End::Inside;
        }

        // One branch, with a probability in proportion to its share.
        let shares = interaction.branches().iter().map(|b| (throughput * b.throughput).max_element());
        let total: f32 = shares.clone().sum();
        if total <= 0.0 {
            return End::Inside;
        }
        let going_on = throughput * passed_on;
        let mut pick = key.uniform(2 * depth) * total;
        let mut chosen = 0;
        let mut probability = 1.0;
        for (index, share) in shares.enumerate() {
            if share > 0.0 {
                (chosen, probability) = (index, share / total);
                if pick < share {
                    break;
                }
                pick -= share;
            }
        }
        let branch = &interaction.branches()[chosen];
        throughput = throughput * branch.throughput / probability;
        ledger.roulette += entry(going_on) - entry(throughput);
        if params.from_light && branch.event != Event::Undeviated {
            let corrected = throughput * interaction.adjoint_factor(ray.direction, branch.direction);
            ledger.shading += entry(throughput - corrected);
            throughput = corrected;
        }

        // Unbiased roulette keeps long walks in check.
        let strength = throughput.max_element();
        if strength < params.roulette_below {
            let survival = strength / params.roulette_below;
            if key.uniform(2 * depth + 1) >= survival {
                ledger.roulette += entry(throughput);
                return End::Inside;
            }
            ledger.roulette += entry(throughput) - entry(throughput / survival);
            throughput /= survival;
        }

        chain.push(branch.event);
        media = branch.media;
        let origin = tracer.departure(&hit, position);
        ray = Ray { origin, direction: branch.direction, from: tracer.planes().of(hit.triangle) };
    }
    ledger.cut_off += entry(throughput);
    End::Inside
}

/// Power throughput of the path from `origin` over the mirrors in `planes` to the last of `targets`.
///
/// `targets[k]` is where the path aims before it meets `planes[k]` (the light's image through the mirrors k..); the
/// last target is the point on the light itself. Panes and blended surfaces on the way let their share pass. Zero
/// where a mirror is missed or something blocks.
pub fn follow(
    tracer: &Tracer,
    origin: Vec3,
    from: PlaneId,
    planes: &[PlaneId],
    targets: &[Vec3],
    to: PlaneId,
) -> Rgb {
    // What lies in the last mirror's plane has no image in it: the image would be the thing itself.
    if to != PlaneId::NONE && planes.last() == Some(&to) {
        return Rgb::ZERO;
    }
    let Some(left) = over_mirrors(tracer, origin, from, planes, targets) else { return Rgb::ZERO };
    left.throughput * tracer.visibility_at_last(left.origin, left.from, left.target, to, left.distance)
}

/// What is left of a path behind its last mirror.
#[derive(Clone, Copy, Debug)]
pub struct Left {
    /// Where it leaves the mirror.
    pub origin: Vec3,
    /// The mirror's plane.
    pub from: PlaneId,
    /// The point on the light.
    pub target: Vec3,
    /// Power throughput so far.
    pub throughput: Rgb,
    /// Length of the path so far, metres.
    pub distance: f32,
}

/// The first part of [`follow`], up to the last mirror; `None` where a mirror is missed or something blocks.
pub fn over_mirrors(
    tracer: &Tracer,
    origin: Vec3,
    from: PlaneId,
    planes: &[PlaneId],
    targets: &[Vec3],
) -> Option<Left> {
    let mut throughput = Rgb::ONE;
    let mut distance = 0.0;
    let length = targets.first().map_or(0.0, |image| image.distance(origin));
    let mut ray = Ray { origin, direction: Vec3::ZERO, from };
    for (&plane, &target) in planes.iter().zip(targets) {
        let aim = (target - ray.origin).normalize_or_zero();
        // A target behind the last mirror is not seen in it.
        if aim.dot(ray.direction) < 0.0 {
            return None;
        }
        ray.direction = aim;
        let start = ray.origin;
        ray = off_mirror(tracer, ray, plane, length, &mut throughput)?;
        distance += ray.origin.distance(start);
    }
    let target = *targets.last()?;
    let ahead = (target - ray.origin).dot(ray.direction) >= 0.0;
    ahead.then_some(Left { origin: ray.origin, from: ray.from, target, throughput, distance })
}

/// Surfaces that one leg of a path passes, at most.
const MAX_CROSSINGS: u32 = 64;

/// Straight on through whatever lets light pass, up to a mirror in `plane` and off it; `None` where it is missed or something
/// blocks. `length` is that of the whole path.
fn off_mirror(
    tracer: &Tracer,
    mut ray: Ray,
    plane: PlaneId,
    length: f32,
    throughput: &mut Rgb,
) -> Option<Ray> {
    let mut passage = Passage::new(tracer, ray.direction, length);
    for _ in 0..=MAX_CROSSINGS {
        let hit = tracer.nearest(&ray, f32::INFINITY)?;
        let here = tracer.planes().of(hit.triangle);
        let origin = ray.origin + ray.direction * hit.t;
        if here != plane {
            if !passage.passes(&hit, hit.t) {
                return None;
            }
            ray = Ray { origin, from: here, ..ray };
            continue;
        }
        let interaction = tracer.interact(ray.direction, &hit, MediumStack::AIR);
        let is_wanted = |event: Event| matches!(event, Event::Planar(at) | Event::Facet(at) if at == plane);
        let branch = interaction.branches().iter().find(|b| is_wanted(b.event))?;
        // 0 where the mirror lies within a sheet of glass.
        *throughput *= passage.share() * branch.throughput;
        return Some(Ray { origin, direction: branch.direction, from: here });
    }
    None
}

/// Where a path that starts at a light arrives on a diffuse side, after the mirrors in `planes` in the order in which it meets
/// them: the hit, its place and the surface there. Panes and blended surfaces on the way let it pass.
pub fn arrival_over(
    tracer: &Tracer,
    mut ray: Ray,
    planes: impl Iterator<Item = PlaneId>,
) -> Option<(Hit, Vec3, Interaction)> {
    let mut throughput = Rgb::ONE;
    for plane in planes {
        ray = off_mirror(tracer, ray, plane, f32::INFINITY, &mut throughput)?;
    }
    let mut passage = Passage::new(tracer, ray.direction, f32::INFINITY);
    for _ in 0..=MAX_CROSSINGS {
        let hit = tracer.nearest(&ray, f32::INFINITY)?;
        let interaction = tracer.interact(ray.direction, &hit, MediumStack::AIR);
        let origin = ray.origin + ray.direction * hit.t;
        if interaction.receives > 0.0 && passage.share() != Rgb::ZERO {
            return Some((hit, origin, interaction));
        }
        if !passage.passes(&hit, hit.t) {
            return None;
        }
        ray = Ray { origin, from: tracer.planes().of(hit.triangle), ..ray };
    }
    None
}
