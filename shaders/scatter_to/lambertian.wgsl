// How bsdfs/lambertian.wgsl draws a direction.

fn toward_lambertian(s: Scattering, surface: Surface, direction: vec3<real>) -> Toward {
    return Toward(cosine_density(s, surface, direction), surface.lambertian);
}
