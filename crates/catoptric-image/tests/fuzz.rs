//! A short, deterministic run of the readers' fuzzer; the long one is `examples/fuzz_readers`.

#[path = "../examples/fuzz_readers/mutate.rs"]
mod mutate;

use mutate::{Outcome, Random};

#[test]
fn twenty_thousand_mutants_are_decoded_or_refused() {
    let seeds = mutate::seeds();
    let mut random = Random(20_261_121);
    let mut counts = [0; 3];
    for _ in 0..20_000 {
        counts[mutate::execute(&seeds, &mut random).1 as usize] += 1;
    }
    assert!(
        counts[Outcome::Decoded as usize] > 100 && counts[Outcome::Refused as usize] > 10_000,
        "{counts:?}"
    );
}
