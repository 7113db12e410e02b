//! The seed of random tests.

/// `DYNRT_SEED` where it is set, to replay a run, else another in every run. It is shown where the test fails.
pub fn seed() -> u64 {
    let seed = match std::env::var("DYNRT_SEED") {
        Ok(text) => text
            .parse()
            .unwrap_or_else(|_| panic!("DYNRT_SEED={text} is no unsigned integer")),
        Err(_) => fastrand::u64(..),
    };
    println!("replay with DYNRT_SEED={seed}");
    seed
}
