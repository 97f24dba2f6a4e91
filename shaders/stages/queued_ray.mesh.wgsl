// The entry of a queue: the ray, and the triangle that the ray leaves.

struct RayInQueue {
    ray: PackedRay,
    triangle: u32,
}

fn plain_queued(ray: Ray) -> RayInQueue {
    return RayInQueue(pack_ray(ray), arrived_triangle);
}

fn plain_unqueued(q: RayInQueue) -> Ray {
    arrived_triangle = q.triangle;
    return unpack_ray(q.ray);
}
