// Rays are those that strayed from the nominal path: their ids, low and high word.
@group(0) @binding(22) var<storage, read> strays: array<vec2<u32>>;

fn key_of(index: u32) -> RayKey {
    let id = strays[index];
    return key_of_id(id.x, id.y);
}
