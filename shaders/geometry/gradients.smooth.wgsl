// The gradient of a quadric as a normal, where no gradient is zero. Twin of gradients.tip.wgsl.

fn unit_gradient(surface: Surface, gradient: vec3<real>) -> vec3<real> {
    if UNIT_GRADIENTS {
        return renormalize(gradient);
    }
    return gradient / sqrt(dot(gradient, gradient));
}
