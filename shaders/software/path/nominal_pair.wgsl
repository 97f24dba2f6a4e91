// An invocation of trace_nominal follows two rays side by side (composed), which lie as far apart as its workgroup is large. What a
// ray does next waits for what it has done; a processor, which looks some hundred instructions ahead, works on the other
// one meanwhile. Where the last ray has no neighbour, it is followed twice: it books nothing, and logs the same again.

fn first_of_pair(invocation: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    return ray_of(2u * (invocation - local) + local);
}

fn second_of_pair(invocation: u32, first: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    let second = ray_of(2u * (invocation - local) + WORKGROUP_SIZE + local);
    return select(first, second, second < range.count);
}
