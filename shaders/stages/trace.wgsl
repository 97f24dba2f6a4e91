// The loop within a pass: each dispatch follows rays for a few events in registers, then queues the survivors.
//
// The loop calls `interact`; the physics is `plain_interact`. What stands between the two names is a slot, which an addition
// may fill (stages/path.plain.wgsl). So it is with `generate`, `intersect`, `splat` and others.

@compute @workgroup_size(WORKGROUP_SIZE)
fn trace_new(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local_index: u32,
) {
    begin();
    let ray = follow_rays(id.y * groups.x * WORKGROUP_SIZE + id.x);
    flush_bins();
    flush_reached();
    notice_cut_loops();
    if HAS_QUEUE {
        compact(ray, ray.fate == ALIVE, local_index);
    }
}

// Follows a ray of the range from its birth on. An index beyond the range gives a ray that has ended.
fn follow_new(index: u32) -> Ray {
    var ray: Ray;
    ray.fate = DETECTED;
    if index < range.count {
        go_on_after_passes(0u);
        ray = generate(index);
        record_birth(ray);
        follow(&ray);
    }
    return ray;
}

// Follows a ray for up to EVENTS_PER_DISPATCH events, then writes where the ray ended to memory. A ray ends at most
// once, so its end is dealt with after the loop. On wide machines, every lane pays for what any lane does inside the
// loop.
fn follow(ray: ptr<function, Ray>) {
    var step = 0u;
    loop {
        if always_true() & ((*ray).fate == ALIVE) {
            next_event(ray);
        }
        step += 1u;
        if step >= EVENTS_PER_DISPATCH || (*ray).fate != ALIVE {
            break;
        }
    }
    if (*ray).fate != ALIVE && !has_position(*ray) {
        end_without_position();
        (*ray).fate = ESCAPED;
    }
    settle(*ray);
    log_end((*ray).index);
}

fn settle_end(ray: Ray) {
    if ray.fate == DETECTED {
        splat(ray, ray.last - NUM_SURFACES, true);
    } else if ray.fate != ALIVE {
        deposit_fate(ray);
    }
}

// False if the ray's position or direction is no number. Such a ray meets nothing: it ends as escaped, and is counted
// as invalid.
fn has_position(ray: Ray) -> bool {
    let size = abs(ray.position) + abs(ray.direction);
    return is_number(size.x + size.y + size.z);
}

// One event, in Optiland's order: bulk absorption over the segment, the event itself, depth, roulette.
fn next_event(ray: ptr<function, Ray>) {
    let hit = intersect(*ray);
    if hit.primitive == NONE {
        (*ray).fate = ESCAPED;
        return;
    }
    reach(ray, hit);
    record_hit(*ray, hit.primitive);
    if hit.primitive < NUM_SURFACES {
        mark_reached(hit.primitive);
        interact(ray, surface_of(hit.primitive), hit.primitive);
    } else {
        arrive(ray, hit.primitive - NUM_SURFACES);
    }
    if (*ray).fate == ALIVE {
        go_on(ray);
    }
}

fn reach(ray: ptr<function, Ray>, hit: Hit) {
    leave_contact(ray, hit.distance);
    attenuate(ray, hit.distance);
    (*ray).position += hit.distance * (*ray).direction;
    (*ray).last = hit.primitive;
}

fn go_on(ray: ptr<function, Ray>) {
    (*ray).bounce += 1u;
    (*ray).fresnel = stream_next((*ray).fresnel);
    (*ray).roulette = stream_next((*ray).roulette);
    if (*ray).bounce >= MAX_DEPTH {
        (*ray).fate = DEPTH_KILLED;
    } else {
        roulette(ray);
    }
}

// Deposits the ray's whole weight where the ray ended.
fn plain_deposit_fate(ray: Ray) {
    record_death(ray);
    end_in(select(CELL_ESCAPED + (ray.fate - ESCAPED), CELL_SURFACES + ray.last, ray.fate == ABSORBED), ray.weight);
}
