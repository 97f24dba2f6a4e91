// Every ray ends within one dispatch: no queue.

fn compact(ray: Ray, alive: bool, local_index: u32) {}
