// The entry of a queue: the ray, and the triangle that the ray leaves.

struct QueuedRay {
    ray: PackedRay,
    triangle: u32,
}

fn queued(ray: Ray) -> QueuedRay {
    return QueuedRay(pack_ray(ray), arrived_triangle);
}

fn unqueued(q: QueuedRay) -> Ray {
    arrived_triangle = q.triangle;
    return unpack_ray(q.ray);
}
