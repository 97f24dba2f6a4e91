// No two faces are in contact.

fn note_side(ray: ptr<function, Ray>, n: vec3<real>) {}

alias Standing = u32;

fn standing(ray: Ray) -> Standing {
    return 0u;
}
