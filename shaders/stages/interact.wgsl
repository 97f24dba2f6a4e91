// Stage interact: the effect of a surface on a ray that has arrived on it.

// Interactions of a surface.
const ABSORBING: u32 = 0u;
const REFLECTIVE: u32 = 1u;
const REFRACTIVE: u32 = 2u;

fn plain_interact(ray: ptr<function, Ray>, surface: Surface, primitive: u32) {
    if surface.interaction == ABSORBING {
        (*ray).fate = ABSORBED;
        return;
    }
    let n = geometric_normal(surface, (*ray).position);
    let incoming = (*ray).direction;
    if HAS_REFLECTIVE && surface.interaction == REFLECTIVE {
        reflect_off(ray, surface, primitive, n);
    }
    if HAS_REFRACTIVE && surface.interaction == REFRACTIVE {
        refract_at(ray, surface, primitive, n);
    }
    scatter(ray, surface, n, incoming);
    note_side(ray, n, incoming);
}

// The unit normal of an analytic shape, from the front medium to the back medium. The normal is the gradient of the
// quadric.
fn normal_of_quadric(surface: Surface, position: vec3<real>) -> vec3<real> {
    let origin = vec3<real>(surface.origin_x, surface.origin_y, surface.origin_z);
    let p = to_surface(surface, position - origin);
    let slope = vec3<real>(surface.radial * p.x, surface.radial * p.y, surface.axial * p.z + surface.offset);
    // A plane's gradient is the same everywhere, and is known where the plane is compiled in.
    let is_plane = (surface.radial == 0.0) & (surface.axial == 0.0);
    let gradient = select(slope, vec3<real>(0.0, 0.0, surface.offset), is_plane);
    return from_surface(surface, unit_gradient(surface, gradient));
}

// A number between 0 and 1, kept as a quotient that is not yet computed.
struct Share {
    part: real,
    whole: real,
}

fn quotient(share: Share) -> real {
    return share.part / share.whole;
}

fn mirrored(d: vec3<real>, n: vec3<real>) -> vec3<real> {
    return renormalize(d - 2.0 * dot(d, n) * n);
}

fn reflect_off(ray: ptr<function, Ray>, surface: Surface, primitive: u32, n: vec3<real>) {
    let before = (*ray).weight;
    let after = before * mirror_reflectance(surface, primitive, (*ray).wavelength, dot((*ray).direction, n));
    deposit_loss(CELL_SURFACES + primitive, before, after);
    (*ray).weight = after;
    (*ray).direction = mirrored((*ray).direction, n);
}

// A smooth boundary of two media as a ray meets it, by Snell's and Fresnel's laws for unpolarised light.
struct Boundary {
    // The transmitted direction is `eta` times the ray's direction plus `along_normal` times the geometric normal.
    eta: real,
    along_normal: real,
    total_reflection: bool,
    // Reflectance and transmittance of the bare boundary, without a coating.
    reflectance: Share,
    transmittance: real,
}

// Reflects or refracts the ray. The direction against the geometric normal decides the side, and indices never do.
fn refract_at(ray: ptr<function, Ray>, surface: Surface, primitive: u32, n: vec3<real>) {
    let d = (*ray).direction;
    let cosine = dot(d, n);
    let entering_back = cosine > 0.0;
    let boundary = boundary_of(surface, (*ray).wavelength, cosine, entering_back);
    let reflects = reflects_at(ray, surface, primitive, cosine, boundary);
    (*ray).direction = select(transmitted(d, n, boundary), mirrored(d, n), reflects);
    pay_coating(ray, surface, primitive, cosine, boundary.total_reflection, reflects);
    leave_boundary(ray, surface, entering_back, reflects);
}

// The boundary at a cosine between the ray's direction and the geometric normal.
fn boundary_of(surface: Surface, wavelength: u32, cosine: real, entering_back: bool) -> Boundary {
    let indices = indices_of(surface, wavelength);
    let n1 = select(indices.y, indices.x, entering_back);
    let n2 = select(indices.x, indices.y, entering_back);
    // Both quotients are computed before the side is known: a division takes long, and later steps wait for the side.
    let eta = select(indices.y / indices.x, indices.x / indices.y, entering_back);
    let cos_i = abs(cosine);
    // 1 - eta^2 (1 - cos_i^2), in a form that keeps its digits at grazing incidence, whatever the indices.
    let cos_t_squared = (1.0 - eta) * (1.0 + eta) + (eta * cos_i) * (eta * cos_i);
    let total_reflection = cos_t_squared < 0.0;
    // Where cos_t_squared is negative, there is no transmitted wave, and nothing below is used.
    let cos_t = sqrt(abs(cos_t_squared));
    let sum_s = n1 * cos_i + n2 * cos_t;
    let sum_p = n2 * cos_i + n1 * cos_t;
    // (r_s^2 + r_p^2) / 2, over one denominator: a division takes long, and a draw needs no division.
    let part_s = (n1 * cos_i - n2 * cos_t) * sum_p;
    let part_p = (n2 * cos_i - n1 * cos_t) * sum_s;
    let reflectance = Share(0.5 * (part_s * part_s + part_p * part_p), (sum_s * sum_p) * (sum_s * sum_p));
    // Computed without 1 - R, which cancels near grazing incidence and near the critical angle.
    let product = 2.0 * (n1 * cos_i) * (n2 * cos_t);
    let transmittance = product / (sum_s * sum_s) + product / (sum_p * sum_p);
    let against_normal = eta * cos_i - cos_t;
    let along_normal = select(against_normal, -against_normal, entering_back);
    return Boundary(eta, along_normal, total_reflection, reflectance, transmittance);
}

fn reflects_at(
    ray: ptr<function, Ray>, surface: Surface, primitive: u32, cosine: real, boundary: Boundary,
) -> bool {
    let total_reflection = boundary.total_reflection;
    let coated = coated_reflectance(surface, primitive, (*ray).wavelength, cosine, boundary.reflectance);
    // In total reflection there is no transmitted wave, and a coating does not change that. What the coating absorbs of
    // the reflected wave, `pay_coating` takes.
    let reflectance = Share(select(coated.part, 1.0, total_reflection), select(coated.whole, 1.0, total_reflection));
    let transmittance = coated_transmittance(surface, boundary.transmittance, coated);
    let bits = stream_bits((*ray).fresnel);
    return draw_reflection(ray, bits, reflectance, transmittance, total_reflection);
}

fn transmitted(d: vec3<real>, n: vec3<real>, boundary: Boundary) -> vec3<real> {
    return renormalize(boundary.eta * d + boundary.along_normal * n);
}

// Sets the medium that the ray is in after the event. The medium is read from the surface, because the ray's own record
// may be wrong: a ray can leave an open solid unnoticed.
fn pass_boundary(ray: ptr<function, Ray>, surface: Surface, entering_back: bool, reflects: bool) {
    let medium = select(surface.front, surface.back, entering_back != reflects);
    (*ray).medium = medium;
    if !reflects {
        track_solids(ray, medium == 0u);
    }
}

// Counts rays that enter vacuum without having entered a solid. Such a ray shows a defect of the geometry, or was born
// in glass.
fn track_solids(ray: ptr<function, Ray>, ambient: bool) {
    if ambient && !(*ray).entered_solid {
        add_to_bin(CELL_UNDERFLOWS, NO_QUANTA);
    }
    (*ray).entered_solid = !ambient;
}
