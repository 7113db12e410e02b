//! Temporary files and directories that do not outlive their use.
//!
//! They are removed when dropped. If the process is ended by a signal, [`interrupt`] removes those
//! that exist at that time. A process that is killed leaves them behind. Their names contain its process number;
//! the next process that creates something temporary in the same directory removes those without a running process.
//!
//! [`File`] and [`Folder::for_result`] are for results that must never be incomplete: they are created in the folder of
//! the result and then renamed.

use crate::interrupt;
use std::collections::BTreeSet;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, SystemTime};

/// The prefix of a result's name while it is written.
const RESULT: &str = ".dynrt-";

/// The prefix of folders that hold replaced files while a result is moved into place.
const REPLACED: &str = ".dynrt-old-";

/// The prefix of folders in the system's folder for temporary files.
const WORK: &str = "dynrt-";

/// Age after which a file is regarded as abandoned if its process cannot be checked.
const DAY: Duration = Duration::from_secs(24 * 3600);

/// The number of random characters that `tempfile` appends to a name.
const RANDOM: usize = 6;

/// The existing temporary files, to be removed on an interrupt.
static LIVE: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Folders that were created for a result that does not exist yet.
static PARENTS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// The folders in which this process has already removed abandoned files.
static SWEPT: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary directory. It is removed with its contents when dropped.
pub struct Folder {
    /// `None` after `keep`.
    inner: Option<tempfile::TempDir>,
}

impl Folder {
    /// Creates a directory for intermediate files in the system's directory for temporary files.
    /// Its name starts with `dynrt-`.
    ///
    /// # Errors
    /// The directory cannot be created.
    pub fn new() -> io::Result<Folder> {
        Folder::make(&std::env::temp_dir(), WORK, |_| ())
    }

    /// Creates a directory in `parent` that is going to be renamed to a result. Its permissions are
    /// those of any new directory; its name starts with `.dynrt-`.
    ///
    /// # Errors
    /// The directory cannot be created.
    pub fn for_result(parent: &Path) -> io::Result<Folder> {
        Folder::make(parent, RESULT, |builder| permit(builder, 0o777))
    }

    /// Creates a directory in `parent` for intermediate files. Its name starts with `prefix`.
    ///
    /// # Errors
    /// The directory cannot be created.
    pub fn named(parent: &Path, prefix: &str) -> io::Result<Folder> {
        Folder::make(parent, prefix, |_| ())
    }

    fn make(
        parent: &Path,
        prefix: &str,
        adjust: impl FnOnce(&mut tempfile::Builder<'_, '_>),
    ) -> io::Result<Folder> {
        sweep(parent, prefix);
        let prefix = format!("{prefix}{}", tag());
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).rand_bytes(RANDOM);
        adjust(&mut builder);
        let mut live = interrupt::lock(&LIVE);
        let inner = builder.tempdir_in(parent)?;
        live.insert(inner.path().to_path_buf());
        Ok(Folder { inner: Some(inner) })
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        let inner = self.inner.as_ref();
        inner.map_or(Path::new(""), |inner| inner.path())
    }

    /// Leaves the directory in place, even if it has been renamed in the meantime.
    pub fn keep(mut self) {
        if let Some(inner) = self.inner.take() {
            locked(&LIVE).remove(&inner.keep());
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if let Some(inner) = self.inner.take() {
            let path = inner.path().to_path_buf();
            drop(inner);
            locked(&LIVE).remove(&path);
        }
    }
}

/// Directories that were created to hold a result. Those that are empty are removed when dropped.
pub struct Parents(Vec<PathBuf>);

impl Parents {
    /// Creates a directory and its missing ancestors.
    ///
    /// # Errors
    /// One of them cannot be created; none is left then.
    pub fn make(folder: &Path) -> io::Result<Parents> {
        let is_missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
        let missing = folder.ancestors().take_while(is_missing);
        let parents = Parents(missing.map(Path::to_path_buf).collect());
        let mut made = interrupt::lock(&PARENTS);
        made.extend(parents.0.iter().cloned());
        drop(made);
        // On an error, dropping `parents` removes the folders created so far.
        fs::create_dir_all(folder)?;
        Ok(parents)
    }

    /// Leaves the directories in place.
    pub fn keep(mut self) {
        let mut made = locked(&PARENTS);
        for path in self.0.drain(..) {
            made.remove(&path);
        }
    }
}

impl Drop for Parents {
    fn drop(&mut self) {
        let mut made = locked(&PARENTS);
        // Deepest first.
        for path in self.0.drain(..) {
            let _ = fs::remove_dir(&path);
            made.remove(&path);
        }
    }
}

/// A temporary file that is going to be renamed to a result. It is removed when dropped.
pub struct File {
    inner: Option<tempfile::NamedTempFile>,
}

impl File {
    /// Creates a file in `folder` with the permissions of any new file. Its name starts with
    /// `.dynrt-`.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn new(folder: &Path) -> io::Result<File> {
        sweep(folder, RESULT);
        let prefix = format!("{RESULT}{}", tag());
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).rand_bytes(RANDOM);
        permit(&mut builder, 0o666);
        let mut live = interrupt::lock(&LIVE);
        let inner = builder.tempfile_in(folder)?;
        live.insert(inner.path().to_path_buf());
        Ok(File { inner: Some(inner) })
    }

    /// Returns the current path.
    pub fn path(&self) -> &Path {
        let inner = self.inner.as_ref();
        inner.map_or(Path::new(""), |inner| inner.path())
    }

    /// Renames the file to `place`, replacing a file of that name.
    ///
    /// # Errors
    /// The file cannot be renamed; it is removed then.
    pub fn persist(mut self, place: &Path) -> io::Result<()> {
        let Some(inner) = self.inner.take() else {
            return Ok(());
        };
        let path = inner.path().to_path_buf();
        let persisted = inner.persist(place);
        locked(&LIVE).remove(&path);
        persisted.map(drop).map_err(|error| error.error)
    }
}

impl Write for File {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.inner {
            Some(inner) => inner.write(bytes),
            None => Err(io::ErrorKind::NotFound.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for File {
    fn drop(&mut self) {
        if let Some(inner) = self.inner.take() {
            let path = inner.path().to_path_buf();
            drop(inner);
            locked(&LIVE).remove(&path);
        }
    }
}

/// Creates a directory in `parent` that holds the files a result replaces, under their names, while they are
/// being replaced. The caller must hold off signals ([`interrupt::hold`]) until it is dropped. If the process is
/// killed, the next one that creates something temporary in `parent` puts back the files that have not been
/// replaced.
///
/// # Errors
/// The directory cannot be created.
pub fn for_replaced(parent: &Path) -> io::Result<tempfile::TempDir> {
    let prefix = format!("{REPLACED}{}", tag());
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).rand_bytes(RANDOM);
    builder.tempdir_in(parent)
}

/// Gives a temporary file, which is private by default, the permissions of any new file. The process's file mode mask
/// applies.
fn permit(builder: &mut tempfile::Builder<'_, '_>, mode: u32) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = (builder, mode);
}

/// Removes everything temporary that exists. Nothing temporary can be created or removed afterwards: such calls
/// block. The function is meant for a process that is about to end.
pub fn remove_all() {
    let live = locked(&LIVE);
    for path in live.iter() {
        // Another thread may still write into the folder through files that it has opened.
        for _ in 0..50 {
            match remove(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    std::thread::sleep(Duration::from_millis(10));
                }
                _ => break,
            }
        }
    }
    std::mem::forget(live);
    let parents = locked(&PARENTS);
    // A parent precedes its children here, so remove in reverse order.
    for path in parents.iter().rev() {
        let _ = fs::remove_dir(path);
    }
    std::mem::forget(parents);
}

/// Removes a file, or a folder with its contents.
fn remove(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path)?.is_dir() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    }
}

/// The part of a name that identifies its process: the machine and the process number.
fn tag() -> String {
    format!("{}-{}-", machine(), std::process::id())
}

/// Eight digits that identify the scope of process numbers: the machine, its last start, and the container. All zero if that
/// cannot be determined.
fn machine() -> &'static str {
    static MACHINE: OnceLock<String> = OnceLock::new();
    MACHINE.get_or_init(|| {
        let started = fs::read("/proc/sys/kernel/random/boot_id");
        let names = fs::read_link("/proc/self/ns/pid");
        let (Ok(started), Ok(names)) = (started, names) else {
            return "0".repeat(8);
        };
        let mut hasher = DefaultHasher::new();
        (started, names).hash(&mut hasher);
        format!("{:08x}", hasher.finish() as u32)
    })
}

/// The meaning of a name after its prefix.
#[derive(Debug, PartialEq)]
enum Tag<'n> {
    /// The identification of the machine, and the process number.
    Process(&'n str, u32),
    /// No information, because an earlier version wrote the name.
    Old,
}

fn tag_of(rest: &str) -> Option<Tag<'_>> {
    let is_random =
        |text: &str| text.len() == RANDOM && text.bytes().all(|byte| byte.is_ascii_alphanumeric());
    let mut parts = rest.split('-');
    match (parts.next()?, parts.next(), parts.next(), parts.next()) {
        (random, None, ..) if is_random(random) => Some(Tag::Old),
        (machine, Some(process), Some(random), None) => {
            let is_hex = machine.len() == 8 && machine.bytes().all(|b| b.is_ascii_hexdigit());
            let process = process.parse().ok()?;
            (is_hex && is_random(random)).then_some(Tag::Process(machine, process))
        }
        _ => None,
    }
}

/// Whether a process runs on this machine; `None` if that cannot be determined.
fn is_running(process: u32) -> Option<bool> {
    #[cfg(unix)]
    {
        use rustix::io::Errno;
        use rustix::process::{Pid, test_kill_process};
        // A process that has ended but has not been waited for still exists, in state Z.
        let status = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        let state = status
            .rsplit(')')
            .next()
            .and_then(|rest| rest.trim_start().chars().next());
        let process = Pid::from_raw(i32::try_from(process).ok()?)?;
        Some(test_kill_process(process) != Err(Errno::SRCH) && !matches!(state, Some('Z' | 'X')))
    }
    #[cfg(not(unix))]
    {
        let _ = process;
        None
    }
}

/// Whether no process uses the file with this tag any longer.
fn is_abandoned(tag: &Tag<'_>, path: &Path) -> bool {
    if let Tag::Process(name, process) = tag
        && *name == machine()
        && name.bytes().any(|digit| digit != b'0')
        && let Some(is_running) = is_running(*process)
    {
        return !is_running;
    }
    let modified = fs::symlink_metadata(path).and_then(|data| data.modified());
    let age = modified
        .ok()
        .and_then(|modified| SystemTime::now().duration_since(modified).ok());
    age.is_some_and(|age| age > DAY)
}

/// Removes files with this prefix that killed processes have left in a folder; errors are ignored.
fn sweep(folder: &Path, prefix: &str) {
    let place = folder.canonicalize().unwrap_or_default().join(prefix);
    if !locked(&SWEPT).insert(place) {
        return;
    }
    sweep_now(folder, prefix);
}

fn sweep_now(folder: &Path, prefix: &str) {
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let Some(name) = name.to_str() else {
            continue;
        };
        if let (RESULT, Some(rest)) = (prefix, name.strip_prefix(REPLACED)) {
            if let Some(tag) = tag_of(rest)
                && is_abandoned(&tag, &entry.path())
            {
                put_back(folder, &entry.path());
            }
        } else if let Some(tag) = name.strip_prefix(prefix).and_then(tag_of)
            && is_abandoned(&tag, &entry.path())
            // Earlier versions kept files here that they could not put back.
            && !(tag == Tag::Old && entry.path().join("earlier").exists())
        {
            let _ = remove(&entry.path());
        }
    }
}

/// Puts back files that a killed process has set aside and not replaced, and removes the others.
fn put_back(folder: &Path, replaced: &Path) {
    let Ok(entries) = fs::read_dir(replaced) else {
        return;
    };
    for entry in entries.flatten() {
        let place = folder.join(entry.file_name());
        if fs::symlink_metadata(&place).is_err() && fs::rename(entry.path(), &place).is_err() {
            return;
        }
    }
    let _ = remove(replaced);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn what_is_dropped_vanishes_and_what_is_kept_stays() {
        let parent = tempfile::tempdir().unwrap();
        let folder = Folder::for_result(parent.path()).unwrap();
        fs::write(folder.path().join("a"), "1").unwrap();
        let file = File::new(parent.path()).unwrap();
        let live = [folder.path().to_path_buf(), file.path().to_path_buf()];
        assert!(live.iter().all(|path| locked(&LIVE).contains(path)));
        let name = folder.path().file_name().unwrap().to_str().unwrap();
        let tag = tag_of(name.strip_prefix(RESULT).unwrap());
        assert_eq!(tag, Some(Tag::Process(machine(), std::process::id())));
        drop((folder, file));
        assert_eq!(names(parent.path()), [""; 0]);
        let folder = Folder::for_result(parent.path()).unwrap();
        fs::rename(folder.path(), parent.path().join("kept")).unwrap();
        folder.keep();
        let mut file = File::new(parent.path()).unwrap();
        file.write_all(b"text").unwrap();
        file.persist(&parent.path().join("file")).unwrap();
        assert_eq!(names(parent.path()), ["file", "kept"]);
        assert!(live.iter().all(|path| !locked(&LIVE).contains(path)));
    }

    #[test]
    fn folders_made_for_a_result_vanish_without_it() {
        let parent = tempfile::tempdir().unwrap();
        let deep = parent.path().join("a/b/c");
        drop(Parents::make(&deep).unwrap());
        assert_eq!(names(parent.path()), [""; 0]);
        let parents = Parents::make(&deep).unwrap();
        fs::write(parent.path().join("a/b/mine"), "").unwrap();
        drop(parents);
        assert_eq!(names(&parent.path().join("a/b")), ["mine"]);
        Parents::make(&deep).unwrap().keep();
        drop(Parents::make(&deep).unwrap());
        assert!(deep.is_dir());
        assert!(Parents::make(&parent.path().join("a/b/mine/d/e")).is_err());
        assert_eq!(names(&parent.path().join("a/b")), ["c", "mine"]);
    }

    #[test]
    fn tags_are_told_from_other_names() {
        assert_eq!(
            tag_of("0123abcd-77-aB3dE6"),
            Some(Tag::Process("0123abcd", 77))
        );
        assert_eq!(tag_of("aB3dE6"), Some(Tag::Old));
        for other in ["", "notes.txt", "0123abcd-77", "0123abcd-x-aB3dE6", "aB3dE"] {
            assert_eq!(tag_of(other), None, "{other}");
        }
    }

    /// The number of a process that has ended.
    #[cfg(target_os = "linux")]
    fn process_that_is_over() -> u32 {
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let number = child.id();
        child.wait().unwrap();
        number
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_process_that_nobody_has_asked_about_is_over() {
        let mut child = std::process::Command::new("true").spawn().unwrap();
        while is_running(child.id()) == Some(true) {
            std::thread::yield_now();
        }
        // Until now it was a zombie.
        assert_eq!(
            child.try_wait().unwrap().map(|status| status.success()),
            Some(true)
        );
        assert_eq!(is_running(std::process::id()), Some(true));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_a_killed_process_has_left_is_removed_and_nothing_else() {
        let parent = tempfile::tempdir().unwrap();
        let at = |name: &str| parent.path().join(name);
        let (ours, over) = (machine(), process_that_is_over());
        let left = format!(".dynrt-{ours}-{over}-aaaaaa");
        let alive = format!(".dynrt-{ours}-{}-aaaaaa", std::process::id());
        let elsewhere = format!(".dynrt-ffffffff-{over}-aaaaaa");
        let old_elsewhere = format!(".dynrt-ffffffff-{over}-bbbbbb");
        let (old, new, kept) = (".dynrt-cccccc", ".dynrt-dddddd", ".dynrt-eeeeee");
        for name in [&left, &alive, &elsewhere, &old_elsewhere] {
            fs::create_dir_all(at(name).join("below")).unwrap();
        }
        for name in [old, new, "mine"] {
            fs::create_dir(at(name)).unwrap();
        }
        fs::create_dir_all(at(kept).join("earlier")).unwrap();
        fs::write(at(&format!(".dynrt-{ours}-{over}-ffffff")), "a file").unwrap();
        for name in [old, kept, old_elsewhere.as_str(), "mine"] {
            let two_days_ago = SystemTime::now() - 2 * DAY;
            let folder = fs::File::open(at(name)).unwrap();
            folder.set_modified(two_days_ago).unwrap();
        }
        sweep_now(parent.path(), RESULT);
        let mut expected = [&alive, &elsewhere, new, kept, "mine"];
        expected.sort_unstable();
        assert_eq!(names(parent.path()), expected);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_a_killed_process_was_about_to_replace_is_put_back() {
        let parent = tempfile::tempdir().unwrap();
        let at = |name: &str| parent.path().join(name);
        let aside = format!(".dynrt-old-{}-{}-", machine(), process_that_is_over());
        for (end, name) in [("aaaaaa", "lost"), ("bbbbbb", "replaced")] {
            let aside = at(&format!("{aside}{end}")).join(name);
            fs::create_dir_all(&aside).unwrap();
            fs::write(aside.join("text"), "earlier").unwrap();
        }
        fs::create_dir(at("replaced")).unwrap();
        sweep_now(parent.path(), RESULT);
        assert_eq!(names(parent.path()), ["lost", "replaced"]);
        assert_eq!(names(&at("lost")), ["text"]);
        assert_eq!(names(&at("replaced")), [""; 0]);
    }
}
