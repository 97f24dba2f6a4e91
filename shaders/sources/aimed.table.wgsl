// What rays add to their start and their vector that are aimed at the stop: polynomials of the place in the pupil, by
// wavelength. Twin of aimed.none.wgsl.
//
// At p7 the buffer of tables has, for each wavelength, where its polynomials begin, counted from p7, or -1. These are four:
// of the start along x and y, and of the vector along x and y (model::sources::Aim::numbers).

fn aimed_at(key: RayKey, e: Source, pupil: vec3<real>) -> LocalRay {
    var aimed = LocalRay(vec3<real>(0.0, 0.0, 0.0), vec3<real>(0.0, 0.0, 0.0));
    if e.p7 < 0.0 {
        return aimed;
    }
    let first = u32(e.p7);
    let place = tables[first + draw_wavelength(key, e)];
    if place < 0.0 {
        return aimed;
    }
    var next = first + u32(place);
    aimed.position.x = polynomial_at(next, pupil);
    next = end_of_polynomial(next);
    aimed.position.y = polynomial_at(next, pupil);
    next = end_of_polynomial(next);
    aimed.direction.x = polynomial_at(next, pupil);
    next = end_of_polynomial(next);
    aimed.direction.y = polynomial_at(next, pupil);
    return aimed;
}

// A polynomial of x and y. The number of rows comes first, then the rows, from the highest power of x to the lowest. A
// row has the number of its coefficients, then these, from the highest power of y to the lowest.
fn polynomial_at(first: u32, p: vec3<real>) -> real {
    var sum = real(0.0);
    var at = first + 1u;
    var rows = u32(tables[first]);
    while rows > 0u {
        var row = real(0.0);
        let end = at + 1u + u32(tables[at]);
        at += 1u;
        while at < end {
            row = row * p.y + tables[at];
            at += 1u;
        }
        sum = sum * p.x + row;
        rows -= 1u;
    }
    return sum;
}

fn end_of_polynomial(first: u32) -> u32 {
    var at = first + 1u;
    var rows = u32(tables[first]);
    while rows > 0u {
        at += 1u + u32(tables[at]);
        rows -= 1u;
    }
    return at;
}
