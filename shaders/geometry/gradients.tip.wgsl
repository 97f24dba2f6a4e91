// The gradient of a quadric as a normal, where the tip of a cone belongs to a surface. Twin of gradients.smooth.wgsl.
//
// The gradient is zero at a tip, where any direction of the half space outside would do. The normal there is the axis,
// in the outward direction given by `tip`.

fn unit_gradient(surface: Surface, gradient: vec3<real>) -> vec3<real> {
    let square = dot(gradient, gradient);
    if square == 0.0 {
        return vec3<real>(0.0, 0.0, surface.tip);
    }
    return gradient / sqrt(square);
}
