// The rays of a dispatch are those that the main path rejected, as a list of ids (low word, high word). Twin of
// stages/ids.range.wgsl.
@group(GROUP_SCENE) @binding(BINDING_REJECTED) var<storage, read> rejected: array<vec2<u32>>;

fn key_of(index: u32) -> RayKey {
    let id = rejected[index];
    return key_of_id(id.x, id.y);
}
