// No path is recorded. Twin of paths.recorded.wgsl.

fn record_birth(ray: Ray) {}
fn record_hit(ray: Ray, primitive: u32) {}
fn record_death(ray: Ray) {}
