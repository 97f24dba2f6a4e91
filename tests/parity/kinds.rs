//! The kinds of sources, shapes and detectors. Each match is exhaustive, so that a new kind is not forgotten here.

use nsq_gpu::model::{
    Annulus, Bsdf, Collimated, Conic, Detector, DetectorKind, Extended, Frustum, Outline, Point, Shape,
    Source, SourceKind, Spectral, Sphere, Splat, Surface,
};

/// Every kind of source that Optiland has.
pub const SOURCES: [&str; 6] = [
    "point in a cone",
    "point in all directions",
    "top hat",
    "Gaussian beam",
    "extended rectangle",
    "extended disk",
];
/// Every kind of shape.
pub const SHAPES: [&str; 10] = [
    "flat conic",
    "conic",
    "infinite plane",
    "rectangle",
    "disk",
    "annulus",
    "frustum",
    "sphere",
    "sphere with an aperture",
    "mesh",
];
/// Every kind of detector.
pub const DETECTORS: [&str; 7] = [
    "irradiance, hard",
    "irradiance, bilinear",
    "irradiance, Gaussian",
    "spectral, hard",
    "spectral, splatted",
    "far field",
    "ray database",
];

/// What surfaces do beside Fresnel's laws and reflection, of what Optiland has. A lobe to the far side is a matter of the same function.
pub const FINISHES: [&str; 5] = ["coating", "specular", "Lambertian", "Harvey-Shack", "tabulated"];

/// The finishes of a surface, of [`FINISHES`].
pub fn of_finish(surface: &Surface) -> Vec<&'static str> {
    let bsdf = surface.scatter.as_ref().map(|scatter| match &scatter.bsdf {
        Bsdf::Specular(_) => "specular",
        Bsdf::Lambertian(_) => "Lambertian",
        Bsdf::HarveyShack(_) => "Harvey-Shack",
        Bsdf::Tabulated(_) => "tabulated",
        Bsdf::KCorrelation(_) => "K-correlation",
        Bsdf::Measured(_) => "measured",
    });
    bsdf.into_iter().chain(surface.coating.as_ref().map(|_| "coating")).collect()
}

/// The kind of a source, of [`SOURCES`].
pub fn of_source(source: &Source) -> &'static str {
    match source.kind {
        SourceKind::Point(Point { half_angle }) if half_angle < std::f64::consts::PI => "point in a cone",
        SourceKind::Point(Point { .. }) => "point in all directions",
        SourceKind::Collimated(Collimated { sigma: None, .. }) => "top hat",
        SourceKind::Collimated(Collimated { sigma: Some(_), .. }) => "Gaussian beam",
        SourceKind::Extended(Extended { area: Outline::Rectangle { .. }, .. }) => "extended rectangle",
        SourceKind::Extended(Extended { area: Outline::Disk { .. } | Outline::Infinite, .. }) => {
            "extended disk"
        }
        SourceKind::Pupil(_) => "pupil",
        SourceKind::Tabulated(_) => "lamp",
        SourceKind::Rays(_) => "rays of a file",
    }
}

/// The kind of a shape, of [`SHAPES`].
pub fn of_shape(shape: &Shape) -> &'static str {
    match shape {
        Shape::Conic(Conic { curvature: 0.0, .. }) => "flat conic",
        Shape::Conic(Conic { .. }) => "conic",
        Shape::Plane(Outline::Infinite) => "infinite plane",
        Shape::Plane(Outline::Rectangle { .. }) => "rectangle",
        Shape::Plane(Outline::Disk { .. }) => "disk",
        Shape::Annulus(Annulus { .. }) => "annulus",
        Shape::Frustum(Frustum { .. }) => "frustum",
        Shape::Sphere(Sphere { aperture_radius: None, .. }) => "sphere",
        Shape::Sphere(Sphere { aperture_radius: Some(_), .. }) => "sphere with an aperture",
        Shape::Mesh(_) => "mesh",
        Shape::ClippedConic(_) => "clipped conic",
        Shape::EvenAsphere(_) => "even asphere",
        Shape::OddAsphere(_) => "odd asphere",
        Shape::Biconic(_) => "biconic",
        Shape::Toroidal(_) => "toroid",
        Shape::Polynomial(_) => "polynomial",
        Shape::Chebyshev(_) => "Chebyshev",
        Shape::Zernike(_) => "Zernike",
    }
}

/// The kind of a detector, of [`DETECTORS`].
pub fn of_detector(detector: &Detector) -> &'static str {
    match &detector.kind {
        DetectorKind::Irradiance(grid) => match grid.splat {
            Splat::Hard => "irradiance, hard",
            Splat::Bilinear => "irradiance, bilinear",
            Splat::Gaussian { .. } => "irradiance, Gaussian",
        },
        DetectorKind::Spectral(Spectral { grid, .. }) => match grid.splat {
            Splat::Hard => "spectral, hard",
            Splat::Bilinear | Splat::Gaussian { .. } => "spectral, splatted",
        },
        DetectorKind::FarField(_) => "far field",
        DetectorKind::RayDatabase(_) => "ray database",
        DetectorKind::Apart(_) => "wavelengths apart",
    }
}
