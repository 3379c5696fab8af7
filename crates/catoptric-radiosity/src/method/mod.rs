//! Form factor methods: siblings behind one trait, each plain (D–D) or extended (D–S*–D).
//!
//! F_ij is the share of the power that leaves element i with a Lambertian lobe and arrives at element j, directly or over
//! ideal mirrors and glass, before j splits it (DESIGN §1): A_i F_ij = A_j F_ji, Σ_j (1 − ρ_s,j) F_ij = 1 in a closed
//! scene. A coat counts as a mirror of the element that it covers.

pub mod analytic;
pub mod area;
mod beams;
pub mod elements;
pub mod hemicube;
pub mod matrix;
mod quadrature;
pub mod rays;
mod scrambles;
mod visible;

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use rayon::prelude::*;

use catoptric_scene::{Cancelled, Progress};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

pub use elements::{Element, ElementSet, Piece};
pub use matrix::FactorMatrix;

/// How form factors are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Hemisphere rays by Malley's mapping of a scrambled low-discrepancy sequence.
    Rays,
    /// Projection onto half a cube with an item buffer.
    Hemicube,
    /// Area-to-area Monte Carlo, stratified over both surfaces.
    Area,
    /// Lambert's contour formula from the points of a quadrature, with exact clipping.
    Analytic,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 4] = [Self::Rays, Self::Hemicube, Self::Area, Self::Analytic];

    /// Its word on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rays => "rays",
            Self::Hemicube => "hemicube",
            Self::Area => "area",
            Self::Analytic => "analytic",
        }
    }
}

impl FromStr for Method {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|m| m.name() == text)
            .ok_or_else(|| format!("expected one of the methods {names}"))
    }
}

/// Parameters of all methods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MethodParams {
    /// Limits of the S* walk; `extended: false` for plain form factors.
    pub walk: WalkParams,
    /// Samples per element (`area`: per pair) in each of 16 independent scrambles: rays, pairs of points, or cells of all
    /// hemicubes. `analytic`: rays for what is neither flat nor a plain mirror.
    pub rays: u32,
    /// Seed of all sequences.
    pub seed: u32,
    /// Cells along an edge of a hemicube's top.
    pub resolution: u32,
    /// `analytic`: relative error aimed at.
    pub tolerance: f64,
    /// `analytic`: cells of the quadrature per element, at most.
    pub max_cells: usize,
}

impl Default for MethodParams {
    fn default() -> Self {
        Self {
            walk: WalkParams::default(),
            rays: 4_096,
            seed: 0,
            resolution: 64,
            tolerance: 1e-7,
            max_cells: 2_000,
        }
    }
}

/// One form factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Receiver.
    pub to: u32,
    /// F, per channel.
    pub factor: DVec3,
    /// Standard error of the sampled methods; estimate of the error of the deterministic ones. Largest channel.
    pub error: f64,
}

/// All form factors from one element.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FactorRow {
    /// Receivers with a form factor other than zero, ascending.
    pub entries: Vec<Entry>,
    /// Where the power went, as shares of what was sent.
    pub ledger: Ledger,
    /// Rays, pairs of points, cells or contour sums that were evaluated.
    pub samples: u64,
}

impl FactorRow {
    /// F to an element.
    pub fn to(&self, element: u32) -> DVec3 {
        self.entry(element).map_or(DVec3::ZERO, |e| e.factor)
    }

    /// The entry of an element.
    pub fn entry(&self, element: u32) -> Option<&Entry> {
        self.entries.binary_search_by_key(&element, |e| e.to).ok().map(|i| &self.entries[i])
    }

    /// Keeps what is not zero of dense factors with their errors.
    fn from_dense(factors: &[DVec3], errors: &[f64], ledger: Ledger, samples: u64) -> Self {
        let entries = factors
            .iter()
            .zip(errors)
            .enumerate()
            .filter(|(_, (f, _))| **f != DVec3::ZERO)
            .map(|(to, (&factor, &error))| Entry { to: to as u32, factor, error })
            .collect();
        Self { entries, ledger, samples }
    }
}

/// A method, ready to be asked for rows.
pub trait FormFactors: Sync {
    /// All form factors from one element. The same bits for the same element, whatever else is computed.
    fn row(&self, from: u32) -> FactorRow;
}

/// Why a method cannot be used on a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MethodError {
    /// Holes of masked materials have no outline.
    CutOuts {
        /// A surface with such a material.
        surface: String,
    },
    /// More polygons than clipping each by all others can cope with.
    TooManyPolygons {
        /// Polygons.
        found: usize,
        /// At most.
        limit: usize,
    },
}

impl fmt::Display for MethodError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::CutOuts { surface } => {
                write!(f, "{surface}: has holes by alpha, which have no outline to clip by")
            }
            Self::TooManyPolygons { found, limit } => {
                write!(f, "{found} polygons are too many to clip each by all others (at most {limit})")
            }
        }
    }
}

impl std::error::Error for MethodError {}

/// Prepares a method for a scene.
pub fn prepare<'a>(
    method: Method,
    tracer: &'a Tracer<'a>,
    set: &'a ElementSet,
    params: &MethodParams,
) -> Result<Box<dyn FormFactors + 'a>, MethodError> {
    Ok(match method {
        Method::Rays => Box::new(rays::Rays { tracer, set, params: *params }),
        Method::Hemicube => Box::new(hemicube::Hemicube::new(tracer, set, params)),
        Method::Area => Box::new(area::Area::new(tracer, set, params)),
        Method::Analytic => Box::new(analytic::Analytic::new(tracer, set, params)?),
    })
}

/// All rows of a prepared method.
pub fn factors(
    method: &dyn FormFactors,
    set: &ElementSet,
    progress: &dyn Progress,
) -> Result<FactorMatrix, Cancelled> {
    progress.begin("form factors", set.len() as u64);
    let rows: Result<Vec<FactorRow>, Cancelled> = (0..set.len() as u32)
        .into_par_iter()
        .with_max_len(1)
        .map(|from| {
            if progress.is_cancelled() {
                return Err(Cancelled);
            }
            let row = method.row(from);
            progress.advance(1);
            Ok(row)
        })
        .collect();
    Ok(FactorMatrix { rows: rows? })
}
