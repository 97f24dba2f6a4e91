// No two faces are in contact. Twin of contact.on.wgsl.

fn leave_contact(ray: ptr<function, Ray>, distance: real) {}

fn note_side(ray: ptr<function, Ray>, n: vec3<real>, incoming: vec3<real>) {}

fn note_passing(ray: ptr<function, Ray>, detector: Detector) {}

alias Standing = u32;

fn standing(ray: Ray) -> Standing {
    return 0u;
}
