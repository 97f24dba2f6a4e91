// The weight after a segment, under the name that the loop calls. An addition to the plain loop may take the place of
// this file.

fn attenuated(ray: Ray, distance: real) -> real {
    return plain_attenuated(ray, distance);
}
