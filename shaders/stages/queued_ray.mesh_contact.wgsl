// The entry of a queue: the ray, the triangle that the ray leaves, and the faces in its place that lie below the ray.

struct QueuedRay {
    ray: PackedRay,
    triangle: u32,
    below_it: u32,
}

fn queued(ray: Ray) -> QueuedRay {
    return QueuedRay(pack_ray(ray), arrived_triangle, ray.below_it);
}

fn unqueued(q: QueuedRay) -> Ray {
    arrived_triangle = q.triangle;
    var ray = unpack_ray(q.ray);
    ray.below_it = q.below_it;
    return ray;
}
