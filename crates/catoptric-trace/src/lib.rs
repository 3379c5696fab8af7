//! Ray tracing, the surface interaction and the S* walk
