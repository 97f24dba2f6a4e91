// Takes the rays of a dispatch from a list of ids (low word, high word). Rays that failed a guard of the hot path stand
// in such a list, and so do rays whose paths are replayed. Twin of ids.range.wgsl.
@group(GROUP_SCENE) @binding(BINDING_LISTED_IDS) var<storage, read> listed_ids: array<vec2<u32>>;

fn key_of(index: u32) -> RayKey {
    let id = listed_ids[index];
    return key_of_id(id.x, id.y);
}
