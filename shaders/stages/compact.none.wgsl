// Every ray ends within one dispatch, so there is no queue. Twin of compact.on.wgsl.

fn compact(ray: Ray, alive: bool, local_index: u32) {}
