//! Cleans up when the process is ended by a signal.
//!
//! A program calls [`listen`] once, at its start. From then on SIGINT, SIGTERM and SIGHUP end the programs started
//! through [`child`] and remove the files made by [`temporary`] before the process ends. On platforms other than Unix
//! nothing is installed.

use crate::{child, temporary};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Whether the process is about to end.
static ENDING: AtomicBool = AtomicBool::new(false);

/// Held while results are moved into place, and after an interrupt.
static PLACING: Mutex<()> = Mutex::new(());

/// Delays the handling of signals until the guard is dropped, so that files that belong together
/// are put in place together. The guard is not reentrant: a second call in the same thread blocks.
pub fn hold() -> MutexGuard<'static, ()> {
    PLACING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Blocks forever if the process is about to end after a signal; otherwise returns at once. Call it
/// before creating anything that would have to be removed.
pub fn stop_if_ending() {
    while ENDING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

/// Locks what the end of the process locks, too, before creating anything that would have to be removed. If the process is about to
/// end, it blocks forever, without the lock.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    lock_unless(&ENDING, mutex)
}

fn lock_unless<'m, T>(ending: &AtomicBool, mutex: &'m Mutex<T>) -> MutexGuard<'m, T> {
    let guard = mutex.lock().unwrap_or_else(PoisonError::into_inner);
    if ending.load(Ordering::SeqCst) {
        drop(guard);
        loop {
            std::thread::park();
        }
    }
    guard
}

/// Installs the handling of SIGINT, SIGTERM and SIGHUP: the supervised programs are ended,
/// everything temporary is removed, and the process ends as it would by default, with exit status
/// 130, 143 or 129 in a shell. A second signal ends the process at once. SIGHUP remains ignored if
/// it was ignored when the process started, as under `nohup`.
///
/// # Errors
/// The handler or its thread cannot be installed.
#[cfg(unix)]
pub fn listen() -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    use signal_hook::iterator::Signals;
    use std::sync::Arc;

    let mut wanted = vec![SIGINT, SIGTERM];
    // `nohup` ignores SIGHUP so that a command continues after its terminal is closed.
    if !is_ignored(SIGHUP) {
        wanted.push(SIGHUP);
    }
    let again = Arc::new(AtomicBool::new(false));
    for &signal in &wanted {
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&again))?;
    }
    let mut signals = Signals::new(&wanted)?;
    let wait = move || {
        if let Some(signal) = signals.forever().next() {
            again.store(true, Ordering::SeqCst);
            end();
            // Never returns, because all of these signals end a process.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
    };
    std::thread::Builder::new()
        .name("interrupt".into())
        .spawn(wait)
        .map(drop)
}

/// Does nothing on this platform. Files that an interrupted process leaves are removed by a later process: see
/// [`temporary`].
///
/// # Errors
/// None.
#[cfg(not(unix))]
pub fn listen() -> std::io::Result<()> {
    Ok(())
}

/// Whether the process was started with the signal ignored; `false` if that cannot be determined.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// Ends the started programs and removes temporary files. Other threads stop when they try to create one.
#[cfg(unix)]
fn end() {
    ENDING.store(true, Ordering::SeqCst);
    std::mem::forget(hold());
    child::end_all();
    temporary::remove_all();
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    /// The end of the process needs the lock.
    #[test]
    fn a_thread_that_waits_for_the_end_holds_no_lock() {
        static SHARED: Mutex<u32> = Mutex::new(0);
        for ending in [false, true] {
            let (sender, receiver) = channel();
            std::thread::spawn(move || {
                let guard = lock_unless(&AtomicBool::new(ending), &SHARED);
                drop(guard);
                let _ = sender.send(());
            });
            let went_on =
                receiver.recv_timeout(Duration::from_millis(if ending { 200 } else { 60_000 }));
            assert_eq!(
                went_on,
                if ending {
                    Err(RecvTimeoutError::Timeout)
                } else {
                    Ok(())
                }
            );
            assert!(SHARED.try_lock().is_ok());
        }
    }
}
