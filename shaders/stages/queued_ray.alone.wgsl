// The entry of a queue: the ray alone.

struct RayInQueue {
    ray: PackedRay,
}

fn plain_queued(ray: Ray) -> RayInQueue {
    return RayInQueue(pack_ray(ray));
}

fn plain_unqueued(q: RayInQueue) -> Ray {
    return unpack_ray(q.ray);
}
