//! Fuzzes the image readers with mutants of small files, the same ones for the same seed.
//!
//! ```text
//! (ulimit -v 4000000; cargo run --release -p catoptric-image --example fuzz_readers -- --executions 10000000)
//! ```
//!
//! A crash ends the process; `ulimit -v` turns a runaway allocation into one. An execution longer than two seconds is a
//! failure, and so is a panic that a decoder let out. `--seed N` gives other mutants, `--start N` resumes.

mod mutate;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use mutate::{Outcome, Random};

/// Mutants made from one random stream: any of them can be found again from its block and position.
const BLOCK: u64 = 1000;
const TIME_LIMIT: Duration = Duration::from_secs(2);

fn main() -> std::process::ExitCode {
    let executions = option("--executions", 1_000_000);
    let seed = option("--seed", 1);
    let next = AtomicU64::new(option("--start", 0) / BLOCK);
    // Caught panics are counted, not printed.
    std::panic::set_hook(Box::new(|_| {}));
    let seeds = mutate::seeds();
    let counts = [const { AtomicU64::new(0) }; 3];
    let slowest = Mutex::new(Duration::ZERO);
    let start = Instant::now();
    let workers = std::thread::available_parallelism().map_or(1, |n| n.get());
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                loop {
                    let block = next.fetch_add(1, Ordering::Relaxed);
                    if block * BLOCK >= executions {
                        return;
                    }
                    let mut random = Random(seed ^ (block << 20));
                    let mut longest = Duration::ZERO;
                    for _ in 0..BLOCK {
                        let began = Instant::now();
                        let (_, outcome) = mutate::execute(&seeds, &mut random);
                        longest = longest.max(began.elapsed());
                        counts[outcome as usize].fetch_add(1, Ordering::Relaxed);
                    }
                    let mut slowest = slowest.lock().expect("no worker panics");
                    *slowest = longest.max(*slowest);
                    if block % 100 == 99 {
                        let done = (block + 1) * BLOCK;
                        eprintln!(
                            "{done} executions, {:.0} s, slowest {:?}",
                            start.elapsed().as_secs_f64(),
                            *slowest
                        );
                    }
                }
            });
        }
    });
    let count = |outcome: Outcome| counts[outcome as usize].load(Ordering::Relaxed);
    let slowest = *slowest.lock().expect("no worker panics");
    println!(
        "{} decoded, {} refused, {} panics caught inside decoders; slowest {slowest:?}; {:.0} s",
        count(Outcome::Decoded),
        count(Outcome::Refused),
        count(Outcome::Caught),
        start.elapsed().as_secs_f64()
    );
    if slowest > TIME_LIMIT { std::process::ExitCode::FAILURE } else { std::process::ExitCode::SUCCESS }
}

fn option(name: &str, default: u64) -> u64 {
    let arguments: Vec<String> = std::env::args().collect();
    let given = arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1));
    given.map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} needs a number, not {text}")))
}
