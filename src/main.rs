//! The `nsq-gpu` command: hands over to [`nsq_gpu::cli`].

fn main() -> std::process::ExitCode {
    nsq_gpu::cli::main()
}
