//! The command line of Catoptric.

mod args;
mod diff;
mod estimate;
mod failure;
mod form_factors;
mod info;
mod input;
mod interrupt;
mod memory;
mod npz;
mod output;
mod pass_one;
mod progress;
mod render;
mod report;
mod solve;
mod summary;
mod value;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use args::{Cli, Command, RunArgs};
use failure::Failure;

fn main() -> ExitCode {
    let cli = Cli::parse();
    interrupt::install();
    failure::guard(|| match run(&cli.command) {
        Ok(code) => code,
        Err(failure) => {
            failure::tell(format_args!("error: {failure}"));
            ExitCode::from(failure.exit_code())
        }
    })
}

fn run(command: &Command) -> Result<ExitCode, Failure> {
    match command {
        Command::Render(args) => in_threads(&args.run, || render::run(args))?,
        Command::Solve(args) => in_threads(&args.run, || solve::run(args))?,
        Command::FormFactors(args) => in_threads(&args.run, || form_factors::run(args))?,
        Command::Info(args) => info::run(args)?,
        Command::Diff(args) => return Ok(diff::run(args)),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "catoptric", &mut script);
            report::print(&String::from_utf8_lossy(&script))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Does something in as many threads as were asked for, else in one per processor.
fn in_threads(args: &RunArgs, work: impl FnOnce() -> Result<(), Failure> + Send) -> Result<(), Failure> {
    let threads = args.threads.map_or(0, usize::from);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(|error| {
        Failure::run(format_args!("cannot start the threads: {error}"), "try fewer: --threads 1")
    })?;
    // All of it, what is serial too: were there one thread more than processors, the others would wake up two to a processor.
    rayon::scope(|_| work())
}
