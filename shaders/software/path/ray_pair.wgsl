// An invocation of trace_main_path follows two rays side by side, which lie as far apart as its workgroup is large. The stage
// itself is composed. Each step of a ray waits for the step before; a processor, which looks some hundred instructions
// ahead, meanwhile works on the other ray. A last ray without a neighbour is followed twice: it deposits nothing, and logs
// the same again.

fn first_of_pair(invocation: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    return ray_of(2u * (invocation - local) + local);
}

fn second_of_pair(invocation: u32, first: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    let second = ray_of(2u * (invocation - local) + WORKGROUP_SIZE + local);
    return select(first, second, second < range.count);
}
