// Stage trace_nominal: the path that most rays of a scene take, one event after the other and nothing else. `walk` is
// composed: at each event it looks for the nearest of those primitives that can lie between the last one and the next.
// A ray that does anything else has strayed: it leaves nothing but a mark, where its log begins, and trace_new traces it
// anew from its birth. So no bit of a result depends on what the path is. Wide machines run no branch that no ray takes, and no
// round of a loop that a few rays need.
// Nor does it mark what it reaches: where a ray has kept to the path, the host knows what that is.

@compute @workgroup_size(WORKGROUP_SIZE)
fn trace_nominal(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    begin();
    follow_nominal_rays(id.y * groups.x * WORKGROUP_SIZE + id.x);
    use_entries();
    flush_bins();
    notice_cut_loops();
}

fn follow_nominal(index: u32) {
    if index >= range.count {
        return;
    }
    keep_bins();
    begin_path();
    var ray = new_ray(key_in_range(index), index);
    let holds = walk(&ray);
    end_path(ray, holds);
}

// One event of the path on a surface: true if the ray has met it and does as the path. One that has strayed goes through
// the same motions, to no effect.
fn keeps_to(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & goes_on(ray);
}

// From a refracting surface the path goes on in this medium. From here on it is a constant: of media that are compiled in,
// the compiler knows what they absorb.
fn has_come_into(ray: ptr<function, Ray>, medium: u32) -> bool {
    let is_in = (*ray).medium == medium;
    (*ray).medium = medium;
    return is_in;
}

// The last event of a path may be the last one of all.
fn goes_on(ray: ptr<function, Ray>) -> bool {
    let lives = (*ray).fate == ALIVE;
    go_on(ray);
    return lives & ((*ray).fate == select(ALIVE, DEPTH_KILLED, (*ray).bounce >= MAX_DEPTH));
}

// The last event of the path on a surface that absorbs the ray.
fn ends_on_surface(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & ((*ray).fate != ALIVE);
}
