// Transforms between frames: global = rotation * local + origin. The rotation's columns x, y, z are the local axes.

struct Rotation {
    x: vec3<real>,
    y: vec3<real>,
    z: vec3<real>,
}

fn to_local(v: vec3<real>, r: Rotation) -> vec3<real> {
    return vec3<real>(dot(r.x, v), dot(r.y, v), dot(r.z, v));
}

fn to_global(v: vec3<real>, r: Rotation) -> vec3<real> {
    return v.x * r.x + v.y * r.y + v.z * r.z;
}
