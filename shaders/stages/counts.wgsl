// Counts of what a dispatch hands on: rays in the queues, and rows for the host. The last word is not 0 if loops were
// cut short (loops.many.wgsl).

struct QueueCounts {
    incoming: atomic<u32>,
    outgoing: atomic<u32>,
    events: atomic<u32>,
    cut: atomic<u32>,
}

@group(GROUP_QUEUES) @binding(BINDING_QUEUE_COUNTS) var<storage, read_write> queue_counts: QueueCounts;
