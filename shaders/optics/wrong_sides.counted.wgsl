// Looks for solids whose faces do not agree on what is inside. Scenes without boundaries between media are traced
// without this file. Twin of wrong_sides.none.wgsl.
//
// A ray that passes a face from another medium than the one in front of that face is on the wrong side. Either that face
// is turned inside out, a solid before it is open, or the ray's source stands in a solid without the solid's medium. A
// ray that ends in a medium in which it was not born has left a solid by no face. Other ends mean nothing: an absorber may
// bound a solid, and other fates may come anywhere.

// True where a guard may still fail, and the ray is then traced anew (cpu/path/sides.guarded.wgsl). There it is not
// counted, and noted in `went_wrong`.
var<private> is_provisional: bool = false;
var<private> went_wrong: bool = false;

fn plain_leave_boundary(ray: ptr<function, Ray>, surface: Surface, entering_back: bool, reflects: bool) {
    let near = select(surface.back, surface.front, entering_back);
    let far = select(surface.front, surface.back, entering_back);
    if !reflects & ((*ray).medium != near) & (near != far) {
        if is_provisional {
            went_wrong = true;
        } else {
            count(COUNTER_ENTERED_TWICE + (*ray).last);
        }
    }
    pass_boundary(ray, surface, entering_back, reflects);
}

fn settle(ray: Ray) {
    let ends_anywhere = (ray.fate == DETECTED) | (ray.fate == ESCAPED);
    if ends_anywhere & (ray.medium != 0u) & (ray.last != NONE) {
        if ray.medium != source().medium {
            count(COUNTER_ENDED_INSIDE + ray.last);
        }
    }
    settle_end(ray);
}
