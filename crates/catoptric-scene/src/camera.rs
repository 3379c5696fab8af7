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

impl Camera {
    /// Ray through the continuous pixel coordinates (x right, y down) of a `width`×`height` image:
    /// origin and unit direction. Pixel (i, j) covers [i, i+1)×[j, j+1).
    pub fn ray(&self, x: f32, y: f32, width: usize, height: usize) -> (Vec3, Vec3) {
        let ndc_x = 2.0 * x / width as f32 - 1.0;
        let ndc_y = 1.0 - 2.0 * y / height as f32;
        let aspect = width as f32 / height as f32;
        let (origin, direction) = match self.projection {
            Projection::Perspective { yfov } => {
                let t = libm::tanf(0.5 * yfov);
                (Vec3::ZERO, Vec3::new(aspect * t * ndc_x, t * ndc_y, -1.0))
            }
            Projection::Orthographic { xmag, ymag } => {
                (Vec3::new(xmag * ndc_x, ymag * ndc_y, 0.0), Vec3::NEG_Z)
            }
        };
        let origin = self.world_from_camera.transform_point3(origin);
        let direction = self.world_from_camera.transform_vector3(direction);
        (origin, direction.normalize_or_zero())
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
