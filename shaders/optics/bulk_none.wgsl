// No medium of this scene absorbs.

fn attenuate(ray: ptr<function, Ray>, distance: real) {}
