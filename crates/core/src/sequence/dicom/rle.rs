//! Run lengths (PS3.5, annex G): segments of bytes, each packed by itself.

/// Bytes of the head of a frame: the number of segments, and their places.
const HEAD: usize = 64;
const MOST_SEGMENTS: usize = 15;

/// Unpacks a frame of `segments` segments with `len` bytes each, one after the other. The error says why that
/// is not possible.
pub(super) fn unpack(frame: &[u8], segments: usize, len: usize) -> Result<Vec<Vec<u8>>, String> {
    let head = frame.get(..HEAD).ok_or("a frame is cut off")?;
    let numbers = || head.as_chunks::<4>().0.iter().map(|four| u32::from_le_bytes(*four) as usize);
    let count = numbers().next().unwrap_or(0);
    if count != segments || segments > MOST_SEGMENTS {
        return Err(format!("a frame has {count} segments instead of {segments}"));
    }
    let starts: Vec<usize> = numbers().skip(1).take(segments).collect();
    let end_of = |i: usize| starts.get(i + 1).copied().unwrap_or(frame.len());
    let segment = |i: usize| {
        let packed = frame.get(starts[i]..end_of(i)).ok_or("a segment lies outside of its frame")?;
        unpack_segment(packed, len)
    };
    (0..segments).map(segment).collect()
}

fn unpack_segment(packed: &[u8], len: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut rest = packed;
    while bytes.len() < len {
        let (&code, tail) = rest.split_first().ok_or("a segment is too short")?;
        let code = code as i8;
        rest = match code {
            0.. => {
                let (own, tail) = tail.split_at_checked(code as usize + 1).ok_or("a segment is cut off")?;
                bytes.extend(own);
                tail
            }
            i8::MIN => tail,
            _ => {
                let (&byte, tail) = tail.split_first().ok_or("a segment is cut off")?;
                bytes.resize(bytes.len() + usize::from(code.unsigned_abs()) + 1, byte);
                tail
            }
        };
    }
    bytes.truncate(len);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_and_single_bytes_are_unpacked() {
        // Packed bytes of PS3.5, annex G: two literals, a run of three, nothing.
        assert_eq!(unpack_segment(&[1, 7, 8, 0xfe, 9, 0x80], 5).unwrap(), [7, 8, 9, 9, 9]);
        assert!(unpack_segment(&[1, 7], 2).is_err() && unpack_segment(&[0, 1], 2).is_err());
    }
}
