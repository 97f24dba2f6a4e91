// Far field, whose light of each wavelength is kept apart: a far field for each, one behind the other.

fn record_far_field_apart(ray: Ray, detector: Detector, ends: bool) {
    var own = detector;
    own.cell += spectral_bins[detector.bins + ray.wavelength] * detector.num_x * detector.num_y;
    record_far_field(ray, own, ends);
}
