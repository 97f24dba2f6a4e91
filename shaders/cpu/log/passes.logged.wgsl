// A ray logs what it leaves on detectors in passing, beside where it ends (ends.logged.wgsl). Atomics within the loop
// over events would cost time at each event. Twin of sums/passes.deposited.wgsl.
//
// Entries of one ray lie range.log_stride apart. First come the entries of its passes, in their order; the last is its
// end.

const END_PASSES: u32 = 0x20000000u;

var<private> num_passes: u32 = 0u;

fn log_pass(index: u32) {
    write_entry(entry_number(index), END_PASSES | end, end_weight, end_position);
    end = 0u;
    num_passes += 1u;
}

fn entry_number(index: u32) -> u32 {
    return num_passes * range.log_stride + index;
}

// The number of passes so far, which a ray keeps in the queue.
fn passes_so_far() -> u32 {
    return num_passes;
}

fn go_on_after_passes(num: u32) {
    num_passes = num;
}
