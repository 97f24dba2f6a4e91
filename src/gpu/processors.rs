//! The processors that the program may use.

/// How many there are, as the operating system tells at this moment; one where it does not tell.
pub fn count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
