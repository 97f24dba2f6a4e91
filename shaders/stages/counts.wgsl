// Counts of what a dispatch hands on: rays in the queues, rows for the host; and whether loops were cut (rounds.many.wgsl).

struct QueueCounts {
    incoming: atomic<u32>,
    outgoing: atomic<u32>,
    events: atomic<u32>,
    cut: atomic<u32>,
}

@group(1) @binding(0) var<storage, read_write> queue_counts: QueueCounts;
