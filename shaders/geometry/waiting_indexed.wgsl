// What waits at a level of a walk, by its index. Of trees that lie in an image and are not too deep, it is chosen among all
// levels (composed).

fn waiting_at(walk: ptr<function, Walk>, place: u32) -> u32 {
    return (*walk).waiting[place];
}

fn wait_at(walk: ptr<function, Walk>, place: u32, group: u32) {
    (*walk).waiting[place] = group;
}
