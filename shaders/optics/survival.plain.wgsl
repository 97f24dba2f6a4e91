// Russian roulette, under the name that the loop calls. An addition to the plain loop may take the place of this file.

fn roulette(ray: ptr<function, Ray>) {
    plain_roulette(ray);
}
