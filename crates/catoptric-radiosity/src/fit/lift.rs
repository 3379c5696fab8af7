//! A least-squares fit is negative beside a sharp edge: what is below zero is lifted with light of the neighbours.

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;

/// Rounds in which neighbours give to what is below zero.
const LIFTS: usize = 8;

/// Lifts what is below zero to zero with light of the neighbours, so that the integral stays: a least-squares fit is negative
/// beside a sharp edge, and what is clamped there would be added to the scene.
pub(super) fn lift(mesh: &DisplayMesh, values: &mut [Rgb]) {
    if values.iter().all(|v| v.min_element() >= 0.0) {
        return;
    }
    let mut mass = vec![0.0_f32; values.len()];
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for (index, element) in mesh.elements.iter().enumerate() {
        let corners = element.vertices;
        let third = mesh.area(index as u32) / 3.0;
        corners.iter().for_each(|&v| mass[v as usize] += third);
        for (k, &own) in corners.iter().enumerate() {
            if values[own as usize].min_element() < 0.0 {
                pairs.extend([(own, corners[(k + 1) % 3]), (own, corners[(k + 2) % 3])]);
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    for _ in 0..LIFTS {
        for around in pairs.chunk_by(|a, b| a.0 == b.0) {
            let own = around[0].0 as usize;
            for channel in 0..3 {
                let lack = -values[own][channel] * mass[own];
                let wealth = |&(_, v): &(u32, u32)| values[v as usize][channel].max(0.0) * mass[v as usize];
                let there: f32 = around.iter().map(wealth).sum();
                if lack <= 0.0 || there <= 0.0 {
                    continue;
                }
                let share = (lack / there).min(1.0);
                for &(_, v) in around {
                    let value = &mut values[v as usize][channel];
                    *value -= value.max(0.0) * share;
                }
                values[own][channel] += there * share / mass[own];
            }
        }
    }
    for value in values {
        *value = value.max(Rgb::ZERO);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::tests::strip;
    use catoptric_solution::Element;

    /// A sharp edge: the fit is below zero beside it, and neither that nor its repair changes the integral.
    #[test]
    fn what_is_lifted_to_zero_is_taken_from_the_neighbours() {
        let mesh = strip(8);
        let mut values = vec![Rgb::splat(-0.2); mesh.vertices.len()];
        for (vertex, value) in values.iter_mut().enumerate() {
            let x = mesh.vertices[vertex].position.x;
            *value = Rgb::new(if x > 3.5 { 1.0 } else { 0.0 }, x - 0.3, if x == 3.0 { -0.4 } else { 0.5 });
        }
        let integral = |values: &[Rgb]| -> Rgb {
            let corners = |e: &Element| e.vertices.iter().map(|&v| values[v as usize]).sum::<Rgb>();
            mesh.elements.iter().enumerate().map(|(i, e)| corners(e) * (mesh.area(i as u32) / 3.0)).sum()
        };
        let before = integral(&values);
        lift(&mesh, &mut values);
        assert!(values.iter().all(|v| v.min_element() >= 0.0), "{values:?}");
        // Sums of some twenty f32.
        assert!((integral(&values) - before).abs().max_element() < 1e-5, "{before} {}", integral(&values));
    }
}
