// Lambertian: cosine-weighted over a hemisphere, whatever the incidence; its reflectance is taken from every ray.

fn sample_lambertian(s: Scattering, surface: Surface) -> Lobe {
    let n = lobe_normal(s, surface);
    return Lobe(cosine_weighted(s, n).direction, surface.lambertian);
}
