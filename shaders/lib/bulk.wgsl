// Beer-Lambert over the segment: exp(-4 pi k L / lambda).

fn attenuate(ray: ptr<function, Ray>, distance: real) {
    let absorption = medium_at((*ray).medium, (*ray).wavelength).absorption;
    if absorption == 0.0 {
        return;
    }
    let before = (*ray).weight;
    (*ray).weight = before * exp_real(-absorption * distance);
    book_loss(CELL_BULK, before, (*ray).weight);
}
