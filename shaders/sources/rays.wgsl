// Rays of a file. p0 = where the table begins (model::sources::rays).
//
// The wavelength comes first. Then one of its rays is drawn by its share of the light. An even draw takes a row, and a
// second draw takes that row or the row that it names. So draws are independent of each other, and all rays weigh the
// same. Source: A. J. Walker, ACM Transactions on Mathematical Software 3, 253 (1977): alias tables.

// Numbers of a ray: the share of the draws of its row that stay there, the row that has the others, position and direction.
const FILE_RAY_NUMBERS: u32 = 8u;

fn emit_rays(key: RayKey, e: Source) -> LocalRay {
    let first = u32(e.p0);
    let rays = first + u32(tables[first + draw_wavelength(key, e)]);
    let rows = rays + 1u;
    var row = rows + FILE_RAY_NUMBERS * row_of(draw_first(key, SOURCE_U1), u32(tables[rays]));
    if uniform_of(draw_first(key, SOURCE_U2)) >= tables[row] {
        row = rows + FILE_RAY_NUMBERS * u32(tables[row + 1u]);
    }
    return LocalRay(
        vec3<real>(tables[row + 2u], tables[row + 3u], tables[row + 4u]),
        vec3<real>(tables[row + 5u], tables[row + 6u], tables[row + 7u]),
    );
}

// floor(bits count / 2^32) of fewer than 2^20 rows, in parts that do not overflow.
fn row_of(bits: u32, count: u32) -> u32 {
    let low = ((bits & 255u) * count) >> 8u;
    let middle = (((bits >> 8u) & 4095u) * count + low) >> 12u;
    return ((bits >> 20u) * count + middle) >> 12u;
}
