//! Radiometric quantities, one number per colour channel (linear Rec. 709, no clamping).
//!
//! The π between radiosity and radiance lives here and nowhere else (docs/conventions.md: a Lambertian surface
//! of radiosity B has radiance L = B/π in every direction).

use std::f32::consts::PI;

/// Three channels of anything: a reflectance, a throughput, a weight.
pub type Rgb = glam::Vec3;

/// Luminance weights of Rec. 709 primaries.
pub const LUMINANCE: Rgb = Rgb::new(0.2126, 0.7152, 0.0722);

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[repr(transparent)]
        pub struct $name(pub Rgb);

        impl $name {
            /// No light.
            pub const ZERO: Self = Self(Rgb::ZERO);
        }

        impl std::ops::Add for $name {
            type Output = Self;
            #[inline]
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl std::ops::AddAssign for $name {
            #[inline]
            fn add_assign(&mut self, other: Self) {
                self.0 += other.0;
            }
        }

        impl std::ops::Mul<f32> for $name {
            type Output = Self;
            #[inline]
            fn mul(self, factor: f32) -> Self {
                Self(self.0 * factor)
            }
        }

        impl std::ops::Mul<Rgb> for $name {
            type Output = Self;
            #[inline]
            fn mul(self, factor: Rgb) -> Self {
                Self(self.0 * factor)
            }
        }
    };
}

quantity! {
    /// Radiance L (nits, or W·m⁻²·sr⁻¹: the unit is the author's).
    Radiance
}
quantity! {
    /// Irradiance H: flux per area that arrives.
    Irradiance
}
quantity! {
    /// Radiosity B: flux per area that leaves, B = πL_e + ρ·H.
    Radiosity
}

impl Radiosity {
    /// Radiance of a Lambertian surface of this radiosity: L = B/π.
    #[inline]
    pub fn radiance(self) -> Radiance {
        Radiance(self.0 / PI)
    }
}

impl Radiance {
    /// Radiosity of a Lambertian surface of this radiance: B = πL.
    #[inline]
    pub fn radiosity(self) -> Radiosity {
        Radiosity(self.0 * PI)
    }
}

impl Irradiance {
    /// Radiosity that a surface of diffuse reflectance `reflectance` sends back: ρ·H.
    #[inline]
    pub fn reflected(self, reflectance: Rgb) -> Radiosity {
        Radiosity(self.0 * reflectance)
    }
}
