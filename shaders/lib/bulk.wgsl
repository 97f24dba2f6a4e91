// Beer-Lambert over the segment: exp(-4 pi k L / lambda). The media table holds 4 pi k / lambda per mm.

fn attenuate(ray: ptr<function, Ray>, distance: real) {
    let absorption = medium_at((*ray).medium * NUM_WAVELENGTHS + (*ray).wavelength).y;
    let before = (*ray).weight;
    (*ray).weight = before * exp_real(-absorption * distance);
    book_loss(CELL_BULK, before, (*ray).weight);
}
