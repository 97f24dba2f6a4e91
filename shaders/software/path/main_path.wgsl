// Stage trace_main_path follows the main path, the one that most rays of a scene take: its events in a row, and nothing else.
// The walk is composed: at each event it looks for the nearest of those primitives that can lie between the last event and
// the next. A ray that does anything else is rejected: it leaves only a mark, where its log begins, and trace_new traces it
// anew from its birth. So no bit of a result depends on what the path is. Wide machines run no branch that no ray takes,
// and no round of a loop that a few rays need.
// Nor does a ray mark what it reaches: where a ray has kept to the path, the host knows that.
// Stages trace_side_a and so on follow side paths in the same way: what most of those rays do that were rejected at the
// same event. Entry points are composed, each with the walk of its own path alone: drivers take long over text that is not
// used.

// Events in which the ray has kept to the path: those rejected at the same event have ways alike, and are traced side by
// side.
var<private> kept_events: u32 = 0u;

// Begins the stage of a path: the number of the invocation.
fn begin_stage(invocation: Invocation) -> u32 {
    begin();
    begin_lanes(invocation);
    return invocation.id.y * invocation.groups.x * WORKGROUP_SIZE + invocation.id.x;
}

fn end_stage() {
    use_entries();
    flush_bins();
    notice_cut_loops();
}

fn begin_ray() {
    keep_bins();
    begin_path();
    kept_events = 0u;
}

// One event of the path on a surface: true if the ray has met it and does as the path. A rejected ray goes through
// the same motions, to no effect.
fn keeps_to(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & goes_on(ray);
}

// The same at a refracting surface to which the path's rays come from one side, and which reflects all of them or none: what
// follows from that is a constant, the medium in which the ray goes on above all.
fn crosses(
    ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32, entering_back: bool, reflected: bool,
) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    let n = geometric_normal(surface, (*ray).position);
    let d = (*ray).direction;
    let cosine = dot(d, n);
    let boundary = boundary_of(surface, (*ray).wavelength, cosine, entering_back);
    let reflects = reflects_at(ray, surface, primitive, boundary);
    if reflected {
        (*ray).direction = mirrored(d, n);
    } else {
        (*ray).direction = transmitted(d, n, boundary);
    }
    leave_boundary(ray, surface, primitive, entering_back, reflected);
    note_side(ray, n, d);
    let takes_side = ((cosine > 0.0) == entering_back) & (reflects == reflected);
    return (hit.primitive == primitive) & takes_side & goes_on(ray);
}

// The last event of a path may be the last one of all.
fn goes_on(ray: ptr<function, Ray>) -> bool {
    let lives = (*ray).fate == ALIVE;
    go_on_along(ray);
    return lives & ((*ray).fate == select(ALIVE, DEPTH_KILLED, (*ray).bounce >= MAX_DEPTH));
}

// The last event of the path on a surface that absorbs the ray.
fn ends_on_surface(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & ((*ray).fate != ALIVE);
}
