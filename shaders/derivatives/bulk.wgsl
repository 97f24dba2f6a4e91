// Absorption along a segment. A medium that absorbs nothing has a derivative by its absorption.

fn attenuated(ray: Ray, distance: real) -> real {
    let absorption = medium_at(ray.medium, ray.wavelength).absorption;
    return attached(plain_attenuated(ray, distance), ray.weight * exp_real(-absorption * distance));
}
