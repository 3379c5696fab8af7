//! Ids are types, so that a triangle is never looked up as a material.

macro_rules! id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub u32);

        impl $name {
            /// Position in the table that this id points into.
            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    };
}

id! {
    /// A triangle of [`Scene::triangles`](crate::Scene::triangles).
    TriangleId
}
id! {
    /// A named surface (one primitive of one glTF node) of [`Scene::surfaces`](crate::Scene::surfaces).
    SurfaceId
}
id! {
    /// A material of [`Scene::materials`](crate::Scene::materials).
    MaterialId
}
id! {
    /// A texture of [`Scene::textures`](crate::Scene::textures).
    TextureId
}
