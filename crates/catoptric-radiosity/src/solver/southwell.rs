//! Southwell relaxation (Gortler, Cohen & Slusallek 1994 show that shooting is this): one residual is relaxed at a time.
//! In powers β = wB: β_k += r_k/(1 − ρ_k F_kk), r_i += ρ_i F_ki … by row k alone, since w_i F_ik = w_k F_ki.
//!
//! Two orders go by the name: the largest residual power first, and no particular order; both are here. What is displayed
//! is B + r/w: the residual has already been received, only not been sent on.

use super::{Params, Solution, Step, Stop, System};

/// Which residual is relaxed next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The largest residual power; of equal ones the first.
    Largest,
    /// The next in the order of the elements whose residual is not zero.
    Index,
}

/// Relaxes until a rule strikes.
pub fn solve(
    system: &System,
    params: &Params,
    order: Order,
    watch: &mut dyn FnMut(&Step) -> bool,
) -> Solution {
    let count = system.len();
    let emitted = system.emitted().max(f64::MIN_POSITIVE);
    let (mut relaxed, mut rows) = (vec![0.0; count], 0);
    let mut residual: Vec<f64> = system.emission.to_vec();
    if let Some(warm) = params.warm {
        relaxed.copy_from_slice(warm);
        for i in 0..count {
            let (others, own) = system.rows.gathered(i, warm);
            residual[i] += system.reflectance[i] * (others + own * warm[i]) - warm[i];
        }
        rows += count;
    }
    let mut shown: Vec<f64> = relaxed.iter().zip(&residual).map(|(b, r)| b + r).collect();
    let mut row: Vec<(usize, f64)> = Vec::new();
    let mut steps = 0;
    let mut cursor = 0;
    let stop = loop {
        let power = |i: usize| residual[i].abs() * system.weights[i];
        let left = (0..count).map(power).sum::<f64>() / emitted;
        if left <= params.residual {
            break Stop::Unshot;
        }
        if steps >= params.max_steps {
            break Stop::Steps;
        }
        let chosen = match order {
            Order::Largest => (0..count).fold(0, |best, i| if power(i) > power(best) { i } else { best }),
            Order::Index => {
                (0..count).map(|k| (cursor + k) % count).find(|&i| residual[i] != 0.0).unwrap_or(0)
            }
        };
        cursor = chosen + 1;
        // Read once: the row may be computed on demand, and its own form factor may come last.
        row.clear();
        system.rows.visit(chosen, &mut |to, factor| row.push((to, factor)));
        let own: f64 = row.iter().filter(|e| e.0 == chosen).map(|e| e.1).sum();
        let sent = residual[chosen] / (1.0 - system.reflectance[chosen] * own);
        relaxed[chosen] += sent;
        residual[chosen] = 0.0;
        shown[chosen] = relaxed[chosen];
        let power = sent * system.weights[chosen];
        for &(to, factor) in row.iter().filter(|e| e.0 != chosen) {
            let received = system.reflectance[to] * factor * power / system.weights[to];
            residual[to] += received;
            shown[to] += received;
        }
        steps += 1;
        rows += 1;
        if !watch(&Step { steps, radiosity: &shown, unshot: &residual, ambient: 0.0 }) {
            break Stop::Watcher;
        }
    };
    let left = residual.iter().zip(system.weights).map(|(r, w)| r.abs() * w).sum::<f64>() / emitted;
    Solution { radiosity: shown, steps, rows, residual: left, stop }
}
