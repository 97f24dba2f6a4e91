// The entry of a queue is the ray. An addition that keeps something beside the ray takes the place of this file
// (shaders/paths/queued.wgsl).

alias QueuedRay = RayInQueue;

fn queued(ray: Ray) -> QueuedRay {
    return plain_queued(ray);
}

fn unqueued(q: QueuedRay) -> Ray {
    return plain_unqueued(q);
}
