// Russian roulette by the weight that a plain ray would have here. A guided ray on a rare path has a low weight, but is
// wanted.

fn roulette(ray: ptr<function, Ray>) {
    let before = (*ray).weight;
    let plain = before * real(PLAIN_SHARE + (1f - PLAIN_SHARE) * guide_ratio()) / real(share_followed_alone());
    if !(plain < ROULETTE_THRESHOLD && plain > 0.0) {
        return;
    }
    let survival = clamp(plain / ROULETTE_THRESHOLD, 0.05, 1.0);
    if below(stream_bits((*ray).roulette), survival) {
        (*ray).weight = before / survival;
        deposit_loss(CELL_ROULETTE_GAIN, (*ray).weight, before);
    } else {
        (*ray).fate = ROULETTE_KILLED;
    }
}
