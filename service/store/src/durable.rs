//! What a loss of power takes away again: a file's bytes are durable when it is synced, its name when its folder is.

use std::path::Path;

/// Makes the name of a file or folder durable.
///
/// # Errors
/// Where its folder cannot be opened or synced, nor the file system as a whole.
pub fn sync_name(file: &Path) -> std::io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let synced = std::fs::File::open(folder).and_then(|folder| folder.sync_all());
    // A folder that may be written and not listed cannot be opened, and some file systems know no folder that is durable by itself: with all
    // of its file system the name is durable too.
    #[cfg(target_os = "linux")]
    let synced = synced.or_else(|error| match error.kind() {
        std::io::ErrorKind::PermissionDenied
        | std::io::ErrorKind::InvalidInput
        | std::io::ErrorKind::Unsupported => Ok(rustix::fs::syncfs(std::fs::File::open(file)?)?),
        _ => Err(error),
    });
    synced
}
