// The entry of a queue: the ray alone.

struct QueuedRay {
    ray: PackedRay,
}

fn queued(ray: Ray) -> QueuedRay {
    return QueuedRay(pack_ray(ray));
}

fn unqueued(q: QueuedRay) -> Ray {
    return unpack_ray(q.ray);
}
