// Per medium and wavelength: refractive index, and absorption 4 pi k / lambda [1/mm].
@group(0) @binding(5) var<storage, read> media: array<vec2<real>>;
