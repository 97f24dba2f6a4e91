// The search for the next hit, under the name that the loop calls. An addition to the plain loop may take the place of
// this file.

fn intersect(ray: Ray) -> Hit {
    return plain_intersect(ray);
}
