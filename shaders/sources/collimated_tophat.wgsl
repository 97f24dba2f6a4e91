// Collimated source, uniform over a disk. p0 = disk radius [mm].

fn emit_collimated_tophat(key: RayKey, e: Source) -> LocalRay {
    return LocalRay(disk_point(key, e.p0), vec3<real>(0.0, 0.0, 1.0));
}
