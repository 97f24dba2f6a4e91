// A dispatch traces the rays of a list of ids (low word, high word). Some begin as rays that the host has uploaded. Twin
// of ids.listed.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LISTED_IDS) var<storage, read> listed_ids: array<vec2<u32>>;

// The ray's place in the dispatch, and among the uploaded rays.
var<private> place_in_dispatch: u32;

fn key_of(index: u32) -> RayKey {
    place_in_dispatch = index;
    let id = listed_ids[index];
    return key_of_id(id.x, id.y);
}
