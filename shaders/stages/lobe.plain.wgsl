// The draw of a scattered direction, under the name that stages/scatter.on.wgsl calls. An addition to the plain loop may
// take the place of this file.

fn sample_bsdf(s: Scattering, surface: Surface) -> Lobe {
    return plain_sample_bsdf(s, surface);
}
