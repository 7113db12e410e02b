//! The seed of a random run.

/// 1, or what the variable `DYNRT_SEED` says: a number, or `random` for another seed in every run. It is printed, so that a test that
/// fails shows it.
///
/// # Panics
/// `DYNRT_SEED` is neither.
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
