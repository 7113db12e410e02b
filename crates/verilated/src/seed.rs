//! The seed of a test with random data.

/// Returns the seed for a test with random data: 1, or the value of the environment variable
/// `DYNRT_SEED`, which is an unsigned integer or `random` for a different seed in every run. The
/// seed is printed to standard output, so that a failing test shows it.
///
/// # Panics
/// If `DYNRT_SEED` is neither an unsigned integer nor `random`.
pub fn of_run() -> u64 {
    let seed = match std::env::var("DYNRT_SEED").as_deref() {
        Err(_) => 1,
        Ok("random") => fastrand::u64(..),
        Ok(text) => text.parse().unwrap_or_else(|_| {
            panic!("DYNRT_SEED={text} is neither an unsigned integer nor random")
        }),
    };
    println!("replay with DYNRT_SEED={seed}");
    seed
}
