// The radius of a place that was drawn within the disk of a Gaussian beam. Twin of derivatives/accepted.wgsl, which says what
// the radius changes by.

fn accepted_radius(radius: real, e: Source) -> real {
    return radius;
}
