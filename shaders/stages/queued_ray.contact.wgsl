// The entry of a queue: the ray, and the faces in its place that lie below the ray.

struct RayInQueue {
    ray: PackedRay,
    below_it: u32,
}

fn plain_queued(ray: Ray) -> RayInQueue {
    return RayInQueue(pack_ray(ray), ray.below_it);
}

fn plain_unqueued(q: RayInQueue) -> Ray {
    var ray = unpack_ray(q.ray);
    ray.below_it = q.below_it;
    return ray;
}
