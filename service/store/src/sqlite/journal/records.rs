//! Where the records of a journal's file begin and end, and which of them are whole.

use super::RECORD_HEAD;

/// The bodies of an epoch's records, in their order, up to the first that is not whole.
#[derive(Clone)]
pub(super) struct Records<'b> {
    bytes: &'b [u8],
    /// Each begins at a multiple of so many bytes.
    multiple: usize,
    epoch: u64,
    number: u32,
}

impl<'b> Records<'b> {
    pub(super) const fn of(bytes: &'b [u8], multiple: usize, epoch: u64) -> Self {
        Self { bytes, multiple, epoch, number: 0 }
    }

    /// Whether another record of the epoch stands behind the first that is not whole. That one was on the disk before the
    /// other was begun: it was acknowledged, and is damaged.
    pub(super) fn are_damaged(&self) -> bool {
        let mut rest = self.clone();
        rest.by_ref().for_each(drop);
        epochs(rest.bytes, rest.multiple).any(|epoch| epoch == self.epoch)
    }
}

impl<'b> Iterator for Records<'b> {
    type Item = &'b [u8];

    fn next(&mut self) -> Option<&'b [u8]> {
        let (epoch, number, body, rest) = record(self.bytes)?;
        if epoch != self.epoch || number != self.number {
            return None;
        }
        let end = (self.bytes.len() - rest.len()).next_multiple_of(self.multiple);
        self.bytes = self.bytes.get(end..).unwrap_or_default();
        self.number = number.checked_add(1)?;
        Some(body)
    }
}

/// The latest epoch of which a record is whole. Not that of the first record alone: that one may be damaged, or a write of it
/// lost, with others of its epoch behind it that were acknowledged.
pub(super) fn latest_epoch(records: &[u8], multiple: usize) -> Option<u64> {
    epochs(records, multiple).max()
}

/// The epochs of all records that are whole. Where they begin anywhere, that of the first alone: the others could not be told
/// from what is in them.
fn epochs(bytes: &[u8], multiple: usize) -> impl Iterator<Item = u64> {
    let places = if multiple > 1 { bytes.len() } else { bytes.len().min(1) };
    (0..places).step_by(multiple).filter_map(|at| record(&bytes[at..])).map(|(epoch, ..)| epoch)
}

/// The first record, where it is whole: its epoch, number and body, and what is behind it.
fn record(bytes: &[u8]) -> Option<(u64, u32, &[u8], &[u8])> {
    let (sum, summed) = bytes.split_first_chunk::<4>()?;
    let (length, rest) = summed.split_first_chunk::<4>()?;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
    let (epoch, rest) = rest.split_first_chunk::<8>()?;
    let (number, rest) = rest.split_first_chunk::<4>()?;
    let (body, rest) = rest.split_at_checked(length)?;
    let whole = crc32fast::hash(&summed[..RECORD_HEAD - 4 + length]) == u32::from_le_bytes(*sum);
    whole.then_some((u64::from_le_bytes(*epoch), u32::from_le_bytes(*number), body, rest))
}
