// The entry of a queue: the ray with what it keeps elsewhere, and its path.

struct QueuedRay {
    ray: RayInQueue,
    path: array<u32, PATH_WORDS>,
}

fn queued(ray: Ray) -> QueuedRay {
    return QueuedRay(plain_queued(ray), path);
}

fn unqueued(q: QueuedRay) -> Ray {
    path = q.path;
    return plain_unqueued(q.ray);
}
