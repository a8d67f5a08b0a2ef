//! What differs between operating systems: Unix sockets, and the permissions of files.

pub(crate) use system::{accepts_at_socket, is_readable_by_others, make_private, set_permissions};

/// Whether processes connect by Unix sockets here.
pub(crate) const HAS_UNIX_SOCKETS: bool = cfg!(unix);

#[cfg(unix)]
mod system {
    use std::fs::{DirBuilder, Metadata, OpenOptions};
    use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
    use std::os::unix::net::UnixStream;

    /// Whether a process accepts connections at the path of a Unix socket.
    pub(crate) fn accepts_at_socket(path: &str) -> bool {
        UnixStream::connect(path).is_ok()
    }

    /// A new folder is for its owner only.
    pub(crate) fn make_private(folder: &mut DirBuilder) {
        folder.mode(0o700);
    }

    /// A new file has these permissions.
    pub(crate) fn set_permissions(file: &mut OpenOptions, mode: u32) {
        file.mode(mode);
    }

    /// Whether every user of the machine can use a file.
    pub(crate) fn is_readable_by_others(file: &Metadata) -> bool {
        file.permissions().mode() & 0o007 != 0
    }
}

/// Files inherit the permissions of their folder.
#[cfg(not(unix))]
mod system {
    use std::fs::{DirBuilder, Metadata, OpenOptions};

    pub(crate) fn accepts_at_socket(_: &str) -> bool {
        false
    }

    pub(crate) fn make_private(_: &mut DirBuilder) {}

    pub(crate) fn set_permissions(_: &mut OpenOptions, _: u32) {}

    pub(crate) fn is_readable_by_others(_: &Metadata) -> bool {
        false
    }
}
