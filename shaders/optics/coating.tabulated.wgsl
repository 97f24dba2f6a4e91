// Coatings by the angle of incidence. A table has the reflectance R and the transmittance T for light from the front
// medium and from the back medium. Between two cosines of the table, both are linear in the cosine. Where R + T < 1,
// the rest is absorbed. Twin of coating.none.wgsl and coating.simple.wgsl.
//
// A table holds ascending cosines, then four columns for each wavelength: R and T from the front, R and T from the back
// (model::TabulatedCoating::numbers). The table of an uncoated surface has no cosines.

// R and T at a cosine between the ray's direction and the geometric normal, which is positive from the front.
struct Coating {
    reflectance: real,
    transmittance: real,
}

fn coating_of(surface: Surface, wavelength: u32, cosine: real) -> Coating {
    let count = surface.coating_cosines;
    let x = min(abs(cosine), 1.0);
    let i = interval_of(x, surface.coating_table, count);
    let knot = surface.coating_table + i;
    let u = position_in(x, knot);
    let from_back = select(2u, 0u, cosine > 0.0);
    let reflectance = knot + count * (1u + 4u * wavelength + from_back);
    let transmittance = reflectance + count;
    return Coating(
        (1.0 - u) * tables[reflectance] + u * tables[reflectance + 1u],
        (1.0 - u) * tables[transmittance] + u * tables[transmittance + 1u],
    );
}

fn mirror_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real) -> real {
    if surface.coating_cosines == 0u {
        return reflectance_of(surface, primitive, wavelength);
    }
    return coating_of(surface, wavelength, cosine).reflectance;
}

// What `coated_reflectance` found last, for `pay_coating` of the same event: the search takes as long as all else there.
var<private> found: Coating = Coating(0.0, 0.0);

fn coated_reflectance(surface: Surface, primitive: u32, wavelength: u32, cosine: real, bare: Share) -> Share {
    if surface.coating_cosines == 0u {
        return bare;
    }
    found = coating_of(surface, wavelength, cosine);
    return Share(found.reflectance, 1.0);
}

// The share 1 - R that is not reflected; `pay_coating` then takes from it what the coating absorbs.
fn coated_transmittance(surface: Surface, bare: real, reflectance: Share) -> real {
    return select(1.0 - quotient(reflectance), bare, surface.coating_cosines == 0u);
}

// A coating transmits T / (1 - R) of the light that it does not reflect. Where reflection is total, R + T remains. The
// sum is taken, because the table may step from transmission to total reflection between two cosines. A simple coating,
// which is a table of two equal columns here, takes nothing of what is totally reflected.
fn pay_coating(
    ray: ptr<function, Ray>, surface: Surface, primitive: u32, cosine: real, total_reflection: bool, reflects: bool,
) {
    if surface.coating_cosines == 0u || (reflects && !(total_reflection && surface.absorbs_totally_reflected != 0u)) {
        return;
    }
    let coating = found;
    let part = select(coating.transmittance, coating.reflectance + coating.transmittance, total_reflection);
    let whole = select(1.0 - coating.reflectance, 1.0, total_reflection);
    let before = (*ray).weight;
    // Where R is 1, nothing is transmitted. By rounding alone the quotient exceeds 1.
    let after = before * select(0.0, min(part / select(1.0, whole, whole > 0.0), 1.0), whole > 0.0);
    deposit_loss(CELL_COATING, before, after);
    (*ray).weight = after;
}
