//! Cameras: where eye rays start and where they go.

use glam::{Affine3A, Vec2, Vec3};

/// How a camera maps the image plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole with a vertical field of view in radians.
    Perspective {
        /// Vertical field of view, radians.
        yfov: f32,
    },
    /// Parallel rays; half extents of the image in metres.
    Orthographic {
        /// Half width.
        xmag: f32,
        /// Half height.
        ymag: f32,
    },
}

/// A camera in world space; looks along its local −Z, +Y up.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name of the node (or camera).
    pub name: String,
    /// Camera to world; orthonormal axes.
    pub world_from_camera: Affine3A,
    /// The projection.
    pub projection: Projection,
    /// Width over height, if the file says it.
    pub aspect: Option<f32>,
    /// Near plane, metres along −Z: nothing closer is seen. 0 for none.
    pub near: f32,
}

/// Where the rays of an image go: a camera and a size, of which what all rays share is known.
#[derive(Clone, Copy, Debug)]
pub struct Film {
    world_from_camera: Affine3A,
    /// Half of its extent: a metre before the eye, or as it is; metres.
    half: Vec2,
    /// Pixels.
    size: Vec2,
    is_perspective: bool,
    /// Near plane of the [`Camera`].
    pub near: f32,
}

impl Film {
    /// [`Camera::ray`] of this image.
    #[inline]
    pub fn ray(&self, x: f32, y: f32) -> (Vec3, Vec3) {
        let ndc = Vec2::new(2.0 * x / self.size.x - 1.0, 1.0 - 2.0 * y / self.size.y);
        let Vec2 { x: across, y: up } = self.half * ndc;
        let (origin, direction) = if self.is_perspective {
            (Vec3::ZERO, Vec3::new(across, up, -1.0))
        } else {
            (Vec3::new(across, up, 0.0), Vec3::NEG_Z)
        };
        let origin = self.world_from_camera.transform_point3(origin);
        let direction = self.world_from_camera.transform_vector3(direction);
        (origin, direction.normalize_or_zero())
    }
}

impl Camera {
    /// Ray through the continuous pixel coordinates (x right, y down) of a `width`×`height` image:
    /// origin and unit direction. Pixel (i, j) covers [i, i+1)×[j, j+1).
    pub fn ray(&self, x: f32, y: f32, width: usize, height: usize) -> (Vec3, Vec3) {
        self.film(width, height).ray(x, y)
    }

    /// The image plane, divided into `width`×`height` pixels.
    pub fn film(&self, width: usize, height: usize) -> Film {
        let size = Vec2::new(width as f32, height as f32);
        let half = match self.projection {
            Projection::Perspective { yfov } => {
                let t = libm::tanf(0.5 * yfov);
                Vec2::new(size.x / size.y * t, t)
            }
            Projection::Orthographic { xmag, ymag } => Vec2::new(xmag, ymag),
        };
        let is_perspective = self.is_perspective();
        Film { world_from_camera: self.world_from_camera, half, size, is_perspective, near: self.near }
    }

    /// Pixel coordinates of a point of the camera's own space, in front of it: the inverse of [`ray`](Self::ray).
    pub fn pixel_of(&self, point: Vec3, width: usize, height: usize) -> Vec2 {
        let (width, height) = (width as f32, height as f32);
        let ndc = match self.projection {
            Projection::Perspective { yfov } => {
                let t = libm::tanf(0.5 * yfov) * -point.z;
                Vec2::new(point.x / (width / height * t), point.y / t)
            }
            Projection::Orthographic { xmag, ymag } => Vec2::new(point.x / xmag, point.y / ymag),
        };
        Vec2::new(0.5 * (1.0 + ndc.x) * width, 0.5 * (1.0 - ndc.y) * height)
    }

    /// Whether all rays start at one point.
    pub fn is_perspective(&self) -> bool {
        matches!(self.projection, Projection::Perspective { .. })
    }

    /// Rows of an image of `width` columns that keeps the camera's aspect (4:3 if the file names none).
    pub fn height_for_width(&self, width: usize) -> usize {
        let aspect = match self.projection {
            Projection::Orthographic { xmag, ymag } => xmag / ymag,
            Projection::Perspective { .. } => self.aspect.unwrap_or(4.0 / 3.0),
        };
        ((width as f32 / aspect).round() as usize).max(1)
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    #[test]
    fn points_on_the_ray_of_a_pixel_are_seen_in_it() {
        let turned = Quat::from_rotation_y(0.7) * Quat::from_rotation_x(-0.4);
        let world_from_camera = Affine3A::from_rotation_translation(turned, Vec3::new(1.0, 2.0, -3.0));
        let perspective = Projection::Perspective { yfov: 0.9 };
        for projection in [perspective, Projection::Orthographic { xmag: 3.0, ymag: 2.0 }] {
            let camera =
                Camera { name: String::new(), world_from_camera, projection, aspect: None, near: 0.0 };
            for (x, y) in [(0.0, 0.0), (320.0, 200.0), (17.25, 150.5)] {
                let (origin, direction) = camera.ray(x, y, 320, 200);
                let point = world_from_camera.inverse().transform_point3(origin + direction * 7.0);
                let found = camera.pixel_of(point, 320, 200);
                // 24 bits, a few times rounded, of hundreds.
                assert!(found.distance(Vec2::new(x, y)) < 1e-3, "{found} for {x}, {y}");
            }
        }
        assert!(
            Camera {
                name: String::new(),
                world_from_camera,
                projection: perspective,
                aspect: None,
                near: 0.0
            }
            .is_perspective()
        );
    }
}
