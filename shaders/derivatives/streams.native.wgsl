// Streams of draws, one step back. Twin of streams.portable.wgsl.

// The stream one step before. The factor is the inverse of stream_next's, modulo 2^64.
fn stream_before(stream: Stream) -> Stream {
    return Stream((stream.state - stream.increment) * 0xC097EF87329E28A5lu, stream.increment);
}
