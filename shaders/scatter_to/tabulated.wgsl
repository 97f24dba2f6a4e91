// How bsdfs/tabulated.wgsl draws a direction.

fn toward_tabulated(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward {
    let theta_i = degrees_of(abs(dot(s.incident, s.normal)));
    let theta_s = degrees_of(abs(dot(direction, s.normal)));
    return Toward(cosine_density(s, surface, direction), tabulated_value(theta_i, theta_s, surface));
}
