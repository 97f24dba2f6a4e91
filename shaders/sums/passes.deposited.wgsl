// The device adds up what rays leave on detectors in passing. In the twin cpu/log/passes.logged.wgsl, the host
// does.

fn log_pass(index: u32) {}

fn entry_number(index: u32) -> u32 {
    return index;
}

fn passes_so_far() -> u32 {
    return 0u;
}

fn go_on_after_passes(num: u32) {}
