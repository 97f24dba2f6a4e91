// Roulette decides by the weight, and the decision is detached.

fn roulette(ray: ptr<function, Ray>) {
    let before = (*ray).weight;
    roulette_of_value(ray);
    (*ray).weight = weight_of_branch(before, (*ray).weight, 1.0);
}
