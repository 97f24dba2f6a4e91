//! The processors that the program may use.

/// The number of processors that the operating system grants at this moment; 1 if the number is unknown.
pub fn count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
