//! Emitters, image chains, irradiance at a point by term, and who owns a light path
