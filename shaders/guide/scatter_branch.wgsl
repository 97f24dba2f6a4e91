// Scattering is drawn with the probability that the guide has for it, mixed with the surface's own. Twin of
// stages/scatter_branch.plain.wgsl.

fn draw_scattering(ray: ptr<function, Ray>, surface: Surface, bits: u32) -> bool {
    let scatters = surface.scatter_fraction;
    let passes = 1.0 - scatters;
    let has_branches = HAS_REFRACTIVE && surface.interaction == REFRACTIVE;
    let may = scattering_that_may_match((*ray).last, !has_branches || branch_reflects);
    if may.x != may.y {
        follow_alone(ray, select(passes, scatters, may.x));
        return may.x;
    }
    var wanted = scattering_of_branch;
    if !has_branches {
        wanted = guide_choice(path[GUIDE_NODE], (*ray).last).scatter;
    }
    let is_plain = wanted < 0f;
    let guided = select(vec2<f32>(wanted, 1f - wanted), vec2<f32>(f32(scatters), f32(passes)), is_plain);
    return draw_guided(ray, bits, scatters, passes, guided, is_plain);
}
