// No medium of this scene absorbs. Twin of bulk.on.wgsl.

fn attenuate(ray: ptr<function, Ray>, distance: real) {}
