//! Numbers in binary files.

use half::f16;

/// Storage format of a number.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NumberType {
    /// Number of bytes of a number.
    pub(crate) size: usize,
    is_big_endian: bool,
    of_bits: fn(u64) -> f64,
}

impl NumberType {
    /// Returns the type by NumPy's letter and number of bytes, e.g. "f4"; `None` if it is no real number.
    pub(crate) fn named(name: &str, is_big_endian: bool) -> Option<Self> {
        let (size, of_bits): (usize, fn(u64) -> f64) = match name {
            "b1" => (1, |bits| f64::from(u8::from(bits != 0))),
            "u1" => (1, |bits| bits as f64),
            "u2" => (2, |bits| bits as f64),
            "u4" => (4, |bits| bits as f64),
            "u8" => (8, |bits| bits as f64),
            "i1" => (1, |bits| f64::from(bits as i8)),
            "i2" => (2, |bits| f64::from(bits as i16)),
            "i4" => (4, |bits| f64::from(bits as i32)),
            "i8" => (8, |bits| bits as i64 as f64),
            "f2" => (2, |bits| f16::from_bits(bits as u16).to_f64()),
            "f4" => (4, |bits| f64::from(f32::from_bits(bits as u32))),
            "f8" => (8, f64::from_bits),
            _ => return None,
        };
        Some(Self { size, is_big_endian, of_bits })
    }

    /// Returns the number stored in `size` bytes.
    pub(crate) fn read(&self, bytes: &[u8]) -> f64 {
        let mut eight = [0; 8];
        eight[..bytes.len()].copy_from_slice(bytes);
        if self.is_big_endian {
            eight[..bytes.len()].reverse();
        }
        (self.of_bits)(u64::from_le_bytes(eight))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_type_are_read_in_both_orders() {
        let check = |name: &str, little: &[u8], value: f64| {
            let mut big = little.to_vec();
            big.reverse();
            for (bytes, is_big) in [(little, false), (&big, true)] {
                let number = NumberType::named(name, is_big).unwrap();
                assert_eq!((number.size, number.read(bytes)), (little.len(), value), "{name}");
            }
        };
        check("b1", &[7], 1.0);
        check("u1", &[200], 200.0);
        check("i1", &[200], -56.0);
        check("u2", &60_000_u16.to_le_bytes(), 60_000.0);
        check("i2", &(-2_i16).to_le_bytes(), -2.0);
        check("u4", &u32::MAX.to_le_bytes(), f64::from(u32::MAX));
        check("i4", &(-2_i32).to_le_bytes(), -2.0);
        check("u8", &(1_u64 << 40).to_le_bytes(), (1_u64 << 40) as f64);
        check("i8", &(-2_i64).to_le_bytes(), -2.0);
        check("f2", &f16::from_f64(-1.5).to_le_bytes(), -1.5);
        check("f4", &0.25_f32.to_le_bytes(), 0.25);
        check("f8", &0.1_f64.to_le_bytes(), 0.1);
        assert!(["c8", "U5", "O", "", "f16"].iter().all(|name| NumberType::named(name, false).is_none()));
    }
}
