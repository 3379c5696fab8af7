//! The validated scene, and glTF in and out
