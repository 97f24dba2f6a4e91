// Marks nothing: all surfaces absorb what they meet, so where rays have ended tells which were reached. Twin of
// reached.bits.wgsl and reached.counters.wgsl.

fn mark_reached(primitive: u32) {}

fn flush_reached() {}
