//! End-to-end tests of Catoptric live in `tests/`; this library holds what they share.
