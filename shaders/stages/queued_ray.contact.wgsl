// The entry of a queue: the ray, and the faces in its place that lie below the ray.

struct QueuedRay {
    ray: PackedRay,
    below_it: u32,
}

fn queued(ray: Ray) -> QueuedRay {
    return QueuedRay(pack_ray(ray), ray.below_it);
}

fn unqueued(q: QueuedRay) -> Ray {
    var ray = unpack_ray(q.ray);
    ray.below_it = q.below_it;
    return ray;
}
