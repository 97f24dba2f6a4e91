// Far field over the sphere, whose light of each wavelength is kept apart: a sphere for each, one behind the other.

fn record_far_field_sphere_apart(ray: Ray, detector: Detector, ends: bool) {
    var own = detector;
    own.cell += spectral_bins[detector.bins + ray.wavelength] * 2u * detector.num_x * detector.num_y;
    record_far_field_sphere(ray, own, ends);
}
