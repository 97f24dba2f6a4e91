// No two faces are in contact.

fn note_side(ray: ptr<function, Ray>, n: vec3<real>) {}
