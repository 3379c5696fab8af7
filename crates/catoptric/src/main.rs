//! The command line of Catoptric.

mod diff;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The complete two-pass renderer.
#[derive(Parser)]
#[command(name = "catoptric", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Compare images with references.
    Diff(diff::DiffArgs),
}

fn main() -> ExitCode {
    match Cli::parse().command {
        Command::Diff(args) => diff::run(&args),
    }
}
