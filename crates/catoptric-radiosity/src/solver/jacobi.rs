//! Jacobi relaxation (seeds of the field: Goral et al. 1984 solve by it): every radiosity from those of the sweep before,
//! B_i = (E_i + ρ_i Σ_{j≠i} F_ij B_j)/(1 − ρ_i F_ii).

use super::{Params, Solution, Step, System, sweep_until};

/// Sweeps until a rule strikes.
pub fn solve(system: &System, params: &Params, watch: &mut dyn FnMut(&Step) -> bool) -> Solution {
    sweep_until(system, params, watch, |radiosity| {
        let mut change = 0.0;
        let next = (0..system.len())
            .map(|i| {
                let (others, own) = system.rows.gathered(i, radiosity);
                let diagonal = 1.0 - system.reflectance[i] * own;
                let value = (system.emission[i] + system.reflectance[i] * others) / diagonal;
                change += (value - radiosity[i]).abs() * diagonal * system.weights[i];
                value
            })
            .collect();
        *radiosity = next;
        change
    })
}
