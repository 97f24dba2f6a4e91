// Rays of a file that the host has uploaded for this dispatch, a row a ray. p0 = where the rows begin
// (model::sources::rays).
//
// The host has drawn the rays, or taken them in their order. Nothing is drawn here.

// Numbers of a ray: the number of its wavelength or -1, position and direction.
const UPLOADED_RAY_NUMBERS: u32 = 7u;

fn emit_streamed_rays(key: RayKey, e: Source) -> LocalRay {
    let row = uploaded_row(e);
    return LocalRay(
        vec3<real>(tables[row + 1u], tables[row + 2u], tables[row + 3u]),
        vec3<real>(tables[row + 4u], tables[row + 5u], tables[row + 6u]),
    );
}

fn uploaded_row(e: Source) -> u32 {
    return u32(e.p0) + UPLOADED_RAY_NUMBERS * place_in_dispatch;
}
