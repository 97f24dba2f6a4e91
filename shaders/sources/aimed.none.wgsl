// No source has rays that are aimed. Twin of aimed.table.wgsl.

fn aimed_at(key: RayKey, e: Source, pupil: vec3<real>) -> LocalRay {
    return LocalRay(vec3<real>(0.0, 0.0, 0.0), vec3<real>(0.0, 0.0, 0.0));
}
