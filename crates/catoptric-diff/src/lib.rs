//! Image metrics, limits, heat maps and reports
