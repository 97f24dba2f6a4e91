// Per medium and wavelength: refractive index, and absorption 4 pi k / lambda [1/mm]. Where a scene is compiled in and has
// few, the composition writes medium_at with what they are.
@group(0) @binding(5) var<storage, read> media: array<vec2<real>>;

fn medium_at(index: u32) -> vec2<real> {
    return media[index];
}
