// An invocation of trace_hot_path follows two rays side by side, one workgroup's size apart. The stage itself is
// composed.
//
// Each step of a ray waits for the step before. A processor looks some hundred instructions ahead, and meanwhile works
// on the other ray. A last ray without a neighbour is followed twice. The second time, the ray deposits nothing, and
// logs the same again.

fn first_of_pair(invocation: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    return 2u * (invocation - local) + local;
}

fn second_of_pair(invocation: u32, first: u32) -> u32 {
    let local = invocation % WORKGROUP_SIZE;
    let second = 2u * (invocation - local) + WORKGROUP_SIZE + local;
    return select(first, second, second < range.count);
}
