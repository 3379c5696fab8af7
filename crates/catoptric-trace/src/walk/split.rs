//! The eye's driver: every branch is followed, weak ones by roulette.

use glam::Vec3;

use catoptric_scene::Rgb;

use crate::chain::Event;
use crate::interaction::Interaction;
use crate::medium::MediumStack;
use crate::sequence::Key;
use crate::tracer::{Hit, Ray, Tracer};

/// Limits of the split driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplitParams {
    /// Events after which a path is given up.
    pub max_depth: u32,
    /// Below this throughput roulette decides whether a branch is followed.
    pub roulette_below: f32,
}

impl Default for SplitParams {
    fn default() -> Self {
        Self { max_depth: 1000, roulette_below: 4e-4 }
    }
}

impl SplitParams {
    /// For one of so many (weighted) samples of a pixel. A branch of throughput t that goes on with the probability t/τ, and then for τ,
    /// has the variance t (τ − t) of its light: at the same number of times the threshold, that of the mean stays.
    #[must_use]
    pub fn for_one_of(self, samples: f32) -> Self {
        let roulette_below = self.roulette_below * samples.max(1.0);
        Self { roulette_below: roulette_below.min(1.0), ..self }
    }
}

/// A surface that the eye meets: an [`Arrival`](super::Arrival) whose events are counted, not named. A chain of 40 bytes in every
/// branch that waits is much to copy.
#[derive(Debug)]
pub struct Seen<'a> {
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
    /// Events on the way.
    pub events: u32,
    /// What they were: the same for paths through neighbouring pixels that meet the same things.
    pub way: Way,
    /// Media at the end.
    pub media: MediumStack,
    /// Length of the whole path, metres.
    pub distance: f32,
}

/// What the eye meets.
#[derive(Debug)]
pub enum Sight<'a> {
    /// A surface.
    Surface(Seen<'a>),
    /// Out of the scene.
    Sky {
        /// Where it left from.
        origin: Vec3,
        /// Direction.
        direction: Vec3,
        /// Throughput.
        throughput: Rgb,
        /// Events on the way.
        events: u32,
        /// What they were.
        way: Way,
    },
}

/// What happened to a path, event by event: in base four, so that a dozen are told apart, and of longer ways most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Way {
    events: u32,
    bends: bool,
}

impl Way {
    /// … and this event at its end; `into` another medium or not.
    #[must_use]
    pub fn through(self, event: Event, into: bool) -> Self {
        let kind = match event {
            Event::Undeviated => 1,
            Event::Enters(_) | Event::Leaves(_) => 2,
            Event::Curved if into => 2,
            Event::Planar(_) | Event::Facet(_) | Event::Curved => 3,
        };
        let bends = self.bends || !matches!(event, Event::Undeviated | Event::Planar(_));
        Self { events: self.events.wrapping_mul(4).wrapping_add(kind), bends }
    }

    /// Whether anything had a part in it but large planar mirrors, panes and alpha.
    pub fn bends(self) -> bool {
        self.bends
    }
}

/// A branch that is still to be followed.
#[derive(Clone, Copy, Debug)]
struct Open {
    ray: Ray,
    media: MediumStack,
    throughput: Rgb,
    distance: f32,
    /// Surfaces met.
    depth: u32,
    /// Those that did something to the light.
    events: u32,
    way: Way,
    /// It went on by roulette.
    drawn: bool,
}

/// Memory for the branches that wait, from path to path.
#[derive(Debug, Default)]
pub struct Waiting(Vec<Open>);

/// Roulette by systematic sampling: of branches of strength s₁, s₂, … below the threshold τ those go on, for τ, where the sums of
/// s/τ pass a whole number, begun anywhere below 1. Each does with the probability s/τ, and together they stand for their sum
/// but for less than τ, where independent draws would differ by the root of their number.
struct Roulette(f32);

impl Roulette {
    fn goes_on(&mut self, probability: f32) -> bool {
        self.0 += probability;
        let goes_on = self.0 >= 1.0;
        if goes_on {
            self.0 -= 1.0;
        }
        goes_on
    }
}

/// Branches that wait: more than this and the weakest go by roulette at a higher threshold.
const MAX_OPEN: usize = 64;

/// Surfaces after which light is let go that normals which are no shape keep in a body: it would go round for all events, at four times the time of
/// a bottle with smooth edges.
const CAUGHT: u32 = 12;

/// Follows every branch from the eye. `see` gets everything that is met; `first` the first visible hit.
///
/// This is sample `index` of those with the same `key`, whose draws are stratified together.
///
/// Opaque single-sided surfaces are passed from behind before the first hit, as glTF viewers do.
pub fn trace(
    tracer: &Tracer,
    ray: Ray,
    media: MediumStack,
    sample: (Key, u32),
    params: &SplitParams,
    waiting: &mut Waiting,
    first: impl FnMut(&Hit),
    see: impl FnMut(Sight),
) {
    let path = Open {
        ray,
        media,
        throughput: Rgb::ONE,
        distance: 0.0,
        depth: 0,
        events: 0,
        way: Way::default(),
        drawn: false,
    };
    let interact = |direction: Vec3, hit: &Hit, media, depth| {
        tracer.interact_as_seen(direction, hit, media, depth <= CAUGHT)
    };
    follow(tracer, path, Some(first), sample, params, waiting, interact, see);
}

/// [`trace`] from a diffuse surface, for light that one event has happened to: normal maps bend nothing, and backs are opaque.
pub fn trace_on(
    tracer: &Tracer,
    ray: Ray,
    media: MediumStack,
    throughput: Rgb,
    sample: (Key, u32),
    params: &SplitParams,
    waiting: &mut Waiting,
    see: impl FnMut(Sight),
) {
    let path = Open {
        ray,
        media,
        throughput,
        distance: 0.0,
        depth: 1,
        events: 1,
        way: Way::default(),
        drawn: false,
    };
    let interact = |direction: Vec3, hit: &Hit, media, _| tracer.interact(direction, hit, media);
    follow(tracer, path, None::<fn(&Hit)>, sample, params, waiting, interact, see);
}

/// Follows all branches of a path, `first` to what it sees first.
fn follow(
    tracer: &Tracer,
    mut path: Open,
    first: Option<impl FnMut(&Hit)>,
    (key, index): (Key, u32),
    params: &SplitParams,
    waiting: &mut Waiting,
    interact: impl Fn(Vec3, &Hit, MediumStack, u32) -> Interaction,
    mut see: impl FnMut(Sight),
) {
    let open = &mut waiting.0;
    open.clear();
    // One for all branches that are met whatever it decides; the rest depend on it, and have another at each event.
    let mut first_draws = Roulette(key.shifted(index));
    let key = key.child(index);
    let mut splits = 0;
    let mut first = first;
    loop {
        let goes_on = 'event: {
            let Some(hit) = tracer.nearest(&path.ray, f32::INFINITY) else {
                let Open { ray: Ray { origin, direction, .. }, throughput, events, way, .. } = path;
                see(Sight::Sky { origin, direction, throughput, events, way });
                break 'event false;
            };
            path.distance += hit.t;
            path.depth += 1;
            let position = path.ray.origin + path.ray.direction * hit.t;
            let from = tracer.planes().of(hit.triangle);
            if first.is_some() && hit.back && tracer.is_culled_from_behind(hit.triangle) {
                (path.ray.origin, path.ray.from) = (position, from);
                break 'event path.depth < params.max_depth;
            }
            if let Some(mut first) = first.take() {
                first(&hit);
            }
            if path.media != MediumStack::AIR {
                path.throughput *= tracer.media().transmittance(path.media.current(), hit.t);
            }
            let interaction = interact(path.ray.direction, &hit, path.media, path.depth);
            see(Sight::Surface(Seen {
                hit: &hit,
                position,
                direction: path.ray.direction,
                interaction: &interaction,
                throughput: path.throughput,
                events: path.events,
                way: path.way,
                media: path.media,
                distance: path.distance,
            }));
            if path.depth >= params.max_depth {
                break 'event false;
            }
            // A full stack raises the threshold: the work per pixel stays bounded, the mean does not change.
            let is_full = open.len() >= MAX_OPEN;
            let threshold = if is_full { 1.0 } else { params.roulette_below };
            splits += 1;
            let mut later_draws = None;
            let before = Open { events: path.events + 1, ..path };
            let origin = tracer.departure(&hit, position);
            let mut goes_on = false;
            for branch in interaction.branches() {
                let mut throughput = before.throughput * branch.throughput;
                let strength = throughput.max_element();
                let mut drawn = before.drawn;
                if strength < threshold {
                    let roulette = if before.drawn || is_full {
                        later_draws.get_or_insert_with(|| Roulette(key.uniform(splits)))
                    } else {
                        &mut first_draws
                    };
                    let survival = strength / threshold;
                    if !roulette.goes_on(survival) {
                        continue;
                    }
                    throughput /= survival;
                    drawn = true;
                }
                if goes_on {
                    open.push(path);
                }
                goes_on = true;
                let ray = Ray { origin, direction: branch.direction, from };
                let way = before.way.through(branch.event, branch.media != before.media);
                path = Open { ray, media: branch.media, throughput, way, drawn, ..before };
            }
            goes_on
        };
        if !goes_on {
            let Some(next) = open.pop() else { return };
            path = next;
        }
    }
}
