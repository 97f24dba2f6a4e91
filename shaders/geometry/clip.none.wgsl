// No surface has an aperture that is no disk about the axis. Twin of clip.table.wgsl.

fn clip_holds(p: vec3<real>, first: real) -> bool {
    return true;
}
