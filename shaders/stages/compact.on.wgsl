// Stage compact: packs the rays that are alive after a dispatch's events into a queue for the next dispatch. Twin of
// compact.none.wgsl.

struct PackedRay {
    position_x: real,
    position_y: real,
    position_z: real,
    direction_x: real,
    direction_y: real,
    direction_z: real,
    weight: real,
    index: u32,
    // The bounce count, in the low 20 bits. Above it: entries of the log so far (cpu/log/passes.logged.wgsl).
    bounce: u32,
    last: u32,
    // Wavelength in the low 16 bits, medium in the next 14, then forward and entered_solid.
    state: u32,
}

@group(GROUP_QUEUES) @binding(BINDING_QUEUE_IN) var<storage, read> queue_in: array<QueuedRay>;
@group(GROUP_QUEUES) @binding(BINDING_QUEUE_OUT) var<storage, read_write> queue_out: array<QueuedRay>;

var<workgroup> survivors: atomic<u32>;
var<workgroup> queue_base: u32;

fn unpack_ray(q: PackedRay) -> Ray {
    let key = key_of(q.index);
    let bounce = q.bounce & 0xfffffu;
    let jump = rng_table[bounce];
    go_on_after_passes(q.bounce >> 20u);
    return Ray(
        vec3<real>(q.position_x, q.position_y, q.position_z),
        vec3<real>(q.direction_x, q.direction_y, q.direction_z),
        q.weight, key, stream_at(key, FRESNEL_BRANCH, jump), stream_at(key, RR, jump), q.index, bounce, q.last,
        q.state & 0xffffu, (q.state >> 16u) & 0x3fffu, (q.state >> 31u) != 0u, ((q.state >> 30u) & 1u) != 0u, 0u, ALIVE,
    );
}

fn pack_ray(ray: Ray) -> PackedRay {
    let flags = (select(0u, 1u, ray.forward) << 30u) | (select(0u, 1u, ray.entered_solid) << 31u);
    let state = ray.wavelength | (ray.medium << 16u) | flags;
    let bounce = ray.bounce | (passes_so_far() << 20u);
    return PackedRay(
        ray.position.x, ray.position.y, ray.position.z, ray.direction.x, ray.direction.y, ray.direction.z,
        ray.weight, ray.index, bounce, ray.last, state,
    );
}

// Queues a ray that is alive, with one global atomic per workgroup. Every invocation must call it, because of the
// barriers.
fn compact(ray: Ray, alive: bool, local_index: u32) {
    var place = 0u;
    if alive {
        place = atomicAdd(&survivors, 1u);
    }
    workgroupBarrier();
    if local_index == 0u {
        queue_base = atomicAdd(&queue_counts.outgoing, atomicLoad(&survivors));
    }
    workgroupBarrier();
    if alive {
        queue_out[queue_base + place] = queued(ray);
    }
}

@compute @workgroup_size(WORKGROUP_SIZE)
fn trace_queued(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) local_index: u32,
) {
    begin();
    var ray: Ray;
    ray.fate = DETECTED;
    if id.x < atomicLoad(&queue_counts.incoming) {
        ray = unqueued(queue_in[id.x]);
        follow(&ray);
    }
    flush_bins();
    flush_reached();
    notice_cut_loops();
    compact(ray, ray.fate == ALIVE, local_index);
}
