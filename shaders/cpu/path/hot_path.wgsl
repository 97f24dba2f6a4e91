// Stage trace_hot_path follows the hot path, which most rays of a scene take: its events in a row, and nothing else.
// Wide machines then skip branches that rays never take, and iterations of a loop that only a few rays need.
//
// The walk is composed. At each event, it looks for the nearest of those primitives that can lie between the last event
// and the next. A ray that does anything else fails a guard. It leaves only a mark, where its log begins, and
// trace_new traces it anew from its birth. So no bit of a result depends on the choice of the path. Rays on the path do
// not mark the primitives that they reach, because the host knows them.
//
// Stages trace_side_a and so on follow side traces in the same way. A side trace is what most of the rays do that
// failed the guard of the same event. Entry points are composed, each with the walk of its own path alone, because drivers take
// long over unused text.

// The number of events in which the ray has kept to the path. Rays that fail at the same event take similar ways, and
// are traced side by side.
var<private> kept_events: u32 = 0u;

struct Invocation {
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
}

// Begins the stage of a path, and returns the number of the invocation.
fn begin_stage(invocation: Invocation) -> u32 {
    begin();
    return invocation.id.y * invocation.groups.x * WORKGROUP_SIZE + invocation.id.x;
}

fn end_stage() {
    use_entries();
    flush_bins();
    notice_cut_loops();
}

fn begin_on_path() {
    keep_bins();
    begin_path();
    kept_events = 0u;
}

// One event of the path on a surface. True if the ray has met the surface and does what the path does. A failed ray
// goes through the same motions, to no effect.
fn keeps_to(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & goes_on(ray);
}

// One event of the path on a refracting surface, where the path's rays come from one side and are all reflected or all
// transmitted. What follows from side and branch is then a constant, above all the medium in which the ray goes on.
fn crosses(
    ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32, entering_back: bool, reflected: bool,
) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    let n = geometric_normal(surface, (*ray).position);
    let d = (*ray).direction;
    let cosine = dot(d, n);
    let boundary = boundary_of(surface, (*ray).wavelength, cosine, entering_back);
    let reflects = reflects_at(ray, surface, primitive, cosine, boundary);
    if reflected {
        (*ray).direction = mirrored(d, n);
    } else {
        (*ray).direction = transmitted(d, n, boundary);
    }
    pay_coating(ray, surface, primitive, cosine, boundary.total_reflection, reflected);
    leave_boundary(ray, surface, entering_back, reflected);
    note_side(ray, n, d);
    let takes_side = ((cosine > 0.0) == entering_back) & (reflects == reflected);
    return (hit.primitive == primitive) & takes_side & goes_on(ray);
}

// True if the ray lives on. The last event of the path may also be the last that any ray may have.
fn goes_on(ray: ptr<function, Ray>) -> bool {
    let lives = (*ray).fate == ALIVE;
    go_on_along(ray);
    return lives & ((*ray).fate == select(ALIVE, DEPTH_KILLED, (*ray).bounce >= MAX_DEPTH));
}

// The last event of the path, on a surface that absorbs the ray.
fn ends_on_surface(ray: ptr<function, Ray>, hit: Hit, surface: Surface, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    interact(ray, surface, primitive);
    return (hit.primitive == primitive) & ((*ray).fate != ALIVE);
}
