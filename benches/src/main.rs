//! The `nsq-bench` command: hands over to [`nsq_bench::command`].

fn main() -> std::process::ExitCode {
    nsq_gpu::internals::main_of("nsq-bench", nsq_bench::command::run)
}
