//! Scenes of the unit tests of the engine.

/// Two mirrors between which a part of the light is caught.
pub(crate) const TRAP: &str = r#"{"nsq_schema_version": 1,
    "components": [
        {"type": "mirror", "name": "A", "cs": {"z": 10}, "config": {"radius": Infinity, "reflectance": 0.99, "aperture_radius": 5}},
        {"type": "mirror", "name": "B", "cs": {"z": -10}, "config": {"radius": Infinity, "reflectance": 0.98, "aperture_radius": 5}}],
    "sources": [{"type": "collimated", "name": "S", "cs": {}, "spectrum": {"wavelengths": [0.55], "weights": [1]}, "total_flux": 1, "aperture_radius": 10}],
    "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 20}, "width": 20, "height": 20, "num_pixels_x": 8, "num_pixels_y": 8, "absorb": true}]}"#;
