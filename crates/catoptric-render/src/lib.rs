//! Pass two: eye rays, irradiance look-up, anti-aliasing and layers
