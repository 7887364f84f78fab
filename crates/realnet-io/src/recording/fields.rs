//! The fields of MCAP records: little-endian numbers, and bytes, text and maps
//! behind their length.

use std::collections::BTreeMap;

/// What is left of a record's bytes. Every read is `None` where too few are left.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind a length of 32 bits.
    fn counted(&mut self) -> Option<&'a [u8]> {
        let count = self.u32()?;
        self.bytes(usize::try_from(count).ok()?)
    }

    /// Bytes behind a length of 64 bits.
    pub(super) fn long_counted(&mut self) -> Option<&'a [u8]> {
        let count = self.u64()?;
        self.bytes(usize::try_from(count).ok()?)
    }

    pub(super) fn text(&mut self) -> Option<String> {
        String::from_utf8(self.counted()?.to_vec()).ok()
    }

    pub(super) fn text_map(&mut self) -> Option<BTreeMap<String, String>> {
        let mut entries = Fields(self.counted()?);
        let mut map = BTreeMap::new();
        while !entries.0.is_empty() {
            map.insert(entries.text()?, entries.text()?);
        }
        Some(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_beyond_the_end_are_refused() {
        let map = b"\x0d\0\0\0\x01\0\0\0a\x05\0\0\0hello";
        let read = Fields(map).text_map();
        assert_eq!(read, None, "the map's length covers one byte less than its entry");
        let map = b"\x0e\0\0\0\x01\0\0\0a\x05\0\0\0helloX";
        let mut fields = Fields(map);
        assert_eq!(fields.text_map(), Some([("a".into(), "hello".into())].into()));
        assert_eq!(fields.0, b"X");
        assert_eq!(Fields(b"\xff\xff\xff\xffabc").text(), None);
        assert_eq!(Fields(b"\xff\xff\xff\xff\xff\xff\xff\xffabc").long_counted(), None);
        assert_eq!(Fields(b"\x01\0\0\0\xff").text(), None, "no UTF-8");
        assert_eq!(Fields(b"\x01").u16(), None);
    }
}
