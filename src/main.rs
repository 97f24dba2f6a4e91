//! The `nsq-gpu` command: hands over to [`nsq_gpu::cli`].

fn main() -> std::process::ExitCode {
    // SAFETY: no other thread runs yet.
    #[allow(unsafe_code)]
    unsafe {
        nsq_gpu::cli::vectors::widen();
    }
    nsq_gpu::cli::main()
}
