// Where media alone take something from the rays of the nominal path, what they weigh at its end tells the host all that they
// have lost: differences of quantised weights telescope (gpu::end_paths). So they book nothing. One that loses something
// on more or fewer of its ways than the others, or comes to roulette, has strayed. An invocation follows
// one ray. Twin of path_losses_booked.wgsl.

var<private> num_losses: u32 = 0u;
var<private> is_off_roulette: bool = true;

// As `reach`.
fn reach_next(ray: ptr<function, Ray>, hit: Hit) {
    let before = (*ray).weight;
    (*ray).weight = attenuated(*ray, hit.distance);
    num_losses += select(0u, 1u, (*ray).weight < before);
    is_off_roulette = is_off_roulette & ((*ray).weight >= ROULETTE_THRESHOLD);
    (*ray).position += hit.distance * (*ray).direction;
    (*ray).last = hit.primitive;
}

// As `go_on`, without roulette.
fn go_on_along(ray: ptr<function, Ray>) {
    (*ray).bounce += 1u;
    (*ray).fresnel = stream_next((*ray).fresnel);
    if (*ray).bounce >= MAX_DEPTH {
        (*ray).fate = DEPTH_KILLED;
    }
}

// The ray has lost what its weight tells, on so many ways, and nothing else.
fn are_losses_told(attenuating_legs: u32) -> bool {
    return (num_losses == attenuating_legs) & is_off_roulette;
}
