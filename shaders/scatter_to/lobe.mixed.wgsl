// Scatter to a target. Of the rays that scatter, a share goes towards each target of the surface, and the BSDF draws
// the others. A ray's weight is multiplied by the BSDF's density over the mixture's. So no expectation changes, and no
// weight is more than 1 / (1 - sum of shares) times a plain ray's. Densities are per solid angle [1/sr]. Source: Veach
// and Guibas, Optimally combining sampling techniques for Monte Carlo rendering (SIGGRAPH 1995), section 3: one-sample
// balance heuristic.

// The slot of the draw that chooses a target, after the slots of random/rng_slots.wgsl.
const SCATTER_TO: u32 = 12u;

// The table of a surface's targets has these numbers for each: the kind, the share, then three vectors. The first
// vector is a place relative to the surface's origin (model::scatter_sampling).
const TARGET_NUMBERS: u32 = 11u;
// A cone: its axis, and 1 - cos of half its angle.
const TARGET_CONE: real = 0.0;
// A sphere: its centre and its radius.
const TARGET_SPHERE: real = 1.0;
// A rectangle: its centre, and the ways to the middles of two sides. A disk: its centre and two radii.
const TARGET_RECTANGLE: real = 2.0;

// How a BSDF draws a direction: with which density, and which weight a ray then has.
struct Toward {
    density: real,
    weight: real,
}

fn plain_sample_bsdf(s: Scattering, surface: Surface) -> Lobe {
    if surface.num_targets == 0u {
        return bsdf_lobe(s, surface);
    }
    let point = s.position - vec3<real>(surface.origin_x, surface.origin_y, surface.origin_z);
    let chosen = chosen_target(s, surface);
    var lobe = Lobe(s.normal, 1.0);
    if chosen == NONE {
        lobe = bsdf_lobe(s, surface);
    } else {
        lobe.direction = drawn_towards(s, point, chosen);
    }
    // A direction that a BSDF draws, but that does not exist, has the weight 0 (bsdfs/shift_invariant.wgsl).
    if lobe.weight == 0.0 {
        return lobe;
    }
    let toward = bsdf_toward(s, surface, lobe.direction);
    var share: real = 1.0;
    var density: real = 0.0;
    for (var i = 0u; i < surface.num_targets; i++) {
        let row = surface.targets + i * TARGET_NUMBERS;
        share -= tables[row + 1u];
        density += tables[row + 1u] * density_towards(point, row, lobe.direction);
    }
    density += share * toward.density;
    lobe.weight = toward.weight * select(0.0, toward.density / density, toward.density > 0.0);
    return lobe;
}

// The density of cosine_weighted (stages/scattering.plain.wgsl), on either side.
fn cosine_density(s: Scattering, surface: Surface, direction: vec3<real>) -> real {
    let cosine = dot(direction, s.normal);
    let through = surface.transmissive_fraction;
    return select(1.0 - through, through, cosine < 0.0) * abs(cosine) * 0.3183098861837907;
}

// The row of the target that is drawn, or NONE.
fn chosen_target(s: Scattering, surface: Surface) -> u32 {
    let u = uniform_of(draw(s.key, SCATTER_TO, s.step));
    var chosen = NONE;
    var first: real = 0.0;
    for (var i = 0u; i < surface.num_targets; i++) {
        let row = surface.targets + i * TARGET_NUMBERS;
        let last = first + tables[row + 1u];
        chosen = select(chosen, row, u >= first && u < last);
        first = last;
    }
    return chosen;
}

fn target_vector(row: u32, number: u32) -> vec3<real> {
    let at = row + 2u + 3u * number;
    return vec3<real>(tables[at], tables[at + 1u], tables[at + 2u]);
}

// Directions about an axis, up to 1 - cos = `height`.
struct Cone {
    axis: vec3<real>,
    height: real,
}

// The cone in which a sphere is seen. From within, all directions lead to it.
fn cone_of_sphere(to: vec3<real>, radius: real) -> Cone {
    let distance_squared = dot(to, to);
    let sine_squared = radius * radius / distance_squared;
    if !(sine_squared < 1.0) {
        return Cone(vec3<real>(0.0, 0.0, 1.0), 2.0);
    }
    return Cone(to / sqrt(distance_squared), sine_squared / (1.0 + sqrt(1.0 - sine_squared)));
}

fn target_cone(point: vec3<real>, row: u32) -> Cone {
    let first = target_vector(row, 0u);
    let number = target_vector(row, 1u).x;
    if tables[row] == TARGET_CONE {
        return Cone(first, number);
    }
    return cone_of_sphere(first - point, number);
}

// A direction from a point towards a target. Directions are uniform over the solid angle of a cone or a sphere, and
// over the area of a rectangle or a disk.
fn drawn_towards(s: Scattering, point: vec3<real>, row: u32) -> vec3<real> {
    let turn = draw(s.key, BSDF_U1, s.step);
    let u = uniform_of(draw(s.key, BSDF_U2, s.step));
    if tables[row] <= TARGET_SPHERE {
        let cone = target_cone(point, row);
        let height = u * cone.height;
        let sine = sqrt(height * (2.0 - height));
        let cos_sin = sincos_turns(turn);
        let tangents = tangents_of(cone.axis);
        return renormalize(
            sine * cos_sin.x * tangents.t + sine * cos_sin.y * tangents.b + (1.0 - height) * cone.axis,
        );
    }
    var place = vec2<real>(2.0 * uniform_of(turn) - 1.0, 2.0 * u - 1.0);
    if tables[row] != TARGET_RECTANGLE {
        place = sqrt(u) * sincos_turns(turn);
    }
    let to = target_vector(row, 0u) - point + place.x * target_vector(row, 1u) + place.y * target_vector(row, 2u);
    return renormalize(to / sqrt(dot(to, to)));
}

// The density of drawn_towards in a direction.
fn density_towards(point: vec3<real>, row: u32, direction: vec3<real>) -> real {
    if tables[row] <= TARGET_SPHERE {
        let cone = target_cone(point, row);
        // 1 - cos, which keeps its digits near the axis.
        let off = direction - cone.axis;
        return select(0.0, 0.15915494309189535 / cone.height, 0.5 * dot(off, off) <= cone.height);
    }
    let u = target_vector(row, 1u);
    let v = target_vector(row, 2u);
    let area_normal = cross(u, v);
    let slant = dot(direction, area_normal);
    if slant == 0.0 {
        return 0.0;
    }
    let to = target_vector(row, 0u) - point;
    let distance = dot(to, area_normal) / slant;
    let off = distance * direction - to;
    let x = dot(off, u) / dot(u, u);
    let y = dot(off, v) / dot(v, v);
    let in_rectangle = max(abs(x), abs(y)) <= 1.0;
    let is_disk = tables[row] != TARGET_RECTANGLE;
    let within = (distance > 0.0) & select(in_rectangle, x * x + y * y <= 1.0, is_disk);
    // The area over |cos|: 4 or pi times |u| |v| |cos|.
    let area = choose(4.0, 3.141592653589793, is_disk) * abs(slant);
    return select(0.0, distance * distance / area, within);
}
