//! The `surgtpgs` program; everything is in the library.

fn main() -> std::process::ExitCode {
    surgtpgs::cli::run(std::env::args_os()).into()
}
