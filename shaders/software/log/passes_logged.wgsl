// What rays leave on detectors in passing, written down beside where they end (software/log/ends_logged.wgsl): atomics in the loop
// over events would be paid for in each of them. Entries of a ray are range.log_stride apart: what it left in passing, in
// turn, and last its end. Twin of passes_booked.wgsl.

const END_PASSES: u32 = 0x20000000u;

var<private> num_passes: u32 = 0u;

fn log_pass(index: u32) {
    write_entry(entry_number(index), END_PASSES | end, end_weight, end_place);
    end = 0u;
    num_passes += 1u;
}

fn entry_number(index: u32) -> u32 {
    return num_passes * range.log_stride + index;
}

// What a ray takes with it into the queue.
fn passes_so_far() -> u32 {
    return num_passes;
}

fn go_on_after_passes(num: u32) {
    num_passes = num;
}
