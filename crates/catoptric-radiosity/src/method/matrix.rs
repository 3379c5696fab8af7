//! All form factors of a scene: what a person checks before trusting them, and the repair of what sampling broke.

use glam::DVec3;

use super::{ElementSet, Entry, FactorRow};
use catoptric_trace::Tracer;

/// Form factors between all elements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FactorMatrix {
    /// One row per element.
    pub rows: Vec<FactorRow>,
}

/// How well a matrix keeps the laws.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Closure {
    /// Per row: Σ of the ledger less 1, largest channel: what no entry accounts for.
    pub unaccounted: Vec<f64>,
    /// Mean escaped share, area-weighted.
    pub escaped: f64,
    /// Mean share that met black backs, area-weighted.
    pub black_backs: f64,
    /// Worst |n_i² A_i F_ij − n_j² A_j F_ji|, m².
    pub reciprocity: f64,
    /// Between which.
    pub worst_pair: Option<(u32, u32)>,
    /// The same over all pairs, root of the mean square, relative to the largest n² A F.
    pub reciprocity_relative: f64,
    /// Largest error of an entry.
    pub largest_error: f64,
}

/// What a repair did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Repair {
    /// Largest change of a form factor.
    pub largest: f64,
    /// Σ A_i |ΔF_ij| / Σ A_i F_ij.
    pub mean: f64,
    /// Rounds.
    pub rounds: usize,
    /// What closure still misses.
    pub left: f64,
}

impl FactorMatrix {
    /// F from one element to another.
    pub fn get(&self, from: u32, to: u32) -> DVec3 {
        self.rows[from as usize].to(to)
    }

    /// Whether every entry is the same in all channels.
    pub fn is_gray(&self) -> bool {
        self.entries().all(|(_, e)| e.factor.x == e.factor.y && e.factor.y == e.factor.z)
    }

    /// All entries with their senders.
    pub fn entries(&self) -> impl Iterator<Item = (u32, &Entry)> {
        self.rows.iter().enumerate().flat_map(|(from, row)| row.entries.iter().map(move |e| (from as u32, e)))
    }

    /// n² A of each element: what reciprocity weighs rows with.
    pub fn weights(tracer: &Tracer, set: &ElementSet) -> Vec<f64> {
        let ior = |e: &super::Element| f64::from(tracer.media().ior(e.media.current()));
        set.elements().iter().map(|e| ior(e) * ior(e) * e.area).collect()
    }

    /// Checks closure and reciprocity; `weights` are n² A.
    pub fn closure(&self, weights: &[f64]) -> Closure {
        let mut report = Closure::default();
        let total: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        for (row, weight) in self.rows.iter().zip(weights) {
            report.unaccounted.push((row.ledger.sum() - DVec3::ONE).abs().max_element());
            report.escaped += row.ledger.escaped.max_element() * weight / total;
            report.black_backs += row.ledger.black_backs.max_element() * weight / total;
        }
        let (mut squares, mut count, mut largest) = (0.0, 0_u64, f64::MIN_POSITIVE);
        for (from, entry) in self.entries() {
            let there = entry.factor * weights[from as usize];
            let back = self.get(entry.to, from) * weights[entry.to as usize];
            let difference = (there - back).abs().max_element();
            largest = largest.max(there.max_element());
            squares += difference * difference;
            count += 1;
            report.largest_error = report.largest_error.max(entry.error);
            if difference > report.reciprocity {
                report.reciprocity = difference;
                report.worst_pair = Some((from, entry.to));
            }
        }
        report.reciprocity_relative = (squares / count.max(1) as f64).sqrt() / largest;
        report
    }

    /// Makes n² A F symmetric, with row sums as close to closure as symmetry allows.
    ///
    /// S = (AF + (AF)ᵀ)/2 first; then S_ij ← S_ij √(c_i c_j) with c_i the factor that row i misses, over and over
    /// (Knight, Ruiz & Uçar 2014: symmetric scaling converges to the one diagonal scaling D S D with the right row sums).
    /// `kept` is 1 − ρ_s of each element; Σ_j kept_j F_ij must be what row i lost neither to the sky nor to black backs.
    /// Where elements do not cover everything that keeps light, closure cannot be asked for: `close` is false.
    pub fn repair(&mut self, weights: &[f64], kept: &[DVec3], close: bool) -> Repair {
        let count = self.rows.len();
        let before = self.clone();
        // Row sums that closure asks for: everything but what no element receives.
        let target: Vec<DVec3> = self
            .rows
            .iter()
            .map(|r| DVec3::ONE - r.ledger.escaped - r.ledger.black_backs - r.ledger.cut_off)
            .collect();
        let mut symmetric: Vec<Vec<(u32, DVec3, f64)>> = vec![Vec::new(); count];
        for (from, e) in before.entries() {
            let (i, j) = (from as usize, e.to as usize);
            let there = e.factor * weights[i];
            let back = before.get(e.to, from) * weights[j];
            symmetric[i].push((e.to, (there + back) * 0.5, e.error));
            if back == DVec3::ZERO && i != j {
                symmetric[j].push((from, there * 0.5, e.error));
            }
        }
        for row in &mut symmetric {
            row.sort_by_key(|e| e.0);
        }
        let mut repair = Repair::default();
        let misses = |symmetric: &[Vec<(u32, DVec3, f64)>]| -> Vec<DVec3> {
            (0..count)
                .map(|i| {
                    let sum: DVec3 = symmetric[i].iter().map(|e| e.1 * kept[e.0 as usize]).sum();
                    let wanted = target[i] * weights[i];
                    let ratio = |w: f64, s: f64| if w > 0.0 && s > 0.0 { w / s } else { 1.0 };
                    DVec3::new(ratio(wanted.x, sum.x), ratio(wanted.y, sum.y), ratio(wanted.z, sum.z))
                })
                .collect()
        };
        for _ in 0..if close { REPAIR_ROUNDS } else { 0 } {
            let scale = misses(&symmetric);
            repair.left = scale.iter().map(|s| (*s - DVec3::ONE).abs().max_element()).fold(0.0, f64::max);
            if repair.left < REPAIR_TOLERANCE {
                break;
            }
            for (i, row) in symmetric.iter_mut().enumerate() {
                for (to, value, _) in row {
                    let product = scale[i] * scale[*to as usize];
                    *value *= DVec3::new(product.x.sqrt(), product.y.sqrt(), product.z.sqrt());
                }
            }
            repair.rounds += 1;
        }
        let (mut moved, mut total) = (0.0, 0.0);
        for (i, row) in symmetric.into_iter().enumerate() {
            self.rows[i].entries = row
                .into_iter()
                .map(|(to, value, error)| Entry { to, factor: value / weights[i], error })
                .collect();
            for entry in &self.rows[i].entries {
                let change = (entry.factor - before.get(i as u32, entry.to)).abs().max_element();
                repair.largest = repair.largest.max(change);
                moved += change * weights[i];
                total += entry.factor.max_element() * weights[i];
            }
        }
        repair.mean = moved / f64::max(total, f64::MIN_POSITIVE);
        repair
    }
}

const REPAIR_ROUNDS: usize = 200;
const REPAIR_TOLERANCE: f64 = 1e-12;
