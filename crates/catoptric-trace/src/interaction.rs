//! What a surface does to light, once, for every pass: directions, Fresnel, power throughput, event.
//!
//! Conventions (docs/conventions.md): an opaque single-sided surface is black from behind; panes and blended surfaces act from
//! both sides; a solid's border acts by its geometric normal; a coat transmits T(θ) = 1 − s·F(θ) on the way in and on
//! the way out, so its diffuse side receives H_T = ∫ L·T·cosθ dω and sends T(θ)·B/π (Mitsuba's `plastic`, nonlinear:
//! f_d = ρ·T(θi)·T(θo)/(π·N)).

use glam::Vec3;

use catoptric_scene::{AlphaMode, Material, Radiance, Rgb, Side, SurfacePoint, Transmission, TriangleId};

use crate::chain::Event;
use crate::fresnel;
use crate::medium::{MediumId, MediumStack};
use crate::tracer::{Hit, Tracer};

/// One way in which light goes on.
#[derive(Clone, Copy, Debug)]
pub struct Branch {
    /// Unit direction.
    pub direction: Vec3,
    /// Share of the power, per channel.
    pub throughput: Rgb,
    /// What happened.
    pub event: Event,
    /// Media after the event.
    pub media: MediumStack,
}

/// The ways of light at one hit.
#[derive(Clone, Copy, Debug)]
pub struct Interaction {
    /// The side that was hit.
    pub side: Side,
    /// Unit shading normal on that side (interpolated where the mesh is smooth).
    pub normal: Vec3,
    /// Unit geometric normal on that side.
    pub geometric: Vec3,
    /// Weight with which light arrives at the diffuse side: opacity × T(θ); 0 where there is none.
    pub receives: f32,
    /// Effective diffuse reflectance: B = reflectance × H (for coats: of H_T, sent with T(θ)).
    pub reflectance: Rgb,
    /// Lambertian transmittance to the other side.
    pub transmittance: Rgb,
    /// Radiance emitted towards the ray's origin.
    pub emission: Radiance,
    /// Radiance that only the eye sees (`KHR_materials_unlit`): it lights nothing.
    pub shown: Radiance,
    branches: [Branch; 3],
    count: usize,
}

impl Interaction {
    /// Of something black that lets nothing pass, about the shading and the geometric normal.
    #[inline]
    fn nothing(side: Side, (normal, geometric): (Vec3, Vec3), direction: Vec3, media: MediumStack) -> Self {
        let nothing = Branch { direction, throughput: Rgb::ZERO, event: Event::Undeviated, media };
        Self {
            side,
            normal,
            geometric,
            receives: 0.0,
            reflectance: Rgb::ZERO,
            transmittance: Rgb::ZERO,
            emission: Radiance::ZERO,
            shown: Radiance::ZERO,
            branches: [nothing; 3],
            count: 0,
        }
    }

    /// Back to that, about another shading normal.
    fn forget(&mut self, normal: Vec3) {
        self.normal = normal;
        self.receives = 0.0;
        (self.reflectance, self.transmittance) = (Rgb::ZERO, Rgb::ZERO);
        (self.emission, self.shown) = (Radiance::ZERO, Radiance::ZERO);
        self.count = 0;
    }

    /// The ways in which light goes on.
    #[inline]
    pub fn branches(&self) -> &[Branch] {
        &self.branches[..self.count]
    }

    /// Σ of the branches' throughputs.
    #[inline]
    pub fn passed_on(&self) -> Rgb {
        self.branches().iter().map(|b| b.throughput).sum()
    }

    /// Veach's factor for adjoint scattering with interpolated normals (Veach 1996, "Non-symmetric scattering in light
    /// transport algorithms", eq. 11; thesis 1997, §5.3.2): light that travels along `arriving` and leaves along
    /// `leaving` carries |cosθi_s·cosθo_g| / (|cosθi_g·cosθo_s|) of what the eye-side walk gives to the same path, with
    /// s the interpolated and g the geometric normal. For ideal mirrors and refraction alike: the Jacobian of Snell's law
    /// turns the n² of radiance into power and leaves the cosines.
    #[inline]
    pub fn adjoint_factor(&self, arriving: Vec3, leaving: Vec3) -> f32 {
        if self.normal == self.geometric {
            return 1.0;
        }
        let over = arriving.dot(self.normal) * leaving.dot(self.geometric);
        let under = arriving.dot(self.geometric) * leaving.dot(self.normal);
        if under == 0.0 { 0.0 } else { (over / under).abs() }
    }

    #[inline]
    fn push(&mut self, branch: Branch) {
        if branch.throughput.max_element() > 0.0 {
            self.branches[self.count] = branch;
            self.count += 1;
        }
    }
}

/// What a diffuse side of a triangle is made of at a point, without a ray.
#[derive(Clone, Copy, Debug)]
pub struct DiffuseSide {
    /// Effective reflectance of H (or H_T).
    pub reflectance: Rgb,
    /// Lambertian transmittance to the other side.
    pub transmittance: Rgb,
    /// Coat over it, for T(θ).
    pub coat: Coat,
    /// α.
    pub opacity: f32,
}

/// The dielectric interfaces over a diffuse side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Strength of the material's own interface.
    pub strength: f32,
    /// Its index.
    pub ior: f32,
    /// Strength of the clearcoat.
    pub clearcoat: f32,
}

/// Cosine to the surface of a reflection that a normal map would send below it.
const GRAZING: f32 = 0.01;

/// Index of refraction of KHR_materials_clearcoat.
const CLEARCOAT_IOR: f32 = 1.5;

impl Coat {
    /// Nothing over it.
    pub const NONE: Self = Self { strength: 0.0, ior: 1.5, clearcoat: 0.0 };

    /// T(θ).
    #[inline]
    pub fn transmittance(&self, cos: f32) -> f32 {
        if self.strength == 0.0 && self.clearcoat == 0.0 {
            return 1.0;
        }
        let under = self.strength * fresnel::refract(cos, 1.0, self.ior).reflectance;
        let over = self.clearcoat * fresnel::refract(cos, 1.0, CLEARCOAT_IOR).reflectance;
        // Light goes to and fro between the two interfaces: Σ (over·under)^k.
        (1.0 - over) * (1.0 - under) / (1.0 - over * under).max(f32::MIN_POSITIVE)
    }

    /// Whether there is any.
    #[inline]
    pub fn is_none(&self) -> bool {
        self.strength == 0.0 && self.clearcoat == 0.0
    }
}

/// Reflectance of something of reflectance `below` under a lossless interface that reflects `over`, all bounces
/// between them included: R = o + (1−o)²r/(1−or).
#[inline]
fn layered(over: f32, below: Rgb) -> Rgb {
    if over == 0.0 {
        return below;
    }
    Rgb::splat(over) + below * (1.0 - over) * reaches(over, below)
}

/// Share of light that gets through such an interface to what is below, all bounces included: (1−o)/(1−or).
#[inline]
fn reaches(over: f32, below: Rgb) -> Rgb {
    Rgb::splat(1.0 - over) / (Rgb::ONE - below * over).max(Rgb::splat(f32::MIN_POSITIVE))
}

impl Tracer<'_> {
    /// The diffuse side of a surface at a point. `None` where that side does not exist: it is black, or ideal.
    pub fn diffuse_side(
        &self,
        triangle: TriangleId,
        point: &SurfacePoint,
        side: Side,
    ) -> Option<DiffuseSide> {
        if side == Side::Back && !self.has_back(triangle) {
            return None;
        }
        let coat = Coat { strength: point.coat, ior: point.ior, clearcoat: point.clearcoat };
        let reflectance = self.effective_reflectance(triangle, point, &coat);
        Some(DiffuseSide {
            reflectance,
            transmittance: point.diffuse_transmission,
            coat,
            opacity: point.opacity,
        })
    }

    /// ρ/N with N = T̄ + (1 − ρ)·s·n²·F_int: for a full coat (s = 1) this is n²(1 − ρF_int), since
    /// n²(1 − F_int) = T̄; for none it is 1; at ρ = 1 no power is lost for any s.
    #[inline]
    fn effective_reflectance(&self, triangle: TriangleId, point: &SurfacePoint, coat: &Coat) -> Rgb {
        if coat.is_none() {
            return point.diffuse;
        }
        let own = self.coat_averages(triangle);
        let n2 = point.ior * point.ior;
        let clear = self.clearcoat_averages();
        let mean = if coat.strength > 0.0 && coat.clearcoat > 0.0 {
            fresnel::cosine_mean(64, |cos| f64::from(coat.transmittance(cos))) as f32
        } else {
            1.0 - coat.strength * own.external - coat.clearcoat * clear.external
        };
        let trapped = coat.strength * n2 * own.internal
            + coat.clearcoat * CLEARCOAT_IOR * CLEARCOAT_IOR * clear.internal;
        let share = point.coat_share.max(1e-6);
        let rho = (point.diffuse / share).min(Rgb::ONE);
        let normaliser = Rgb::splat(mean) + (Rgb::ONE - rho) * trapped;
        point.diffuse / normaliser
    }

    /// What happens to light that travels along `direction` in `media` and meets `hit`.
    pub fn interact(&self, direction: Vec3, hit: &Hit, media: MediumStack) -> Interaction {
        let side = if hit.back { Side::Back } else { Side::Front };
        let normal = side.orient(self.scene().shading_normal(hit.triangle, hit.at));
        self.interact_about(normal, direction, hit, media, false)
    }

    /// The same as the eye sees it: normal maps bend what is reflected and refracted. Where they would send a reflection
    /// below the surface it grazes the surface, since a map has no shape that could hide it. Of what normals that are smooth over an edge reflect
    /// totally in a body, `all` is kept, or nothing.
    pub fn interact_as_seen(&self, direction: Vec3, hit: &Hit, media: MediumStack, all: bool) -> Interaction {
        let scene = self.scene();
        let side = if hit.back { Side::Back } else { Side::Front };
        let Some(map) = scene.material_of(hit.triangle).outer_normal_texture() else {
            let normal = side.orient(scene.shading_normal(hit.triangle, hit.at));
            return self.interact_about(normal, direction, hit, media, all);
        };
        let geometric = side.orient(scene.geometric_normal(hit.triangle));
        let bent = side.orient(scene.bent_normal(hit.triangle, hit.at, Some(map)));
        let reflected = direction - bent * (2.0 * direction.dot(bent));
        let below = GRAZING - reflected.dot(geometric);
        let normal = if below > 0.0 {
            let lifted = (reflected + geometric * below).normalize_or_zero();
            (lifted - direction).try_normalize().unwrap_or(geometric)
        } else {
            bent
        };
        self.interact_about(normal, direction, hit, media, all)
    }

    /// The interaction about a unit normal on the side that was hit. Where normals that are smooth over an edge would reflect below the surface or
    /// refract back, the surface acts as flat as it is. What would be reflected totally then, inside, is absorbed if not `all` is wanted: such normals
    /// are no shape, light in it may go round for good, and gains by Veach's factor at each turn.
    fn interact_about(
        &self,
        normal: Vec3,
        direction: Vec3,
        hit: &Hit,
        media: MediumStack,
        all: bool,
    ) -> Interaction {
        let side = if hit.back { Side::Back } else { Side::Front };
        let geometric = side.orient(self.scene().geometric_normal(hit.triangle));
        let is_flat = normal == geometric;
        // Filled in where it is returned: it is large to copy.
        let mut interaction = Interaction::nothing(side, (normal, geometric), direction, media);
        let is_possible = self.interact_with(is_flat, direction, hit, media, &mut interaction);
        if !(is_possible || is_flat) {
            interaction.forget(geometric);
            self.interact_with(false, direction, hit, media, &mut interaction);
            let is_total = hit.back
                && media != MediumStack::AIR
                && interaction.branches().iter().all(|b| b.media == media);
            if is_total && !all {
                interaction.count = 0;
            }
        }
        interaction
    }

    /// Fills in the interaction about its normals, and returns whether its directions lie on the sides of the surface where they should.
    fn interact_with(
        &self,
        is_flat: bool,
        direction: Vec3,
        hit: &Hit,
        media: MediumStack,
        result: &mut Interaction,
    ) -> bool {
        let scene = self.scene();
        let Interaction { side, normal, geometric, .. } = *result;
        let nothing = Branch { direction, throughput: Rgb::ZERO, event: Event::Undeviated, media };
        let point = scene.surface_point(hit.triangle, hit.at);
        let material = scene.material_of(hit.triangle);
        let acts_behind = self.has_back(hit.triangle);
        let solid = point.transmission > 0.0 && point.transmission_kind == Transmission::Solid;
        let straight_alpha = 1.0 - point.opacity;

        // Opaque parts of a single-sided surface are black from behind; panes and solids act from both sides.
        let visible = side == Side::Front || acts_behind;
        let cos = (-direction.dot(normal)).clamp(0.0, 1.0);
        let coat = Coat { strength: point.coat, ior: point.ior, clearcoat: point.clearcoat };
        let clearcoat = |cos_in_air: f32| {
            if coat.clearcoat == 0.0 {
                return 0.0;
            }
            coat.clearcoat * fresnel::refract(cos_in_air, 1.0, CLEARCOAT_IOR).reflectance
        };

        // Unlit surfaces are for the eye: light meets something black.
        if material.unlit {
            if visible {
                result.shown = Radiance(point.tint * point.opacity);
            }
            let throughput = Rgb::splat(straight_alpha);
            result.push(Branch { throughput, ..nothing });
            return true;
        }

        // The diffuse side.
        if visible {
            result.emission = point.emission * point.opacity;
            if point.emission != Radiance::ZERO && !material.lobe.is_diffuse() {
                let leaves = -direction.dot(geometric);
                result.emission = result.emission * material.lobe.factor(f64::from(leaves)) as f32;
            }
            let diffuse = point.diffuse.max_element() > 0.0 || point.diffuse_transmission.max_element() > 0.0;
            if diffuse || material.may_be_diffuse() {
                result.reflectance = self.effective_reflectance(hit.triangle, &point, &coat);
                result.transmittance = point.diffuse_transmission;
                result.receives = point.opacity * coat.transmittance(cos);
            }
        }

        if self.is_lambertian(hit.triangle) {
            return true;
        }
        // Mirror, coat and the reflecting part of panes and solids share one direction.
        // Each share (metal, body, what transmits) lies under the clearcoat with its own bounces.
        let mut reflected = Rgb::ZERO;
        if visible {
            let over = clearcoat(cos);
            let metal = (1.0 - point.coat_share - point.transmission).max(0.0);
            if over == 0.0 {
                reflected += point.mirror;
            } else if metal > 0.0 {
                reflected += layered(over, (point.mirror / metal).min(Rgb::ONE)) * metal;
            }
            if coat.strength > 0.0 || over > 0.0 {
                let own = coat.strength * fresnel::refract(cos, 1.0, point.ior).reflectance;
                reflected += layered(over, Rgb::splat(own)) * point.coat_share;
            }
        }
        let mut straight = Rgb::splat(straight_alpha);
        let mut refracted = None;
        if point.transmission > 0.0 {
            if solid {
                let inside = MediumId::inside(scene.material_id_of(hit.triangle));
                let outside = if hit.back { media.left(inside) } else { media };
                let n_inside = point.ior;
                let n_outside = self.media().ior(outside.current());
                let (n1, n2, after) = if hit.back {
                    (n_inside, n_outside, outside)
                } else {
                    (n_outside, n_inside, media.entered(inside))
                };
                let interface = fresnel::refract(cos, n1, n2);
                // The clearcoat lies outside: from inside its bounces come after the glass's own interface.
                let own = Rgb::splat(interface.reflectance);
                let over = clearcoat(if hit.back { interface.cos_transmitted } else { cos });
                let passes = reaches(over, own) * (1.0 - interface.reflectance);
                reflected +=
                    if hit.back { Rgb::ONE - passes } else { layered(over, own) } * point.transmission;
                if interface.reflectance < 1.0 {
                    let ratio = n1 / n2;
                    let towards = direction * ratio + normal * (ratio * cos - interface.cos_transmitted);
                    let share = point.tint * passes * point.transmission;
                    refracted = Some((towards.normalize_or_zero(), share, after));
                }
            } else {
                let (r, t) = fresnel::pane(cos, point.ior, point.tint);
                let over = clearcoat(cos);
                reflected += layered(over, r) * point.transmission;
                straight += t * reaches(over, r) * (point.transmission * point.opacity);
            }
        }
        let reflected = reflected * point.opacity;

        let mut is_possible = true;
        if reflected.max_element() > 0.0 {
            let towards = (direction + normal * (2.0 * -direction.dot(normal))).normalize_or_zero();
            let event = if is_flat { self.reflection(hit.triangle) } else { Event::Curved };
            is_possible &= towards.dot(geometric) > 0.0;
            result.push(Branch { direction: towards, throughput: reflected, event, media });
        }
        if let Some((towards, share, after)) = refracted {
            let event = match self.slab_of(hit.triangle) {
                Some(slab) if is_flat && !hit.back && media == MediumStack::AIR => Event::Enters(slab),
                Some(slab) if is_flat && hit.back && after == MediumStack::AIR => Event::Leaves(slab),
                _ => Event::Curved,
            };
            is_possible &= towards.dot(geometric) < 0.0;
            result.push(Branch {
                direction: towards,
                throughput: share * point.opacity,
                event,
                media: after,
            });
        }
        result.push(Branch { direction, throughput: straight, event: Event::Undeviated, media });
        debug_assert!(
            result.passed_on().max_element() <= 1.0 + 1e-4,
            "a surface amplifies light: {result:?}"
        );
        is_possible
    }

    /// Whether the back of a triangle is a surface of its own: doubleSided, thin panes and Lambertian transmission.
    #[inline]
    pub fn has_back(&self, triangle: TriangleId) -> bool {
        has_back(self.scene().material_of(triangle))
    }

    /// Whether the eye looks through the back of this triangle before its first hit, as glTF viewers do.
    #[inline]
    pub fn is_culled_from_behind(&self, triangle: TriangleId) -> bool {
        let material = self.scene().material_of(triangle);
        !self.has_back(triangle) && material.transmission <= 0.0 && material.alpha_mode != AlphaMode::Blend
    }
}

/// Whether the back of what is made of a material is a surface of its own.
pub(crate) fn has_back(material: &Material) -> bool {
    material.double_sided
        || (material.transmission > 0.0 && material.transmission_kind == Transmission::Pane)
        || material.diffuse_transmission_factor > 0.0
}
