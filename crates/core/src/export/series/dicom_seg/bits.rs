//! Packing of masks, one bit per pixel, the lowest bit of a byte first (PS3.5, 8.1.1 and D). Frames follow
//! each other without a gap, so that one may begin within a byte.

/// The bits that do not fill a byte yet.
#[derive(Default)]
pub(super) struct Bits {
    byte: u8,
    count: u32,
}

impl Bits {
    /// Adds a mask; full bytes go to `out`.
    pub(super) fn push(&mut self, mask: &[bool], out: &mut Vec<u8>) {
        for bit in mask {
            self.byte |= u8::from(*bit) << self.count;
            self.count += 1;
            if self.count == u8::BITS {
                out.push(self.byte);
                *self = Self::default();
            }
        }
    }

    /// Returns the last byte, if it is not full.
    pub(super) fn rest(self) -> Option<u8> {
        (self.count > 0).then_some(self.byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_follow_each_other_within_a_byte() {
        let (mut bits, mut out) = (Bits::default(), Vec::new());
        bits.push(&[true, false, true], &mut out);
        bits.push(&[false, false, true, false, false, true], &mut out);
        assert_eq!((out.as_slice(), bits.rest()), (&[0b0010_0101][..], Some(1)));
    }
}
