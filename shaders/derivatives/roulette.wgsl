// Roulette decides by the weight, and the decision is detached. It leaves a weight of zero alone, which may have a derivative.

fn roulette(ray: ptr<function, Ray>) {
    let before = (*ray).weight;
    plain_roulette(ray);
    let after = (*ray).weight;
    (*ray).weight = attached(after, before * detached(select(after / select(before, 1.0, before == 0.0), 1.0, before == 0.0)));
}
