// Cells on 64-bit atomics: the low 64 bits in sums, and the carry out of them in tops. Twin of sums.portable.wgsl.
@group(GROUP_SCENE) @binding(BINDING_SUMS) var<storage, read_write> sums: array<atomic<u64>>;
@group(GROUP_SCENE) @binding(BINDING_TOPS) var<storage, read_write> tops: array<atomic<u32>>;

// Adds to a cell. The one deposit that wrapped a word takes its carry, so the total is exact once the dispatch has
// ended.
fn deposit(cell: u32, q: Quanta) {
    let low = u64(q.x) | (u64(q.y) << 32u);
    let old = atomicAdd(&sums[cell], low);
    let top = q.z + select(0u, 1u, old + low < old);
    if top != 0u {
        atomicAdd(&tops[cell], top);
    }
}
