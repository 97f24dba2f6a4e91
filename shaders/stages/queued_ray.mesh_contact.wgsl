// The entry of a queue: the ray, the triangle that the ray leaves, and the faces in its place that lie below the ray.

struct RayInQueue {
    ray: PackedRay,
    triangle: u32,
    below_it: u32,
}

fn plain_queued(ray: Ray) -> RayInQueue {
    return RayInQueue(pack_ray(ray), arrived_triangle, ray.below_it);
}

fn plain_unqueued(q: RayInQueue) -> Ray {
    arrived_triangle = q.triangle;
    var ray = unpack_ray(q.ray);
    ray.below_it = q.below_it;
    return ray;
}
