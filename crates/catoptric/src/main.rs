//! The command line of Catoptric.

fn main() {}
