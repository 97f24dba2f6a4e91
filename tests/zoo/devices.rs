//! Devices that the tests of a program share.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Lavapipe compiles most of a shader at its first dispatch, and a device dispatches one thing at a time: one device
/// leaves a processor idle. Each further one compiles what tests have in common once more.
const NUM_DEVICES: usize = 2;

/// Dealt out to threads, and so to tests, in turn; opened when first asked for.
pub struct Devices<T>([OnceLock<T>; NUM_DEVICES]);

static NEXT: AtomicUsize = AtomicUsize::new(0);
// Of devices of any kind, a thread has those of the same number.
thread_local!(static MINE: usize = NEXT.fetch_add(1, Ordering::Relaxed) % NUM_DEVICES);

impl<T> Devices<T> {
    pub const fn new() -> Self {
        Devices([const { OnceLock::new() }; NUM_DEVICES])
    }

    /// Those that are open.
    pub fn opened(&self) -> impl Iterator<Item = &T> {
        self.0.iter().filter_map(OnceLock::get)
    }

    /// The one of this thread, always the same.
    pub fn mine(&self, open: impl FnOnce() -> T) -> &T {
        self.0[MINE.with(|&mine| mine)].get_or_init(open)
    }
}
