//! Cameras that move: translation, rotation and scale tracks on their nodes and the nodes above.

use std::collections::BTreeMap;

use glam::{DMat4, DQuat, DVec3, DVec4};

use crate::camera::Camera;

use super::accessor::Accessor;
use super::asset::Asset;
use super::camera::{CameraNode, camera_frame};
use super::document::{Entity, Table};
use super::node::{Hierarchy, Local};
use super::report::Report;

/// More keyframes than this are not a camera path.
const MOST_KEYFRAMES: usize = 1 << 22;

/// The cameras of a scene at any time. Only cameras are animated: geometry and lights stand still.
#[derive(Clone, Debug, Default)]
pub struct AnimatedCameras {
    rigs: Vec<Rig>,
    /// Of the scene, in the file's world.
    origin: DVec3,
    duration: f32,
}

#[derive(Clone, Debug)]
struct Rig {
    /// At rest.
    camera: Camera,
    /// From the root to the camera's node; empty where nothing moves.
    chain: Vec<Link>,
}

#[derive(Clone, Debug)]
struct Link {
    local: Local,
    tracks: Tracks,
}

#[derive(Clone, Debug, Default)]
struct Tracks {
    translation: Option<Track>,
    rotation: Option<Track>,
    scale: Option<Track>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interpolation {
    Linear,
    Step,
    CubicSpline,
}

/// Keyframes: times ascend; cubic splines have three values per time (in-tangent, value, out-tangent).
#[derive(Clone, Debug)]
struct Track {
    times: Vec<f32>,
    values: Vec<DVec4>,
    interpolation: Interpolation,
}

impl AnimatedCameras {
    /// Cameras that stand still.
    pub fn still(cameras: &[Camera]) -> Self {
        let rigs = cameras.iter().map(|camera| Rig { camera: camera.clone(), chain: Vec::new() }).collect();
        Self { rigs, origin: DVec3::ZERO, duration: 0.0 }
    }

    /// Time of the last keyframe of any camera, seconds; 0 if none moves.
    pub fn duration(&self) -> f32 {
        self.duration
    }

    /// All cameras at a time, in the scene's order. Before the first and after the last keyframe they stand.
    pub fn at(&self, seconds: f32) -> Vec<Camera> {
        self.rigs
            .iter()
            .map(|rig| {
                let mut camera = rig.camera.clone();
                if !rig.chain.is_empty() {
                    let from_world = DMat4::from_translation(-self.origin);
                    let world = rig.chain.iter().fold(from_world, |world, link| world * link.at(seconds));
                    camera.world_from_camera = camera_frame(&world).unwrap_or(camera.world_from_camera);
                }
                camera
            })
            .collect()
    }

    /// Finds the tracks that move `cameras`.
    pub(super) fn read(
        asset: &Asset,
        hierarchy: &Hierarchy,
        cameras: &[CameraNode],
        origin: DVec3,
        report: &Report,
    ) -> Self {
        // Which nodes matter: those of the cameras and all above.
        let mut tracks: BTreeMap<usize, Tracks> = cameras
            .iter()
            .flat_map(|camera| hierarchy.chain(camera.node))
            .map(|position| (hierarchy.nodes[position].index, Tracks::default()))
            .collect();
        let root = asset.root();
        let mut duration = 0.0_f32;
        for index in 0..root.table_len(Table::ANIMATIONS) {
            let Some(animation) = root.element(Table::ANIMATIONS, index, report) else { continue };
            let samplers = animation.objects("samplers", report);
            for channel in animation.objects("channels", report) {
                let Some(target) = channel.object("target", report) else { continue };
                let tracks = target.index("node", report).and_then(|node| tracks.get_mut(&node));
                let (slot, components) = match (tracks, target.string("path", report)) {
                    (Some(tracks), Some("translation")) => (&mut tracks.translation, 3),
                    (Some(tracks), Some("rotation")) => (&mut tracks.rotation, 4),
                    (Some(tracks), Some("scale")) => (&mut tracks.scale, 3),
                    _ => continue,
                };
                let sampler = channel.index("sampler", report).and_then(|sampler| samplers.get(sampler));
                let track = sampler.and_then(|sampler| read_track(asset, sampler, components, report));
                let Some(track) = track else {
                    report.warn(animation.place(), "a camera's track cannot be read and is ignored");
                    continue;
                };
                duration = duration.max(track.times.last().copied().unwrap_or(0.0));
                if slot.is_some() {
                    report.warn(animation.place(), "moves a camera that an earlier animation moves: ignored");
                    continue;
                }
                *slot = Some(track);
            }
        }
        let rigs = cameras
            .iter()
            .map(|camera| {
                let chain: Vec<Link> = hierarchy
                    .chain(camera.node)
                    .into_iter()
                    .map(|position| {
                        let node = &hierarchy.nodes[position];
                        Link {
                            local: node.local,
                            tracks: tracks.get(&node.index).cloned().unwrap_or_default(),
                        }
                    })
                    .collect();
                let moves = chain.iter().any(|link| link.tracks.any());
                Rig { camera: camera.camera.clone(), chain: if moves { chain } else { Vec::new() } }
            })
            .collect();
        Self { rigs, origin, duration }
    }
}

impl Tracks {
    fn any(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }
}

impl Link {
    fn at(&self, seconds: f32) -> DMat4 {
        let Local::Trs(mut trs) = self.local else { return self.local.matrix() };
        if let Some(track) = &self.tracks.translation {
            trs.translation = track.at(seconds, false).truncate();
        }
        if let Some(track) = &self.tracks.rotation {
            trs.rotation = DQuat::from_vec4(track.at(seconds, true));
        }
        if let Some(track) = &self.tracks.scale {
            trs.scale = track.at(seconds, false).truncate();
        }
        let matrix = trs.matrix();
        if matrix.is_finite() { matrix } else { self.local.matrix() }
    }
}

impl Track {
    /// The value at a time; rotations are interpolated on the sphere and come out as unit quaternions.
    fn at(&self, seconds: f32, rotation: bool) -> DVec4 {
        let next = self.times.partition_point(|&time| time <= seconds);
        let (value, tangents) = match self.interpolation {
            Interpolation::CubicSpline => (1, 3),
            _ => (0, 1),
        };
        let key = |index: usize| self.values[index * tangents + value];
        let unit = |v: DVec4| if rotation { v.try_normalize().unwrap_or(DVec4::W) } else { v };
        if next == 0 || next == self.times.len() {
            return unit(key(next.saturating_sub(1)));
        }
        let previous = next - 1;
        let step = f64::from(self.times[next]) - f64::from(self.times[previous]);
        let t = ((f64::from(seconds) - f64::from(self.times[previous])) / step).clamp(0.0, 1.0);
        match self.interpolation {
            Interpolation::Step => unit(key(previous)),
            Interpolation::Linear if rotation => slerp(unit(key(previous)), unit(key(next)), t),
            Interpolation::Linear => key(previous) + (key(next) - key(previous)) * t,
            // glTF 2.0, appendix C.5: Hermite with tangents scaled by the time between the keys.
            Interpolation::CubicSpline => {
                let (t2, t3) = (t * t, t * t * t);
                let out_tangent = self.values[previous * 3 + 2] * step;
                let in_tangent = self.values[next * 3] * step;
                unit(
                    key(previous) * (2.0 * t3 - 3.0 * t2 + 1.0)
                        + out_tangent * (t3 - 2.0 * t2 + t)
                        + key(next) * (3.0 * t2 - 2.0 * t3)
                        + in_tangent * (t3 - t2),
                )
            }
        }
    }
}

/// Spherical interpolation along the shorter arc (glTF 2.0, appendix C.4).
fn slerp(from: DVec4, to: DVec4, t: f64) -> DVec4 {
    let dot = from.dot(to);
    let (to, dot) = if dot < 0.0 { (-to, -dot) } else { (to, dot) };
    // Near 1 the arc is a chord to the last bit, and its sine loses digits.
    if dot > 1.0 - 1e-9 {
        return (from + (to - from) * t).try_normalize().unwrap_or(from);
    }
    let angle = libm::acos(dot.min(1.0));
    (from * libm::sin((1.0 - t) * angle) + to * libm::sin(t * angle)) / libm::sin(angle)
}

fn read_track(asset: &Asset, sampler: &Entity<'_>, components: usize, report: &Report) -> Option<Track> {
    let interpolation = match sampler.string("interpolation", report) {
        None | Some("LINEAR") => Interpolation::Linear,
        Some("STEP") => Interpolation::Step,
        Some("CUBICSPLINE") => Interpolation::CubicSpline,
        Some(_) => return None,
    };
    let input = Accessor::open(asset, sampler.index("input", report)?, &[1], &"animation input", report)?;
    let output = sampler.index("output", report)?;
    let output = Accessor::open(asset, output, &[components], &"animation output", report)?;
    let per_key = if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
    if input.count == 0 || input.count > MOST_KEYFRAMES || output.count < input.count * per_key {
        return None;
    }
    let times: Vec<f32> = (0..input.count).map(|i| input.get::<1>(i)[0]).collect();
    let values: Vec<DVec4> = (0..input.count * per_key)
        .map(|i| {
            let [x, y, z, w] = output.get::<4>(i).map(f64::from);
            DVec4::new(x, y, z, w)
        })
        .collect();
    let usable = times.iter().all(|time| time.is_finite())
        && times.windows(2).all(|pair| pair[0] < pair[1])
        && values.iter().all(|value| value.is_finite());
    usable.then_some(Track { times, values, interpolation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(interpolation: Interpolation, values: &[f64]) -> Track {
        let values = values.iter().map(|&x| DVec4::new(x, 0.0, 0.0, 0.0)).collect();
        Track { times: vec![1.0, 3.0], values, interpolation }
    }

    #[test]
    fn each_interpolation_follows_its_formula_and_stands_outside_of_its_keys() {
        let linear = track(Interpolation::Linear, &[10.0, 20.0]);
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|t| linear.at(t, false).x), [10.0, 10.0, 15.0, 20.0, 20.0]);
        let step = track(Interpolation::Step, &[10.0, 20.0]);
        assert_eq!([0.0, 2.9, 3.0].map(|t| step.at(t, false).x), [10.0, 10.0, 20.0]);
        // The cubic x = s³ of the seconds s after the first key: value 0 and 8, slope 0 and 12.
        let cubic = track(Interpolation::CubicSpline, &[0.0, 0.0, 0.0, 12.0, 8.0, 0.0]);
        assert_eq!([1.0, 1.5, 2.0, 3.0].map(|t| cubic.at(t, false).x), [0.0, 0.125, 1.0, 8.0]);
    }

    #[test]
    fn rotations_turn_at_constant_speed_along_the_shorter_arc() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A quarter turn about z, its quaternion negated: the same rotation.
        let quarter = DVec4::new(0.0, 0.0, -half, -half);
        let third = slerp(DVec4::W, quarter, 1.0 / 3.0);
        let expected = DVec4::new(0.0, 0.0, libm::sin(15_f64.to_radians()), libm::cos(15_f64.to_radians()));
        // Some f64 roundings of values below 1.
        assert!((third - expected).abs().max_element() < 1e-15, "{third}");
    }
}
