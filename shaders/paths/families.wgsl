// Keeps the paths of rays that wait. A ray that was split waits as it arrived, before the event.

var<private> waiting_paths: array<array<u32, PATH_WORDS>, WAITING_RAYS>;

fn child(parent: Ray, weight: real) -> Ray {
    waiting_paths[num_waiting] = path;
    return plain_child(parent, weight);
}

fn restore_triangle(triangle: u32) {
    path = waiting_paths[num_waiting];
    plain_restore_triangle(triangle);
}
