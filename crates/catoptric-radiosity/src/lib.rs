//! Pass one: patch mesh, form factor rows, solvers, refinement and the gather
