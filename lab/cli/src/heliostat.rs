//! The program `heliostat`, for the Python wheel: it packs the programs of one package.

use std::process::ExitCode;

fn main() -> ExitCode {
    heliostat::main()
}
