// Specular: mirror reflection of the incident direction.

fn sample_specular(s: Scattering, surface: Surface) -> Lobe {
    return Lobe(mirrored(s.incident, s.normal), 1.0);
}
