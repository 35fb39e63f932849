//! Files written: none destroys what was there before it is whole, and none is written where another file is read or written.

use std::borrow::Cow;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Links followed from one to the next.
const MAX_LINKS: usize = 40;
/// Names tried for a file that is not whole yet.
const MAX_NAMES: u32 = 100;

/// A file being written beside its place, as `.NAME.PROCESS.part`, and moved there once it is whole. Dropped before, it goes, and an older
/// file stays as it was; of a killed program it remains.
///
/// What is no regular file (`/dev/stdout`, a pipe) is written to directly.
#[derive(Debug)]
pub struct OutputFile {
    file: File,
    place: PathBuf,
    /// Where it is as long as it is not whole; `None` once it is in its place.
    part: Option<PathBuf>,
}

impl OutputFile {
    /// Begins a file. One that may not be overwritten is refused now.
    pub fn create(path: &Path) -> io::Result<Self> {
        let place = place(path);
        let old = match fs::metadata(path) {
            Ok(old) if !old.is_file() => return Self::in_place(path),
            Ok(old) => {
                OpenOptions::new().write(true).open(path)?;
                Some(old)
            }
            Err(_) => None,
        };
        let (file, part) = create_part(&place)?;
        let output = Self { file, place, part: Some(part) };
        if let Some(old) = old {
            output.file.set_permissions(old.permissions())?;
        }
        Ok(output)
    }

    /// Begins a file that grows while a program runs, and holds what there is should the program be killed: in its place where nothing is
    /// there to be lost, else beside it.
    pub fn record(path: &Path) -> io::Result<Self> {
        if fs::symlink_metadata(path).is_ok() { Self::create(path) } else { Self::in_place(path) }
    }

    /// Begins a file in its place, whatever is there: for records that are to be found there as far as they go.
    pub fn in_place(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::create(path)?, place: path.into(), part: None })
    }

    /// The file is whole: moves it to its place.
    pub fn commit(&mut self) -> io::Result<()> {
        if let Some(part) = &self.part {
            fs::rename(part, &self.place)?;
            self.part = None;
        }
        Ok(())
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for OutputFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if let Some(part) = &self.part {
            // Nobody is left to hear of an error.
            let _ = fs::remove_file(part);
        }
    }
}

/// Writes a whole file.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let mut output = OutputFile::create(path)?;
    output.write_all(bytes.as_ref())?;
    output.commit()
}

fn create_part(place: &Path) -> io::Result<(File, PathBuf)> {
    let name = place.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_string_lossy();
    for number in 0..MAX_NAMES {
        let number = if number == 0 { String::new() } else { format!(".{number}") };
        let part = place.with_file_name(format!(".{name}.{}{number}.part", std::process::id()));
        match OpenOptions::new().write(true).create_new(true).open(&part) {
            Ok(file) => return Ok((file, part)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Where a file is, or would be: links followed.
fn place(path: &Path) -> PathBuf {
    let mut path = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        let Ok(target) = fs::read_link(&path) else { break };
        path = path.parent().unwrap_or(Path::new("")).join(target);
    }
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (fs::canonicalize(parent), path.file_name()) {
        (Ok(parent), Some(name)) => parent.join(name),
        _ => path,
    }
}

/// A file with what it is to its user: `("--tum", path)`.
pub type Role<'a> = (&'a str, Cow<'a, Path>);

/// The same file for two roles.
#[derive(Debug, Error)]
#[error("{first} and {second} are the same file, {}: it would be destroyed; give another name", path.display())]
pub struct SameFile {
    first: String,
    second: String,
    path: PathBuf,
}

/// Refuses an output that is an input, or another output. Opens nothing.
pub fn check_roles(inputs: &[Role], outputs: &[Role]) -> Result<(), SameFile> {
    for (i, (role, path)) in outputs.iter().enumerate() {
        let Some(identity) = Identity::of(path) else { continue };
        let others = inputs.iter().chain(&outputs[..i]);
        if let Some((other, _)) = others.into_iter().find(|(_, other)| Identity::of(other).as_ref() == Some(&identity)) {
            return Err(SameFile { first: (*role).into(), second: (*other).into(), path: path.clone().into_owned() });
        }
    }
    Ok(())
}

/// What two names of one file have in common.
#[derive(PartialEq, Eq)]
enum Identity {
    /// Device and number of a file that is there.
    #[cfg(unix)]
    Number(u64, u64),
    Place(PathBuf),
}

impl Identity {
    /// `None` for what holds nothing that could be destroyed: devices, pipes, folders.
    fn of(path: &Path) -> Option<Self> {
        match fs::metadata(path) {
            Ok(metadata) if !metadata.is_file() => None,
            #[cfg(unix)]
            Ok(metadata) => {
                use std::os::unix::fs::MetadataExt;
                Some(Self::Number(metadata.dev(), metadata.ino()))
            }
            _ => Some(Self::Place(place(path))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_older_file_stays_until_the_new_one_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, "old").unwrap();
        let mut output = OutputFile::create(&path).unwrap();
        output.write_all(b"half").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        drop(output);
        assert_eq!((fs::read_to_string(&path).unwrap().as_str(), fs::read_dir(folder.path()).unwrap().count()), ("old", 1));
        write(&path, "new").unwrap();
        assert_eq!((fs::read_to_string(&path).unwrap().as_str(), fs::read_dir(folder.path()).unwrap().count()), ("new", 1));
        assert!(write(&folder.path().join("no/such"), "").is_err() && write(folder.path(), "").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_links_and_lead_to_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::os::unix::fs::symlink("a", path("link")).unwrap();
        let clash =
            |input: &str, output: &str| check_roles(&[("in", path(input).into())], &[("out", path(output).into())]).is_err();
        assert!(clash("a", "link") && clash("a", "./a") && clash("link", "a") && !clash("a", "b"));
        write(&path("link"), "1").unwrap();
        assert!(path("link").is_symlink() && fs::read_to_string(path("a")).unwrap() == "1");
        fs::hard_link(path("a"), path("hard")).unwrap();
        assert!(clash("a", "link") && clash("hard", "a") && clash("hard", "link"));
        let null = Path::new("/dev/null");
        assert!(check_roles(&[], &[("--tum", null.into()), ("--csv", null.into())]).is_ok());
        let (a, same) = (path("a"), path("./a"));
        let problem =
            check_roles(&[], &[("--tum", a.as_path().into()), ("--csv", same.as_path().into())]).unwrap_err().to_string();
        assert!(problem.contains("--csv and --tum are the same file"), "{problem}");
    }
}
