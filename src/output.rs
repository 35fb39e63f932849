//! Output files. An existing file is replaced only when the new one is complete, and no output may overwrite an input or another
//! output.

use std::borrow::Cow;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Maximum number of symbolic links followed.
const MAX_LINKS: usize = 40;
/// Maximum number of names tried for a temporary file.
const MAX_NAMES: u32 = 100;

/// A file that is written under a temporary name in the target folder, `.NAME.PROCESS.part`, and renamed when it is complete. If
/// it is dropped before, the temporary file is removed and an existing file stays unchanged. If the program is killed, the
/// temporary file remains.
///
/// Anything but a regular file (`/dev/stdout`, a pipe) is written to directly.
#[derive(Debug)]
pub struct OutputFile {
    file: File,
    target: PathBuf,
    /// The temporary file; `None` after it was renamed, or if the file is written in place.
    temporary: Option<PathBuf>,
}

impl OutputFile {
    /// Creates a file. Fails now if an existing file may not be overwritten.
    pub fn create(path: &Path) -> io::Result<Self> {
        let target = resolved(path);
        let old = match fs::metadata(path) {
            Ok(old) if !old.is_file() => return Self::create_in_place(path),
            Ok(old) => {
                OpenOptions::new().write(true).open(path)?;
                Some(old)
            }
            Err(_) => None,
        };
        let (file, temporary) = create_temporary(&target)?;
        let output = Self { file, target, temporary: Some(temporary) };
        if let Some(old) = old {
            output.file.set_permissions(old.permissions())?;
        }
        Ok(output)
    }

    /// Creates a file that grows while a program runs, and keeps what was written if the program is killed. It is written in
    /// place if no file exists there that could be lost, otherwise under a temporary name.
    pub fn create_growing(path: &Path) -> io::Result<Self> {
        if fs::symlink_metadata(path).is_ok() { Self::create(path) } else { Self::create_in_place(path) }
    }

    /// Creates a file in place, and overwrites an existing one: for recordings that must be usable as far as they were written.
    pub fn create_in_place(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::create(path)?, target: path.into(), temporary: None })
    }

    /// Completes the file: renames it to its final name.
    pub fn commit(&mut self) -> io::Result<()> {
        if let Some(temporary) = &self.temporary {
            fs::rename(temporary, &self.target)?;
            self.temporary = None;
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
        if let Some(temporary) = &self.temporary {
            // There is no one to report an error to.
            let _ = fs::remove_file(temporary);
        }
    }
}

/// Writes a complete file.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let mut output = OutputFile::create(path)?;
    output.write_all(bytes.as_ref())?;
    output.commit()
}

fn create_temporary(target: &Path) -> io::Result<(File, PathBuf)> {
    let name = target.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_string_lossy();
    for number in 0..MAX_NAMES {
        let number = if number == 0 { String::new() } else { format!(".{number}") };
        let temporary = target.with_file_name(format!(".{name}.{}{number}.part", std::process::id()));
        match OpenOptions::new().write(true).create_new(true).open(&temporary) {
            Ok(file) => return Ok((file, temporary)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// The path that a file has or would have, with symbolic links resolved.
fn resolved(path: &Path) -> PathBuf {
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

/// A file and how the user named it, such as `("--tum", path)`.
pub type NamedPath<'a> = (&'a str, Cow<'a, Path>);

/// Error: two names refer to the same file.
#[derive(Debug, Error)]
#[error("{first} and {second} are the same file, {}: it would be overwritten; choose another name", path.display())]
pub struct SameFile {
    first: String,
    second: String,
    path: PathBuf,
}

/// Fails if an output is also an input or another output. Opens no files.
pub fn check_no_overwrite(inputs: &[NamedPath], outputs: &[NamedPath]) -> Result<(), SameFile> {
    for (i, (name, path)) in outputs.iter().enumerate() {
        let Some(identity) = Identity::of(path) else { continue };
        let others = inputs.iter().chain(&outputs[..i]);
        if let Some((other, _)) = others.into_iter().find(|(_, other)| Identity::of(other).as_ref() == Some(&identity)) {
            return Err(SameFile { first: (*name).into(), second: (*other).into(), path: path.clone().into_owned() });
        }
    }
    Ok(())
}

/// Identity of a file, equal for different names of the same file.
#[derive(PartialEq, Eq)]
enum Identity {
    /// Device and inode number of an existing file.
    #[cfg(unix)]
    Inode(u64, u64),
    /// Path of a file that does not exist yet.
    Path(PathBuf),
}

impl Identity {
    /// `None` for devices, pipes and folders, which cannot be overwritten.
    fn of(path: &Path) -> Option<Self> {
        match fs::metadata(path) {
            Ok(metadata) if !metadata.is_file() => None,
            #[cfg(unix)]
            Ok(metadata) => {
                use std::os::unix::fs::MetadataExt;
                Some(Self::Inode(metadata.dev(), metadata.ino()))
            }
            _ => Some(Self::Path(resolved(path))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_file_is_kept_until_the_new_one_is_complete() {
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
    fn links_are_kept_and_count_as_the_same_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::os::unix::fs::symlink("a", path("link")).unwrap();
        let clash = |input: &str, output: &str| {
            check_no_overwrite(&[("in", path(input).into())], &[("out", path(output).into())]).is_err()
        };
        assert!(clash("a", "link") && clash("a", "./a") && clash("link", "a") && !clash("a", "b"));
        write(&path("link"), "1").unwrap();
        assert!(path("link").is_symlink() && fs::read_to_string(path("a")).unwrap() == "1");
        fs::hard_link(path("a"), path("hard")).unwrap();
        assert!(clash("a", "link") && clash("hard", "a") && clash("hard", "link"));
        let null = Path::new("/dev/null");
        assert!(check_no_overwrite(&[], &[("--tum", null.into()), ("--csv", null.into())]).is_ok());
        let (a, same) = (path("a"), path("./a"));
        let problem =
            check_no_overwrite(&[], &[("--tum", a.as_path().into()), ("--csv", same.as_path().into())]).unwrap_err().to_string();
        assert!(problem.contains("--csv and --tum are the same file"), "{problem}");
    }
}
