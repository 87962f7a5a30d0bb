//! The command `memsavvy`, for tests to start.

use std::process::ExitCode;

fn main() -> ExitCode {
    memsavvy::command_line::main()
}
