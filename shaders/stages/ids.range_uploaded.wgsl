// A dispatch traces the rays of its range. Some begin as rays that the host has uploaded. Twin of stages/ids.range.wgsl.

// The ray's place in the dispatch, and among the uploaded rays.
var<private> place_in_dispatch: u32;

fn key_of(index: u32) -> RayKey {
    place_in_dispatch = index;
    return key_in_range(index);
}
