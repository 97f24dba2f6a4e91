// No weight of this scene can fall below the threshold of roulette.

fn roulette(ray: ptr<function, Ray>) {}
