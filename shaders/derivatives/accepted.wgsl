// What the radius of a place in a truncated Gaussian beam changes by. Twin of sources/accepted.plain.wgsl.
//
// A place is drawn until one lies within the disk. A wider beam has more places rejected, and none beyond the rim. So a place
// does not move in proportion to sigma: it keeps the share of the beam's light that lies within its radius. With
// q = r^2 / (2 sigma^2), and Q the same of the rim, that share is (1 - exp(-q)) / (1 - exp(-Q)).
//
// Source: Figurnov, Mohamed and Mnih, Implicit Reparameterization Gradients (NeurIPS 2018), equation 5.

fn accepted_radius(radius: real, e: Source) -> real {
    let rim = e.p0 * e.p0 / (2.0 * e.p1 * e.p1);
    let to_rim = detached(rim);
    let here = detached(radius * radius / (2.0 * e.p1 * e.p1));
    let slope = detached(exp_less_1(-here) * exp_real(here - to_rim) / exp_less_1(-to_rim));
    return attached(radius, e.p1 * sqrt(2.0 * (here + slope * (rim - to_rim))));
}
