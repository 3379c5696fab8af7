//! Progressive refinement (Cohen, Chen, Wallace & Greenberg 1988): the element with the largest unshot power w_i ΔB_i
//! sends it on, one row at a time, O(n) memory:
//! ΔB_j += ρ_j F_ij ΔB_i w_i/w_j, B_j likewise, ΔB_i = 0 (+ what comes back to itself).
//!
//! The ambient term stands for what is unshot, for display only: A = R ΔB̄ with R = 1/(1 − ρ̄). With mirrors (and in open
//! scenes) power does not come to rest on diffuse elements once per shot but c̄ times, the mean row sum: R = 1/(1 − ρ̄ c̄)
//! and A = c̄ R ΔB̄.

use super::{Params, Solution, Step, Stop, System};

/// Shoots until a rule strikes.
pub fn solve(system: &System, params: &Params, watch: &mut dyn FnMut(&Step) -> bool) -> Solution {
    let count = system.len();
    let emitted = system.emitted().max(f64::MIN_POSITIVE);
    let mut rows = 0;
    let mut unshot: Vec<f64> = system.emission.to_vec();
    let mut radiosity = unshot.clone();
    if let Some(warm) = params.warm {
        for i in 0..count {
            let (others, own) = system.rows.gathered(i, warm);
            unshot[i] += system.reflectance[i] * (others + own * warm[i]) - warm[i];
            radiosity[i] = warm[i] + unshot[i];
        }
        rows += count;
    }
    let total: f64 = system.weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let mean_reflectance =
        system.reflectance.iter().zip(system.weights).map(|(r, w)| r * w).sum::<f64>() / total;
    let (mut shot, mut arrived) = (0.0, 0.0);
    let mut steps = 0;
    let stop = loop {
        let power = |i: usize| unshot[i].abs() * system.weights[i];
        if (0..count).map(power).sum::<f64>() / emitted <= params.residual {
            break Stop::Unshot;
        }
        if steps >= params.max_steps {
            break Stop::Steps;
        }
        let chosen = (0..count).fold(0, |best, i| if power(i) > power(best) { i } else { best });
        let power = unshot[chosen] * system.weights[chosen];
        unshot[chosen] = 0.0;
        let mut sum = 0.0;
        system.rows.visit(chosen, &mut |to, factor| {
            let received = system.reflectance[to] * factor * power / system.weights[to];
            unshot[to] += received;
            radiosity[to] += received;
            sum += factor;
        });
        shot += power.abs();
        arrived += power.abs() * sum;
        steps += 1;
        rows += 1;
        let mean_unshot = unshot.iter().zip(system.weights).map(|(u, w)| u * w).sum::<f64>() / total;
        let row_sum = if shot > 0.0 { arrived / shot } else { 1.0 };
        let ambient = row_sum * mean_unshot / (1.0 - (mean_reflectance * row_sum).min(0.999));
        if !watch(&Step { steps, radiosity: &radiosity, unshot: &unshot, ambient }) {
            break Stop::Watcher;
        }
    };
    let left = unshot.iter().zip(system.weights).map(|(u, w)| u.abs() * w).sum::<f64>() / emitted;
    Solution { radiosity, steps, rows, residual: left, stop }
}
