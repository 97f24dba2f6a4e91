// Runs between two dispatches: the rays that came out of the last dispatch become the input of the next.

struct QueueCounts {
    incoming: u32,
    outgoing: u32,
    events: u32,
    cut: u32,
}

@group(GROUP_BETWEEN) @binding(BINDING_COUNTS) var<storage, read_write> queue_counts: QueueCounts;
@group(GROUP_BETWEEN) @binding(BINDING_WORKGROUPS) var<storage, read_write> workgroups: array<u32, 3>;

override workgroup_size: u32 = 64u;

@compute @workgroup_size(1)
fn advance() {
    let alive = queue_counts.outgoing;
    queue_counts.incoming = alive;
    queue_counts.outgoing = 0u;
    workgroups[0] = (alive + workgroup_size - 1u) / workgroup_size;
    workgroups[1] = 1u;
    workgroups[2] = 1u;
}
