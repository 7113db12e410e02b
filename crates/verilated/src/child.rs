//! Runs other programs such that they end with this process. See [`Supervised`].

use crate::interrupt;
use std::collections::BTreeSet;
use std::io;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The process groups of running programs; the program leads its group.
static RUNNING: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

fn running() -> MutexGuard<'static, BTreeSet<u32>> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs a program to its end, or until this process ends if that is earlier.
///
/// On Unix each program runs in a process group of its own, which [`interrupt`] ends as a whole.
pub trait Supervised {
    /// Runs the program with empty standard input and returns what it prints, as
    /// [`Command::output`].
    ///
    /// # Errors
    /// The program cannot be started, or its output cannot be read.
    fn supervised_output(&mut self) -> io::Result<Output>;

    /// Runs the program with the standard streams of this process, as [`Command::status`].
    ///
    /// # Errors
    /// The program cannot be started, or its status cannot be read.
    fn supervised_status(&mut self) -> io::Result<ExitStatus>;
}

impl Supervised for Command {
    fn supervised_output(&mut self) -> io::Result<Output> {
        self.stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        while_running(self, Child::wait_with_output)
    }

    fn supervised_status(&mut self) -> io::Result<ExitStatus> {
        while_running(self, |mut child| child.wait())
    }
}

fn while_running<T>(
    command: &mut Command,
    wait: impl FnOnce(Child) -> io::Result<T>,
) -> io::Result<T> {
    // In a group of its own, the processes that the program starts can be ended with it.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    let child = {
        let mut running = interrupt::lock(&RUNNING);
        let child = command.spawn()?;
        running.insert(child.id());
        child
    };
    let group = child.id();
    let ended = wait(child);
    running().remove(&group);
    ended
}

/// Ends all supervised programs and the programs that they have started: they get SIGTERM, and
/// SIGKILL after two seconds. No supervised program can be started afterwards; the function is
/// meant for a process that is about to end.
#[cfg(unix)]
pub fn end_all() {
    use rustix::process::{Pid, Signal, kill_process_group, test_kill_process_group};
    use std::time::{Duration, Instant};

    /// Time for a program to end after SIGTERM.
    const PATIENCE: Duration = Duration::from_secs(2);

    let running = running();
    let groups: Vec<Pid> = (running.iter())
        .filter_map(|&group| Pid::from_raw(i32::try_from(group).ok()?))
        .collect();
    std::mem::forget(running);
    let signal = |signal| {
        for &group in &groups {
            // An error means that the program has already ended.
            let _ = kill_process_group(group, signal);
        }
    };
    signal(Signal::TERM);
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until && groups.iter().any(|&g| test_kill_process_group(g).is_ok()) {
        std::thread::sleep(Duration::from_millis(5));
    }
    signal(Signal::KILL);
}
