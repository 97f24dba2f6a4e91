// Bulk absorption over a segment of length L, after Beer and Lambert: exp(-4 pi k L / lambda). Twin of bulk.none.wgsl.

fn attenuate(ray: ptr<function, Ray>, distance: real) {
    let before = (*ray).weight;
    (*ray).weight = attenuated(*ray, distance);
    deposit_loss(CELL_BULK, before, (*ray).weight);
}

// The ray's weight after the segment.
fn plain_attenuated(ray: Ray, distance: real) -> real {
    let absorption = medium_at(ray.medium, ray.wavelength).absorption;
    if absorption == 0.0 {
        return ray.weight;
    }
    return ray.weight * exp_real(-absorption * distance);
}
