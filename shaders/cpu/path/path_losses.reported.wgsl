// Rays that keep to the path report their last weight, and deposit nothing on their way. Twin of
// path_losses.deposited.wgsl.
//
// Only media take weight from such rays. Differences of quantised weights telescope, so the last weight determines all
// losses. A ray fails the guard if the number of segments that weaken it differs from the path's, or if it comes to
// roulette.

var<private> num_losses: u32 = 0u;
var<private> is_off_roulette: bool = true;
var<private> is_absorbed_weakly: bool = true;

// As `reach`.
fn reach_next(ray: ptr<function, Ray>, hit: Hit) {
    leave_contact(ray, hit.distance);
    let before = (*ray).weight;
    if MEDIA_ABSORB_WEAKLY {
        (*ray).weight = attenuated_weakly(*ray, hit.distance);
    } else {
        (*ray).weight = attenuated(*ray, hit.distance);
    }
    num_losses += select(0u, 1u, (*ray).weight < before);
    is_off_roulette = is_off_roulette & ((*ray).weight >= ROULETTE_THRESHOLD);
    (*ray).position += hit.distance * (*ray).direction;
    (*ray).last = hit.primitive;
}

// As `attenuated`, where a segment takes little from nearly all rays. A ray that loses more fails the guard.
fn attenuated_weakly(ray: Ray, distance: real) -> real {
    let absorption = medium_at(ray.medium, ray.wavelength).absorption;
    if absorption == 0.0 {
        return ray.weight;
    }
    let exponent = -absorption * distance;
    is_absorbed_weakly = is_absorbed_weakly & (abs(exponent) <= NEAR_ZERO);
    return ray.weight * exp_near_zero(exponent);
}

// As `go_on`, without roulette.
fn go_on_along(ray: ptr<function, Ray>) {
    (*ray).bounce += 1u;
    (*ray).fresnel = stream_next((*ray).fresnel);
    if (*ray).bounce >= MAX_DEPTH {
        (*ray).fate = DEPTH_KILLED;
    }
}

// True if the last weight determines all losses: the ray lost weight on this number of segments, and to nothing else.
fn are_losses_reported(attenuating_legs: u32) -> bool {
    return (num_losses == attenuating_legs) & is_off_roulette & is_absorbed_weakly;
}
