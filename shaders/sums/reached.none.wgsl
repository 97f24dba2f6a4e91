// No marks are needed: every surface absorbs what it meets, so the places where rays ended are those that were reached.
// Twin of reached.bits.wgsl and reached.counters.wgsl.

fn mark_reached(primitive: u32) {}

fn flush_reached() {}
