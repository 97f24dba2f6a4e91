// The key of a path's sequence: three hashes of its parts. Twin of `SequenceKey` in model::sequence.

fn begin_key() {
    path[0] = 0x9E3779B9u;
    path[1] = 0x85EBCA6Bu;
    path[2] = 0xC2B2AE35u;
}

fn extend_key(kind: u32, number: u32) {
    let key = key_with(kind, number);
    path[0] = key.x;
    path[1] = key.y;
    path[2] = key.z;
}

// The key after one more part.
fn key_with(kind: u32, number: u32) -> vec3<u32> {
    let code = (number << 3u) | kind;
    let mixed = (vec3<u32>(path[0], path[1], path[2]) ^ vec3<u32>(code)) * vec3<u32>(0x2C1B3C6Du, 0x297A2D39u, 0xAC564B05u);
    return mixed ^ (mixed >> vec3<u32>(15u));
}

// The key of a whole sequence, as the table holds it: a word of 0 says that there is none.
fn ended_key(kind: u32, number: u32) -> vec3<u32> {
    return max(key_with(kind, number), vec3<u32>(1u));
}
