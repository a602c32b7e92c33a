//! Bytes that go to a disk as they are: in whole blocks, from an address that is a multiple of a block.
//!
//! The system copies other writes into its own pages first, and writes those when it is asked to sync: for a record of one
//! cycle that is a third of the time that its poster waits for the disk.

use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes of a block. Disks ask for 512 or for this.
pub(super) const BLOCK: usize = 4096;

/// The next multiple of a block.
pub(super) const fn up(bytes: u64) -> u64 {
    bytes.next_multiple_of(BLOCK as u64)
}

/// Bytes that grow, and begin at such an address.
#[derive(Debug)]
pub(super) struct Blocks {
    /// With room for whole blocks from `begins` on; what is behind `length` is of no meaning.
    memory: Vec<u8>,
    begins: usize,
    length: usize,
}

impl Blocks {
    /// Of so many bytes, zeros, with room for more. Memory that is not written to takes none of the system's.
    pub(super) fn of(length: usize, room: usize) -> Self {
        let mut blocks = Self { memory: Vec::new(), begins: 0, length: 0 };
        blocks.make_room(length.max(room));
        blocks.length = length;
        blocks
    }

    pub(super) const fn len(&self) -> usize {
        self.length
    }

    /// Keeps the first bytes alone.
    pub(super) fn truncate(&mut self, length: usize) {
        self.length = self.length.min(length);
    }

    /// Gives memory back beyond so many bytes.
    pub(super) fn shrink_to(&mut self, bytes: usize) {
        if self.memory.len() > bytes.max(self.length) + 2 * BLOCK {
            self.make_room(bytes.max(self.length));
        }
    }

    pub(super) fn push(&mut self, byte: u8) {
        self.extend_from_slice(&[byte]);
    }

    pub(super) fn extend_from_slice(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        if self.begins + end.next_multiple_of(BLOCK) > self.memory.len() {
            self.make_room(end.max(2 * self.length));
        }
        self.memory[self.begins + self.length..self.begins + end].copy_from_slice(bytes);
        self.length = end;
    }

    pub(super) fn as_slice(&self) -> &[u8] {
        &self.memory[self.begins..self.begins + self.length]
    }

    pub(super) fn as_mut_slice(&mut self) -> &mut [u8] {
        &mut self.memory[self.begins..self.begins + self.length]
    }

    /// The bytes, and zeros up to the end of the last block.
    pub(super) fn whole_blocks(&mut self) -> &[u8] {
        let end = self.begins + self.length.next_multiple_of(BLOCK);
        self.memory[self.begins + self.length..end].fill(0);
        &self.memory[self.begins..end]
    }

    /// Moves to memory that has room for the blocks of so many bytes.
    fn make_room(&mut self, bytes: usize) {
        // One more, of which the blocks do not begin at the first byte.
        let memory = vec![0; bytes.next_multiple_of(BLOCK) + BLOCK];
        // Where no such address is told, a disk that asks for one refuses what is written.
        let begins = memory.as_ptr().align_offset(BLOCK).min(BLOCK);
        let before = std::mem::replace(self, Self { memory, begins, length: self.length });
        self.as_mut_slice().copy_from_slice(before.as_slice());
    }
}

/// The same file once more, for writes that the system does not copy; `None` where the system, or the file system, has none.
/// `first` is the first block as it stands there, which is written to find out.
pub(super) fn opened(path: &Path, file: &File, first: &[u8]) -> Option<File> {
    let direct = open(path).ok()?;
    let mut block = Blocks::of(0, BLOCK);
    block.extend_from_slice(first);
    let tried = is_same(file, &direct).and_then(|same| match same {
        true => super::write_at(&direct, block.whole_blocks(), 0).and_then(|()| direct.sync_data()),
        false => Err(io::ErrorKind::NotFound.into()),
    });
    tried.is_ok().then_some(direct)
}

#[cfg(target_os = "linux")]
fn open(path: &Path) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt;
    let flag = i32::try_from(rustix::fs::OFlags::DIRECT.bits()).map_err(io::Error::other)?;
    File::options().write(true).custom_flags(flag).open(path)
}

#[cfg(not(target_os = "linux"))]
fn open(_: &Path) -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(unix)]
fn is_same(one: &File, other: &File) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    let name = |file: &File| file.metadata().map(|of| (of.dev(), of.ino()));
    Ok(name(one)? == name(other)?)
}

#[cfg(not(unix))]
fn is_same(_: &File, _: &File) -> io::Result<bool> {
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// As a vector of bytes, whatever is done to it.
        #[test]
        fn bytes_grow_and_begin_where_a_block_does(
            steps in prop::collection::vec((0_u8..5, 0_usize..20_000), 0..30)
        ) {
            let (mut blocks, mut plain) = (Blocks::of(3, 0), vec![0; 3]);
            for (step, size) in steps {
                match step {
                    0 => {
                        blocks.truncate(size);
                        plain.truncate(size);
                    }
                    1 => blocks.shrink_to(size),
                    2 => {
                        blocks.push(7);
                        plain.push(7);
                    }
                    _ => {
                        let bytes: Vec<u8> = (0..size).map(|at| u8::try_from(at % 251).unwrap()).collect();
                        blocks.extend_from_slice(&bytes);
                        plain.extend_from_slice(&bytes);
                    }
                }
                prop_assert_eq!((blocks.as_slice(), blocks.len()), (plain.as_slice(), plain.len()));
                let whole = blocks.whole_blocks();
                prop_assert_eq!(whole.as_ptr().align_offset(BLOCK), 0);
                prop_assert_eq!(whole.len() % BLOCK, 0);
                prop_assert!(whole.len() < plain.len() + BLOCK);
                prop_assert_eq!(&whole[..plain.len()], plain.as_slice());
                prop_assert!(whole[plain.len()..].iter().all(|byte| *byte == 0));
            }
        }
    }

    #[test]
    fn memory_of_a_long_one_is_given_back() {
        let mut blocks = Blocks::of(1 << 20, 0);
        blocks.truncate(20);
        blocks.shrink_to(64 << 10);
        assert!(blocks.memory.len() <= (64 << 10) + 2 * BLOCK);
        assert_eq!(blocks.as_slice(), [0; 20]);
    }
}
