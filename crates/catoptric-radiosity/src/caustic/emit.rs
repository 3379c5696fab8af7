//! Light-side rays: from a point of a source to a point of the specular geometry, and on from there by the choose-walk.
//!
//! Area sampling of the first deviating event (the light-side twin of next-event estimation): the power per area that
//! arrives at a point of a target, L·cosθ·cosθ'/r², over the area density of that point. Every path from a concentrated
//! source that is deviated at all has exactly one such event, so nothing is missed and nothing counted twice.

use glam::{DVec3, Vec2};
use rayon::prelude::*;

use catoptric_light::{Lights, Owner};
use catoptric_scene::{AlphaMode, Barycentric, Cancelled, Progress, Rgb, TriangleId};
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use catoptric_trace::walk::{self, Arrival, WalkParams};
use catoptric_trace::{Chain, Event, Hit, Ledger, Ray};

use crate::JOB;
use crate::caustic::deposit::Deposit;
use crate::caustic::source::{self, Beam, Source};
use crate::caustic::table::Table;
use crate::caustic::target::{self, Places, Target};
use crate::display::Displayed;
use crate::draft::Draft;

/// Sources, targets, and how likely each pair is tried.
pub(super) struct Emission<'a> {
    lights: &'a Lights<'a>,
    draft: &'a Draft,
    base: &'a Displayed,
    walk: WalkParams,
    targets: Vec<Target>,
    places: Places,
    sources: Vec<Source>,
    /// Per source: share of its rays whose directions are drawn, not their ends.
    straight: Vec<f32>,
    /// Per source: power that each target gets, about.
    importance: Vec<Vec<f32>>,
    choice: Table,
    /// Per source: choice of a target.
    tables: Vec<Table>,
}

/// What a number of rays brought, as sums: shares of 1/n are taken by the caller.
#[derive(Clone, Debug, Default)]
pub(super) struct Harvest {
    pub(super) deposits: Vec<Deposit>,
    /// Power that left first deviating events.
    pub(super) sent: DVec3,
    /// Power that ended on receivers with a caustic chain.
    pub(super) deposited: DVec3,
    /// Power that arrived there without a curved event, or where nothing is stored: not ours.
    pub(super) elsewhere: DVec3,
    /// Where what was sent went.
    pub(super) ledger: Ledger,
}

/// Share of the rays of a lamp beside specular surfaces that are sent in cosine-weighted directions (with the others combined by the balance
/// heuristic, Veach & Guibas 1995): between points near each other nothing else bounds what a ray carries.
const STRAIGHT: f32 = 0.25;
/// Rays of one unit of work.
const CHUNK: u32 = 4096;
/// Rays that learn which targets matter.
const PILOT_RAYS: u32 = 1 << 14;
/// Targets that share what the pilot learned.
const BLOCKS: usize = 512;

impl<'a> Emission<'a> {
    /// `None` if no light takes such paths.
    pub(super) fn new(
        lights: &'a Lights<'a>,
        draft: &'a Draft,
        base: &'a Displayed,
        walk: WalkParams,
        seed: u32,
    ) -> Option<Self> {
        let bright = lights.has_sources() || !lights.tracer().scene().lights().is_empty();
        if !bright || !walk.extended {
            return None;
        }
        let targets = target::collect(lights);
        if targets.is_empty() {
            return None;
        }
        let sources = source::collect(lights, &targets, seed);
        let walk = WalkParams { from_light: true, ..walk };
        let straight = sources.iter().map(|s| if s.is_beside(&targets) { STRAIGHT } else { 0.0 }).collect();
        let mut emission = Self {
            lights,
            draft,
            base,
            walk,
            places: Places::new(&targets),
            targets,
            sources,
            straight,
            importance: Vec::new(),
            choice: Table::default(),
            tables: Vec::new(),
        };
        let of = |source: &Source| {
            emission.targets.par_iter().with_min_len(JOB).map(|t| source.importance(lights, t)).collect()
        };
        emission.importance = emission.sources.par_iter().map(of).collect();
        emission.weigh(|_| 1.0);
        (emission.choice.total > 0.0).then_some(emission)
    }

    /// Sets the probabilities from the importance of each pair, times a factor of the target.
    fn weigh(&mut self, factor: impl Fn(usize) -> f32 + Sync) {
        let table = |importance: &Vec<f32>| {
            Table::new(importance.iter().enumerate().map(|(index, power)| power * factor(index)))
        };
        self.tables = self.importance.par_iter().map(table).collect();
        self.choice = Table::new(self.tables.iter().map(|t| t.total as f32));
    }

    /// Shifts the probabilities to the targets from which light gets to receivers. An independent first look decides:
    /// the rays that count never do.
    pub(super) fn learn(&mut self, seed: u32, progress: &dyn Progress) -> Result<(), Cancelled> {
        let per_block = self.targets.len().div_ceil(BLOCKS).max(1);
        let blocks = self.targets.len().div_ceil(per_block);
        let keys = Keys::new(seed, 0);
        let chunks: Vec<Vec<(f64, f64)>> = (0..PILOT_RAYS / CHUNK)
            .into_par_iter()
            .with_max_len(1)
            .map(|chunk| {
                let mut sums = vec![(0.0, 0.0); blocks];
                let mut harvest = Harvest::default();
                for index in chunk * CHUNK..(chunk + 1) * CHUNK {
                    let before = harvest.deposited.element_sum();
                    let aim = self.aim(index, &keys);
                    self.shoot(&aim, &keys, &mut harvest);
                    let sum = &mut sums[aim.target / per_block];
                    sum.0 += 1.0;
                    sum.1 += harvest.deposited.element_sum() - before;
                    harvest.deposits.clear();
                }
                sums
            })
            .collect();
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        let mut sums = vec![(0.0, 0.0); blocks];
        for chunk in &chunks {
            for (sum, part) in sums.iter_mut().zip(chunk) {
                sum.0 += part.0;
                sum.1 += part.1;
            }
        }
        let (tried, found) = sums.iter().fold((0.0, 0.0), |s, b| (s.0 + b.0, s.1 + b.1));
        if found <= 0.0 {
            return Ok(());
        }
        // The mean counts as a few rays of each block; a square root, since the variance per ray of a share p is p.
        let prior = 4.0;
        let mean = found / tried;
        let share: Vec<f32> = sums
            .iter()
            .map(|&(tried, found)| ((found / mean + prior) / (tried + prior)).sqrt() as f32)
            .collect();
        let least = 0.1;
        self.weigh(|target| share[target / per_block].max(least));
        Ok(())
    }

    /// Sends the rays `range` of the main sequence: within a unit of work by targets, for what is beside each other is in the
    /// caches, too.
    pub(super) fn send(
        &self,
        range: std::ops::Range<u32>,
        seed: u32,
        progress: &dyn Progress,
    ) -> Result<Harvest, Cancelled> {
        let keys = Keys::new(seed, 1);
        let chunks: Vec<Harvest> = (range.start / CHUNK..range.end.div_ceil(CHUNK))
            .into_par_iter()
            .with_max_len(1)
            .map(|chunk| {
                let mut harvest = Harvest::default();
                if progress.is_cancelled() {
                    return harvest;
                }
                harvest.deposits.reserve(CHUNK as usize);
                let end = ((chunk + 1) * CHUNK).min(range.end);
                let mut aims: Vec<Aim> =
                    ((chunk * CHUNK).max(range.start)..end).map(|index| self.aim(index, &keys)).collect();
                aims.sort_unstable_by_key(|aim| (aim.source, aim.target, aim.index));
                aims.iter().for_each(|aim| self.shoot(aim, &keys, &mut harvest));
                progress.advance(u64::from(CHUNK));
                harvest
            })
            .collect();
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        let mut sum = Harvest::default();
        sum.deposits.reserve(chunks.iter().map(|c| c.deposits.len()).sum());
        for chunk in chunks {
            sum.add(chunk);
        }
        Ok(sum)
    }

    /// What a ray is to connect.
    fn aim(&self, index: u32, keys: &Keys) -> Aim {
        let (e, t) = (keys.source.point2(index), keys.target.point2(index));
        let (source, source_share, at_source) = self.choice.pick(e.x);
        let (target, target_share, on_target) = self.tables[source].pick(t.x);
        Aim {
            index,
            source,
            source_share,
            at_source: Vec2::new(at_source, e.y),
            target,
            target_share,
            on_target: Vec2::new(on_target, t.y),
        }
    }

    /// One ray.
    fn shoot(&self, aim: &Aim, keys: &Keys, harvest: &mut Harvest) {
        let Aim { index, source, source_share, at_source, target, target_share, on_target } = *aim;
        let straight = if keys.learn { 0.0 } else { self.straight[source] };
        let density = |target_share: f32, target: &Target| Density {
            source: source_share,
            target: (1.0 - straight) * target_share / target.area,
            straight,
        };
        let (table, source, key) = (&self.tables[source], &self.sources[source], keys.walk.child(index));
        let target = &self.targets[target];
        // One of four by chance: every fourth would have a quarter of the sequence.
        if straight > 0.0 && keys.straight.uniform(index) < straight {
            let towards = keys.direction.point2(index);
            let met = source.ray(self.lights, at_source, towards).and_then(|ray| {
                let hit = self.lights.tracer().nearest(&ray, f32::INFINITY)?;
                Some((hit.at, self.places.part(hit.triangle, hit.at)?))
            });
            if let Some((at, met)) = met {
                let target = &self.targets[met];
                let density = density(table.share(met), target);
                self.follow(source, at_source, target, at, density, key, harvest);
            }
            return;
        }
        let density = density(target_share, target);
        let (u, v) = triangle_point(on_target);
        self.follow(source, at_source, target, target.at(u, v), density, key, harvest);
    }

    fn follow(
        &self,
        source: &Source,
        at_source: Vec2,
        target: &Target,
        at: Barycentric,
        density: Density,
        key: Key,
        harvest: &mut Harvest,
    ) {
        let tracer = self.lights.tracer();
        let scene = tracer.scene();
        if scene.is_cut_out(target.triangle, at) {
            return;
        }
        let position = scene.position(target.triangle, at);
        let plane = tracer.planes().of(target.triangle);
        let Some(beam) = source.connect(self.lights, at_source, position, target.normal, plane) else {
            return;
        };
        // The walk carries a colour, the deposits take the strength.
        let strength = beam.power.max_element() / density.of(&beam);
        let color = beam.power / beam.power.max_element();

        // The first deviating event: what goes straight on belongs to other terms.
        let direction = beam.direction;
        let back = direction.dot(target.normal) > 0.0;
        let hit = Hit { t: 0.0, triangle: target.triangle, at, back };
        let interaction = tracer.interact(direction, &hit, source.media);
        let ways = || interaction.branches().iter().filter(|b| b.event != Event::Undeviated);
        let going_on: Rgb = ways().map(|b| b.throughput).sum();
        let total: f32 = ways().map(|b| (color * b.throughput).max_element()).sum();
        if total <= 0.0 {
            return;
        }
        let mut pick = key.uniform(0) * total;
        let mut chosen = None;
        for branch in ways() {
            let share = (color * branch.throughput).max_element();
            if share > 0.0 {
                chosen = Some((branch, share / total));
                if pick < share {
                    break;
                }
                pick -= share;
            }
        }
        let Some((branch, probability)) = chosen else { return };
        let unweighted = color * branch.throughput / probability;
        let throughput = unweighted * interaction.adjoint_factor(direction, branch.direction);
        let mut chain = Chain::DIRECT;
        chain.push(branch.event);
        let mut ledger = Ledger::default();
        ledger.roulette += (color * going_on - unweighted).as_dvec3();
        ledger.shading += (unweighted - throughput).as_dvec3();

        let origin = tracer.departure(&hit, position);
        let ray = Ray { origin, direction: branch.direction, from: plane };
        let (mut deposited, mut elsewhere) = (DVec3::ZERO, DVec3::ZERO);
        let mut last = Bend::new(target.triangle, branch.event);
        let meet = |arrival: &Arrival| {
            let bend = last.follow(arrival);
            if arrival.interaction.receives <= 0.0 {
                return;
            }
            let kept = arrival.throughput * (Rgb::ONE - arrival.interaction.passed_on());
            let owner = if source.is_lamp() {
                self.lights.owner_from_lamp(arrival.chain, bend)
            } else {
                self.lights.owner_from_light(arrival.chain)
            };
            let ours = owner == Owner::LightRays;
            if ours && self.deposit(arrival, strength, harvest) {
                deposited += kept.as_dvec3();
            } else {
                elsewhere += kept.as_dvec3();
            }
        };
        walk::choose_meeting_after(
            tracer,
            ray,
            branch.media,
            throughput,
            chain,
            key.child(1),
            &self.walk,
            &mut ledger,
            meet,
        );
        let scale = f64::from(strength);
        harvest.sent += (color * going_on).as_dvec3() * scale;
        harvest.deposited += deposited * scale;
        harvest.elsewhere += elsewhere * scale;
        harvest.ledger.add(&ledger.scaled(scale));
    }

    /// Stores irradiance × area of an arrival; false where nothing is stored.
    fn deposit(&self, arrival: &Arrival, strength: f32, harvest: &mut Harvest) -> bool {
        let tracer = self.lights.tracer();
        let interaction = arrival.interaction;
        let triangle = arrival.hit.triangle;
        let Some(located) = self.base.mesh.locate(triangle, interaction.side, arrival.position) else {
            return false;
        };
        // Irradiance is counted with the cosine of the interpolated normal, power arrives with that of the geometry.
        let geometric = -arrival.direction.dot(interaction.geometric);
        let shading = -arrival.direction.dot(interaction.normal);
        if geometric <= 0.0 || shading <= 0.0 {
            return false;
        }
        // Stored irradiance knows the coat, but not how much of the surface is there.
        let scene = tracer.scene();
        let opacity = match scene.material_of(triangle).alpha_mode {
            AlphaMode::Blend => scene.surface_point(triangle, arrival.hit.at).opacity,
            _ => 1.0,
        };
        let factor = strength * interaction.receives * shading / (geometric * opacity);
        let root = self.base.roots[located.element as usize];
        let power = arrival.throughput * factor;
        harvest.deposits.push(Deposit::at(
            self.draft,
            &self.base.mesh,
            root,
            &located,
            arrival.position,
            power,
        ));
        true
    }
}

/// A choice of two points to connect.
#[derive(Clone, Copy)]
struct Aim {
    /// Number of the ray.
    index: u32,
    source: usize,
    /// Probability of the source.
    source_share: f32,
    /// Point of the unit square for the point of the source, …
    at_source: Vec2,
    target: usize,
    /// Probability of the target, given the source.
    target_share: f32,
    /// … and for the point of the target.
    on_target: Vec2,
}

/// How likely a pair of points is tried, per area of the target, but for the choice of the point of the source.
#[derive(Clone, Copy)]
struct Density {
    /// Of the source.
    source: f32,
    /// Of a point of the target, chosen as such.
    target: f32,
    /// Of a drawn direction.
    straight: f32,
}

impl Density {
    fn of(self, beam: &Beam) -> f32 {
        self.source * (self.target + self.straight * beam.straight)
    }
}

impl Harvest {
    /// Adds what another range of rays brought.
    pub(super) fn add(&mut self, mut other: Harvest) {
        self.deposits.append(&mut other.deposits);
        self.sent += other.sent;
        self.deposited += other.deposited;
        self.elsewhere += other.elsewhere;
        self.ledger.add(&other.ledger);
    }
}

/// What last changed the direction of light.
struct Bend {
    /// A curved or refracting surface, if it was one.
    by: Option<TriangleId>,
    /// What it met last, …
    met: TriangleId,
    /// … and the events before.
    events: (usize, usize),
}

impl Bend {
    fn new(triangle: TriangleId, event: Event) -> Self {
        let mut chain = Chain::DIRECT;
        chain.push(event);
        let by = (event == Event::Curved).then_some(triangle);
        Self { by, met: triangle, events: (chain.curved_count(), chain.planar_count()) }
    }

    /// Light has met another surface. Returns what has bent it last.
    fn follow(&mut self, arrival: &Arrival) -> Option<TriangleId> {
        let events = (arrival.chain.curved_count(), arrival.chain.planar_count());
        if events.0 != self.events.0 {
            self.by = Some(self.met);
        } else if events.1 != self.events.1 {
            self.by = None;
        }
        let before = std::mem::replace(&mut self.met, arrival.hit.triangle);
        self.events = events;
        // What is met within a sheet of glass does not know whether that will have been a bend.
        if arrival.chain.is_in_slab() { Some(before) } else { self.by }
    }
}

/// Sequences of one series of rays.
struct Keys {
    source: Key,
    target: Key,
    walk: Key,
    straight: Key,
    direction: Key,
    /// Only targets are learned about.
    learn: bool,
}

impl Keys {
    fn new(seed: u32, series: u32) -> Self {
        let key = Key::new(seed, Purpose::LightRay, u64::from(series));
        let [source, target, walk, straight, direction] = [0, 1, 2, 3, 4].map(|k| key.child(k));
        Self { source, target, walk, straight, direction, learn: series == 0 }
    }
}
