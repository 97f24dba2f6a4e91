// Russian roulette below the threshold, drawn at the bounce count after the event; survival probability
// clip(weight / threshold, 0.05, 1), survivors boosted by its inverse. A ray of weight 0 is left alone.

fn roulette(ray: ptr<function, Ray>) {
    let before = (*ray).weight;
    if !(before < ROULETTE_THRESHOLD && before > 0.0) {
        return;
    }
    let survival = clamp(before / ROULETTE_THRESHOLD, 0.05, 1.0);
    if below(stream_bits((*ray).roulette), survival) {
        (*ray).weight = before / survival;
        deposit_loss(CELL_ROULETTE_GAIN, (*ray).weight, before);
    } else {
        (*ray).fate = ROULETTE_KILLED;
    }
}
