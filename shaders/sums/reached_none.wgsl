// Which surfaces were reached: all absorb what they meet, so where rays have ended tells it. Twin of reached_mask.wgsl and
// reached_table.wgsl.

fn mark_reached(primitive: u32) {}

fn flush_reached() {}
