// Rays that keep to the path log entries, as all other rays do (cpu/log/ends.logged.wgsl). Twin of
// path_log.arrivals.wgsl.

// All ends that the invocation has logged, joined by `|`. This variable uses each entry a second time, which saves a
// tenth of the time in f64 here. A driver that stores lanes one by one would otherwise compose an entry anew for each
// lane, from each of its parts. An entry that is used twice is composed once, for all lanes. In trace_new, where
// entries have few parts, a second use would cost time.
var<private> entries: u32 = 0u;

// One event of the path on a detector that lets it pass.
fn passes(ray: ptr<function, Ray>, hit: Hit, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    arrive(ray, primitive - NUM_SURFACES);
    return (hit.primitive == primitive) & goes_on(ray);
}

// The last event of the path, on a detector that ends the ray.
fn ends_on_detector(ray: ptr<function, Ray>, hit: Hit, primitive: u32) -> bool {
    reach_next(ray, Hit(hit.distance, primitive));
    (*ray).fate = DETECTED;
    return hit.primitive == primitive;
}

fn begin_path() {
    go_on_after_passes(0u);
}

fn end_on_path(ray: Ray, holds: bool) {
    if holds {
        settle(ray);
    } else {
        restore_bins();
        // What it left in passing is overwritten.
        go_on_after_passes(0u);
        end_failed(kept_events);
    }
    entries |= end;
    log_end(ray.index);
}

// The second use of entries, without effect, because no entry has the highest bit.
fn use_entries() {
    if (entries >> 31u) != 0u {
        atomicStore(&queue_counts.cut, 1u);
    }
}
