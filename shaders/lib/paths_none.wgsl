// No paths are recorded.

fn record_birth(ray: Ray) {}
fn record_surface(ray: Ray, primitive: u32) {}
fn record_sensor(ray: Ray, sensor: u32) {}
fn record_death(ray: Ray) {}
