//! Linear images: EXR, HDR, PFM, PNG and JPEG in and out, exposure and tone map
