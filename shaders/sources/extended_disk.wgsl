// Extended source: a disk. p0 = disk radius [mm], p2 = 1 - cos(half angle); a negative p2 means Lambertian.

fn emit_extended_disk(key: RayKey, e: Source) -> LocalRay {
    return LocalRay(disk_point(key, e.p0), extended_direction(key, e.p2));
}
