//! NumPy arrays. (The format: numpy.lib.format.)

use super::{NumberType, open_regular};
use crate::{Error, Result};
use ndarray::{ArrayD, IxDyn, ShapeBuilder};
use std::{
    io::{BufReader, Read},
    path::Path,
};

const MAGIC: &[u8] = b"\x93NUMPY";
/// Largest size of a header in bytes; NumPy itself reads 10,000.
const MOST_HEADER: usize = 1 << 16;
/// Largest number of axes; NumPy has no more.
const MOST_AXES: usize = 64;

/// Reads a NumPy array of any real number type: its shape and its values in row-major order.
///
/// Memory is taken only once the file is known to hold as many values as its header says.
pub fn npy(path: &Path) -> Result<(Vec<usize>, Vec<f64>)> {
    read(path, |v| v)
}

/// Reads an array like [`npy`], rounded to single precision.
pub(crate) fn npy_f32(path: &Path) -> Result<(Vec<usize>, Vec<f32>)> {
    read(path, |v| v as f32)
}

fn read<T: Clone>(path: &Path, of: fn(f64) -> T) -> Result<(Vec<usize>, Vec<T>)> {
    let fail = |e| Error::io("read the array", path, e);
    let wrong = |what: String| {
        Error::input_at(
            path,
            format!("the array cannot be read: {what}"),
            "Save it as float32 with numpy.save.",
        )
    };
    let file = open_regular(path).map_err(fail)?;
    let len = file.metadata().map_err(fail)?.len();
    let mut file = BufReader::new(file.take(len));
    let (header, start) = NpyHeader::read(&mut file).map_err(|e| match e {
        Problem::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => fail(e),
        Problem::Io(_) => wrong("the file ends within its header".into()),
        Problem::What(what) => wrong(what),
    })?;
    let NpyHeader { shape, number, is_fortran } = header;
    // An empty axis makes the product 0; the other axes must be valid sizes all the same.
    let places = shape.iter().try_fold(8_usize, |n, &axis| n.checked_mul(axis.max(1)));
    let count: usize = if shape.contains(&0) { 0 } else { places.unwrap_or(0) / 8 };
    let there = len.saturating_sub(start);
    if places.is_none_or(|n| n > isize::MAX as usize) || (count * number.size) as u64 != there {
        return Err(wrong(format!(
            "its header says {shape:?} of {} bytes each, but {there} bytes follow",
            number.size
        )));
    }
    let mut values = Vec::with_capacity(count);
    let mut item = [0; 8];
    for _ in 0..count {
        file.read_exact(&mut item[..number.size]).map_err(fail)?;
        values.push(of(number.read(&item[..number.size])));
    }
    if is_fortran && shape.len() > 1 {
        let array = ArrayD::from_shape_vec(IxDyn(&shape).f(), values).map_err(|e| wrong(e.to_string()))?;
        values = array.iter().cloned().collect();
    }
    Ok((shape, values))
}

/// The reason why a header was not read.
enum Problem {
    Io(std::io::Error),
    What(String),
}

impl From<std::io::Error> for Problem {
    fn from(e: std::io::Error) -> Self {
        Self::Io(e)
    }
}

/// Shape and number type of an array.
struct NpyHeader {
    shape: Vec<usize>,
    number: NumberType,
    is_fortran: bool,
}

impl NpyHeader {
    /// Reads the header and returns it with the position of its end.
    fn read(file: &mut impl Read) -> Result<(Self, u64), Problem> {
        let mut start = [0; 8];
        file.read_exact(&mut start)?;
        let length_bytes = match (start.strip_prefix(MAGIC), start[6]) {
            (Some(_), 1) => 2,
            (Some(_), 2 | 3) => 4,
            _ => return Err(Problem::What("this is not a NumPy file of version 1 to 3".into())),
        };
        let mut length = [0; 4];
        file.read_exact(&mut length[..length_bytes])?;
        let length = u32::from_le_bytes(length) as usize;
        if length > MOST_HEADER {
            return Err(Problem::What(format!("its header has {length} bytes")));
        }
        let mut text = vec![0; length];
        file.read_exact(&mut text)?;
        let text = String::from_utf8_lossy(&text);
        let header = Self::parse(&text).map_err(Problem::What)?;
        Ok((header, (start.len() + length_bytes + length) as u64))
    }

    /// Parses a Python dictionary such as `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`.
    fn parse(text: &str) -> Result<Self, String> {
        let mut rest = Words(text);
        let (mut shape, mut number, mut is_fortran) = (None, None, None);
        rest.expect("{")?;
        while !rest.eat("}") {
            let key = rest.quoted()?;
            rest.expect(":")?;
            match key {
                "descr" => number = Some(number_type(rest.quoted()?)?),
                "fortran_order" => is_fortran = Some(rest.truth()?),
                "shape" => shape = Some(rest.tuple()?),
                other => return Err(format!("its header has the unknown key {other:?}")),
            }
            if !rest.eat(",") {
                rest.expect("}")?;
                break;
            }
        }
        match (shape, number, is_fortran) {
            (Some(shape), Some(number), Some(is_fortran)) => Ok(Self { shape, number, is_fortran }),
            _ => Err("its header lacks descr, fortran_order or shape".into()),
        }
    }
}

fn number_type(descr: &str) -> Result<NumberType, String> {
    let (order, name) = descr.split_at_checked(1).unwrap_or_default();
    let known = match order {
        "<" | "|" => NumberType::named(name, false),
        ">" => NumberType::named(name, true),
        _ => None,
    };
    known.ok_or_else(|| format!("its number type {descr:?} is not supported"))
}

/// Rest of a header's text.
struct Words<'a>(&'a str);

impl<'a> Words<'a> {
    fn eat(&mut self, what: &str) -> bool {
        self.0 = self.0.trim_start();
        let rest = self.0.strip_prefix(what);
        self.0 = rest.unwrap_or(self.0);
        rest.is_some()
    }

    fn expect(&mut self, what: &str) -> Result<(), String> {
        if self.eat(what) {
            return Ok(());
        }
        let found: String = self.0.chars().take(20).collect();
        Err(format!("its header should have {what:?} where it has {found:?}"))
    }

    fn quoted(&mut self) -> Result<&'a str, String> {
        let quote = if self.eat("\"") {
            '"'
        } else {
            self.expect("'")?;
            '\''
        };
        let (text, rest) = self.0.split_once(quote).ok_or("its header ends within a word")?;
        self.0 = rest;
        Ok(text)
    }

    fn truth(&mut self) -> Result<bool, String> {
        if self.eat("True") {
            return Ok(true);
        }
        self.expect("False").map(|()| false)
    }

    /// Parses whole numbers in round brackets. Python 2 wrote an L after some.
    fn tuple(&mut self) -> Result<Vec<usize>, String> {
        let mut numbers = Vec::new();
        self.expect("(")?;
        while !self.eat(")") {
            let end = self.0.find(|c: char| !c.is_ascii_digit()).unwrap_or(self.0.len());
            let (digits, rest) = self.0.split_at(end);
            numbers.push(digits.parse().map_err(|_| format!("its header has the axis {digits:?}"))?);
            self.0 = rest;
            self.eat("L");
            if numbers.len() > MOST_AXES {
                return Err(format!("it has more than {MOST_AXES} axes"));
            }
            if !self.eat(",") {
                self.expect(")")?;
                break;
            }
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, data: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let length = (header.len() as u16).to_le_bytes();
        std::fs::write(&path, [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()).unwrap();
        (folder, path)
    }

    fn read(header: &str, data: &[u8]) -> Result<(Vec<usize>, Vec<f64>)> {
        let (_folder, path) = file(header, data);
        npy(&path)
    }

    #[test]
    fn arrays_of_all_orders_are_read() {
        let header = |descr: &str, fortran: &str, shape: &str| {
            format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}   \n")
        };
        let bytes = [1, 2, 3, 4, 5, 6];
        let rows = (vec![2, 3], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(read(&header("|u1", "False", "(2, 3)"), &bytes).unwrap(), rows);
        assert_eq!(read(&header("|u1", "False", "(2L, 3L)"), &bytes).unwrap(), rows);
        let columns = read(&header("|u1", "True", "(2, 3)"), &bytes).unwrap();
        assert_eq!(columns, (vec![2, 3], vec![1.0, 3.0, 5.0, 2.0, 4.0, 6.0]));
        assert_eq!(read(&header(">u2", "False", "(3,)"), &bytes).unwrap().1, [258.0, 772.0, 1286.0]);
        assert_eq!(read(&header("<i2", "False", "()"), &bytes[..2]).unwrap(), (vec![], vec![513.0]));
        assert_eq!(read(&header("<f4", "True", "(0, 512)"), &[]).unwrap(), (vec![0, 512], vec![]));
    }

    #[test]
    fn what_the_library_writes_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let array = ndarray::array![[1.5_f32, -2.0], [f32::MAX, 0.0]];
        ndarray_npy::write_npy(&path, &array).unwrap();
        assert_eq!(npy_f32(&path).unwrap(), (vec![2, 2], array.iter().copied().collect()));
        ndarray_npy::write_npy(&path, &array.t()).unwrap();
        assert_eq!(npy_f32(&path).unwrap().1, [1.5, f32::MAX, -2.0, 0.0]);
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused_before_memory_is_taken() {
        for shape in [
            "(1000000000, 17)",
            "(0, 99999999999999999999)",
            "(4294967296, 4294967296)",
            "(4294967296, 4294967296, 0)",
            "(1,)",
            "(3,)",
        ] {
            let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}");
            let what = read(&header, &[0; 16]).unwrap_err().to_string();
            assert!(what.contains("the array cannot be read"), "{shape}: {what}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let nested = format!("{{'descr': {}, 'fortran_order': False, 'shape': (1,)}}", "[".repeat(30_000));
        for header in [
            "",
            "{",
            "{}",
            "{'descr': '<f4'}",
            "{'descr': '<f4",
            "{'shape': (1",
            "{'shape': (,)}",
            "{'shape': (-1,)}",
            "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}",
            "{'descr': '', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': 'é4', 'fortran_order': False, 'shape': (1,)}",
            &format!("{{'shape': ({})}}", "1,".repeat(1000)),
            &nested,
        ] {
            assert!(read(header, &[0; 4]).unwrap_err().to_string().contains("cannot be read"), "{header}");
        }
        let (_folder, path) = file("", b"");
        for bytes in [&b""[..], b"\x93NUMPY", b"\x93NUMPY\x02\x00\xff\xff\xff\xff", b"PK\x03\x04and more"] {
            std::fs::write(&path, bytes).unwrap();
            assert!(npy(&path).unwrap_err().to_string().contains("cannot be read"));
        }
    }
}
