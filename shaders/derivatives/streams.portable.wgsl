// Streams of draws, one step back. Twin of streams.native.wgsl.

// The stream one step before. The factor is the inverse of stream_next's, modulo 2^64.
fn stream_before(stream: Stream) -> Stream {
    let negative = pair_add(~stream.increment, vec2<u32>(1u, 0u));
    let difference = pair_add(stream.state, negative);
    return Stream(pair_mul(difference, vec2<u32>(0x329E28A5u, 0xC097EF87u)), stream.increment);
}
