//! What both passes share: the display mesh and its irradiance, saved as glTF
