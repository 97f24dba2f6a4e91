// Reports to the host what happened to each ray: an event for each part of its path. Nothing is summed up. Twin of
// sums.totals.wgsl.

const EVENT_PATH_STEP: u32 = 5u;
const EVENT_PATH_END: u32 = 6u;

fn sum_up_path(ray: Ray, kind: u32, number: u32, place: u32) -> bool {
    if is_end_replayed(ray) {
        append_event(ray, EVENT_PATH_END, (number << 3u) | kind);
    }
    return false;
}

fn flush_path() {}

fn report_step(ray: Ray, primitive: u32) {
    if is_step_replayed(ray) {
        append_event(ray, EVENT_PATH_STEP, (primitive << 3u) | step_kind);
    }
}
