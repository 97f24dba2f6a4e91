// A walk finds the group that waits at a level by its index. Trees that lie in an image and are not too deep have a
// composed twin, which selects among all levels.

fn waiting_at(walk: ptr<function, Walk>, place: u32) -> u32 {
    return (*walk).waiting[place];
}

fn wait_at(walk: ptr<function, Walk>, place: u32, group: u32) {
    (*walk).waiting[place] = group;
}
