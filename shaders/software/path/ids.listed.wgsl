// The rays of a dispatch are those that the main path rejected: their ids, as low and high word. Twin of
// stages/ids.range.wgsl.
@group(0) @binding(22) var<storage, read> strays: array<vec2<u32>>;

fn key_of(index: u32) -> RayKey {
    let id = strays[index];
    return key_of_id(id.x, id.y);
}
