// Russian roulette for weights below the threshold. A ray survives with the probability clip(weight / threshold, 0.05,
// 1), and a survivor's weight is divided by that probability. The draw belongs to the bounce count after the event. A
// ray of weight 0 goes on unchanged.

fn plain_roulette(ray: ptr<function, Ray>) {
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
