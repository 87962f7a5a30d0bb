//! The command `memsavvy`.

use std::process::ExitCode;

fn main() -> ExitCode {
    memsavvy::command_line::main()
}
